"""Starts, steps and ends that lead nowhere: every optimizer says so, and what it returns is no worse than the start."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from factors import Isotropic, Prior
from models import SE2
from models.algebra import Array
from models.errors import EvaluationError, UnderconstrainedError
from nls import FactorGraph, Result, Status, Stop, Values
from nls.optimizers import OPTIMIZERS
from tests.nls.graphs import GROUPS, WrongSign, never_worse, p, pose_graph, scalar

ALL = pytest.mark.parametrize("name", OPTIMIZERS)
DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])


def optimize(graph: FactorGraph, start: Values, name: str, stop: Stop | None = None) -> Result:
    """The result, with what every result must keep."""
    before = {kind: start[kind].copy() for kind in start}
    result = graph.optimize(start, OPTIMIZERS[name](stop or Stop()))
    never_worse(graph, start, result)
    assert all(np.array_equal(start[kind], X) for kind, X in before.items())
    assert np.isfinite([it.chi2 for it in result.history]).all()
    assert result.reason
    return result


# ---- the start cannot be evaluated


@ALL
def test_nothing_to_start_from(name: str) -> None:
    """Residuals, Jacobians or weighted residuals that are not finite."""
    for bad in (np.nan, np.inf, -np.inf, 1e200):

        def depth(X: Array, bad: float = bad) -> Array:
            return np.full_like(X, bad)

        graph, start = scalar(depth, 1.0)
        with pytest.raises(EvaluationError, match=r"depth\(p0\): its residual is") as caught:
            graph.optimize(start, OPTIMIZERS[name]())
        assert (caught.value.iteration, caught.value.where, caught.value.factor) == (0, "residual", "depth")
        assert np.array_equal(start[p], [[1.0]])
    graph, start = scalar(lambda X: X, 1.0, lambda X: np.full((1, 1, 1), np.nan))
    with pytest.raises(EvaluationError, match="Jacobian with respect to p0 is not finite") as caught:
        graph.optimize(start, OPTIMIZERS[name]())
    assert caught.value.iteration == 0
    with pytest.raises(EvaluationError):
        FactorGraph([Prior(p[0], [0.0], Isotropic(1e-160))]).optimize(start, OPTIMIZERS[name]())


@ALL
def test_a_function_that_raises(name: str) -> None:
    """At the start or later: the exception comes through, chained, with the iteration; the values are untouched."""
    for call in (1, 2, 5):
        calls: list[int] = []

        def table(X: Array, calls: list[int] = calls, call: int = call) -> Array:
            calls.append(1)
            if len(calls) >= call:
                raise KeyError("no such depth")
            return np.array(X**2 + 1.0)

        graph, start = scalar(table, 30.0, lambda X: 2 * X[..., None])
        with pytest.raises(EvaluationError, match=r"table\(p0\): .* KeyError: 'no such depth'") as caught:
            graph.optimize(start, OPTIMIZERS[name]())
        assert isinstance(caught.value.__cause__, KeyError)
        assert caught.value.iteration == (0 if call == 1 else len(calls) - 1)
        assert np.array_equal(start[p], [[30.0]])


# ---- no step leads anywhere


@ALL
@pytest.mark.parametrize("singular", [False, True])
def test_no_trial_step_can_be_evaluated(name: str, singular: bool) -> None:
    def hole(X: Array) -> Array:
        if X[0, 0] != 1.0 and singular:
            raise nls.SingularGeometryError("hole(p0): the range is zero")
        return np.where(X == 1.0, 1.0, np.nan)

    graph, start = scalar(hole, 1.0, lambda X: np.ones((1, 1, 1)))
    result = optimize(graph, start, name)
    assert result.status is (Status.DIVERGED if name == "gauss-newton" else Status.STALLED)
    assert result.iterations == 0 or name == "gauss-newton"
    assert "hole(p0)" in result.reason
    assert ("range is zero" if singular else "not finite") in result.reason
    assert np.array_equal(result.values[p], [[1.0]])


@ALL
def test_a_jacobian_of_the_wrong_sign(name: str) -> None:
    graph, start = scalar(lambda X: X - 1.0, 3.0, lambda X: -np.ones((1, 1, 1)))
    result = optimize(graph, start, name)
    assert np.array_equal(result.values[p[0]], [3.0])
    assert result.status is (Status.DIVERGED if name == "gauss-newton" else Status.STALLED)
    assert name == "gauss-newton" or "factors.check_jacobians" in result.reason
    for group in GROUPS:
        sample = pose_graph(group, anchored=False)
        graph = FactorGraph([WrongSign(*f.keys, f.z, f.noise) for f in sample.graph.factors])
        result = optimize(graph, sample.values, name)
        assert not result.converged
        if name != "gauss-newton":
            assert result.status is Status.STALLED
            assert "factors.check_jacobians" in result.reason


# ---- nothing there


@ALL
def test_a_plateau_at_infinity(name: str) -> None:
    for at, dim, residual in (
        (0.5, 1, lambda X: np.arctan(X) - 2.0),
        (3.0, 1, lambda X: np.arctan(X) - 2.0),
        (0.5, 1, lambda X: np.exp(-X) + 1.0),
        (0.5, 2, lambda X: np.concatenate([np.exp(-X), np.ones_like(X)], axis=1)),
        (3.0, 2, lambda X: np.concatenate([1 / (1 + X**2), 3 * np.ones_like(X)], axis=1)),
    ):
        graph, start = scalar(residual, at, dim=dim)
        try:
            result = optimize(graph, start, name)
        except UnderconstrainedError as error:  # the refusal of an undamped method
            assert (name != "levenberg-marquardt", "p0" in str(error)) == (True, True)  # noqa: PT017
            assert graph.chi2(error.values) <= graph.chi2(start)  # noqa: PT017
            continue
        assert np.isfinite(result.values[p]).all()
        assert result.values[p[0]][0] > at + 1  # on its way to infinity
        if at == 0.5 and dim == 2:
            assert (result.status, result.rule) == (Status.DIVERGED, "plateau")
        if result.status is Status.DIVERGED:
            assert any(word in result.reason for word in ("plateau", "by an update of", "not finite")), result.reason
        else:  # damped steps: chi2 is still falling, or the only residual promises a fall to 0 that never comes
            assert name != "gauss-newton"
            assert result.status in (Status.MAX_ITERATIONS, Status.STALLED)


@ALL
def test_a_kink(name: str) -> None:
    """|x| + 1 has its minimum at a kink, where no derivative vanishes: any name but converged, unless it is there."""
    for at in (-2.3, 0.7, 40.0):
        for limits in (None, Stop(update_tol=1e-9)):
            graph, start = scalar(lambda X: np.abs(X) + 1.0, at, lambda X: np.sign(X)[..., None])
            result = optimize(graph, start, name, limits)
            assert not result.converged
            assert name == "gauss-newton" or abs(result.values[p[0]][0]) < 1e-3 * abs(at)


def quartic(unit: float, scale: float) -> tuple[FactorGraph, Values]:
    """x - 2 and x^2 - 3, x in units of `scale` and the residual in those of `unit`."""

    def residual(X: Array) -> Array:
        return unit * np.concatenate([X / scale - 2.0, (X / scale) ** 2 - 3.0], axis=1)

    def slope(X: Array) -> Array:
        return unit * np.stack([np.ones_like(X) / scale, 2 * X / scale**2], axis=1)

    return scalar(residual, 5 * scale, slope, dim=2)


@DAMPED
def test_huge_and_tiny_numbers(name: str) -> None:
    """Units of the unknown do not matter: x in units of `scale`."""
    for scale in (1e-100, 1e-20, 1e20, 1e60):
        result = optimize(*quartic(1.0, scale), name, Stop(update_tol=0.0))
        assert result.converged
        assert result.values[p[0]][0] == pytest.approx(1.7523324 * scale, rel=1e-4, abs=0)  # 2 x^3 - 5 x = 2


@ALL
def test_a_huge_chi2(name: str) -> None:
    """With a unit of 1e90 the square of chi2 is no number; nothing of it is below a sigma, so it ends at rounding."""
    results = [optimize(*quartic(unit, 1.0), name) for unit in (1e-90, 1.0, 1e90)]
    assert [result.converged for result in results] == [True, True, True]
    tiny, one, huge = (result.iterations for result in results)
    assert tiny == one <= huge <= one + 5
    for result in results:
        assert result.values[p[0]][0] == pytest.approx(1.7523324, rel=1e-4)


@ALL
def test_zero_residuals_at_the_start(name: str) -> None:
    graph = FactorGraph([Prior(p[0], [1.0, 2.0, 0.5], Isotropic(0.1))])
    result = optimize(graph, Values({p: (SE2, [1.0, 2.0, 0.5])}), name, Stop(0.0, 0.0, 0.0))
    assert (result.status, result.iterations, result.chi2_final) == (Status.CONVERGED, 0, 0.0)


def test_a_short_step_that_misses_its_promise_is_no_arrival() -> None:
    """A Jacobian thirty times too large: the update is below its threshold, and so is the fall below its promise."""
    graph, start = scalar(lambda X: X - 1.0, 1.00001, lambda X: np.full((1, 1, 1), 30.0))
    result = optimize(graph, start, "gauss-newton", Stop(update_tol=1e-6))
    assert (result.status, result.rule) == (Status.STALLED, "promise_missed")
    assert "factors.check_jacobians" in result.reason
