"""`nls convert` to PLY: the positions of all poses and points, and what has none is counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from models import SE2, SE3, SO3, R
from nls import GraphError, Values, kinds

x, l, r = kinds("x", "l", "r")


def test_points_of_the_plane_and_of_space(tmp_path: Path) -> None:
    values = Values(
        {x: (SE2, [[1, 2, 0.5], [3, 4, 0]], [5, 2**40]), l: (R(2), [[7, 8]], [3]), r: (SO3, SO3.identity())}
    )
    nls.save(tmp_path / "cloud.ply", nls.FactorGraph(), values)
    head, data = (tmp_path / "cloud.ply").read_bytes().split(b"end_header\n")
    rows = np.frombuffer(data, dtype=[("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")])
    assert rows["p"].tolist() == [[1, 2, 0], [3, 4, 0], [7, 8, 0]]
    assert (rows["kind"].tolist(), rows["number"].tolist()) == ([0, 0, 1], [5, -1, 3])
    assert b"element vertex 3\n" in head
    assert b"comment kind: 0 x, 1 l\n" in head
    _, notes = nls.io.rendered("cloud.ply", nls.FactorGraph(), values)
    assert notes == ["a ply file holds positions: 1 variable without left out"]
    with pytest.raises(GraphError, match="a ply file holds poses and points"):
        nls.save(tmp_path / "none.ply", nls.FactorGraph(), Values({r: (SO3, SO3.identity())}))
    X = SE3.exp([[1.0, 2, 3, 0.1, 0, 0]])
    nls.save(tmp_path / "space.ply", nls.FactorGraph(), Values({x: (SE3, X)}))
    assert (tmp_path / "space.ply").read_bytes().endswith(X[0, :3].astype("<f8").tobytes() + b"\0\0\0\0\0")
