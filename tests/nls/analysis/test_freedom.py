"""Under-constrained problems: what is free by name and number, also where rounding hides it, and what helps."""

from __future__ import annotations

import re

import numpy as np
import pytest

import nls
from factors import Bearing, Between, Diagonal, Factor, Information, Isotropic, Prior, Range, SqrtInformation
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.sensors import direction
from nls import EvaluationError, FactorGraph, LevenbergMarquardt, Marginals, UnderconstrainedError, Values
from nls.linear import SOLVERS
from tests.combinations import for_all
from tests.nls.graphs import GROUPS, Seen, in_frame, l, p, pose_graph, walk, x
from tests.nls.solving import null_space

INSTALLED = [name for name in SOLVERS if SOLVERS[name].missing() is None]
REFUSING = [name for name in INSTALLED if name != "pinv"]


def refused(graph: FactorGraph, values: Values, gauge: str = "none", solver: str = "lu") -> UnderconstrainedError:
    with pytest.raises(UnderconstrainedError) as caught:
        graph.optimize(values, linear_solver=SOLVERS[solver](), gauge=gauge)
    assert isinstance(caught.value, np.linalg.LinAlgError)
    return caught.value


def names(error: UnderconstrainedError) -> list[str]:
    return [repr(key) for key in error.keys]


def actions(error: UnderconstrainedError) -> list[str]:
    return [advice.action for advice in error.advice]


@for_all(solver=REFUSING)
def test_an_untouched_variable(solver: str) -> None:
    graph = FactorGraph([Prior(x[0:3], SE2.identity(3), Isotropic(1))])
    error = refused(graph, Values({x: (SE2, SE2.identity(5), [0, 1, 2, 30, 40])}), solver=solver)
    assert names(error) == ["x30", "x40"]
    assert error.nullity == 6
    assert error.components == ("x30: x, y, yaw", "x40: x, y, yaw")
    assert "6 unknowns are without any measurement" in str(error)
    assert actions(error) == ["factors", "drop", "fix"]


@for_all(group=GROUPS)
def test_a_component_without_anchor(group: LieGroup) -> None:
    """The start is the best, as the first system is singular."""
    sample = pose_graph(group, anchored=False)
    error = refused(sample.graph, sample.values)
    assert error.nullity == group.dim
    assert len(error.components) == group.dim
    assert set(names(error)) <= {f"x{k}" for k in range(8)}
    assert "all 8 variables connected to x0" in str(error)
    assert f"leave {group.dim} direction{'s' if group.dim > 1 else ''} free" in str(error)
    assert actions(error) == ["fix", "prior", "gauge"]
    assert np.array_equal(error.values[x], sample.values[x])


def two(group: LieGroup, n: int, anchored: bool) -> tuple[FactorGraph, Values]:
    """Two chains of n poses each."""
    X = walk(group, 2 * n, np.random.default_rng(3))
    i = np.array([k for k in range(2 * n - 1) if k != n - 1])
    graph = FactorGraph([Between(x[i], x[i + 1], group.between(X[i], X[i + 1]), Isotropic(0.1))])
    if anchored:
        graph.add(Prior(x[2], X[2], Isotropic(0.1)))
    return graph, Values({x: (group, X)})


@pytest.mark.parametrize(("group", "n"), [(R(2), 4), (SE2, 4), (SE3, 4), (SE2, 160), (SE3, 70)], ids=str)
def test_two_components(group: LieGroup, n: int) -> None:
    """Both float, then the second alone. n = 70 in space and 160 in the plane are past 300 columns: the sparse path."""
    error = refused(*two(group, n, anchored=False))
    assert error.nullity == min(12, 2 * group.dim)
    for text in error.components:
        assert len({int(k) < n for k in re.findall(r"x(\d+):", text)}) == 1  # no mixture of both
    graph, values = two(group, n, anchored=True)
    error = refused(graph, values)
    assert error.nullity == group.dim
    assert {int(name[1:]) for name in names(error)} <= set(range(n, 2 * n))
    assert f"all {n} variables connected to x{n}" in str(error)
    assert "connected to x0" not in str(error)
    system = graph.linearize(values)
    N = null_space(system)
    assert (N.shape, np.linalg.matrix_rank(N)) == ((2 * n * group.dim, group.dim), group.dim)
    np.testing.assert_allclose(np.linalg.norm(N, axis=0), 1.0, rtol=1e-12)
    assert np.abs(system.A @ N).max() < 1e-7
    assert np.abs(N[: n * group.dim]).max() < 1e-7


