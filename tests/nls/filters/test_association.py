"""Which landmark a sighting is of: against brute force, where the nearest is wrong, and what one mistake costs."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

import sim
from factors import BearingRange, Between, Diagonal, Isotropic, Landmark, Prior
from models import SE2, R
from models.algebra import Array
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError
from nls import FactorGraph, Values, kinds
from nls.filters import association
from nls.filters.association import JointCompatibility, Nearest, jcbb, nearest, pair_precision_recall, precision_recall
from nls.filters.ekf import EKF
from tests.combinations import for_all

x, l = kinds("x", "l")
EVERY = (Nearest(), association.Assignment(), JointCompatibility(0.99))


@for_all(seed=range(20))
def test_assignment_is_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 5, size=2)
    d2, gate = rng.uniform(0, 20, size=(n, m)), 9.0

    def cost(choice: tuple[int, ...]) -> float:
        return sum(gate if j < 0 else float(d2[i, j]) for i, j in enumerate(choice))

    every = [
        c
        for c in product(range(-1, m), repeat=int(n))
        if len({j for j in c if j >= 0}) == sum(j >= 0 for j in c)
        and all(j < 0 or d2[i, j] <= gate for i, j in enumerate(c))
    ]
    found = association.assignment(d2, gate)
    assert tuple(found.tolist()) in every
    assert cost(tuple(found.tolist())) == pytest.approx(min(map(cost, every)))


def test_without_landmarks_nothing_is_found() -> None:
    for find in (nearest, association.assignment):
        assert find(np.zeros((3, 0)), 9.0).tolist() == [-1, -1, -1]
        assert find(np.zeros((0, 4)), 9.0).tolist() == []
    assert jcbb(np.zeros((0, 2), dtype=int), np.zeros((0, 2)), np.zeros((0, 0)), 3, 0.95).tolist() == [-1, -1, -1]
    assert nearest(np.array([[np.inf, 9.0]]), 9.0).tolist() == [1]


def joint_scene(seed: int, n: int, m: int, dim: int) -> tuple[Array, Array, Array]:
    """Pairs within their gate, innovations, stacked covariance with a large common part."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, 6, size=(m, dim))
    H = np.tile(np.eye(dim), (n * m, 1))
    S = 2.0 * H @ H.T + 0.05 * np.eye(n * m * dim) + 0.02 * np.diag(rng.uniform(size=n * m * dim))
    shift = rng.normal(size=dim) * 1.4
    truly = rng.permutation(m)[: min(n, m)]
    right = place[truly] + shift + 0.2 * rng.normal(size=(len(truly), dim))
    seen = np.concatenate([right, rng.uniform(0, 6, (n - len(truly), dim))])
    nu = (seen[:, None] - place[None]).reshape(-1, dim)
    pairs = np.stack([np.repeat(np.arange(n), m), np.tile(np.arange(m), n)], axis=1)
    d2 = np.array([distance([k], nu, S) for k in range(n * m)])
    near = np.flatnonzero(d2 <= chi2_gate(dim, 0.95))
    rows = (near[:, None] * dim + np.arange(dim)).reshape(-1)
    return pairs[near], nu[near], S[np.ix_(rows, rows)]


def distance(chosen: list[int], nu: Array, S: Array) -> float:
    dim = nu.shape[1]
    rows = np.concatenate([np.arange(k * dim, k * dim + dim) for k in chosen])
    e = nu[chosen].reshape(-1)
    return float(e @ np.linalg.solve(S[np.ix_(rows, rows)], e))


@for_all(seed=range(30))
def test_jcbb_is_the_best_of_all(seed: int) -> None:
    """Every set whose subsets in the order of the sightings are compatible too, as the search builds them."""
    n, m, dim = ((3, 4, 2), (4, 3, 1), (3, 3, 2))[seed % 3]
    pairs, nu, S = joint_scene(seed, n, m, dim)
    best: tuple[int, float, tuple[int, ...]] = (0, 0.0, (-1,) * n)
    index = {(int(i), int(j)): k for k, (i, j) in enumerate(pairs)}
    for c in product(range(-1, m), repeat=n):
        taken = [j for j in c if j >= 0]
        if len(set(taken)) < len(taken) or any((i, j) not in index for i, j in enumerate(c) if j >= 0):
            continue
        chosen = [index[i, j] for i, j in enumerate(c) if j >= 0]
        d2 = [distance(chosen[: k + 1], nu, S) for k in range(len(chosen))]
        if all(d <= chi2_gate(dim * (k + 1), 0.95) for k, d in enumerate(d2)):
            best = min(best, (-len(chosen), d2[-1] if d2 else 0.0, c))
    found = jcbb(pairs, nu, S, n, 0.95)
    assert tuple(found.tolist()) == best[2]


def row_of_posts() -> tuple[FactorGraph, Values]:
    """Five posts in a row, seen before and, four of them, after a step 0.62 m longer than measured (sigma 0.4 m).

    The posts are 1 m apart, not quite evenly: after the step each sighting is nearer to a neighbor.
    """
    posts = np.array([[0.0, 3.0], [1.0, 3.0], [2.1, 3.0], [3.0, 3.0], [4.15, 3.0]])
    X = np.array([[1.0, 0.0, 0.0], [2.62, 0.0, 0.0]])
    i, k = np.repeat([0, 1], [5, 4]), np.array([0, 1, 2, 3, 4, 1, 2, 3, 4])
    walk = Between(x[0], x[1], [1.0, 0.0, 0.0], Diagonal(x=0.4, y=0.01, yaw=0.001))
    seen = Landmark(x[i], l[k], SE2.act(SE2.inverse(X[i]), posts[k]), Isotropic(0.02))
    return FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), walk, seen]), Values({x: (SE2, X), l: (R(2), posts)})


