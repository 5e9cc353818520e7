"""Loop closures accepted one after the other: what supports one, in which order, what goes back, what is a group."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal, Information, Isotropic
from models import SE2, SE3, LieGroup
from models.algebra import Index
from models.chi_squared import chi2_gate
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.robust import accepted_closures, grow
from nls.robust.accepted_closures import misfits, path_covariances, witnesses
from nls.robust.loop_graph import LOW, Neighbors, loop_graph, neighbors

(x,) = kinds("x")
N = 40
STEPS = np.arange(N - 1)
STEP = np.array([1.0, 0.0, 2 * np.pi / N])
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
CIRCLE = Values({x: (SE2, sim.chain(SE2, np.zeros(3), np.tile(STEP, (N - 1, 1))))})  # forty poses


def closures(i: list[int], j: list[int], off: Any = 0.0, noise: Diagonal = SIGMAS) -> Between:
    """Closures that miss the truth by so much."""
    return Between(x[i], x[j], SE2.between(CIRCLE[x][i], CIRCLE[x][j]) + off, noise)


def odometry(noise: Diagonal = SIGMAS, off: Any = 0.0) -> Between:
    """Without noise, but for what it is off."""
    return Between(x[STEPS], x[STEPS + 1], np.tile(STEP, (N - 1, 1)) + off, noise)


def test_paths_are_the_same_however_many_are_searched_together(monkeypatch: pytest.MonkeyPatch) -> None:
    edges = loop_graph(FactorGraph([odometry()]), CIRCLE).edges
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, N, (2, 30))
    together = path_covariances(edges, CIRCLE[x], i, j, 10.0)
    assert (np.linalg.eigvalsh(together[i != j]) > 0).all()
    for size in (1, 3 * N):
        monkeypatch.setattr(accepted_closures, "PLACES", size)
        np.testing.assert_array_equal(path_covariances(edges, CIRCLE[x], i, j, 10.0), together)


def test_what_the_others_contradict_later_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Right closures on both sides of two wrong ones, which odometry alone allows: its headings waver."""
    monkeypatch.setattr(accepted_closures, "misfits", lambda *_: np.zeros(12, dtype=bool))  # only given back here
    coarse, i = Diagonal(x=0.3, y=0.3, yaw=0.1), [*range(5, 10), *range(12, 17)]
    wrong = closures([10, 11], [30, 31], [1.8, -1.8, 0.0], coarse)
    loops = [closures(i, [k + 20 for k in i], noise=coarse), wrong]
    graph = FactorGraph([odometry(Diagonal(x=0.01, y=0.01, yaw=0.05)), *loops])
    monkeypatch.setattr(accepted_closures, "ACCEPTED_SHARE", 1.0)
    accepted: list[int] = []
    solved = accepted_closures._solved

    def noted(loops: Any, values: Values, which: Any) -> Any:
        accepted.append(int(which.sum()))
        return solved(loops, values, which)

    monkeypatch.setattr(accepted_closures, "_solved", noted)
    grown = accepted_closures.grow(graph, CIRCLE)
    assert accepted[0] == 12  # all pass, alone with odometry
    assert grown.masks[1].all()
    assert not grown.masks[2].any()


def test_odometry_that_leads_nowhere_does_not_keep_the_closures_from_being_solved() -> None:
    off = np.zeros((N - 1, 3))
    off[[5, 15, 25], 2] = 2.5  # turned the wrong way round, three times
    weak = Diagonal(x=0.5, y=0.5, yaw=3.0)
    i = list(range(36))
    loops = closures([*i, 0, 1], [*(k + 3 for k in i), 39, 38])
    graph = FactorGraph([odometry(weak, off), loops])
    start = nls.starts.chain(graph, CIRCLE)
    assert graph.chi2(start) > 1e4
    values, s = accepted_closures._solved(loop_graph(graph, start), start, np.ones(len(loops), dtype=bool))
    assert graph.chi2(values) < 10
    assert (s < 1).all()
    ends = (SE2.between(*found[x[[0, 39]]]) for found in (values, CIRCLE))
    np.testing.assert_allclose(*ends, atol=0.05)


def test_a_closure_that_nothing_supports_is_judged_by_the_stated_sigmas() -> None:
    right, wrong = closures([0], [39], [0.03, -0.03, 0.01]), closures([5], [30], [4.0, 2.0, 1.0])
    found = nls.gnc(FactorGraph([odometry(), right, wrong]), CIRCLE)
    assert [each.factor for each in found.rejected] == ["Between(x5, x30)"]
    assert found.sigma0 == 1.0


def test_copies_of_a_closure_neither_support_it_nor_tell_the_noise() -> None:
    far = closures([0, 15], [10, 39], 0.02)
    back = Between(x[[10]], x[[0]], SE2.inverse(far.z[:1]), SIGMAS)
    graph = FactorGraph([odometry(), far, far, back])
    pose_graph = loop_graph(graph, CIRCLE)
    found = neighbors(pose_graph.closures, pose_graph.odometry, CIRCLE[x])
    assert (found.support.tolist(), found.sigma0) == ([0] * 5, 1.0)
    assert not nls.gnc(graph, CIRCLE).rejected
    again = Between(x[[0]], x[[10]], far.z[0] + np.array([0.05, 0.0, 0.0]), SIGMAS)  # measured anew, no copy
    pose_graph = loop_graph(FactorGraph([odometry(), far, again]), CIRCLE)
    assert neighbors(pose_graph.closures, pose_graph.odometry, CIRCLE[x]).support.tolist() == [1, 0, 1]


