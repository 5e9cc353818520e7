"""Groups of closures: redundancy of a common error, how far the map moves without them, and whom `explain` names."""

from __future__ import annotations

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal, Information, Isotropic, Prior, Tukey
from models import SE2, SE3, SO2, LieGroup, R
from models.algebra import Array, Index
from models.chi_squared import chi2_log_tail
from models.errors import UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.analysis import unverified_groups
from nls.analysis.leave_one_out import Checked, Linearization, checks
from nls.analysis.redundancy import Common, _common, closure_groups
from nls.analysis.suspects import GroupTests
from tests.combinations import for_all

x, y, p = kinds("x", "y", "p")
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
EPS = 1e-6


@pytest.fixture(scope="module")
def laps() -> sim.World:
    """Two laps of 60 poses, the second of which is tied to the first."""
    return sim.ring(np.random.default_rng(0), laps=2, per_lap=60)


def early(count: int = 10) -> Between:
    """Closures in a row that say that the second lap begins ten steps early."""
    k = np.arange(count)
    return Between(x[k], x[k + 50], np.zeros((count, 3)), SIGMAS)


def common(graph: FactorGraph, values: Values) -> list[Common]:
    """The common error of every group of a graph in which a variable is fixed."""
    system = graph.linearize(values)
    return [error for _, error in _common(values, system, list(closure_groups(system.pattern)))]


@for_all(space=[SE2, SE3])
def test_the_numbers_are_those_of_the_dense_problem_with_a_common_error(space: LieGroup) -> None:
    """Closures in both directions with correlated noise; the common error goes into what they measure."""
    rng = np.random.default_rng(4)
    n, d, k = 12, space.dim, np.arange(11)
    X = space.exp(0.5 * rng.normal(size=(n, d)))
    i, j = np.array([0, 11, 2]), np.array([10, 1, 11])
    root = 5 * np.eye(d) + rng.normal(size=(3, d, d))
    z = space.compose(space.between(X[i], X[j]), space.exp(1e-5 * rng.normal(size=(3, d))))
    loops = Between(x[i], x[j], z, Information(root.mT @ root))
    graph = FactorGraph([Between(x[k], x[k + 1], space.between(X[:-1], X[1:]), Isotropic(0.3)), loops], [x[0]])
    values = graph.optimize(Values({x: (space, X)})).values
    late = values[x][np.maximum(i, j)]
    turn = space.adjoint(space.between(late, late[[0, 0, 0]]))

    def errors(nabla: Array) -> Array:
        xi = turn @ nabla  # of every later end
        off = np.where((i < j)[:, None], space.compose(z, space.exp(-xi)), space.compose(space.exp(xi), z))
        model, places = values.gather(Between(x[i], x[j], off, loops.noise))
        return np.asarray(model.error(*places)).reshape(-1)

    system = graph.linearize(values)
    A, b = system.A.toarray(), system.b
    C = np.zeros((len(b), d))
    C[-3 * d :] = -np.stack([(errors(EPS * e) - errors(-EPS * e)) / (2 * EPS) for e in np.eye(d)], axis=1)
    rest = np.eye(len(b)) - A @ np.linalg.pinv(A)
    step, *_ = np.linalg.lstsq(np.c_[A, C], b, rcond=None)
    freed = b - np.c_[A, C] @ step
    (group,) = common(graph, values)
    assert group.redundancy == pytest.approx(np.trace(np.linalg.solve(C.T @ C, C.T @ rest @ C)) / d, rel=1e-4)
    assert group.t == pytest.approx(b @ b - freed @ freed, rel=1e-2)
    assert group.dx == pytest.approx(step[: A.shape[1]], rel=1e-2, abs=1e-2 * np.abs(step).max())
    assert group.observable


def test_a_loop_of_vectors_has_the_redundancy_and_the_motion_of_the_closed_form() -> None:
    """n steps of variance s^2 and k closures of variance c^2 that are off by D along the track: a stretched chain."""
    n, k, s, c, off = 100, 4, 0.1, 0.05, 8.0
    steps, ones = np.arange(n), np.ones(k, dtype=np.intp)
    graph = FactorGraph([Between(x[steps], x[steps + 1], np.tile([1.0, 0.0], (n, 1)), Isotropic(s))])
    graph.add(Between(x[0 * ones], x[n * ones], np.tile([n + off, 0.0], (k, 1)), Isotropic(c)))
    result = graph.optimize(Values({x: (R(2), np.zeros((n + 1, 2)))}))
    (group,) = unverified_groups(graph, result.values)
    N, Q = k / c**2, n * s**2
    moved = off * Q / (Q + 1 / N)
    assert group.redundancy == pytest.approx(1 / N / (Q + 1 / N))
    assert group.sigmas == pytest.approx(moved / (s * np.sqrt(n)))  # at the last pose
    assert group.meters == pytest.approx(moved / 2)  # at both ends, as the maps are aligned
    assert group.rms == pytest.approx(moved * np.std(np.arange(n + 1) / n))
    assert group.closures == ((1, 0), (1, 1), (1, 2), (1, 3))
    assert group.names == ("Between(x0, x100)",) * 4


