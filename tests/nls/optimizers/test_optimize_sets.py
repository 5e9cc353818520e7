"""Damped methods on public pose graphs: the optimum of Gauss-Newton; and from starts where that one fails."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Factor, Isotropic
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, Values
from nls.optimizers import OPTIMIZERS
from tests.nls.graphs import p, pose_graph


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
