"""Bytes of files: read within bounds, unpacked; written whole or not at all, compressed by suffix.

Of a file that is not there the error has the names in its folder that are like it.
"""

import gzip
import os
import re
import secrets
import stat
import sys
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import BinaryIO

from models.errors import GraphFileError, GraphWarning, OptionError
from models.listing import some
from nls.io.bounded_text import BoundedText

GRAPH_FILES = ("graph.npz", "graph.g2o")  # of a folder, the first one counts
COPIED_TOGETHER = 0.1  # seconds between two files of one copy
CHUNK = 1 << 20
GZIP = b"\x1f\x8b"
ZIP = b"PK\x03\x04"
CARRIAGE_RETURN = rb"\r(?!\n)"  # alone
OPEN_FILES = r"/dev/fd|/proc/{}(/task/[0-9]+)?/fd"  # of a process, by number


def read_bytes(path: str | Path, archive: bool = False) -> bytes:
    """Content of a text file, unpacked where it is gzip-compressed, without a byte-order mark.

    Lines end in a newline or a carriage return, or both; where one ends in a carriage return alone, all end in newlines
    here.

    Parameters
    ----------
    path : a file, a pipe or a device.
    archive : whether it may be an archive of arrays instead, whose bytes stay as they are.

    Raises
    ------
    GraphFileError
        It cannot be read, or is not text.
    ResourceLimitError
        The text is too much, see `nls.io.bounded_text`; no more than half of the machine's memory is taken.
    """
    name = _name(path)
    try:
        with open(path, "rb") as file:
            BoundedText(f"{name}: has").refuse_above(os.fstat(file.fileno()).st_size)
            return read_stream(file, name, archive)
    except IsADirectoryError as error:
        raise GraphFileError("is a folder; expected a file", name) from error
    except OSError as error:
        raise unreadable(name, error) from error


def read_text(path: str | Path) -> str:
    """The text of a file in UTF-8, otherwise as `read_bytes`.

    Raises
    ------
    GraphFileError
        It cannot be read, or is not UTF-8.
    """
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise GraphFileError(f"is no text in UTF-8: {error.reason}; save it as UTF-8", _name(path)) from error


def read_stream(file: BinaryIO, name: str, archive: bool = False) -> bytes:
    """The content of an open file or pipe; the name is for messages, the rest as for `read_bytes`.

    Raises
    ------
    OSError
        It cannot be read.
    """
    first = file.read(CHUNK)
    if first[:2] != GZIP:
        chunks = chain([first], iter(partial(file.read, CHUNK), b""))
        return _content(chunks, BoundedText(f"{name}: has"), name, archive)
    try:
        return _content(_unpacked(first, file, name), BoundedText(f"{name}: unpacks to"), name, archive)
    except EOFError as error:
        raise GraphFileError(f"is not a complete gzip file: {error}", name) from error
    except zlib.error as error:
        raise GraphFileError(f"is a damaged gzip file: {error}", name) from error


def _name(path: object) -> str:
    """The path as text; numbers, which `open` takes for open files of the process, are none."""
    if not isinstance(path, str | os.PathLike):
        raise OptionError("path", path, "a file name")
    return os.fsdecode(path)


def _unpacked(packed: bytes, file: BinaryIO, name: str) -> Iterator[bytes]:
    """The chunks of a gzip file, of one stream after the other, whose first bytes were read before.

    Raises
    ------
    GraphFileError
        Something else follows.
    EOFError, zlib.error
        It is cut off; it is damaged.
    """
    while packed:
        stream = zlib.decompressobj(wbits=31)
        while not stream.eof:
            yield (chunk := stream.decompress(packed, CHUNK))
            packed = stream.unconsumed_tail
            if not (packed or stream.eof or len(chunk) == CHUNK or (packed := file.read(CHUNK))):
                raise EOFError("it ends within its data")
        packed = (stream.unused_data or file.read(CHUNK)).lstrip(b"\x00")  # zeros fill up what is written in blocks
        if not GZIP.startswith(packed[:2]):
            count = len(packed) + len(file.read(CHUNK))
            more = " or more" * (file.read(1) != b"")
            raise GraphFileError(f"is complete as a gzip file, and {count:,} bytes{more} that are no gzip follow", name)


