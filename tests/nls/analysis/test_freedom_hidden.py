"""Free directions that rounding hides, and weights and lengths that rounding cannot hold, are found and named."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from factors import Bearing, Between, Factor, Isotropic, Prior, Range
from models import SE2, SE3, R
from models.algebra import Array
from models.sensors import direction
from nls import FactorGraph, LevenbergMarquardt, Marginals, UnderconstrainedError, Values, kinds
from tests.combinations import for_all
from tests.nls.analysis.test_freedom import names, refused

x, l = kinds("x", "l")


def bearings_only(dim: int, seed: int) -> tuple[FactorGraph, Values]:
    """Poses and points joined by bearings: whatever the weights, the scale of the map is free."""
    rng, n, m = np.random.default_rng(seed), 12, 15
    group = SE2 if dim == 2 else SE3
    t = np.cumsum(rng.normal(size=(n, dim)) + 0.5, axis=0)
    turn = rng.normal(size=(n, group.dim - dim))
    X = group.compose(group.exp(np.hstack([t, np.zeros_like(turn)])), group.exp(np.hstack([np.zeros_like(t), turn])))
    L = 8 * rng.normal(size=(m, dim))
    i, k = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(m)))
    p = group.act(group.inverse(X[i]), L[k])
    z = direction(p)[0]
    z = z + 0.001 * rng.normal(size=z.shape)
    return FactorGraph([Bearing(x[i], l[k], z, Isotropic(0.001))]), Values({x: (group, X), l: (R(dim), L)})


@for_all(dim=[2, 3], seed=range(2))
def test_the_free_scale_of_a_map_of_bearings_is_always_seen(dim: int, seed: int) -> None:
    graph, values = bearings_only(dim, seed)
    with pytest.raises(UnderconstrainedError, match="1 direction free"):
        Marginals(graph, values)
    with pytest.raises(UnderconstrainedError, match="1 direction free"):
        graph.optimize(values)
    result = graph.optimize(values, LevenbergMarquardt())
    assert not result.converged or result.underconstrained


def test_directions_left_free_are_no_degrees_of_freedom() -> None:
    """One range determines the scale."""
    graph, values = bearings_only(2, 3)
    held = graph.optimize(values, LevenbergMarquardt())
    free = graph.optimize(values, LevenbergMarquardt(), gauge="none")
    assert len(held.underconstrained) == 1
    assert len(free.underconstrained) == 4
    assert held.dof == free.dof == 12 * 15 - (12 * 3 + 15 * 2 - 4)
    graph.add(Range(x[0], l[0], np.linalg.norm(values[l[0]] - values[x[0]][:2]), Isotropic(0.01)))
    assert np.isfinite(Marginals(graph, values).all(l)).all()
    damped, plain = (graph.optimize(values, optimizer) for optimizer in (LevenbergMarquardt(), nls.GaussNewton()))
    assert damped.converged
    assert plain.converged
    assert damped.underconstrained == ()
    assert damped.chi2_final == pytest.approx(plain.chi2_final, rel=1e-6)
    assert damped.dof == plain.dof == held.dof


@for_all(optimizer=[nls.GaussNewton(), LevenbergMarquardt(), nls.Dogleg()])
def test_a_step_onto_a_singular_place_loses_nothing(optimizer: nls.Optimizer) -> None:
    graph = FactorGraph([Range(x[0], l[0], [0.0], Isotropic(0.1)), Prior(l[0], [0.0, 0.0], Isotropic(1.0))])
    graph.fix(x[0])
    result = graph.optimize(Values({x: (SE2, [0.0, 0.0, 0.0]), l: (R(2), [1.0, 0.0])}), optimizer)
    assert result.chi2_final <= 101.0
    assert np.isfinite(result.values[l[0]]).all()
    if optimizer.name == "gauss-newton":
        assert result.status is nls.Status.DIVERGED
        assert "Range(x0, l0)" in result.reason


def test_a_free_gauge_with_dogleg_ends_with_a_status() -> None:
    def residual(A: Array, B: Array) -> Array:
        d = B - A
        return np.stack([d[:, 0] + d[:, 1], d[:, 1] ** 2], axis=1)

    graph = FactorGraph([Factor.from_function(residual, [x[0], x[1]], dim=2, relative=True)])
    start = Values({x: (R(2), [[0.0, 0.0], [1.0, 1.0]])})
    for update_tol in np.logspace(-8, -3, 7):  # at d = 0 the system is singular
        stop = nls.Stop(update_tol=float(update_tol), chi2_rtol=0, gradient_tol=0)
        result = graph.optimize(start, nls.Dogleg(stop), gauge="free")
        assert result.converged
        assert result.chi2_final < 1e-6
        assert not result.underconstrained or "x1" in result.underconstrained[0]


def one_unlike(n: int, sigma: float, measured: float = 1.0) -> tuple[FactorGraph, Values]:
    """A chain of poses, the first held; the step from x2 to x3 has another sigma, or another length."""
    X = np.stack([np.arange(n + 0.0), np.zeros(n), np.zeros(n)], axis=1)
    i = np.delete(np.arange(n - 1), 2)
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.02, 0.01], Isotropic(0.1))])
    graph.add(Between(x[2], x[3], [measured, 0.02, 0.01], Isotropic(sigma)))
    graph.add(Prior(x[0], X[0], Isotropic(0.1)))
    X[3:, 0] += measured - 1.0
    return graph, Values({x: (SE2, X)})


@for_all(n=[6, 120], sigma=[1e-150, 1e-12, 1e10, 1e149])
def test_the_measurement_whose_weight_is_unlike_all_others_is_named(n: int, sigma: float) -> None:
    """Nothing is free, whatever the weights; n = 120 is past 300 columns: the sparse path."""
    graph, values = one_unlike(n, sigma)
    error = refused(graph, values)
    assert (error.nullity, error.components) == (0, ())
    assert f"of Between(x2, x3), sigma {sigma:.3g} (information {sigma**-2:.3g}); its row of A is" in str(error)
    assert error.advice[0].action == ("larger sigma" if sigma < 0.1 else "smaller sigma")
    assert "free" not in str(error)


@for_all(measured=[1e12, 1e100])
def test_the_measurement_that_is_far_too_long_is_named(measured: float) -> None:
    graph, values = one_unlike(6, 0.1, measured)
    error = refused(graph, values)
    assert error.nullity == 0
    assert "of Between(x2, x3), sigma 0.1 (information 100, Jacobian up to" in str(error)
    assert f"its measurement is [{measured}, 0.02, 0.01]" in str(error)
    assert names(error) == ["x2", "x3"]


@for_all(sigma=[1e-12, 1e10])
def test_what_is_free_is_named_beside_a_weight_that_is_unlike_all_others(sigma: float) -> None:
    graph, values = one_unlike(6, sigma)
    X = np.concatenate([values[x[0:6]], [[0.0, 0.0, 0.0]]])
    graph.add(Prior(x[6], X[6], Isotropic(0.1), components=["x", "y"]))
    error = refused(graph, Values({x: (SE2, X)}))
    assert (names(error), error.components) == (["x6"], ("x6: yaw",))


def test_two_kinds_of_weights_name_no_single_measurement() -> None:
    """All steps of a half are a million times as heavy as those of the other: as many rows as there are."""
    X = np.stack([np.arange(200.0), np.zeros(200), np.zeros(200)], axis=1)
    i = np.arange(199)
    sigma = np.where(i < 90, 1e-9, 1e3)
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.0, 0.0], Isotropic(sigma)), Prior(x[0], X[0], Isotropic(1e3))])
    error = refused(graph, Values({x: (SE2, X)}))
    assert error.nullity == 0
    assert "and there are 270 rows of about that size" in str(error)
    assert error.advice[0].action == "compare sigmas"
