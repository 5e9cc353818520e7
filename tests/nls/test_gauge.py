"""What relative measurements leave free, and the four things that can be done about it."""

from __future__ import annotations

import numpy as np
import pytest

from factors import (
    Bearing,
    Between,
    BetweenSensors,
    DriftingStep,
    Factor,
    Isotropic,
    Landmark,
    Position,
    Prior,
    Shifted,
)
from models import SE2, SE3, SO3, LieGroup, R
from models.algebra import Array
from models.sensors import direction
from nls import (
    FactorGraph,
    GaussNewton,
    GraphWarning,
    Incremental,
    Marginals,
    Pinv,
    Stop,
    UnderconstrainedError,
    Values,
)
from nls.analysis.inspection import inspect
from nls.gauge import calibrations, placeless_kinds
from nls.linear import SOLVERS
from nls.missions.scans import dead_reckoning
from tests.nls.graphs import Seen, distance, in_frame, l, moved, p, pose_graph, walk, x, y

ONE_STEP = GaussNewton(Stop(max_iterations=1, update_tol=0.0))
GAUGES = ("first", "prior", "free", "none")
TIGHT = GaussNewton(Stop(update_tol=1e-11))


@pytest.fixture(params=(R(2), SE2, SO3, SE3), ids=str)
def group(request: pytest.FixtureRequest) -> LieGroup:
    return request.param  # type: ignore[no-any-return]


def two_components(group: LieGroup, numbers: tuple[int, ...] = (9, 4, 7, 30, 21, 25)) -> tuple[FactorGraph, Values]:
    X = walk(group, 6, np.random.default_rng(0))
    number = np.array(numbers)
    i, j = [0, 1, 0, 3, 4, 3], [1, 2, 2, 4, 5, 5]
    z = group.retract(group.between(X[i], X[j]), 0.05 * np.random.default_rng(1).normal(size=(6, group.dim)))
    graph = FactorGraph([Between(x[number[i]], x[number[j]], z, Isotropic(0.1))])
    return graph, Values({x: (group, X, number)})


def test_first_holds_the_lowest_number_and_says_so(group: LieGroup) -> None:
    sample = pose_graph(group, anchored=False, numbers=(40, 7, 8, -3, 1000, 12, 9, 11))
    result = sample.graph.optimize(sample.values)
    assert result.converged
    assert result.gauge == "x-3 fixed"
    assert np.array_equal(result.values[x[-3]], sample.values[x[-3]])
    assert distance(group, result.values[x[40]][None], sample.values[x[40]][None]) > 1e-6
    assert result.dof == sample.graph.linearize(sample.values).A.shape[0] - 7 * group.dim
    assert "gauge: x-3 fixed" in str(result)


def test_every_gauge_has_the_same_chi2(group: LieGroup) -> None:
    """One variable in every component is held, or has a prior at its start, which is not the graph's."""
    graph, values = two_components(group)
    first, prior, free = (graph.optimize(values, TIGHT, gauge=gauge) for gauge in ("first", "prior", "free"))
    assert first.chi2_final > 0.01
    assert first.gauge == "x4, x21 fixed"
    assert np.array_equal(first.values[x[[4, 21]]], values[x[[4, 21]]])
    assert prior.gauge == "a prior of unit information on x4, x21"
    assert distance(group, prior.values[x[[4, 21]]], values[x[[4, 21]]]) < 1e-8
    assert prior.dof == 6 * group.dim + 2 * group.dim - 6 * group.dim
    assert len(graph.factors) == 1
    for result in (prior, free):
        assert result.chi2_final == pytest.approx(first.chi2_final, rel=1e-9)


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "pinv"])
def test_free_takes_the_step_of_the_pseudo_inverse(name: str) -> None:
    if (why := SOLVERS[name].missing()) is not None:
        pytest.skip(f"{name}: {why}")
    sample = pose_graph(SE2, anchored=False)
    for group, graph, values in ((SE2, sample.graph, sample.values), (SE3, *two_components(SE3))):
        short = graph.optimize(values, ONE_STEP, Pinv(), gauge="none")
        free = graph.optimize(values, ONE_STEP, SOLVERS[name](), gauge="free")
        assert free.gauge.startswith("free, shortest step")
        assert free.linear_solver.split(",")[0] == name
        assert distance(group, free.values[x], short.values[x]) < 1e-9
        assert distance(group, values[x], free.values[x]) > 1e-4


