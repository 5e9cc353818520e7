"""The undamped step of the damped methods."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Factor
from models import SE2, R
from nls import Dogleg, FactorGraph, LevenbergMarquardt, Values
from nls.optimizers.problem import FAINT, Problem, Undamped
from tests.nls.graphs import p, pose_graph
from tests.nls.solving import make


@pytest.mark.parametrize(("angle", "free", "keeps"), [(1e-8, False, True), (1e-9, True, True), (0.0, True, False)])
def test_the_exact_step_keeps_a_direction_that_only_A_sees(angle: float, free: bool, keeps: bool) -> None:
    """Two columns at an angle whose square is lost in A'A; chi2 falls by 1 along one column, by 1 between them."""
    A = np.array([[1.0, 1.0], [0.0, angle], [0.0, 0.0]])
    factor = Factor.from_function(lambda X: X @ A.T - 1.0, p[0], dim=3, jacobians=lambda X: [A[None]])
    graph, values = FactorGraph([factor]), Values({p: (R(2), [[0.0, 0.0]])})
    system = graph.linearize(values)
    undamped = Undamped(Problem(system.pattern, make("lu")))
    dx = undamped.step(system, system.column_norms, strict=True)
    assert (undamped.free is not None) == free
    assert system.promised(dx) == pytest.approx(2.0 if keeps else 1.0, rel=1e-5)
    for optimizer in (Dogleg(), LevenbergMarquardt()):
        result = graph.optimize(values, optimizer)
        assert not result.converged or result.chi2_final == pytest.approx(1.0 if keeps else 2.0, rel=1e-5)
        assert result.converged or keeps


def test_the_damping_of_a_singular_system_is_the_least_that_works() -> None:
    sample = pose_graph(SE2, anchored=False)
    system = sample.graph.linearize(sample.values)
    undamped, D = Undamped(Problem(system.pattern, make("lu"))), system.column_norms
    dx = undamped.step(system, D)
    assert FAINT < undamped.damping < 1e-8
    assert undamped.free is None  # nobody asked
    undamped.step(system, D, strict=True)
    assert undamped.free is system
    shortest = np.linalg.pinv(system.A.toarray()) @ system.b
    assert system.times(dx) == pytest.approx(system.times(shortest), abs=1e-4 * np.abs(system.b).max())
