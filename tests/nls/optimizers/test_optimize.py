"""Gauss-Newton on problems whose answer is known; every way it can end, each called by its right name."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Prior
from models import LieGroup, R
from models.algebra import Array
from nls import (
    FactorGraph,
    GaussNewton,
    Iteration,
    OptionError,
    SingularGeometryError,
    Status,
    Stop,
    Values,
)
from nls.linear import SOLVERS
from tests.nls.graphs import GROUPS, circle, distance, never_worse, p, pose_graph, scalar, walk, x

NEVER = Stop(update_tol=0.0, chi2_rtol=0.0, gradient_tol=0.0)


# ---- answers known in closed form


@pytest.mark.parametrize("name", SOLVERS)
def test_two_poses_pulled_at_both_ends(name: str) -> None:
    graph = FactorGraph(
        [Prior(x[0], [0.0], Isotropic(1)), Prior(x[1], [2.0], Isotropic(1)), Between(x[0], x[1], [1.0], Isotropic(1))]
    )
    solver = SOLVERS[name]()
    if solver.missing():
        pytest.skip(f"{name}: {solver.missing()}")
    result = graph.optimize(Values({x: (R(1), [5.0, -5.0])}), linear_solver=solver)
    assert result.values[x].ravel() == pytest.approx([1 / 3, 5 / 3], abs=1e-12)
    assert result.chi2_final == pytest.approx(1 / 3, rel=1e-12)
    assert (result.dof, result.converged, result.linear_solver.split(",")[0]) == (1, True, name)


def test_a_mean_is_weighted_by_information() -> None:
    sigmas, z = np.array([0.1, 0.2, 0.4]), np.array([1.0, 2.0, 4.0])
    graph = FactorGraph([Prior(x[[0, 0, 0]], z, Diagonal(sigmas[:, None]))])
    w = 1 / sigmas**2
    result = graph.optimize(Values({x: (R(1), [0.0])}))
    assert result.values[x[0]][0] == pytest.approx((w @ z) / w.sum(), rel=1e-12)


@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_a_chain_is_composed_exactly(group: LieGroup) -> None:
    X = walk(group, 6, np.random.default_rng(1))
    graph = FactorGraph([Between(x[0:5], x[1:6], group.between(X[:-1], X[1:]), Isotropic(0.1))])
    start = np.concatenate([X[:1], np.repeat(X[:1], 5, axis=0)])
    result = graph.optimize(Values({x: (group, start)}))
    assert result.converged
    assert result.chi2_final < 1e-20
    assert distance(group, X, result.values[x]) < 1e-9
    assert np.array_equal(result.values[x[0]], X[0])
    assert result.dof == 0


@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_noise_free_measurements_are_met(group: LieGroup) -> None:
    sample = pose_graph(group, start=0.2)
    for factor in sample.graph.factors:
        X = [sample.truth[keys] for keys in factor.keys]
        factor._z = group.between(*X) if len(X) == 2 else X[0]
        factor._model = None
    result = sample.graph.optimize(sample.values)
    assert result.converged
    assert distance(group, sample.truth[x], result.values[x]) < 1e-8


def test_rosenbrock_from_the_classical_start() -> None:
    graph = FactorGraph(
        [Factor.from_function(lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1), p[0], 2)]
    )
    result = graph.optimize(Values({p: (R(2), [-1.2, 1.0])}))
    assert result.values[p[0]] == pytest.approx([1.0, 1.0], abs=1e-9)
    assert result.iterations <= 4
    assert max(it.chi2 for it in result.history) > result.chi2_initial  # it passes through a rise on its way


# ---- every status


def test_converged_by_the_gradient_without_a_step() -> None:
    graph, start = circle()
    optimum = graph.optimize(start, GaussNewton(Stop(update_tol=1e-14, chi2_rtol=0.0))).values
    again = graph.optimize(optimum, GaussNewton(Stop(update_tol=0.0, chi2_rtol=0.0, gradient_tol=1e-7)))
    assert (again.status, again.iterations) == (Status.CONVERGED, 0)
    assert "scaled gradient" in again.reason
    assert np.array_equal(again.values[p[0]], optimum[p[0]])
    exact = graph.optimize(start, GaussNewton(Stop(0.0, 0.0, gradient_tol=1e-5)))
    assert exact.status is Status.CONVERGED
    assert "1e-05" in exact.reason


def test_converged_by_the_update() -> None:
    graph, start = circle()
    result = graph.optimize(start, GaussNewton(Stop(update_tol=1e-3, chi2_rtol=0.0, gradient_tol=0.0)))
    assert result.status is Status.CONVERGED
    assert result.reason.startswith("max|dx| ")
    assert result.history[-1].update < 1e-3 <= result.history[-2].update
    never_worse(graph, start, result)


def test_converged_by_the_decrease_of_chi2() -> None:
    graph, start = circle()
    result = graph.optimize(start, GaussNewton(Stop(update_tol=0.0, chi2_rtol=1e-2, gradient_tol=0.0)))
    assert result.status is Status.CONVERGED
    assert result.reason.startswith("relative decrease of chi2")
    last, before, earlier = (it.chi2 for it in reversed(result.history[-3:]))
    assert 0 <= before - last <= 1e-2 * before
    assert earlier - before > 1e-2 * earlier


def test_chi2_of_zero_is_converged() -> None:
    graph, start = scalar(lambda X: X - 2.0, 2.0)
    result = graph.optimize(start, GaussNewton(NEVER))
    assert (result.status, result.iterations, result.chi2_final) == (Status.CONVERGED, 0, 0.0)


@pytest.mark.parametrize("limit", [0, 1, 2])
def test_the_iteration_limit(limit: int) -> None:
    graph, start = circle()
    result = graph.optimize(start, GaussNewton(Stop(max_iterations=limit)))
    assert (result.status, result.iterations) == (Status.MAX_ITERATIONS, limit)
    assert result.reason == f"after {limit} iterations"
    assert not result.converged
    never_worse(graph, start, result)


def test_the_time_limit() -> None:
    graph, start = circle()
    result = graph.optimize(start, GaussNewton(Stop(max_seconds=0.0)))
    assert result.status is Status.MAX_TIME
    assert result.iterations <= 1
    never_worse(graph, start, result)


def test_stopped_by_the_callback() -> None:
    graph, start = circle()
    seen: list[Iteration] = []

    def callback(iteration: Iteration) -> bool:
        seen.append(iteration)
        return iteration.number == 2

    result = graph.optimize(start, GaussNewton(NEVER, callback))
    assert (result.status, result.iterations) == (Status.STOPPED, 2)
    assert [it.number for it in seen] == [1, 2]
    assert [(it.chi2, it.update) for it in seen] == [(it.chi2, it.update) for it in result.history[1:]]
    never_worse(graph, start, result)


def test_a_callback_that_returns_nothing_does_not_stop() -> None:
    graph, start = circle()
    assert graph.optimize(start, GaussNewton(callback=lambda iteration: None)).converged


def test_interrupted_in_a_residual() -> None:
    def residual(X: Array) -> Array:
        if X[0, 0] < 5:  # two steps from the start
            raise KeyboardInterrupt
        return np.array(X**2 - 2.0)

    graph, start = scalar(residual, 30.0)
    result = graph.optimize(start)
    assert result.status is Status.INTERRUPTED
    assert 1 <= result.iterations < 5
    assert result.chi2_final < result.chi2_initial
    assert result.values[p[0]][0] < 30.0


def test_interrupted_in_the_callback() -> None:
    graph, start = circle()

    def callback(iteration: Iteration) -> None:
        if iteration.number == 2:
            raise KeyboardInterrupt

    result = graph.optimize(start, GaussNewton(NEVER, callback))
    assert (result.status, result.iterations) == (Status.INTERRUPTED, 2)
    never_worse(graph, start, result)


def test_diverged_by_a_jacobian_of_the_wrong_sign() -> None:
    graph, start = scalar(lambda X: X - 1.0, 3.0, lambda X: -np.ones((1, 1, 1)))
    result = graph.optimize(start, GaussNewton())
    assert result.status is Status.DIVERGED
    assert np.array_equal(result.values[p[0]], [3.0])
    never_worse(graph, start, result)


@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_a_wrong_sign_is_never_converged(group: LieGroup) -> None:
    class Wrong(Between):
        def predict(self, manifolds: tuple, *X: Array) -> tuple:  # type: ignore[type-arg]
            h, (H_i, _) = super().predict(manifolds, *X)
            return h, (-H_i, -np.eye(manifolds[0].dim)[None])

    sample = pose_graph(group, anchored=False)
    edges = [Wrong(*f.keys, f.z, f.noise) for f in sample.graph.factors]
    graph = FactorGraph(edges)
    result = graph.optimize(sample.values, GaussNewton())
    assert not result.converged
    never_worse(graph, sample.values, result)


def test_diverged_where_the_residual_is_not_finite() -> None:
    def residual(X: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.log(X) + 3.0)

    graph, start = scalar(residual, 1.0)  # the first step leads to -2
    result = graph.optimize(start, GaussNewton())
    assert result.status is Status.DIVERGED
    assert "residual(p0)" in result.reason
    assert "not finite" in result.reason
    assert np.array_equal(result.values[p[0]], [1.0])
    assert np.isfinite([it.chi2 for it in result.history]).all()
    never_worse(graph, start, result)


def test_diverged_where_the_geometry_is_singular() -> None:
    def residual(X: Array) -> Array:
        if X[0, 0] < 0:
            raise SingularGeometryError("behind the camera")
        return np.array(X + 3.0)

    graph, start = scalar(residual, 1.0)
    assert graph.optimize(start, GaussNewton()).status is Status.DIVERGED


def test_cycling_between_two_points() -> None:
    graph, start = scalar(lambda X: X**3 - 2 * X + 2, 0.0, lambda X: (3 * X**2 - 2)[..., None])
    result = graph.optimize(start, GaussNewton())  # Newton's classical cycle 0, 1, 0, 1, ...
    assert result.status is Status.CYCLING
    assert result.iterations < 30
    assert result.values[p[0]][0] == pytest.approx(1.0)
    assert result.chi2_final == pytest.approx(1.0)
    never_worse(graph, start, result)


def test_swinging_between_points_of_equal_chi2_is_not_converged() -> None:
    """For sign(x) sqrt|x| the undamped step is -2x: x, -x, x, ... with a slope that never vanishes."""
    graph, start = scalar(
        lambda X: np.sign(X) * np.sqrt(np.abs(X)), 0.7, lambda X: (0.5 / np.sqrt(np.abs(X)))[..., None]
    )
    result = graph.optimize(start, GaussNewton())
    assert result.status is Status.CYCLING


def test_stalled_above_a_lower_point_met_before() -> None:
    """A Jacobian that is wrong where it matters: the steps settle at 0, past the lower point 1."""
    graph, start = scalar(
        lambda X: np.concatenate([X - 1.0, np.ones_like(X)], axis=1), 2.0, lambda X: np.ones((1, 2, 1)), dim=2
    )
    result = graph.optimize(start, GaussNewton())
    assert result.status is Status.STALLED
    assert "above the 1 met before, which is returned" in result.reason
    assert result.values[p[0]][0] == pytest.approx(1.0)
    never_worse(graph, start, result)


@pytest.mark.parametrize("option", ["update_tol", "chi2_rtol", "gradient_tol", "max_iterations", "max_seconds"])
@pytest.mark.parametrize("value", [-1, float("nan"), "1e-3"])
def test_thresholds_that_are_none(option: str, value: object) -> None:
    with pytest.raises(OptionError, match=option):
        Stop(**{option: value})  # type: ignore[arg-type]


def test_half_an_iteration() -> None:
    with pytest.raises(OptionError, match="whole number"):
        Stop(max_iterations=1.5)  # type: ignore[arg-type]
