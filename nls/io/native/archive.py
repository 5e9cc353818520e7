"""Named arrays in one ``.npz`` file: as `numpy.savez` writes them, read without pickles and within bounds."""

from __future__ import annotations

import sys
import warnings
import zipfile
import zlib
from io import BytesIO
from tokenize import TokenError

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from models.errors import GraphFileError, ResourceLimitError
from nls.io.text import printable

Arrays = dict[str, npt.NDArray[np.generic]]
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every array: the same graph is the same file
KINDS = {"f": np.float64, "i": np.int64, "u": np.int64, "b": np.bool_, "U": np.str_}
DAMAGES = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError)


def archived(arrays: Arrays) -> bytes:
    """The bytes of a file of these arrays."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            content = BytesIO()
            npy.write_array(content, np.asarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", EPOCH), content.getvalue())
    return out.getvalue()


def arrays_of(data: bytes, path: str, noun: str = "npz file") -> Arrays:
    """The arrays of a file; the noun says in errors what it should be.

    Raises
    ------
    GraphFileError
        It is damaged, or holds something else than numbers and text.
    ResourceLimitError
        It claims to unpack to far more than its size.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = archive.infolist()
            if any(info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for info in members):
                raise ValueError("it is packed in a way that NumPy does not write")
            claimed = sum(info.file_size for info in members)
            if claimed > (limit := 64 * len(data) + (1 << 20)):
                size = f"{claimed:,} bytes, the limit for its {len(data):,} is {limit:,}"
                raise ResourceLimitError(f"{path}: claims to unpack to {size}", claimed, limit)
            return {i.filename.removesuffix(".npy"): _array(_content(archive, i), i.filename) for i in members}
    except DAMAGES as error:
        raise GraphFileError(f"is a damaged {noun}: {printable(str(error).encode(), 200)}", path) from error


def _content(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """The bytes of a member, and no more than it claims to have."""
    with archive.open(member) as file:
        content = file.read(member.file_size + 1)
        if len(content) == member.file_size and not file.read(1):  # the end: the sum is checked
            return content
    raise ValueError(f"{member.filename!r:.60} has not the size that it claims")


def _array(content: bytes, name: str) -> npt.NDArray[np.generic]:
    """One array, of its header and exactly the numbers that the header says."""
    file = BytesIO(content)
    version = npy.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{name!r:.60} has version {version} of its header, expected 1.0 or 2.0")
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy's for a header of Python 2
            shape, columns_first, dtype = read(file)
    except (TypeError, ValueError, MemoryError, SyntaxError, TokenError, UserWarning) as error:
        raise ValueError(f"the header of {name!r:.60} is damaged") from error
    if dtype.kind not in KINDS:
        raise ValueError(f"{name!r:.60} holds {dtype}, expected numbers or text")
    if any(type(length) is not int for length in shape):
        raise ValueError(f"{name!r:.60} has the shape {shape!r:.60}")
    count, rest = 1, content[file.tell() :]
    for length in shape:
        count *= length
    if count * dtype.itemsize != len(rest):
        raise ValueError(f"{name!r:.60} says {count} numbers of {dtype}, and has {len(rest)} bytes")
    if dtype.kind == "U" and (np.frombuffer(rest, dtype.byteorder.replace("|", "=") + "u4") > sys.maxunicode).any():
        raise ValueError(f"{name!r:.60} holds numbers that are no characters")
    array = np.frombuffer(rest, dtype) if rest else np.zeros(0, dtype)
    return array.reshape(shape, order="F" if columns_first else "C").astype(KINDS[dtype.kind], order="K")