@for_all(n=[2, 122])
def test_a_landmark_with_one_free_direction(n: int) -> None:
    """A component that nothing measures, and a direction across the axes, of one of two points beside some poses."""
    X, L = walk(SE2, n, np.random.default_rng(4)), np.array([[3.0, 1.0], [4.0, -2.0]])
    steps = Between(x[0 : n - 1], x[1:n], SE2.between(X[:-1], X[1:]), Isotropic(0.1))
    seen = Seen(x[[0, 1]], l[[0, 0]], in_frame(X[:2], L[[0, 0]]), Isotropic(0.1))
    for prior, component in (
        (Prior(l[1], [4.0, 0.0], Isotropic(0.2), components=["x"]), "l1: y"),
        (Prior(l[1], [4.0, 0.0], Information(np.array([[4.0, 4.0], [4.0, 4.0]]))), "l1: x, y"),
    ):
        graph = FactorGraph([Prior(x[0], X[0], Isotropic(0.1)), steps, seen, prior])
        error = refused(graph, Values({x: (SE2, X), l: (R(2), L)}))
        assert (error.nullity, names(error), error.components) == (1, ["l1"], (component,))


@for_all(n=[20, 120])
def test_more_directions_than_are_looked_for(n: int) -> None:
    X = np.zeros((2 * n, 1))
    i = 2 * np.arange(n)
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0], Isotropic(1))])
    error = refused(graph, Values({x: (R(1), X)}))
    assert f"leave {'at least 96' if n > 96 else n} directions free" in str(error)
    assert error.nullity == min(n, 96)


def test_the_error_carries_the_best_values() -> None:
    """The second point is singular: x^2 loses its slope at 0, where the first step leads."""
    residual = Factor.from_function(
        lambda X: X**2 + 1.0, p[0], 1, jacobians=lambda X: [np.where(np.abs(X) < 0.5, 0.0, 2.0)[..., None]]
    )
    error = refused(FactorGraph([residual]), Values({p: (R(1), [1.0])}))
    assert error.values[p[0]][0] == pytest.approx(0.0)
    assert names(error) == ["p0"]


@for_all(case=[(20, 1000.0), (150, 300.0)], solver=[name for name in ("cholesky", "lu") if name in INSTALLED])
def test_a_weak_prior_is_named_as_such(solver: str, case: tuple[int, float]) -> None:
    """A precise chain whose first pose has a weak prior; n = 150 is past 300 columns: the sparse path."""
    n, sigma = case
    X = walk(SE2, n, np.random.default_rng(0))
    chain = Between(x[0 : n - 1], x[1:n], SE2.between(X[:-1], X[1:]), Isotropic(1e-4))
    graph, values = FactorGraph([chain, Prior(x[0], X[0], Isotropic(sigma))]), Values({x: (SE2, X)})
    error = refused(graph, values, solver=solver)
    assert (error.nullity, error.components) == (0, ())
    assert {"x0", f"x{n - 1}"} <= set(names(error))
    assert "determine every unknown" in str(error)
    assert "13 digits" in str(error)
    assert f"of all {n} variables connected to x0" in str(error)
    assert {"qr", "tighten", "units"} <= set(actions(error))
    if "qr" in INSTALLED:
        assert graph.optimize(values, linear_solver=SOLVERS["qr"]()).converged


def test_a_long_chain_that_bends_easily_is_not_free() -> None:
    """3,000 poses held at one end alone: a soft bending mode, but only the floating pair behind it is free."""
    n = 3000
    X = np.stack([np.arange(n + 2.0), np.zeros(n + 2), np.zeros(n + 2)], axis=1)
    i = np.array([*range(n - 1), n])
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.0, 0.0], Diagonal([0.1, 0.1, 0.05]))])
    graph.add(Prior(x[0], X[0], Isotropic(0.1)))
    error = refused(graph, Values({x: (SE2, X)}))
    assert (error.nullity, names(error)) == (3, [f"x{n}", f"x{n + 1}"])