def test_neighbors_deceive_the_nearest_but_not_all_together() -> None:
    graph, truth = row_of_posts()
    true = graph.factors[2].keys[1].numbers
    found = {}
    for associate in EVERY:
        ekf = EKF(associate=associate)
        track = ekf.run(graph, truth)
        score = precision_recall(ekf.associations, true)
        found[type(associate)] = score, float(np.abs(track.X[1] - truth[x[1]]).max())
    assert found[JointCompatibility] == (pytest.approx((1.0, 1.0)), pytest.approx(0.0, abs=0.01))
    for deceived in (Nearest, association.Assignment):
        assert found[deceived][0].precision == 0.0
        assert found[deceived][1] > 0.2


@pytest.mark.parametrize("associate", EVERY, ids=lambda a: type(a).__name__)
def test_landmarks_are_found_without_their_names(associate: association.Association) -> None:
    """Six landmarks 20 m apart and a known start: all are found, no pairing is wrong, some sightings left out."""
    world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    names = np.random.default_rng(0).integers(0, 6, size=len(world.sightings))  # what the graph says does not matter
    seen = BearingRange(world.sightings.keys[0], l[names], world.sightings.z, world.sightings.noise)
    graph = FactorGraph([*world.graph.factors[:2], seen])
    ekf = EKF(associate=associate)
    track = ekf.run(graph, world.start)
    score = precision_recall(ekf.associations, world.sightings.keys[1].numbers)
    assert len(track.landmarks) == 6
    assert score.precision == 1.0
    assert 0.95 < score.recall <= 1.0
    assert track.ate(world.truth).rmse < 0.2

    numbered = association.identified(seen, ekf.associations, l)  # and a graph of what it found
    start = Values({x: (SE2, track.X), l: (R(2), track.values[l], track.landmarks.numbers)})
    best = FactorGraph([*world.graph.factors[:2], numbered]).optimize(start)
    assert best.converged
    assert world.ate(best.values) < 0.15
    assert len(numbered) == sum(k >= 0 for k in ekf.associations) < len(seen)


def test_score_does_not_depend_on_the_numbers() -> None:
    true = np.array([4, 4, 9, 4, 9, 9, 2])
    found = np.array([0, 0, 1, 1, 1, -1, 2])  # 4 4 9 4->9 wrong, 9 right, 9 left out, 2 new
    assert precision_recall(found, true) == pytest.approx((2 / 3, 2 / 4))
    for order in permutations([10, 11, 12]):
        other = np.where(found >= 0, np.array(order)[found], -1)
        assert precision_recall(other, true) == pytest.approx((2 / 3, 2 / 4))
    assert precision_recall(true, true) == (1.0, 1.0)
    assert precision_recall([-1, -1], [3, 3]) == (1.0, 1.0)  # nothing was made, nothing could be found again
    assert precision_recall([0, 1], [3, 3]) == (1.0, 0.0)
    assert precision_recall([], []) == (1.0, 1.0)
    with pytest.raises(GraphError, match="shapes"):
        precision_recall([0, 1], [0])


def test_options_that_are_none_are_refused() -> None:
    for bad in (0.0, 1.0, True, "high", np.nan):
        with pytest.raises(OptionError, match="probability"):
            Nearest(probability=bad)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="at least probability"):
        JointCompatibility(0.99, new=0.9)
    with pytest.raises(OptionError, match="associate"):
        EKF(associate=nearest)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match=r"\(2,\) landmarks found for 9 sightings"):
        association.identified(row_of_posts()[0].factors[2], [0, 1], l)  # type: ignore[arg-type]


@for_all(seed=range(10))
def test_pairs_are_counted_as_one_by_one(seed: int) -> None:
    """Names do not matter, nothing left out or false is in a pair that is right."""
    rng = np.random.default_rng(seed)
    labels, true = rng.integers(-1, 4, size=(2, 30))
    same = [(labels[i] == labels[j] >= 0, true[i] == true[j] >= 0) for i, j in product(range(30), range(30)) if i < j]
    right = sum(a and b for a, b in same)
    score = pair_precision_recall(labels, true)
    assert score.precision == pytest.approx(right / sum(a for a, _ in same))
    assert score.recall == pytest.approx(right / sum(b for _, b in same))
    renamed = np.where(labels < 0, -1, 100 - labels)
    assert pair_precision_recall(renamed, true) == score
    assert pair_precision_recall(true, true) == (1.0, 1.0)


def test_pairs_of_nothing_and_of_other_lengths() -> None:
    assert pair_precision_recall([], []) == (1.0, 1.0)
    assert pair_precision_recall([-1, -1], [3, 3]) == (1.0, 0.0)
    assert pair_precision_recall([3, 3], [-1, -1]) == (0.0, 1.0)
    for shapes in (([0, 0], [0]), ([[0]], [[0]])):
        with pytest.raises(GraphError, match="pair_precision_recall: shapes"):
            pair_precision_recall(*shapes)
