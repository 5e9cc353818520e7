"""Damped methods on public pose graphs: the optimum of Gauss-Newton; and from starts where that one fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Cauchy, Factor, Isotropic
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, Stop, Values
from nls.optimizers import OPTIMIZERS
from tests.nls.graphs import never_worse, p, pose_graph

INTEL = "pose-graphs-2d/intel.g2o"
OPTIMUM = {"pose-graphs-3d/smallGrid3D.g2o": 458.154, INTEL: 45.0047}  # chi2
DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])


@DAMPED
def test_the_known_optimum_and_a_kernel(name: str, data: Path) -> None:
    for file, starts in (("pose-graphs-3d/smallGrid3D.g2o", ["chordal"]), (INTEL, ["file", "odometry", "chordal"])):
        graph, values, _ = nls.load(data / file)
        for start in starts:
            begin = nls.starts.initialize(graph, values, start)[0]
            result = graph.optimize(begin, OPTIMIZERS[name]())
            assert (result.converged, result.underconstrained) == (True, ())
            assert result.iterations <= 15
            assert result.chi2_final == pytest.approx(OPTIMUM[file], rel=1e-5)
            never_worse(graph, begin, result)
    robust, stop = graph.robust(Cauchy(1.0)), Stop(chi2_rtol=1e-9)
    expected, result = (robust.optimize(begin, optimizer(stop)) for optimizer in (GaussNewton, OPTIMIZERS[name]))
    assert (expected.converged, result.converged) == (True, True)
    assert result.chi2_final == pytest.approx(expected.chi2_final, rel=1e-6)
    assert result.chi2_final < OPTIMUM[INTEL]


def test_far_starts() -> None:
    """Poses thrown about by 3 m and 3 rad: damping finds the best valley at least as often, and always ends in one."""
    solved = {"gauss-newton": 0, "levenberg-marquardt": 0, "dogleg": 0}
    for seed in range(16):
        sample = pose_graph(SE2, seed=seed, start=3.0)
        for name in solved:
            result = sample.graph.optimize(sample.values, OPTIMIZERS[name]())
            assert result.converged or name == "gauss-newton"
            solved[name] += result.converged and result.chi2_final < 100
    assert solved["levenberg-marquardt"] >= solved["gauss-newton"]
    assert min(solved.values()) >= 8


def test_a_projection_from_far_away() -> None:
    """Gauss-Newton overshoots a bearing-only fix and ends nowhere; damped steps come in."""
    seats = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.2], [3.0, -0.1]])
    truth = np.array([1.5, 4.0])
    slopes = (truth[0] - seats[:, 0]) / (truth[1] - seats[:, 1])

    def pinhole(X: Array) -> Array:
        return np.asarray((X[:, :1] - seats[:, 0]) / (X[:, 1:] - seats[:, 1]) - slopes)

    graph = FactorGraph([Factor.from_function(pinhole, p[0], 4, Isotropic(0.01))])
    start = Values({p: (R(2), [[9.0, 0.7]])})
    undamped = graph.optimize(start, GaussNewton())
    damped = graph.optimize(start, LevenbergMarquardt())
    assert damped.converged
    assert damped.values[p[0]] == pytest.approx(truth, abs=1e-5)
    assert damped.chi2_final < max(undamped.chi2_final, 1e-20)  # or rounding alone
