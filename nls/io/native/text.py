"""Plain data as JSON: with arrays as lists, for people, or with the names of arrays that stand elsewhere."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from models.errors import GraphFileError

STRING = r'"(?:[^"\\]|\\.)*"'
KEY = re.compile(rf"({STRING})\s*:|{STRING}|[{{}}]")  # keys, other strings, ends of dictionaries


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
