"""Motions between local maps: their information, and matches that the others contradict."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls import kinds
from nls.analysis.chi_squared import chi2_gate
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