def test_free_with_points_and_something_fixed() -> None:
    graph, values = landmarks()
    graph.add(Between(y[0], y[1], [1.0], Isotropic(1)))
    stacks = {kind: (s.manifold, s.X, s.numbers) for kind, s in values.stacks.items()}
    values = Values({**stacks, y: (R(1), [0.0, 5.0, 9.0])})
    graph.add(Between(y[1], y[2], [1.0], Isotropic(1)))
    graph.fix(y[2])
    short = graph.optimize(values, ONE_STEP, Pinv(), gauge="none")
    free = graph.optimize(values, ONE_STEP, gauge="free")
    for kind in (x, l, y):
        np.testing.assert_allclose(free.values[kind], short.values[kind], rtol=0, atol=1e-9)
    assert free.values[y].ravel() == pytest.approx([7.0, 8.0, 9.0])


def test_with_a_prior_or_a_fixed_variable_nothing_else_is_held(group: LieGroup) -> None:
    sample, held = pose_graph(group), pose_graph(group, anchored=False)
    held.graph.fix(x[5])
    results = {gauge: sample.graph.optimize(sample.values, TIGHT, gauge=gauge) for gauge in GAUGES}
    reference = results["none"]
    assert reference.converged
    assert distance(group, sample.values[x], reference.values[x]) > 1e-3
    for gauge, result in results.items():
        fixed = held.graph.optimize(held.values, gauge=gauge)
        said = "nothing is fixed" if gauge == "none" else "fixed by the graph itself"
        assert (result.gauge, fixed.gauge, result.dof) == (said, said, reference.dof)
        assert distance(group, reference.values[x], result.values[x]) < 1e-9
        assert np.array_equal(fixed.values[x[5]], held.values[x[5]])
        assert distance(group, held.values[x[[0]]], fixed.values[x[[0]]]) > 1e-6


def test_components_are_held_one_by_one() -> None:
    graph, values = two_components(SE2)
    graph.add(Prior(x[7], values[x[7]], Isotropic(1)))
    assert graph.optimize(values).gauge == "x21 fixed"
    graph.fix(x[30])
    assert graph.optimize(values).gauge == "fixed by the graph itself"
    even = np.arange(0, 16, 2)
    many = FactorGraph([Between(x[even], x[even + 1], [1.0], Isotropic(1))])
    result = many.optimize(Values({x: (R(1), np.zeros((16, 1)))}))
    assert (result.gauge, result.converged) == ("x0, x2, x4, x6, x8 and 3 more fixed", True)


def landmarks() -> tuple[FactorGraph, Values]:
    rng = np.random.default_rng(5)
    X, L = walk(SE2, 4, rng), 3 * rng.normal(size=(3, 2))
    i, j = np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4)
    number = np.array([8, 6, 5, 9])
    seen = Seen(x[number[i]], l[j], in_frame(X[i], L[j]) + 0.05 * rng.normal(size=(12, 2)), Isotropic(0.1))
    return FactorGraph([seen]), Values({l: (R(2), L + 0.1 * rng.normal(size=L.shape)), x: (SE2, X, number)})


def test_drifts_and_all_that_is_joined_to_them_move_with_nothing() -> None:
    """The mean m is in no unmoved slot itself; the drifts d that it joins are."""
    graph, values = dead_reckoning(np.arange(31.0)[:, None] * [1.0, 0.0, 0.0])
    pattern = graph.pattern(values)
    assert placeless_kinds(pattern) == {"d", "m"}
    still = calibrations(pattern)
    assert [int(still[pattern.offsets[kind] :][:n].sum()) for kind, n in (("x", 31), ("d", 3), ("m", 1))] == [0, 3, 1]
    record = inspect(graph, values)
    assert (record["variables"], record["components"], record["component_sizes"]) == (35, 1, [31])


def test_a_pose_is_held_rather_than_a_landmark() -> None:
    graph, values = landmarks()
    result = graph.optimize(values)
    assert result.gauge == "x5 fixed"  # points come first in the values, but cannot hold a heading
    assert result.converged
    assert result.chi2_final < 3 * result.dof
    assert graph.optimize(values, TIGHT, gauge="free").chi2_final == pytest.approx(result.chi2_final, rel=1e-6)