def _content(chunks: Iterator[bytes], text: BoundedText, name: str, archive: bool) -> bytes:
    """The text of a file, or the bytes of an archive."""
    first = next(chunks, b"")
    if archive and first.startswith(ZIP):
        for chunk in chain([first], chunks):
            text.add_binary(chunk)
        return b"".join(text.chunks)
    if first[:4] in (b"\xff\xfe\x00\x00", b"\x00\x00\xfe\xff"):
        raise GraphFileError("is UTF-32 text; save it as UTF-8 or ASCII", name)
    if first[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise GraphFileError("is UTF-16 text; save it as UTF-8 or ASCII", name)
    if first.startswith(b"MATLAB 5.0 MAT-file"):
        raise GraphFileError("is a MATLAB file; expected text (scipy.io.loadmat reads it)", name)
    for chunk in chain([first.removeprefix(b"\xef\xbb\xbf")], chunks):
        if (zero := chunk.find(b"\x00")) >= 0:
            line = sum(piece.count(b"\n") for piece in [*text.chunks, chunk[:zero]]) + 1
            raise GraphFileError("has a zero byte: this is a binary file, expected text", name, line)
        text.add(chunk)
    data = b"".join(text.chunks)
    text.chunks.clear()
    if b"\r" in data and re.search(CARRIAGE_RETURN, data):
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file whole or not at all, gzip-compressed (equal content, equal bytes) where its name ends in ``.gz``.

    A symbolic link stays and the file it leads to is replaced, with its permissions; of hard links only this name gets
    the new content. A pipe or device is written to, and so is an open file of the process, such as ``/dev/stdout``.

    Raises
    ------
    GraphFileError
        It cannot be written; it is write-protected.
    """
    _write_all({_name(path): data})


def descriptor(name: str) -> int | None:
    """The open file of this process that a name such as ``/dev/stdout`` or ``/dev/fd/3`` stands for; None of others.

    Its content belongs to whoever opened it: such a file is written to where it stands, and never replaced.

    Examples
    --------
    >>> descriptor("/dev/null"), descriptor("graph.g2o")
    (None, None)
    """
    for _ in range(40):  # links one by one: the last one leads from the number to the file itself
        folder, last = os.path.split(name)
        folder = os.path.realpath(folder)
        if re.fullmatch(OPEN_FILES.format(os.getpid()), folder) and last.isascii() and last.isdigit():
            return int(last)
        name = os.path.join(folder, last)
        if not os.path.islink(name):
            return None
        name = os.path.join(folder, os.readlink(name))
    return None


def graph_file(path: str | Path) -> str | Path:
    """The file ``graph.npz`` or ``graph.g2o`` of a folder without tables; otherwise the path itself.

    A `GraphWarning` names the second one where it is newer, as after an edit.
    """
    is_folder = isinstance(path, str | os.PathLike) and os.path.isdir(path) and not any(Path(path).glob("*.csv*"))
    files = [file for name in GRAPH_FILES if is_folder and (file := Path(path, name)).is_file()]
    for other in files[1:]:
        if other.stat().st_mtime > files[0].stat().st_mtime + COPIED_TOGETHER:
            newer = f"{other.name} is newer than {files[0].name}, which was read; give {other}"
            warnings.warn(f"{path}: {newer}", GraphWarning, stacklevel=4)
    return str(files[0]) if files else path


def title_of(path: str | Path) -> str:
    """The name of a graph in a picture: that of its file, or of the folder whose `graph_file` it is.

    Examples
    --------
    >>> title_of("demo/graph.npz"), title_of("logs/survey.g2o"), title_of("graph.npz")
    ('demo', 'survey.g2o', 'graph.npz')
    """
    file = Path(path)
    return file.parent.name or file.name if file.name in GRAPH_FILES else file.name


def names_folder(name: str) -> bool:
    """Whether a name can only be that of a folder, such as ``solved/``."""
    return os.path.basename(name) in ("", os.curdir, os.pardir)


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
    with new_folder(folder):
        _write_all({str(Path(folder, name)): data for name, data in files.items()})
    return [str(Path(folder, name)) for name in files]


@contextmanager
def new_folder(folder: str | Path) -> Iterator[None]:
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


def _mode(name: str) -> int | None:
    """Type and permissions of a file; None where there is none, or where a link leads to none."""
    try:
        return os.stat(name).st_mode
    except FileNotFoundError:
        return None


def _append(number: int, data: bytes) -> None:
    """Write to an open file, behind what the process has printed so far."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    with open(number, "wb", closefd=False) as file:
        file.write(data)


def _write_all(files: Mapping[str, bytes]) -> None:
    """Write all files beside their places, then move them there: a disk that fills up leaves them as they were."""
    moves: list[tuple[str, Path, Path]] = []
    name = ""
    try:
        for name, data in files.items():
            content = gzip.compress(data, mtime=0) if name.lower().endswith(".gz") else data
            if (number := descriptor(name)) is not None:
                _append(number, content)
                continue
            if names_folder(name):
                raise IsADirectoryError(0, "its name is that of a folder")
            mode = _mode(name)
            if mode is not None and not stat.S_ISREG(mode):
                Path(name).write_bytes(content)
                continue
            if mode is not None and not os.access(name, os.W_OK):
                raise PermissionError(0, "it is write-protected; allow it with chmod, or give another name")
            target = Path(os.path.realpath(name))
            temporary = target.with_name(f"{secrets.token_hex(8)}.part")
            with open(temporary, "xb") as file:
                moves.append((name, temporary, target))
                file.write(content)
                file.flush()
                os.fsync(file.fileno())  # before it replaces what was there
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


def unreadable(path: str | Path, error: OSError) -> GraphFileError:
    """The error for a file or folder that the system does not read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Path(folder, "survey.g2o").touch()
    ...     for name in ("survye.g2o", "survey.g20", "log.g2o", "log.csv"):
    ...         print(unreadable(Path(folder, name), FileNotFoundError(0, "not there")).message.split("read: ")[1])
    not there; did you mean 'survey.g2o'?
    not there; did you mean 'survey.g2o'?
    not there; its folder has survey.g2o
    not there
    """
    near = _near(Path(path)) if isinstance(error, FileNotFoundError) else ""
    return GraphFileError(f"cannot be read: {error.strerror or error}{near}", os.fspath(path))


def refuse_absent(paths: Iterable[str | Path]) -> None:
    """Refuse files and folders that are not there.

    Raises
    ------
    GraphFileError
        The first of them; see `unreadable`.
    """
    for path in paths:
        try:
            os.stat(path)
        except OSError as error:
            raise unreadable(path, error) from error


def _near(path: Path) -> str:
    """The name in the folder of a missing file that is nearest to its own; else those with its ending."""
    from difflib import get_close_matches

    folder = path.parent
    if not folder.is_dir():
        return f"; there is no folder {str(folder)!r}"
    try:
        names = sorted(name for name in os.listdir(folder) if not name.startswith("."))
    except OSError:
        return ""  # a folder that may be entered and not listed
    like = [name for name in names if Path(name).suffix == path.suffix]
    near = get_close_matches(path.stem, [Path(name).stem for name in like], 1)
    if near := [near[0] + path.suffix] if near else get_close_matches(path.name, [] if like else names, 1):
        return f"; did you mean {near[0]!r}?"
    return f"; its folder has {some(like)}" if like and path.suffix else ""
