"""Small g2o files for the tests of the reader, the starts and the command line."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from factors import Factor, Robust
from nls import FactorGraph, GraphError, GraphFileError, GraphWarning, LoadReport, Values, load, save
from nls.io.read import read_graph

INFORMATION_2 = "500 1 2 400 3 300"
UPPER_3 = "100 1 2 3 4 5 200 6 7 8 9 300 10 11 12 400 13 14 500 15 600"

PLANE = f"""VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0.1 0.1
VERTEX_SE2 2 1.9 1 1.6
VERTEX_SE2 3 1.0 2.1 3.0
EDGE_SE2 0 1 1 0 0.05 {INFORMATION_2}
EDGE_SE2 1 2 1.01 0.98 1.5 {INFORMATION_2}
EDGE_SE2 2 3 1.02 0.9 1.5 {INFORMATION_2}
EDGE_SE2 0 3 1.05 2.05 3.1 {INFORMATION_2}
"""

SPACE = f"""VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0.1 0 0 0 0.19866933079506122 0.98006657784124163
VERTEX_SE3:QUAT 2 2 0.1 0.5 0.099833416646828155 0 0 0.99500416527802582
EDGE_SE3:QUAT 0 1 1.01 0 0.02 0 0 0.19866933079506122 0.98006657784124163 {UPPER_3}
EDGE_SE3:QUAT 1 2 0.9 0 0.4 0.099833416646828155 0 0 0.99500416527802582 {UPPER_3}
EDGE_SE3:QUAT 0 2 1.9 0.2 0.4 0 0.099833416646828155 0 0.99500416527802582 {UPPER_3}
"""


def cases(text: str) -> list[list[str]]:
    """The rows of a table as cells: bars separate them, and a backslash and n end a line within one."""
    return [
        [cell.strip(" ").replace("\\n", "\n") for cell in row.split(" | ")] for row in text.strip("\n").splitlines()
    ]


def assert_refused(
    line: int | None, words: str, reader: Callable[..., object], *given: object, **named: object
) -> GraphFileError:
    """The reader raises an error of a file with this line, and with these words: a name, a key or a number."""
    with pytest.raises(GraphFileError) as caught:
        reader(*given, **named)
    assert caught.value.line == line, str(caught.value)
    assert words in str(caught.value)
    return caught.value


def assert_unwritable(path: Path, words: str, graph: FactorGraph, values: Values, dialect: str | None = None) -> None:
    """Saving raises an error with these words, and writes nothing."""
    with pytest.raises(GraphError, match=words):
        save(path, graph, values, dialect=dialect)
    assert list(path.parent.iterdir()) == []


def write(folder: Path, text: str | bytes, name: str = "graph.g2o") -> Path:
    """A file with this content."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


CONVENTIONS = ("g2o", "graphslam", "log", "gtsam")
Loaded = tuple[FactorGraph, Values, LoadReport]


def read(
    text: str | bytes, convention: str = "g2o", dialect: str = "auto", repair: bool = False, **more: Any
) -> Loaded:
    data = text.encode() if isinstance(text, str) else text
    return read_graph(data, "f.g2o", convention, dialect, repair, **more)


def arrays(factor: Factor) -> list[np.ndarray]:
    """Everything a factor of a file holds: variables, measurements, noise, offsets."""
    offset = getattr(factor, "offset", None)
    offsets = list(offset) if isinstance(offset, tuple) else [offset] if isinstance(offset, np.ndarray) else []
    noise = factor.noise.noise if isinstance(factor.noise, Robust) else factor.noise
    return [*(k.numbers for k in factor.keys), factor.z, noise.matrix, *offsets]  # type: ignore[attr-defined]


def same(one: Loaded, other: Loaded) -> None:
    """Two graphs equal to the bit: values, ids, edges in order, measurements, information, what is fixed, kept text."""
    assert list(one[1].stacks) == list(other[1].stacks)
    for a, b in zip(one[1].stacks.values(), other[1].stacks.values(), strict=True):
        assert a.manifold is b.manifold
        assert np.array_equal(a.numbers, b.numbers)
        assert a.X.tobytes("C") == b.X.tobytes("C")
    same_factors(one, other)
    fixed = [sorted(repr(k) for keys in graph.fixed for k in keys) for graph, _, _ in (one, other)]
    assert fixed[0] == fixed[1]
    assert sorted(one[2].ignored) == sorted(other[2].ignored)


def same_factors(one: Loaded, other: Loaded) -> None:
    """Two graphs have the same measurements, to the bit."""
    assert len(one[0].factors) == len(other[0].factors)
    for f, g in zip(one[0].factors, other[0].factors, strict=True):
        assert type(f) is type(g)
        assert [k.kind for k in f.keys] == [k.kind for k in g.keys]
        assert (f.convention, f.kernel) == (g.convention, g.kernel)
        a, b = arrays(f), arrays(g)
        assert len(a) == len(b)
        assert all(p.shape == q.shape and p.tobytes("C") == q.tobytes("C") for p, q in zip(a, b, strict=True))


def again(loaded: Loaded, folder: Path, convention: str = "g2o", dialect: str = "g2o", **more: Any) -> Loaded:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)
        save(folder / "again.g2o", loaded[0], loaded[1], loaded[2], dialect)
        return load(folder / "again.g2o", convention, dialect, **more)


A, B, L, X = (ord(letter) << 56 for letter in "ablx")
LABEL = ord("B") << 48
INFORMATION = "0.25 0 0 1 0 4"  # its root and inverse are exact
STEP = f"1 0 0.125 {INFORMATION}"
ROBOTS = f"""PARAMS_SE2OFFSET 3 0.5 0.25 0.125
VERTEX_SE2 {A} 0 0 0
FIX {A}
VERTEX_SE2 {A | 1} 1.1 0 0.01
VERTEX_SE2 {A | 44} 2 0.125 0
VERTEX_SE2 {B} 5 5 0.5
VERTEX_SE2 {B | 1} 5 6 0.5
VERTEX_XY {L | 3} 2 2
EDGE_SE2 {A} {A | 1} {STEP}
EDGE_SE2 {B} {B | 1} {STEP}
EDGE_SE2_POINTXY_OFFSET {B | 1} {L | 3} 3 1.5 2.5 4 0 4
EDGE_SE2 {A | 1} {A | 44} {STEP}
EDGE_SE2 {A | 44} {B} 1.5 2 0.5 {INFORMATION}
EDGE_SE2_POINTXY_OFFSET {A | 1} {L | 3} 3 1.5 2.5 4 0 4
"""


def numbers(values: Values) -> dict[str, list[int]]:
    return {kind: stack.numbers.tolist() for kind, stack in values.stacks.items()}


def without(text: str, *words: str) -> str:
    """The lines whose tag has none of these words."""
    return "".join(f"{x}\n" for x in text.splitlines() if not any(word in x.split()[0] for word in words))


def renamed(text: str, new: Callable[[int], int]) -> str:
    """A pose graph with other ids."""
    lines = [line.split() for line in text.splitlines()]
    for line in lines:
        end = 3 if line[0].startswith("EDGE") else 2
        line[1:end] = [str(new(int(n))) for n in line[1:end]]
    return "".join(" ".join(line) + "\n" for line in lines)
