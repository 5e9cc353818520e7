"""Under-constrained problems: the free variables and directions by name, how many there are, and what helps."""

from __future__ import annotations

import re

import numpy as np
import pytest

import nls
from factors import Between, Diagonal, Factor, Information, Isotropic, Prior, SqrtInformation
from models import SE2, SE3, LieGroup, R
from nls import EvaluationError, FactorGraph, UnderconstrainedError, Values
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
    assert "all 8 variables joined to x0" in str(error)
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
    assert f"all {n} variables joined to x{n}" in str(error)
    assert "joined to x0" not in str(error)
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
    assert f"of all {n} variables joined to x0" in str(error)
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
