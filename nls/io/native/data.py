"""The two forms of plain data: JSON, and named arrays in one ``.npz`` file.

JSON has arrays as lists, for people, or the names of arrays that stand elsewhere. Archives are as `numpy.savez` writes
them, read without pickles and within bounds.
"""

import json
import re
import sys
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from tokenize import TokenError
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from models.errors import GraphFileError, ResourceLimitError
from nls.io.text import printable

Arrays = dict[str, npt.NDArray[np.generic]]
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every array: the same graph is the same file
KINDS = {"f": np.float64, "i": np.int64, "u": np.int64, "b": np.bool_, "U": np.str_}
DAMAGES = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError)
STRING = r'"(?:[^"\\]|\\.)*"'
KEY = re.compile(rf"({STRING})\s*:|{STRING}|[{{}}]")  # keys, other strings, ends of dictionaries


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
    raise ValueError(f"{member.filename!r:.60} does not have the size that it claims")


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


def json_of(plain: Any, depth: int = 0) -> str:
    """The text of plain data: a line for every entry of a dictionary, and for every row of an array.

    Examples
    --------
    >>> print(json_of({"z": np.array([[1.0, 0.5], [2.0, 0.25]]), "components": ("x", "y"), "offset": np.zeros((0, 3))}))
    {
     "z": [
      [1.0, 0.5],
      [2.0, 0.25]
     ],
     "components": {"tuple": ["x", "y"]},
     "offset": {"shape": [0, 3]}
    }
    """
    if isinstance(plain, np.ndarray):
        if not plain.size:
            return json.dumps({"shape": plain.shape})
        rows = [json.dumps(row, allow_nan=False) for row in plain.tolist()] if plain.ndim > 1 else []
        return _lines("[", rows, "]", depth) if rows else json.dumps(plain.tolist(), allow_nan=False)
    if isinstance(plain, tuple):
        texts = [json_of(item, depth) for item in plain]
        return f'{{"tuple": [{", ".join(texts)}]}}'
    if isinstance(plain, Mapping):
        entries = [f"{json.dumps(name)}: {json_of(value, depth + 1)}" for name, value in plain.items()]
        return _lines("{", entries, "}", depth)
    return json.dumps(plain, allow_nan=False)


def _lines(begin: str, lines: list[str], end: str, depth: int) -> str:
    """Brackets around lines, which stand further to the right."""
    joined = ",\n".join(" " * (depth + 1) + line for line in lines)
    return f"{begin}\n{joined}\n{' ' * depth}{end}" if lines else begin + end


def without_arrays(plain: Any, arrays: dict[str, Any], name: str = "") -> Any:
    """Plain data with the name of an array in the place of each; the arrays are added by name."""
    if isinstance(plain, np.ndarray):
        arrays[name] = plain
        return {"array": name}
    if isinstance(plain, tuple):
        return tuple(without_arrays(item, arrays, f"{name}.{k}") for k, item in enumerate(plain))
    if isinstance(plain, Mapping):
        return {k: without_arrays(v, arrays, f"{name}.{k}".lstrip(".")) for k, v in plain.items()}
    return plain


def plain_of(text: str, path: str, arrays: dict[str, Any] | None = None) -> Any:
    """The plain data of a text; the arrays that it names are taken out of those given.

    Raises
    ------
    GraphFileError
        No JSON; a key that is given twice; an array that is missing, or of no numbers.
    """

    def refused(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is no finite number")

    def once(entries: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(named := dict(entries)) < len(entries):
            key, line = _repeated(text)
            raise GraphFileError(f"the key {key!r:.60} is given twice; expected each once in its braces", path, line)
        return named

    arrays = {} if arrays is None else arrays
    try:
        return _plain(json.loads(text, parse_constant=refused, object_pairs_hook=once), arrays, 0)
    except GraphFileError:
        raise
    except json.JSONDecodeError as error:
        read = text[: error.pos]
        if "delimiter" in error.msg or not text[error.pos : error.pos + 1].strip(" \n\t}],"):  # behind the last word
            read = read.rstrip()
        raise GraphFileError(f"is no JSON: {error.msg}", path, read.count("\n") + 1) from error
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise GraphFileError(f"{error}", path) from error


def _repeated(text: str) -> tuple[str, int]:
    """The first key that its dictionary has twice, and its line; of JSON up to there.

    Examples
    --------
    >>> _repeated('{"a": {"b": 1},\\n "b": "\\\\"a\\\\": {",\\n "\\\\u0061": 2}')
    ('a', 3)
    """
    keys: list[set[str]] = []
    for word in KEY.finditer(text):
        if word[0] == "{":
            keys.append(set())
        elif word[0] == "}":
            keys.pop()
        elif word[1]:
            key = json.loads(word[1])
            if key in keys[-1]:
                return key, text.count("\n", 0, word.start()) + 1
            keys[-1].add(key)
    raise AssertionError("no key is repeated")


def _plain(node: Any, arrays: dict[str, Any], depth: int) -> Any:
    if depth > 40:
        raise ValueError("more than 40 brackets in brackets")
    if isinstance(node, list):
        array = np.array(node)
        if array.dtype.kind not in "fib":
            raise ValueError(f"expected lists of numbers of one length, got {node!r:.60}")
        return array
    if not isinstance(node, dict):
        return node
    if node.keys() == {"array"}:
        if not isinstance(node["array"], str) or node["array"] not in arrays:
            raise ValueError(f"the array {node['array']!r:.60} is missing")
        return arrays.pop(node["array"])
    if node.keys() == {"shape"}:
        shape = _plain(node["shape"], arrays, depth + 1)
        if not isinstance(shape, np.ndarray) or shape.ndim != 1 or np.prod(shape) != 0 or shape.max() > 1 << 20:
            raise ValueError(f"expected the shape of an array without numbers, got {node['shape']!r:.60}")
        return np.zeros(shape)
    if node.keys() == {"tuple"}:
        return tuple(_plain(item, arrays, depth + 1) for item in node["tuple"])
    return {name: _plain(value, arrays, depth + 1) for name, value in node.items()}