def test_a_jacobian_that_vanishes_is_not_called_no_measurement() -> None:
    squared = Factor.from_function(lambda a, b: a**2 + b**2 - 1.0, [p[0], p[1]], 1)
    start = Values({p: (R(1), [0.0, 0.0]), l: (R(1), [0.0])})
    error = refused(FactorGraph([squared]), start)
    assert names(error) == ["p0", "p1", "l0"]
    assert error.nullity == 3
    assert "1 unknown is without any measurement: l0: x;" in str(error)
    assert "2 unknowns are not measured: p0: x; p1: x;" in str(error)
    assert actions(error) == ["factors", "drop", "fix", "measure", "start"]
    seen = FactorGraph([squared, Prior(l[0], [0.0], Isotropic(1.0)), Prior(l[0], [0.1], Isotropic(1.0))])
    assert actions(refused(seen, start)) == ["measure", "start", "damp", "truncate"]


def test_a_linear_system_says_what_is_free_when_it_is_solved() -> None:
    sample = pose_graph(SE2, anchored=False)
    system = sample.graph.linearize(sample.values)
    for solver in REFUSING:
        with pytest.raises(UnderconstrainedError) as caught:
            nls.gauss_newton_step(system, SOLVERS[solver]())
        assert (caught.value.nullity, caught.value.values) == (3, None), solver
    assert np.isfinite(nls.gauss_newton_step(system, SOLVERS["pinv"]())).all()


@pytest.mark.filterwarnings("ignore:overflow")
@for_all(solver=REFUSING)
def test_overflow_is_not_called_free(solver: str) -> None:
    graph = FactorGraph([Prior(x[[0, 1]], [[0.0], [0.0]], Isotropic([1.0, 1e-160]))])
    match = r"the squares of weights or Jacobians overflow: x of Prior\(x1\), sigma 1e-160 \(information inf\)"
    with pytest.raises(EvaluationError, match=match) as caught:
        nls.gauss_newton_step(graph.linearize(Values({x: (R(1), [[0.0], [0.0]])})), SOLVERS[solver]())
    assert repr(caught.value.keys[0]) == "x1"


def test_the_cure_is_a_gauge_only_where_it_can_be_held() -> None:
    difference = Factor.from_function(lambda a, b: b - a - 1.0, [p[0], p[1]], 1)
    for gauge in ("first", "free", "none"):
        error = refused(FactorGraph([difference]), Values({p: (R(1), [0.0, 5.0])}), gauge=gauge)
        assert actions(error) == ["fix", "prior", "relative"]
        assert error.advice[-1].about == (difference.describe(0),)
    graph = FactorGraph([difference, Between(x[0], x[1], [1.0], Isotropic(1))])
    error = refused(graph, Values({p: (R(1), [0.0, 5.0]), x: (R(1), [0.0, 1.0])}))
    assert actions(error) == ["fix", "prior", "gauge", "join", "relative"]
    assert error.advice[-1].about == (difference.describe(0),)


@for_all(n=[8, 40, 120])
def test_every_variable_with_a_free_direction_is_said_by_itself(n: int) -> None:
    """However many: more than 12, and (n = 120) past 300 columns; beside a floating chain of poses."""
    W = 10 * np.linalg.svd(np.random.default_rng(0).normal(size=(n, 1, 3)))[2]
    W[:, 0] = 0.0  # of every point one direction is held by nothing
    X = walk(SE2, 5, np.random.default_rng(1))
    prior = Prior(l[0:n], np.zeros((n, 3)), SqrtInformation(W))
    graph = FactorGraph([prior, Between(x[0:4], x[1:5], SE2.between(X[:-1], X[1:]), Isotropic(0.1))])
    error = refused(graph, Values({x: (SE2, X), l: (R(3), np.zeros((n, 3)))}))
    assert error.nullity == n + 3
    *single, _, _, _ = error.components
    assert [text.split(":")[0] for text in single] == [f"l{k}" for k in range(n)]
    assert not any(";" in text for text in single)
    for text in error.components[-3:]:
        assert text.startswith(("x0: ", "x1: "))
        assert "l" not in text


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
        stop = nls.Stop(update_tol=float(update_tol))
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
