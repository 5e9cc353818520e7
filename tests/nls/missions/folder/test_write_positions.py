"""Fixes, beacons, ranges and closures go round: written and read again they are the same factors, bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, ZPR, Between, Cauchy, Covariance, Diagonal, Factor, Huber, Isotropic, Position, Prior, Range
from models import SE3, euler
from models.errors import GraphError
from nls import FactorGraph
from nls.missions import write_mission

x, b = nls.kinds("x", "b")
TRACK = [
    XYH(x[[0, 1]], x[[1, 2]], [[1, 0, 0.1], [1, 0.1, 0]], Isotropic(0.1)),
    ZPR(x[[0, 1, 2]], np.zeros((3, 3)), Isotropic(0.01)),
]
ARM = np.array([0.3, -0.1, 0.2])
MOUNT = np.append(ARM, [0, 0, 0, 1.0])
PLACES = Position(x[[0, 2]], [[1, 2, 3], [4, 5, 6.0]], Diagonal(z=1.0, x=0.5, y=0.1), offset=ARM)
FACTORS: list[Factor] = [
    PLACES,
    PLACES.robust(Huber(1.5)),
    Between(x[0], x[2], euler.to_se3([0.1, -0.2, 0.3, 1, 2, 3]), Diagonal(np.arange(1.0, 7.0))).robust(Cauchy(0.1)),
    Prior(b[[5, 7]], [[1, 2, 3], [4, 5, 6.0]], Isotropic([0.1, 0.2])),
    Range(x[[0, 1]], b[[5, 7]], [3.0, 1 / 3], Diagonal(range=[0.1, 0.2]), MOUNT),
]


def test_factors_go_round(tmp_path: Path) -> None:
    graph = FactorGraph([*TRACK, *FACTORS])
    files = write_mission(tmp_path / "m", graph)
    assert [Path(f).name for f in files][2:] == ["fixes.csv", "closures.csv", "beacons.csv", "ranges.csv"]
    again, start, _ = nls.load(tmp_path / "m")
    assert [type(factor) for factor in again.factors] == [type(factor) for factor in graph.factors]
    assert [factor.kernel for factor in again.factors] == [factor.kernel for factor in graph.factors]
    for factor, same in zip(graph.factors, again.factors, strict=True):
        model, _ = start.gather(factor)
        other, _ = start.gather(same)
        assert [keys.numbers.tolist() for keys in factor.keys] == [keys.numbers.tolist() for keys in same.keys]
        assert other.z == pytest.approx(np.broadcast_to(model.z, other.z.shape), abs=1e-15)
        assert factor.chi2(start) == pytest.approx(same.chi2(start), rel=1e-12)
    assert "kernel" not in (tmp_path / "m" / "ranges.csv").read_text()  # no column that says nothing


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ([PLACES, Position(x[1], [1, 2], Isotropic(1), ("x", "y"))], "another factor has other columns of fixes.csv"),
        (
            [Range(x[0], b[5], 3.0, Isotropic(1), SE3.exp([0, 0, 0, 0, 0.1, 0]))],
            "no column for the attitude of a sensor",
        ),
        ([Between(x[0], x[2], SE3.identity(), Covariance(np.eye(6)))], "its noise is Covariance"),
        ([FACTORS[3], FACTORS[3]], "a beacon has two priors"),
        ([FACTORS[3].robust(Huber(1.0))], "beacons.csv has no column for a robust kernel"),
        ([Position(x[9], [1, 2], Isotropic(1), ("x", "y"))], "x9 is in fixes.csv, but no XYH"),
        ([Between(x[0], x[2], SE3.identity(), Isotropic(1), "g2o")], "has no file in a mission folder"),
    ],
)
def test_what_no_column_holds_is_refused(factors: list[Factor], words: str, tmp_path: Path) -> None:
    with pytest.raises(GraphError, match=words):
        write_mission(tmp_path / "m", FactorGraph([*TRACK, *factors]))
