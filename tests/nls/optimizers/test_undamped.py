"""The undamped step of the damped methods, the promise of a linear system, and the damping of a singular one."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Factor
from models import SE2, R
from nls import Dogleg, FactorGraph, LevenbergMarquardt, Values
from nls.optimizers.problem import Problem, Undamped
from tests.nls.graphs import p, pose_graph
from tests.nls.solving import dense_step, make


def test_the_undamped_step_is_solved_once() -> None:
    sample = pose_graph(SE2)
    system = sample.graph.linearize(sample.values)

    class Counting(type(make("dense-qr"))):  # type: ignore[misc]
        solves = 0

        def least_squares(self, *args: object) -> object:
            type(self).solves += 1
            return super().least_squares(*args)

    undamped, D = Undamped(Problem(system.pattern, Counting())), system.column_norms
    for strict in (False, True):  # the faintest damping changes nothing, and each is solved once
        dx = [undamped.step(system, D, strict) for _ in range(2)]
        assert dx[0] is dx[1]
        assert dx[0] == pytest.approx(dense_step(system))
    assert undamped.free is None
    assert Counting.solves == 2


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
