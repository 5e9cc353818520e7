"""Small g2o files for the tests of the reader, the starts and the command line."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from factors import Between, Information
from nls import FactorGraph, GraphWarning, LoadReport, Values, load, save
from nls.io.g2o import read_g2o

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


def write(folder: Path, text: str | bytes, name: str = "graph.g2o") -> Path:
    """A file with this content."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


CONVENTIONS = ("g2o", "graphslam", "log", "gtsam")
Loaded = tuple[FactorGraph, Values, LoadReport]


def read(text: str, convention: str = "g2o") -> Loaded:
    return read_g2o(text.encode(), "f.g2o", convention)


def same(one: Loaded, other: Loaded) -> None:
    """Two graphs equal to the bit: poses, ids, edges in order, measurements, information, what is fixed, kept text."""
    a, b = one[1].stacks["x"], other[1].stacks["x"]
    assert a.manifold is b.manifold
    assert np.array_equal(a.numbers, b.numbers)
    assert a.X.tobytes("C") == b.X.tobytes("C")
    assert len(one[0].factors) == len(other[0].factors)
    for f, g in zip(one[0].factors, other[0].factors, strict=True):
        assert isinstance(f, Between)
        assert isinstance(g, Between)
        assert all(np.array_equal(i.numbers, j.numbers) for i, j in zip(f.keys, g.keys, strict=True))
        assert np.asarray(f.z).tobytes("C") == np.asarray(g.z).tobytes("C")
        assert isinstance(f.noise, Information)
        assert isinstance(g.noise, Information)
        assert f.noise.matrix.tobytes("C") == g.noise.matrix.tobytes("C")
        assert f.convention == g.convention
    fixed = [sorted(n for keys in graph.fixed for n in keys.numbers.tolist()) for graph, _, _ in (one, other)]
    assert fixed[0] == fixed[1]
    assert one[2].ignored == other[2].ignored


def again(loaded: Loaded, folder: Path, convention: str = "g2o") -> Loaded:
    save(folder / "again.g2o", loaded[0], loaded[1], loaded[2].ignored)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)
        return load(folder / "again.g2o", convention)