def test_a_wrong_group_that_carries_the_map_is_listed_and_a_right_one_is_not(laps: sim.World) -> None:
    odometry, closures = laps.graph.factors
    for ten, listed in ((early(), True), (closures[:10], False)):
        graph = FactorGraph([odometry, ten])
        groups = unverified_groups(graph, graph.optimize(laps.start).values)
        assert [len(group.closures) for group in groups] == [10] * listed


def test_two_sessions_that_one_group_joins_fall_apart_without_it() -> None:
    k, track = np.arange(29), np.c_[np.arange(30.0), np.zeros((30, 2))]
    steps = np.tile([1.0, 0.0, 0.0], (29, 1))
    graph = FactorGraph([Between(x[k], x[k + 1], steps, SIGMAS), Between(y[k], y[k + 1], steps, SIGMAS)])
    graph.add(Between(x[[3, 4]], y[[3, 4]], [[0.0, 5.0, 0.0]] * 2, SIGMAS))
    result = graph.optimize(Values({x: (SE2, track), y: (SE2, track + np.array([0.0, 5.0, 0.0]))}))
    (group,) = unverified_groups(graph, result.values)
    assert group.redundancy == pytest.approx(0.0, abs=1e-9)
    assert group.meters == group.rms == group.sigmas == np.inf


def test_measurements_that_close_no_track_are_not_judged(laps: sim.World) -> None:
    """Objects with a pose, positions by a prior, rotations alone."""
    seen = Between(x[[3, 40]], p[[0, 1]], [[1.0, 2.0, 0.0]] * 2, SIGMAS)
    graph = FactorGraph([laps.graph.factors[0], Prior(x[0], laps.truth[x][0], SIGMAS), seen])
    values = Values({x: (SE2, laps.truth[x]), p: (SE2, np.zeros((2, 3)))})
    assert unverified_groups(graph, graph.optimize(values).values) == ()
    k = np.arange(59)
    noise = Isotropic(0.01)
    turns = FactorGraph([Between(x[k], x[k + 1], np.zeros((59, 1)), noise), Between(x[0], x[59], [1.0], noise)])
    assert unverified_groups(turns, turns.optimize(Values({x: (SO2, np.zeros((60, 1)))})).values) == ()


def test_a_group_that_a_kernel_has_let_go_says_nothing(laps: sim.World) -> None:
    odometry, closures = laps.graph.factors
    graph = FactorGraph([odometry, closures[20:], early(3).robust(Tukey(1.0))], [x[0]])
    values = graph.optimize(laps.truth).values
    assert [error.redundancy for error in common(graph, values)][-1] == 1.0
    assert unverified_groups(graph, values) == ()


def test_a_graph_that_is_free_is_refused(laps: sim.World) -> None:
    odometry, closures = laps.graph.factors
    bearing = Between(x[119], x[120], [1.0, 0.0, 0.0], Information(np.diag([1.0, 1.0, 0.0])))
    values = Values({x: (SE2, np.r_[laps.truth[x], [[0.0, 0.0, 0.0]]])})
    with pytest.raises(UnderconstrainedError, match="x120"):
        unverified_groups(FactorGraph([odometry, closures, bearing]), values)


STEP = 0.3


def lines() -> tuple[FactorGraph, Values, Checked]:
    """A linear problem at its optimum: 120 points on a line, closures in three groups, of which the third is off."""
    rng = np.random.default_rng(0)
    a = np.arange(119)
    i = np.array([0, 1, 2, 1, 3, 50, 51, 52])
    j = np.array([30, 31, 32, 100, 102, 90, 91, 92])
    off = np.where((i >= 50)[:, None], [3.0, -2.0], 0.0)
    noise = Diagonal([0.1, 0.2])
    steps = Between(x[a], x[a + 1], [STEP, 0.0] + 0.1 * rng.normal(size=(119, 2)), noise)
    closures = Between(x[i], x[j], (j - i)[:, None] * [STEP, 0.0] + off + 0.1 * rng.normal(size=(8, 2)), noise)
    graph = FactorGraph([steps, closures, Prior(x[0], [[0.0, 0.0]], noise)])
    values = graph.optimize(Values({x: (R(2), np.zeros((120, 2)))})).values
    return graph, values, Checked(Linearization(graph.pattern(values), values))


