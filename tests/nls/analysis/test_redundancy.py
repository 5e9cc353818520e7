"""Groups of closures that nothing verifies: redundancy of a common error, and how far the map moves without them."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import Between, Diagonal, Information, Isotropic, Prior, Tukey
from models import SE2, SE3, SO2, LieGroup, R
from models.algebra import Array
from models.errors import UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.analysis import unverified_groups
from nls.analysis.redundancy import Common, _common, closure_groups
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
    return list(_common(values, system, list(closure_groups(system.pattern))))


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
