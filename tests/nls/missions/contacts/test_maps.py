"""Motions between local maps: alignments, their information, and matches that the others contradict."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from models.algebra import Array
from models.chi_squared import chi2_gate
from nls import kinds
from nls.missions.contacts.alignment import Points, aligned
from nls.missions.contacts.loops import LocalMap, measured_motion

x, l = kinds("x", "l")
GROUPS: dict[str, LieGroup] = {"plane": SE2, "space": SE3}


def two_maps(group: LieGroup, rng: np.random.Generator) -> tuple[LocalMap, LocalMap, Array]:
    """Maps of the same 20 landmarks, whose errors grow together with the way to the anchor, and the motion between."""
    k, d = 20, group.point_dim
    xi = rng.normal(size=group.dim) * ([2.0] * d + [1.0] * (group.dim - d))
    G = group.exp(xi[None])
    p = rng.uniform(-6, 6, (k, d))
    p[-1] *= 3  # far out, it tells the turn
    maps = []
    for seen in (group.act(G, p), p):
        bend = np.einsum("k,a->ka", np.abs(seen[:, 0]), 0.02 * np.eye(d)[1])
        own = np.einsum("kl,ij->klij", np.eye(k), np.diag([0.02, 0.06, 0.03][:d]) ** 2)
        C = np.einsum("ki,lj->klij", bend, bend) + own
        L = np.linalg.cholesky(C.swapaxes(1, 2).reshape(k * d, k * d))
        maps.append(LocalMap(x[[0]], np.arange(k), seen + (L @ rng.normal(size=k * d)).reshape(k, d), C))
    return maps[0], maps[1], G


@pytest.mark.parametrize("name", GROUPS)
def test_the_information_of_a_motion_is_neither_more_nor_less_than_its_error(name: str) -> None:
    group, rng, k = GROUPS[name], np.random.default_rng(0), np.arange(20)
    nees = []
    for _ in range(100):
        a, b, G = two_maps(group, rng)
        start = group.compose(G, group.exp(0.05 * rng.normal(size=(1, group.dim))))[0]
        motion, Omega, agree = measured_motion(group, a, b, k, k, start, chi2_gate(group.point_dim, 0.9999))
        error = group.log(group.between(motion[None], G))[0]
        nees.append(error @ Omega @ error)
        assert np.count_nonzero(~agree) <= 1
    assert 0.85 * group.dim < np.mean(nees) < 1.15 * group.dim


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("wrong", [False, True])
def test_a_far_match_is_compared_with_what_the_others_predict(name: str, wrong: bool) -> None:
    """A far match tells most of the turn, and bends the motion its own way."""
    group, rng, k, left_out = GROUPS[name], np.random.default_rng(2), np.arange(12), 0
    few = np.append(np.arange(11), 19)
    gate = chi2_gate(group.point_dim, 0.995)
    for _ in range(40):
        a, b, G = two_maps(group, rng)
        a, b = (LocalMap(q.anchor, q.sightings[few], q.p[few], q.C[np.ix_(few, few)]) for q in (a, b))
        a.p[-1] += 0.5 * wrong * rng.permuted(np.eye(group.point_dim)[0])
        left_out += not measured_motion(group, a, b, k, k, G[0], gate)[2][-1]
    assert left_out >= 34 if wrong else left_out <= 2


@pytest.mark.parametrize("name", GROUPS)
def test_nothing_agrees_where_most_matches_are_wrong(name: str) -> None:
    group, k = GROUPS[name], np.arange(20)
    a, b, G = two_maps(group, np.random.default_rng(1))
    motion, Omega, agree = measured_motion(group, a, b, k, k[::-1], G[0], chi2_gate(group.point_dim, 0.999))
    assert not agree.any()
    assert np.isfinite([*motion, *Omega.reshape(-1)]).all()
    one = a._replace(p=0 * a.p), b._replace(p=0 * b.p)  # all at one point: no turn is told, and nothing fails
    assert np.isfinite(measured_motion(group, *one, k, k, G[0], 1e9)[1]).all()


SIGMA = 0.05  # m, of a landmark beside its anchor
MOTIONS: dict[str, tuple[LieGroup, Array, Array]] = {  # group, sigmas of the motion, the motion
    "plane": (SE2, np.array([1.0, 1.0, 0.1]), np.array([0.8, -1.2, 0.15])),
    "space": (SE3, np.array([1.0, 1.0, 0.05, 0.002, 0.002, 0.1]), np.array([-1.1, 0.6, 0.03, 0.001, 0.0, -0.12])),
}


def moved_maps(name: str, common: int, seed: int = 0) -> tuple[LieGroup, Points, Points, Array, float]:
    """Maps of 80 landmarks each, some of them the same, the second moved; the arguments of `aligned`."""
    group, sigmas, delta = MOTIONS[name]
    rng, d = np.random.default_rng(seed), group.point_dim
    extent = np.array([12.0, 8.0, 0.5])[:d]
    a, others = rng.uniform(-extent, extent, (80, d)), rng.uniform(-extent, extent, (80 - common, d))
    b = np.concatenate([a[:common], others])
    moved = group.act(group.inverse(group.exp(delta[None])), b) + SIGMA * rng.normal(size=b.shape)
    C = np.broadcast_to(SIGMA**2 * np.eye(d), (80, d, d))
    first, second = Points(a + SIGMA * rng.normal(size=a.shape), C), Points(moved, C)
    return group, first, second, np.diag(sigmas**2), chi2_gate(d, 0.999)


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", range(3))
def test_common_landmarks_tell_the_motion(name: str, seed: int) -> None:
    alignment = aligned(*moved_maps(name, 40, seed))
    assert alignment is not None
    assert alignment.sure
    assert alignment.chance < 15
    assert (np.abs(alignment.delta - MOTIONS[name][2]) < 4 * SIGMA / np.sqrt(40)).all()
    assert np.count_nonzero((alignment.i == alignment.j) & (alignment.j < 40)) >= 36


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", range(5))
def test_nothing_in_common_is_never_sure(name: str, seed: int) -> None:
    alignment = aligned(*moved_maps(name, 0, seed))
    assert alignment is None or not alignment.sure


def test_a_grid_of_landmarks_has_many_places() -> None:
    """Every shift by a step of the grid matches nearly as much."""
    step = 0.5
    p = step * np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    C = np.broadcast_to(SIGMA**2 * np.eye(2), (len(p), 2, 2))
    alignment = aligned(SE2, Points(p, C), Points(p, C), np.diag([0.04, 0.04, 1e-4]), chi2_gate(2, 0.999))
    assert alignment is not None
    assert len(alignment.i) > 300
    assert not alignment.sure


def test_a_motion_that_nobody_knows_waits() -> None:
    group, a, b, Sigma, gate = moved_maps("plane", 80)
    for times in (1e4, 1e12):
        assert aligned(group, a, b, times * Sigma, gate) is None
    thin = [Points(points.p, 1e-20 * points.C) for points in (a, b)]  # cells are many, and nothing matches
    assert aligned(group, *thin, Sigma, gate) is None
    few = [Points(points.p[:9], points.C[:9]) for points in (a, b)]
    assert aligned(group, *few, Sigma, gate) is None
    alignment = aligned(group, a, Points(0 * b.p, b.C), Sigma, gate)  # landmarks at one point tell no place
    assert alignment is None or not alignment.sure


def test_two_landmarks_at_one_place_match_once() -> None:
    group, a, b, Sigma, gate = moved_maps("plane", 40)
    a.p[1], b.p[1] = a.p[0], b.p[0]
    alignment = aligned(group, a, b, Sigma, gate)
    assert alignment is not None
    assert len({*alignment.i}) == len({*alignment.j}) == len(alignment.i)
