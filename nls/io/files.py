"""Bytes of files: read within bounds, unpacked; written whole or not at all, compressed by suffix."""

from __future__ import annotations

import gzip
import io
import os
import secrets
import stat
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from models.errors import GraphFileError, OptionError, ResourceLimitError

__all__ = ["made", "read_bytes", "write_bytes", "write_folder"]

MAX_BYTES = 4 << 30  # of a file, and of what it unpacks to
CHUNK = 1 << 24


def read_bytes(path: str | Path) -> bytes:
    """Content of a text file, unpacked when it is gzip-compressed, without a byte-order mark.

    Raises
    ------
    GraphFileError
        It cannot be read, or is not text.
    ResourceLimitError
        It has more than `MAX_BYTES`, or unpacks to more.
    """
    name = _name(path)
    try:
        with open(path, "rb") as file:
            data = _bounded(file, f"{name}: has", os.fstat(file.fileno()).st_size)
    except IsADirectoryError as error:
        raise GraphFileError("is a folder; expected a file", name) from error
    except OSError as error:
        raise GraphFileError(f"cannot be read: {error.strerror or error}", name) from error
    if data[:2] == b"\x1f\x8b":
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as unpacked:
                data = _bounded(unpacked, f"{name}: unpacks to")
        except (OSError, EOFError, zlib.error) as error:
            raise GraphFileError(f"is not a complete gzip file: {error}", name) from error
    data = data.removeprefix(b"\xef\xbb\xbf")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise GraphFileError("is UTF-16 text; save it as UTF-8 or ASCII", name)
    if data.startswith(b"MATLAB 5.0 MAT-file"):
        raise GraphFileError("is a MATLAB file; expected text (scipy.io.loadmat reads it)", name)
    if b"\x00" in data:
        line = data[: data.index(b"\x00")].count(b"\n") + 1
        raise GraphFileError("has a zero byte: this is a binary file, expected text", name, line)
    return data


def _name(path: object) -> str:
    """The path as text; numbers, which `open` takes for open files of the process, are none."""
    if not isinstance(path, str | os.PathLike):
        raise OptionError("path", path, "a file name")
    return os.fsdecode(path)


def _bounded(file: BinaryIO | gzip.GzipFile, what: str, size: int = 0) -> bytes:
    """All of a file of at least this size, read in chunks: refused as soon as it is known to be too large."""
    chunks: list[bytes] = []
    total = 0
    while max(size, total) <= MAX_BYTES:
        chunk = file.read(CHUNK)
        if not chunk:
            return b"".join(chunks)
        chunks.append(chunk)
        total += len(chunk)
    needed = max(size, total)
    raise ResourceLimitError(
        f"{what} {needed:,} bytes or more, the limit is {MAX_BYTES:,}; split the file or leave lines out",
        needed,
        MAX_BYTES,
        what,
    )


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file whole or not at all, gzip-compressed (equal content, equal bytes) where its name ends in ``.gz``.

    A link stays and the file it leads to is replaced, with its permissions; a pipe or device is written to.

    Raises
    ------
    GraphFileError
        It cannot be written.
    """
    _write_all({_name(path): data})


def write_folder(folder: str | Path, files: Mapping[str, bytes]) -> list[str]:
    """Write files into a folder, which is made where there is none: all of them or none, see `write_bytes`.

    Parameters
    ----------
    folder : where.
    files : content by name.

    Returns
    -------
    list of str
        The files that were written.

    Raises
    ------
    GraphFileError
        The folder cannot be made, or a file cannot be written. The folder is as it was.
    """
    with made(folder):
        _write_all({str(Path(folder, name)): data for name, data in files.items()})
    return [str(Path(folder, name)) for name in files]


@contextmanager
def made(folder: str | Path) -> Iterator[None]:
    """A folder that is there, made where it is not; one that was made goes again if nothing was written into it.

    Raises
    ------
    GraphFileError
        The folder cannot be made.
    """
    path = Path(folder)
    missing = [place for place in (path, *path.parents) if not os.path.lexists(place)]
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GraphFileError(
                f"cannot be made: {error.strerror or error}; give another folder", str(folder)
            ) from error
        yield
    finally:
        for place in missing:
            with suppress(OSError):  # it has files, or was not made
                place.rmdir()


def _write_all(files: Mapping[str, bytes]) -> None:
    """Write all files beside their places, then move them there: a disk that fills up leaves them as they were."""
    moves: list[tuple[str, Path, Path]] = []
    name = ""
    try:
        for name, data in files.items():
            content = gzip.compress(data, mtime=0) if name.lower().endswith(".gz") else data
            mode = os.stat(name).st_mode if os.path.exists(name) else None
            if mode is not None and not stat.S_ISREG(mode):
                with open(name, "wb") as file:
                    file.write(content)
                continue
            target = Path(os.path.realpath(name))
            temporary = target.with_name(f"{secrets.token_hex(8)}.part")
            with open(temporary, "xb") as file:
                moves.append((name, temporary, target))
                file.write(content)
            if mode is not None:
                os.chmod(temporary, stat.S_IMODE(mode))
        for place, temporary, target in moves:
            name = place
            os.replace(temporary, target)
    except OSError as error:
        raise GraphFileError(f"cannot be written: {error.strerror or error}", name) from error
    finally:
        for _, temporary, _ in moves:
            temporary.unlink(missing_ok=True)