def test_a_function_of_two_variables_is_not_taken_for_relative() -> None:
    """Powell's function in two scalars: both have an optimum of their own and neither may be held in silence."""

    def powell(a: Array, b: Array) -> Array:
        return np.concatenate([1e4 * a * b - 1.0, np.exp(-a) + np.exp(-b) - 1.0001], axis=1)

    graph = FactorGraph([Factor.from_function(powell, [p[0], p[1]], 2)])
    result = graph.optimize(Values({p: (R(1), [0.0, 1.0])}))
    assert result.gauge == "fixed by the graph itself"
    assert result.converged
    assert result.values[p].ravel() == pytest.approx([1.098159e-5, 9.106146], rel=1e-5)
    graph = FactorGraph([Factor.from_function(lambda a, b: b - a - 1.0, [p[0], p[1]], 1)])
    with pytest.raises(UnderconstrainedError) as caught:  # a difference is refused
        graph.optimize(Values({p: (R(1), [0.0, 5.0])}))
    assert caught.value.nullity == 1


def test_variables_without_measurement_are_held_with_a_warning() -> None:
    sample = pose_graph(SE2)
    stack = sample.values.stacks["x"]
    values = Values({x: (SE2, stack.X, stack.numbers), l: (R(2), np.arange(14.0).reshape(7, 2))})
    with pytest.warns(GraphWarning, match="l0, l1, l2, l3, l4 and 2 more: no measurement touches them; fixed"):
        result = sample.graph.optimize(values)
    assert result.converged
    assert np.array_equal(result.values[l], values[l])
    assert result.dof == sample.graph.optimize(sample.values).dof
    with pytest.raises(UnderconstrainedError, match="14 unknowns are without any measurement"):
        sample.graph.optimize(values, gauge="none")


def test_the_warning_is_about_the_line_that_called() -> None:
    graph = FactorGraph([Prior(x[0], [0.0], Isotropic(1.0))])
    values = Values({x: (R(1), [0.0, 1.0])})
    for call in (graph.optimize, lambda each: Marginals(graph, each)):
        with pytest.warns(GraphWarning, match="x1: no measurement touches it") as caught:
            call(values)
        assert [warning.filename for warning in caught] == [__file__]


def turned_start(group: LieGroup, n: int = 4) -> tuple[list[Factor], Array, Values]:
    """Poses that see points, with hardly an error; the points; a start where everything is turned and shifted."""
    rng, space = np.random.default_rng(3), R(group.point_dim)
    X, k = walk(group, n, rng), np.arange(n)
    L, T = group.act(X, rng.normal(size=(n, space.dim)) + 2), group.exp(np.full((1, group.dim), 0.4))
    i, j = np.repeat(k, 3), np.clip(np.repeat(k, 3) + np.tile([-1, 0, 1], n), 0, n - 1)
    seen = Landmark(x[i], l[j], group.act(group.inverse(X[i]), L[j]), Isotropic(0.1))
    z = moved(group, group.between(X[:-1], X[1:]), 0.001, rng)
    values = Values({x: (group, group.compose(T, X)), l: (space, group.act(T, L)), p: (R(1), [0.0])})
    return [Between(x[k[:-1]], x[k[1:]], z, Isotropic(0.1)), seen], L, values


def along_world(kind: str, L: Array) -> list[Factor]:
    """Measurements without error between points, which know the axes of the world."""
    i, j, free = l[[0, 1, 2]], l[[1, 2, 3]], Prior(p[0], [0.0], Isotropic(1.0))
    if kind == "difference":
        return [Between(i, j, np.diff(L[:4], axis=0), Isotropic(0.1)), free]
    z = direction(np.diff(L[:4], axis=0))[0]
    bearing = Bearing(i, j, z, Isotropic(0.1))
    return [bearing if kind == "bearing" else Shifted(bearing, np.ones((z.shape[1], 1)), p[0]), free]


in_plane_and_space = pytest.mark.parametrize("group", [SE2, SE3], ids=str)


@in_plane_and_space
@pytest.mark.parametrize("kind", ["difference", "bearing", "shifted bearing"])
def test_beside_poses_points_that_know_the_axes_leave_a_shift_free(group: LieGroup, kind: str) -> None:
    """They determine the headings. A pose that is held would keep the one of its start."""
    seen, L, start = turned_start(group)
    known = along_world(kind, L)
    assert FactorGraph([*seen, known[1]]).optimize(start).gauge == "x0 fixed"
    for gauge, says in zip(GAUGES[:3], ("l0 fixed", "a prior of unit information on l0", "l0 fixed"), strict=True):
        result = FactorGraph([*seen, *known]).optimize(start, gauge=gauge)
        assert result.gauge.endswith(says)
        assert result.converged
        assert result.chi2_final < 0.01
        np.testing.assert_allclose(result.values[l] - result.values[l[0]], L - L[0], atol=0.01)
    marginals = Marginals(FactorGraph([*seen, *known]), result.values)
    assert marginals.gauge == "l0 fixed"
    assert (np.diag(marginals.covariance(x[0], "world")) > 1e-6).all()


