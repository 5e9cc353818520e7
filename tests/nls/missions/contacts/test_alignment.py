"""Alignments of maps that have landmarks in common, of maps that have none, and of motions that nobody knows."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls.analysis.chi_squared import chi2_gate
from nls.missions.contacts.alignment import Points, aligned

SIGMA = 0.05  # m, of a landmark beside its anchor
MOTIONS: dict[str, tuple[LieGroup, Array, Array]] = {  # group, sigmas of the motion, the motion
    "plane": (SE2, np.array([1.0, 1.0, 0.1]), np.array([0.8, -1.2, 0.15])),
    "space": (SE3, np.array([1.0, 1.0, 0.05, 0.002, 0.002, 0.1]), np.array([-1.1, 0.6, 0.03, 0.001, 0.0, -0.12])),
}


def two_maps(name: str, common: int, seed: int = 0) -> tuple[LieGroup, Points, Points, Array, float]:
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
    alignment = aligned(*two_maps(name, 40, seed))
    assert alignment is not None
    assert alignment.sure
    assert alignment.chance < 15
    assert (np.abs(alignment.delta - MOTIONS[name][2]) < 4 * SIGMA / np.sqrt(40)).all()
    assert np.count_nonzero((alignment.i == alignment.j) & (alignment.j < 40)) >= 36


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", range(5))
def test_nothing_in_common_is_never_sure(name: str, seed: int) -> None:
    alignment = aligned(*two_maps(name, 0, seed))
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
    group, a, b, Sigma, gate = two_maps("plane", 80)
    for times in (1e4, 1e12):
        assert aligned(group, a, b, times * Sigma, gate) is None
    thin = [Points(points.p, 1e-20 * points.C) for points in (a, b)]  # cells are many, and nothing matches
    assert aligned(group, *thin, Sigma, gate) is None
    few = [Points(points.p[:9], points.C[:9]) for points in (a, b)]
    assert aligned(group, *few, Sigma, gate) is None
    alignment = aligned(group, a, Points(0 * b.p, b.C), Sigma, gate)  # landmarks at one point tell no place
    assert alignment is None or not alignment.sure


def test_two_landmarks_at_one_place_match_once() -> None:
    group, a, b, Sigma, gate = two_maps("plane", 40)
    a.p[1], b.p[1] = a.p[0], b.p[0]
    alignment = aligned(group, a, b, Sigma, gate)
    assert alignment is not None
    assert len({*alignment.i}) == len({*alignment.j}) == len(alignment.i)
