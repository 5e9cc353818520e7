"""What every optimization promises: named errors, the caller's values and optimizer untouched, a history."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, SO3, LieGroup, R
from models.algebra import Array
from nls import EvaluationError, FactorGraph, GaussNewton, GraphError, Stop
from tests.nls.graphs import circle, never_worse, p, pose_graph, scalar, x


def test_an_exception_in_user_code_is_chained_and_named() -> None:
    def residual(X: Array) -> Array:
        raise ZeroDivisionError("my fault")

    graph, start = scalar(residual, 1.0)
    with pytest.raises(EvaluationError, match=r"residual\(p0\): your function raised ZeroDivisionError: my fault") as e:
        graph.optimize(start)
    assert isinstance(e.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize("group", [R(2), SE2, SO3, SE3], ids=str)
def test_the_callers_values_are_untouched(group: LieGroup) -> None:
    sample = pose_graph(group)
    X = sample.values[x]
    result = sample.graph.optimize(sample.values)
    assert np.array_equal(sample.values[x], X)
    assert not np.shares_memory(result.values.stacks["x"].X, sample.values.stacks["x"].X)
    never_worse(sample.graph, sample.values, result)


def test_a_start_that_is_kept_can_be_changed_without_harm() -> None:
    graph, start = scalar(lambda X: X - 1.0, 3.0, lambda X: -np.ones((1, 1, 1)))
    result = graph.optimize(start)
    start[p[0]] = [99.0]
    assert result.values[p[0]].tolist() == [3.0]


def test_history_timings_and_table() -> None:
    sample = pose_graph(R(2))
    result = sample.graph.optimize(sample.values)
    assert [it.number for it in result.history] == list(range(result.iterations + 1))
    assert np.isnan(result.history[0].update)
    assert result.history[0].chi2 == result.chi2_initial
    assert {"build", "analyze", "linearize", "retract"} <= set(result.timings)
    assert all(seconds >= 0 for seconds in result.timings.values())
    text = str(result)
    assert f"CONVERGED: {result.reason}" in text
    assert f"{result.dof} degrees of freedom" in text
    assert len(text.splitlines()) == 1 + len(result.history) + 2


def test_an_optimizer_is_not_changed_by_a_run() -> None:
    graph, start = circle()
    optimizer = GaussNewton()
    first, second = graph.optimize(start, optimizer), graph.optimize(start, optimizer)
    assert first.values[p[0]].tobytes() == second.values[p[0]].tobytes()
    with pytest.raises(AttributeError):
        optimizer.stop = Stop()  # type: ignore[misc]


def test_nothing_left_to_move() -> None:
    sample = pose_graph(R(2))
    sample.graph.fix(x[0:8])
    result = sample.graph.optimize(sample.values)
    assert result.converged
    assert np.array_equal(result.values[x], sample.values[x])
    with pytest.raises(GraphError):
        FactorGraph().optimize(sample.values)