def without(graph: FactorGraph, values: Values, members: Index) -> float:
    """chi2 of the optimum without some closures, of a linear problem."""
    masks = [np.ones(len(factor), dtype=bool) for factor in graph.factors]
    masks[1][members] = False
    return graph.only(masks).optimize(values).chi2_final


def ones(graph: FactorGraph) -> list[Array]:
    return [np.ones(len(factor)) for factor in graph.factors]


def test_t_is_the_decrease_of_chi2_without_the_group() -> None:
    graph, values, checked = lines()
    tests = GroupTests(checked, ones(graph), 10)
    test = tests.worst()
    assert test is not None
    assert (test.index.tolist(), test.batch.tolist()) == ([5, 6, 7], [1, 1, 1])
    assert test.t == pytest.approx(graph.chi2(values) - without(graph, values, test.index), rel=1e-8)
    assert test.log_tail == chi2_log_tail(test.t, 6)
    assert max(t.t.max() for t in checks(checked, 3)) < test.t
    halved = GroupTests(checked, [4 * each for each in ones(graph)], 10).worst()
    assert halved is not None
    assert halved.t == pytest.approx(test.t / 4)


def test_groups_follow_when_others_are_taken_out() -> None:
    graph, values, checked = lines()
    tests = GroupTests(checked, ones(graph), 10)
    assert tests.worst() is not None  # joint covariances of all groups from here
    taken = np.array([0, 1, 2])
    checked.take_out(np.ones(3, dtype=np.intp), taken)
    accepted = ones(graph)
    accepted[1][taken] = 0.0
    again = Checked(Linearization(checked.linear.pattern, values, accepted))
    for k in range(3):
        np.testing.assert_allclose(checked.e[k], again.e[k], atol=1e-9)
        np.testing.assert_allclose(checked.C[k], again.C[k], atol=1e-9)
        np.testing.assert_array_equal(checked.w[k], again.w[k])
    late, fresh = tests.worst(), GroupTests(again, ones(graph), 10).worst()
    assert late is not None
    assert fresh is not None
    assert late.index.tolist() == fresh.index.tolist()
    fall = without(graph, values, taken) - without(graph, values, np.r_[taken, late.index])
    assert [late.t, fresh.t] == pytest.approx([fall, fall], rel=1e-7)


@for_all(seed=range(2))
def test_of_five_wrong_closures_that_agree_all_are_named_and_no_right_one(seed: int) -> None:
    """Three right closures against five wrong ones: one by one, the right ones are the farthest from all others."""
    world, k = sim.ring(np.random.default_rng(seed), laps=2, per_lap=60), np.arange(5)
    odometry, closures = world.graph.factors
    seen = SE2.between(world.truth[x[15 + k]], world.truth[x[105 + k]])
    wrong = Between(x[15 + k], x[105 + k], SE2.compose([[2.0, 1.0, 0.3]], seen), SIGMAS)  # one place for another
    graph = FactorGraph([odometry, closures[[0, 15, 29]], wrong])
    explanation = nls.explain(graph, graph.optimize(world.start).values)
    assert {suspect.factor for suspect in explanation.suspects} == {wrong.describe(k) for k in range(5)}


def test_a_group_without_which_something_is_free_is_not_taken_out() -> None:
    """Two trajectories that four closures join, one of which is wrong."""
    truth, k = np.arange(31.0)[:, None] * [1, 0, 0], np.arange(4)
    joined = Between(x[k], y[k], (k == 2)[:, None] * [3.0, 2.0, 0.5], SIGMAS)
    graph = FactorGraph([*(Between(p[:30], p[1:31], [1.0, 0, 0], SIGMAS) for p in (x, y)), joined])
    values = graph.optimize(Values({x: (SE2, truth), y: (SE2, truth)})).values
    assert [suspect.factor for suspect in nls.explain(graph, values).suspects] == [joined.describe(2)]


@for_all(dof=[1, 15, 300])
def test_the_logarithm_of_the_tail_goes_on_where_the_tail_is_zero(dof: int) -> None:
    """The slope, the hazard rate of chi-squared, has no step at the change to the expansion; log(0) is never taken."""
    t = np.append(np.linspace(1.0, 2500.0, 5000), [1e4, 2e4])
    log_tail = np.array([chi2_log_tail(float(bound), dof) for bound in t])
    assert np.isfinite(log_tail).all()
    slope = np.diff(log_tail) / np.diff(t)
    assert (slope <= 0).all()
    assert np.abs(np.diff(slope[:-2])).max() < 0.05
    assert slope[-1] == pytest.approx(-0.5, abs=0.02)