def test_passing_are_the_closures_that_odometry_allows() -> None:
    two = closures([0, 15], [30, 39], np.array([[0.02], [30.0]]))
    pose_graph = loop_graph(FactorGraph([odometry(), two]), CIRCLE)
    assert neighbors(pose_graph.closures, pose_graph.odometry, CIRCLE[x]).passing == 0.5


def test_the_weights_that_say_nothing_are_named() -> None:
    loops = closures([0, 1, 2], [37, 38, 39], 0.0)
    oblique = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for blind in (np.diag([400.0, 400.0, 0.0]), 400 * oblique.T @ oblique):
        information = np.array([np.diag([400.0, 400.0, 1e4]), blind, np.diag([400.0, 400.0, 1e20])])
        other = Between(*loops.keys, loops.z, Information(information))
        with pytest.raises(GraphError, match=r"^Between\(x1, x38\): its weights say nothing"):
            nls.gnc(FactorGraph([odometry(), other]), CIRCLE)


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


def test_what_nothing_supports_does_not_lead_the_growth() -> None:
    grown = grow(FactorGraph([odometry(), closures([0, 1, 15], [30, 31, 39], 0.0)]), CIRCLE)
    assert grown.masks[1].all()
    grown = grow(FactorGraph([odometry(), closures([0, 15], [10, 39], 0.0)]), CIRCLE)
    assert not grown.masks[1].any()


def test_of_two_links_between_the_same_places_the_sharper_one_counts() -> None:
    k = np.arange(3)
    links = [Between(x[k], x[k + 1], STEP, Isotropic(sigma)) for sigma in (0.3, 0.01, 0.1)]
    values = Values({x: (SE2, np.zeros((4, 3)))})
    P = path_covariances(loop_graph(FactorGraph(links), values).edges, values[x], np.array([3]), np.array([0]), 1.0)
    assert P[0, 2, 2] == pytest.approx(3 * 0.01**2)


def test_the_probability_is_that_of_the_threshold() -> None:
    loops = closures([0, 3], [30, 25], np.array([[0.15, 0.0, 0.0], [0.05, 0.0, 0.0]]))  # 3 sigmas and 1
    graph = FactorGraph([odometry(), loops])
    graph.fix(x[np.arange(N)])
    (rejected,) = nls.gnc(graph, CIRCLE, probability=0.9, doubted=[loops]).rejected
    assert rejected.factor == "Between(x0, x30)"
    assert not nls.gnc(graph, CIRCLE, probability=0.999, doubted=[loops]).rejected


def row(at: Index) -> Neighbors:
    """One cluster of closures at some steps, near each other within five steps."""
    i, j = np.triu_indices(len(at), 1)
    none = np.zeros(len(at), dtype=np.intp)
    return Neighbors(none, none, near=np.column_stack([i, j])[at[j] - at[i] <= 5])


def test_closures_that_are_far_from_all_others_of_their_cluster_are_a_part_of_their_own() -> None:
    parts = row(np.r_[:100, 113:123]).parts(np.ones(110, dtype=bool))
    assert parts.tolist() == [0] * 100 + [100] * 10


def test_a_row_falls_apart_where_what_joins_it_was_not_accepted() -> None:
    accepted, cluster = np.ones(90, dtype=bool), row(np.arange(90))
    assert not cluster.parts(accepted).any()
    accepted[30:50] = False
    assert set(cluster.parts(accepted)[accepted]) == {0, 50}


def test_a_wrong_part_of_a_large_cluster_is_contradicted_by_the_rest() -> None:
    rng, n = np.random.default_rng(3), 120
    sigma = np.array([0.05, 0.05, 0.02])
    turn = SE2.exp(np.tile([1.0, 0.0, 2 * np.pi / n], (2 * n - 1, 1)))
    noise = Diagonal(x=sigma[0], y=sigma[1], yaw=sigma[2])
    walked = SE2.compose(turn, SE2.exp(rng.normal(0, sigma, turn.shape)))
    right = Between(x[0:n], x[n : 2 * n], SE2.exp(rng.normal(0, sigma, (n, 3))), noise)
    ahead, aside = SE2.exp([[11.0, 0.0, 11 * 2 * np.pi / n]] * 8), np.tile([0.0, 1.5, 0.0], (8, 1))
    z = SE2.compose(SE2.compose(ahead, aside), SE2.exp(rng.normal(0, sigma, (8, 3))))
    wrong = Between(x[40:48], x[n + 51 : n + 59], z, noise)
    graph = FactorGraph([Between(x[0 : 2 * n - 1], x[1 : 2 * n], walked, noise), right, wrong])
    loops = loop_graph(graph, Values({x: (SE2, np.zeros((2 * n, 3)))}))
    assert len(np.unique(loops.neighbors.cluster)) == 1
    result = graph.optimize(loops.values)
    judged = list(witnesses(loops, result.values, np.ones(n + 8, dtype=bool)))
    assert np.flatnonzero(misfits(judged, result, loops)).tolist() == [*range(n, n + 8)]
