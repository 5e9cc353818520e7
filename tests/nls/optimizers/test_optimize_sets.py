"""Damped methods on public pose graphs: the optimum of Gauss-Newton; and from starts where that one fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Cauchy
from models import SE2
from nls import GaussNewton, LevenbergMarquardt, Stop
from nls.optimizers import OPTIMIZERS
from tests.nls.graphs import never_worse, pose_graph

OPTIMUM = {"pose-graphs-3d/smallGrid3D.g2o": 458.154, "pose-graphs-2d/intel.g2o": 45.0047}  # chi2
DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])


@DAMPED
@pytest.mark.parametrize("start", ["file", "odometry", "chordal"])
@pytest.mark.parametrize("graph", OPTIMUM)
def test_the_known_optimum(name: str, start: str, graph: str, data: Path) -> None:
    loaded, values, _ = nls.load(data / graph)
    begin = nls.starts.initialize(loaded, values, start)[0]
    result = loaded.optimize(begin, OPTIMIZERS[name]())
    assert result.converged
    assert result.iterations <= 15
    assert result.underconstrained == ()
    assert result.chi2_final == pytest.approx(OPTIMUM[graph], rel=1e-5)
    never_worse(loaded, begin, result)


@DAMPED
def test_a_kernel_on_real_odometry(name: str, data: Path) -> None:
    loaded, values, _ = nls.load(data / "pose-graphs-2d/intel.g2o")
    graph = loaded.robust(Cauchy(1.0))
    expected = graph.optimize(values, GaussNewton(Stop(chi2_rtol=1e-9)))
    result = graph.optimize(values, OPTIMIZERS[name](Stop(chi2_rtol=1e-9)))
    assert expected.converged
    assert result.converged
    assert result.chi2_final == pytest.approx(expected.chi2_final, rel=1e-6)
    assert result.chi2_final < OPTIMUM["pose-graphs-2d/intel.g2o"]


def test_far_starts() -> None:
    """Poses thrown about by 3 m and 3 rad: damping finds the best valley at least as often, and always ends in one."""
    found = {"gauss-newton": 0, "levenberg-marquardt": 0, "dogleg": 0}
    for seed in range(30):
        sample = pose_graph(SE2, seed=seed, start=3.0)
        for name in found:
            result = sample.graph.optimize(sample.values, OPTIMIZERS[name]())
            assert result.converged or name == "gauss-newton"
            found[name] += result.converged and result.chi2_final < 100
    assert found["levenberg-marquardt"] >= found["gauss-newton"]
    assert min(found.values()) >= 15


def test_a_projection_from_far_away() -> None:
    """Gauss-Newton overshoots a bearing-only fix and ends nowhere; damped steps come in."""
    from factors import Factor, Isotropic
    from models import R
    from nls import FactorGraph, Values, kinds

    (p,) = kinds("p")
    seats = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.2], [3.0, -0.1]])
    truth = np.array([1.5, 4.0])
    slopes = (truth[0] - seats[:, 0]) / (truth[1] - seats[:, 1])

    def pinhole(X: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        return (X[:, :1] - seats[:, 0]) / (X[:, 1:] - seats[:, 1]) - slopes

    graph = FactorGraph([Factor.from_function(pinhole, p[0], 4, Isotropic(0.01))])
    start = Values({p: (R(2), [[9.0, 0.7]])})
    undamped = graph.optimize(start, GaussNewton())
    damped = graph.optimize(start, LevenbergMarquardt())
    assert damped.converged
    assert damped.values[p[0]] == pytest.approx(truth, abs=1e-5)
    assert damped.chi2_final < max(undamped.chi2_final, 1e-20)  # or rounding alone