@in_plane_and_space
@pytest.mark.parametrize("lag", [None, 3])
def test_points_that_know_the_axes_turn_a_map_that_grows(group: LieGroup, lag: int | None) -> None:
    (steps, seen), L, start = turned_start(group, 9)
    smoother = Incremental(1e-6, lag)
    for k in range(9):
        new = [f[f.keys[1 - (f is seen)].numbers == k] for f in (steps, seen)]
        smoother.update([f for f in new if len(f)], start if k == 0 else None)
        if 3 <= k < 6:  # one difference in space leaves a turn about itself free, and waits
            smoother.update(Between(l[k - 1], l[k], L[k] - L[k - 1], Isotropic(0.1)))
    assert smoother.chi2 < 0.01
    assert not smoother.pending
    found = smoother.values.stack(l)
    np.testing.assert_allclose(found.X - found.X[0], L[found.numbers] - L[found.numbers[0]], atol=0.02)
    assert Marginals(smoother.graph, smoother.values).gauge == f"l{found.numbers[0]} fixed"


def test_one_difference_in_space_leaves_a_turn_about_itself_free() -> None:
    seen, L, start = turned_start(SE3)
    differences, free = along_world("difference", L)
    graph = FactorGraph([*seen, differences[[0]], free])
    with pytest.raises(UnderconstrainedError, match="leave 1 direction free") as caught:
        graph.optimize(start)
    assert str(caught.value.advice[0]) == "fix a pose"
    graph.fix(x[0])  # the cure
    assert graph.optimize(start).converged


@in_plane_and_space
def test_a_difference_of_zero_has_no_direction(group: LieGroup) -> None:
    """Two names of one point: everything turns about it, and the pose is fixed."""
    seen, L, start = turned_start(group)
    same = Between(l[0], l[1], np.zeros_like(L[0]), Isotropic(100.0))
    result = FactorGraph([*seen, same, Prior(p[0], [0.0], Isotropic(1.0))]).optimize(start)
    assert (result.gauge, result.converged) == ("x0 fixed", True)
    np.testing.assert_array_equal(result.values[x[0]], start[x[0]])


def test_a_difference_of_zero_between_two_offsets_has_a_direction() -> None:
    seen, L, start = turned_start(SE2)
    sensors = BetweenSensors(l[0], l[1], np.zeros(2), Isotropic(0.1), (L[1] - L[0], np.zeros(2)))
    result = FactorGraph([*seen, sensors, Prior(p[0], [0.0], Isotropic(1.0))]).optimize(start)
    assert (result.gauge, result.converged) == ("l0 fixed", True)
    np.testing.assert_allclose(result.values[l[1]] - result.values[l[0]], L[1] - L[0], atol=0.01)


def test_a_graph_that_is_fixed_as_a_whole_has_no_covariance_but_zero() -> None:
    sample = pose_graph(SE2)
    sample.graph.fix(x[sample.values.stack(x).numbers])
    marginals = Marginals(sample.graph, sample.values)
    i, j = sample.graph.factors[0].keys
    assert not marginals.cross(i, j, frame="body").any()


def test_a_calibration_that_walks_is_not_held() -> None:
    """The poses determine it, though the factor that joins its values is relative."""
    X, drifts = walk(SE2, 3, np.random.default_rng(0)), np.array([[0.1, 0.0], [0.3, 0.2]])
    z = SE2.between(X[:-1], X[1:])
    z[:, :2] += drifts
    step = DriftingStep(x[[0, 1]], x[[1, 2]], p[[0, 1]], z, Isotropic(0.1), length=[1.0, 1.0])
    graph = FactorGraph([step, Between(p[0], p[1], drifts[1] - drifts[0], Isotropic(0.1))])
    values = Values({x: (SE2, X), p: (R(2), np.zeros((2, 2)))})
    graph.fix(x[2])
    graph.add(Position(x[[0, 1]], X[:2, :2], Isotropic(0.01)))
    result = graph.optimize(values)
    assert (result.gauge, result.chi2_final < 1e-12) == ("fixed by the graph itself", True)
    np.testing.assert_allclose(result.values[p], drifts, atol=1e-6)
