"""Wrong loop closures among few, where little is known of the noise: copies, single closures, weights without a say."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from factors import Between, Diagonal, Information, Isotropic
from models import SE2, SE3, LieGroup
from models.algebra import Array
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.analysis.chi_squared import chi2_gate
from nls.robust import grow
from nls.robust.growth import path_covariances
from nls.robust.loop_graph import LOW, loop_graph, neighbors

(x,) = kinds("x")
N = 40
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
STEP = np.array([[1.0, 0.0, 2 * np.pi / N]])


@pytest.fixture(scope="module")
def track() -> tuple[Between, Values]:
    """A circle of forty poses without its last step, and odometry without noise."""
    k = np.arange(N - 1)
    odometry = Between(x[k], x[k + 1], np.tile(STEP, (N - 1, 1)), SIGMAS)
    T = [np.zeros(3)]
    for _ in k:
        T.append(SE2.compose(T[-1], STEP[0]))
    return odometry, Values({x: (SE2, np.array(T))})


def closures(values: Values, i: list[int], j: list[int], off: Array | list[float]) -> Between:
    """Closures that miss the truth by so much."""
    T = values[x]
    return Between(x[i], x[j], SE2.between(T[i], T[j]) + off, SIGMAS)


def test_a_closure_that_nothing_supports_is_judged_by_the_stated_sigmas(track: tuple[Between, Values]) -> None:
    odometry, values = track
    right, wrong = closures(values, [0], [39], [0.03, -0.03, 0.01]), closures(values, [5], [30], [4.0, 2.0, 1.0])
    found = nls.gnc(FactorGraph([odometry, right, wrong]), values)
    assert [each.factor for each in found.rejected] == ["Between(x5, x30)"]
    assert found.sigma0 == 1.0


def test_copies_of_a_closure_neither_support_it_nor_tell_the_noise(track: tuple[Between, Values]) -> None:
    odometry, values = track
    far = closures(values, [0, 15], [10, 39], 0.02)
    back = Between(x[[10]], x[[0]], SE2.inverse(far.z[:1]), SIGMAS)
    graph = FactorGraph([odometry, far, far, back])
    pose_graph = loop_graph(graph, values)
    found = neighbors(pose_graph.closures, pose_graph.odometry, values[x])
    assert found.support.tolist() == [0] * 5
    assert found.sigma0 == 1.0
    assert not nls.gnc(graph, values).rejected
    again = Between(x[[0]], x[[10]], far.z[0] + np.array([0.05, 0.0, 0.0]), SIGMAS)  # measured anew, no copy
    pose_graph = loop_graph(FactorGraph([odometry, far, again]), values)
    assert neighbors(pose_graph.closures, pose_graph.odometry, values[x]).support.tolist() == [1, 0, 1]


def test_passing_are_the_closures_that_odometry_allows(track: tuple[Between, Values]) -> None:
    odometry, values = track
    two = closures(values, [0, 15], [30, 39], np.array([[0.02], [30.0]]))
    pose_graph = loop_graph(FactorGraph([odometry, two]), values)
    assert neighbors(pose_graph.closures, pose_graph.odometry, values[x]).passing == 0.5


def test_the_weights_that_say_nothing_are_named(track: tuple[Between, Values]) -> None:
    odometry, values = track
    loops = closures(values, [0, 1, 2], [37, 38, 39], 0.0)
    oblique = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for blind in (np.diag([400.0, 400.0, 0.0]), 400 * oblique.T @ oblique):
        information = np.array([np.diag([400.0, 400.0, 1e4]), blind, np.diag([400.0, 400.0, 1e20])])
        other = Between(*loops.keys, loops.z, Information(information))
        with pytest.raises(GraphError, match=r"^Between\(x1, x38\): its weights say nothing"):
            nls.gnc(FactorGraph([odometry, other]), values)


def test_numbers_without_any_noise_say_nothing_of_the_sigmas() -> None:
    k = np.arange(5)
    still = Between(x[k], x[k + 1], np.zeros((5, 3)), SIGMAS)
    graph = FactorGraph([still, Between(x[[0, 1]], x[[5, 5]], np.zeros((2, 3)), SIGMAS)])
    found = nls.gnc(graph, Values({x: (SE2, np.zeros((6, 3)))}))
    assert not found.rejected
    assert found.local == found.sigma0 == 1.0
    assert found.strain == 0.0


@pytest.mark.parametrize("space", [SE2, SE3])
@pytest.mark.parametrize("turned", [(), (0,), (1,), (0, 1)])
def test_two_closures_disagree_by_chi2_of_the_loop_they_make(
    space: LieGroup, turned: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nls.robust.loop_graph.ENOUGH_PAIRS", 1)  # one pair is enough to see its chi2
    rng = np.random.default_rng(3)
    n, d, k = 30, space.dim, np.arange(29)
    step = space.exp(0.4 * rng.normal(size=(n - 1, d)))
    root = rng.normal(size=(n + 1, d, d)) + 2 * np.eye(d)
    information = 100 * root.mT @ root
    values = nls.starts.chain(
        FactorGraph([Between(x[k], x[k + 1], step, SIGMAS if d == 3 else Isotropic(0.1))]),
        Values({x: (space, space.identity(n))}),
    )
    T = values[x]
    i, j = np.array([2, 6]), np.array([25, 21])
    for each in turned:
        i[each], j[each] = j[each], i[each]
    z = space.compose(space.between(T[i], T[j]), space.exp(1e-3 * rng.normal(size=(2, d))))
    odometry = Between(x[k], x[k + 1], step, Information(information[:-2]), convention="log")
    loops = Between(x[i], x[j], z, Information(information[-2:]), convention="log")
    pose_graph = loop_graph(FactorGraph([odometry, loops]), values)
    found = neighbors(pose_graph.closures, pose_graph.odometry, T)
    around = np.r_[2:7, 21:26]  # the closures, and four steps at either end
    loop = FactorGraph([odometry[np.r_[2:6, 21:25]], loops])
    result = loop.optimize(Values({x: (space, T[around], around)}))
    assert found.sigma0**2 * chi2_gate(d, LOW) == pytest.approx(result.chi2_final, rel=1e-2)
    assert found.support.tolist() == [1, 1]


def test_paths_are_compared_in_meters_per_radian() -> None:
    k = np.arange(2)
    sharp, straight = Diagonal(x=1e-3, y=1e-3, yaw=0.1), Diagonal(x=1.0, y=1.0, yaw=1e-3)
    graph = FactorGraph([Between(x[k], x[k + 1], STEP, sharp), Between(x[0], x[2], STEP, straight)])
    values = Values({x: (SE2, np.zeros((3, 3)))})
    edges = loop_graph(graph, values).edges
    yaw = [path_covariances(edges, values[x], np.array([0]), np.array([2]), m)[0, 2, 2] for m in (1.0, 1e3)]
    np.testing.assert_allclose(yaw, [2 * 0.1**2, 1e-3**2])


def test_what_nothing_supports_does_not_lead_the_growth(track: tuple[Between, Values]) -> None:
    odometry, values = track
    grown = grow(FactorGraph([odometry, closures(values, [0, 1, 15], [30, 31, 39], 0.0)]), values)
    assert grown.masks[1].all()
    grown = grow(FactorGraph([odometry, closures(values, [0, 15], [10, 39], 0.0)]), values)
    assert not grown.masks[1].any()


def test_of_two_links_between_the_same_places_the_sharper_one_counts() -> None:
    k = np.arange(3)
    links = [Between(x[k], x[k + 1], STEP, Isotropic(sigma)) for sigma in (0.3, 0.01, 0.1)]
    values = Values({x: (SE2, np.zeros((4, 3)))})
    P = path_covariances(loop_graph(FactorGraph(links), values).edges, values[x], np.array([3]), np.array([0]), 1.0)
    assert P[0, 2, 2] == pytest.approx(3 * 0.01**2)


def test_the_probability_is_that_of_the_threshold(track: tuple[Between, Values]) -> None:
    odometry, values = track
    loops = closures(values, [0, 3], [30, 25], np.array([[0.15, 0.0, 0.0], [0.05, 0.0, 0.0]]))  # 3 sigmas and 1
    graph = FactorGraph([odometry, loops])
    graph.fix(x[np.arange(N)])
    assert [each.factor for each in nls.gnc(graph, values, probability=0.9, doubted=[loops]).rejected] == [
        "Between(x0, x30)"
    ]
    assert not nls.gnc(graph, values, probability=0.999, doubted=[loops]).rejected
