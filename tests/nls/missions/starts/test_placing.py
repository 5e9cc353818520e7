"""The start of a mission in the world: wrong fixes do not move it far, and a compass keeps its heading."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Heading, Isotropic, Position, Shifted
from models import SE3, euler
from nls.missions.folder.calibration import Calibrations
from nls.missions.starts.placing import turn_to_measurements
from tests.nls.missions.folder.positioned import Positioned

x, b, c = nls.kinds("x", "b", "c")
TURN = euler.to_se3([0.0, 0.0, 2.0, 70.0, -30.0, 0.0])
NOWHERE = np.zeros((0, 3))


@pytest.fixture
def start(tmp_path: Path) -> nls.Values:
    return nls.Values({x: (SE3, Positioned(tmp_path / "truth").X)})


def test_a_third_of_wrong_fixes(start: nls.Values) -> None:
    X = SE3.compose(TURN, start[x])
    z, rng = X[::2, :2].copy(), np.random.default_rng(0)
    wrong = rng.choice(len(z), len(z) // 3, replace=False)
    z[wrong] += rng.uniform(20, 90, (len(wrong), 2))
    fixes = Position(x[np.arange(0, 81, 2)], z, Isotropic(1.0), ("x", "y"))
    turn = turn_to_measurements(nls.FactorGraph([fixes]), start, NOWHERE, None)
    assert SE3.act(turn, start[x][:, :3]) == pytest.approx(X[:, :3], abs=0.5)


def test_with_a_compass_it_does_not_turn_to_fixes(start: nls.Values) -> None:
    X = SE3.compose(TURN, start[x])
    yaw = euler.from_se3(start[x])[:, 2]
    compass = Heading(x[[4, 9]], yaw[[4, 9]] + 1.5, Isotropic(0.1))
    fixes = Position(x[[0, 80]], X[[0, 80], :2], Isotropic(1.0), ("x", "y"))
    for heading in (compass, Shifted(compass, [[1.0]], c[0])):
        graph = nls.FactorGraph([heading, fixes])
        turn = turn_to_measurements(graph, start, NOWHERE, Calibrations(None).headings(heading))
        assert euler.from_se3(turn)[:3] == pytest.approx([0, 0, 1.5], abs=1e-9)
        moved = SE3.act(turn, start[x][[0, 80], :3])
        assert moved.mean(axis=0)[:2] == pytest.approx(X[[0, 80], :2].mean(axis=0), abs=1e-6)


def test_one_spot_gives_no_yaw(start: nls.Values) -> None:
    fix = Position(x[7], [3.0, 4.0], Isotropic(1.0), ("x", "y"))
    turn = turn_to_measurements(nls.FactorGraph([fix]), start, NOWHERE, None)
    assert SE3.act(turn, start[x][7, :3])[:2] == pytest.approx([3.0, 4.0])
    assert turn[3:] == pytest.approx([0, 0, 0, 1])
