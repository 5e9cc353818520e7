"""Likelihood fields and matches by correlation: poses recovered, scores one by one, what a wall leaves open."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from models import SE2
from models.errors import GraphError, OptionError
from nls.missions.scans import Field, Match, Verdict, match
from nls.missions.scans.closing import verdicts
from nls.missions.scans.correlation import YAW_STEP, scores
from tests.factors.evaluated import Array, refused, same

FLOOR = np.array([0.1, 0.1, 0.005])  # sigmas of any match, m m rad
WINDOW = (3.0, np.radians(8.0))
S = np.arange(0, 12, 0.2)
WALL = np.column_stack([S, 0 * S])
CORNER = np.concatenate([WALL, WALL[:, ::-1] * [1, 0.8], [[7.0, 4.0], [7.2, 4.1], [4.0, 6.0]]])


def seen_from(pose: Array, points: Array, sigma: float = 0.0, seed: int = 0) -> Array:
    """Points of the map in the frame of a scan at a pose (3,)."""
    noise = sigma * np.random.default_rng(seed).normal(size=points.shape)
    return SE2.act(SE2.inverse(pose[None]), points) + noise


def verdict(m: Match) -> int:
    return int(verdicts(*(np.array([v]) for v in (m.score, m.ratio, m.edge, m.spread, WINDOW[0])))[0])


def test_poses_are_recovered_from_guesses_all_over_the_window() -> None:
    field, rng = Field(CORNER), np.random.default_rng(1)
    for seed in range(20):
        true = rng.uniform([-5, -5, -3], [5, 5, 3])
        guess = true + rng.uniform(-0.5, 0.5, 3) * [WINDOW[0], WINDOW[0], WINDOW[1]]
        m = match(field, seen_from(true, CORNER, 0.05, seed), guess, WINDOW)
        e = SE2.local(true[None], m.pose[None])[0]
        assert (np.abs(e) < 2 * np.append(FLOOR[:2], 2 * FLOOR[2])).all(), (seed, e)
        assert m.score > 2.5
        assert verdict(m) == Verdict.ACCEPTED
        z = np.linalg.solve(m.covariance, e) @ e
        assert z < 11.3, "the 99 % quantile"


def test_scores_are_sums_over_the_field() -> None:
    """Every pose of a window, against the cells its points fall into, one at a time."""
    field = Field(CORNER, 0.5, 0.4)
    p, guess = seen_from(np.array([1.0, -2.0, 0.3]), CORNER, 0.1), np.array([1.3, -1.7, 0.35])
    volume, yaws, offsets = scores(field, p, guess, (2.0, 0.07))
    assert volume.shape == (len(yaws), len(offsets), len(offsets))
    same(np.diff(yaws), YAW_STEP)
    rng = np.random.default_rng(0)
    for k, i, j in rng.integers(0, volume.shape, (60, 3)):
        q = SE2.act(np.array([[*guess[:2], guess[2] + yaws[k]]]), p)
        cell = field.cells(q) + np.rint([offsets[i] / 0.4, offsets[j] / 0.4]).astype(int)
        within = ((cell >= 0) & (cell < field.L.shape)).all(axis=1)
        same(volume[k, i, j], field.L[tuple(cell[within].T)].sum(), rtol=1e-4, atol=1e-3)


def test_a_scan_that_lies_partly_outside_the_field_does_not_wrap_around() -> None:
    """A transform repeats its image: what leaves on one side must not come back on the other."""
    field = Field(WALL, 0.5, 0.4)
    far = np.concatenate([WALL + np.array(shift) for shift in ([0.0, 0.0], [14.0, 0.0], [0.0, -9.0], [200.0, 0.0])])
    volume, _, offsets = scores(field, far, np.zeros(3), (4.0, 0.01))
    middle = np.argmin(np.abs(offsets))
    alone, _, _ = scores(field, WALL, np.zeros(3), (4.0, 0.01))
    same(volume[1, middle, middle], alone[1, middle, middle], rtol=1e-4)


@given(st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1)))
def test_a_map_that_is_moved_moves_the_match(moved: tuple[float, float, float]) -> None:
    G, true = np.array([moved]), np.array([[0.6, -0.9, 0.05]])
    scan = seen_from(true[0], CORNER)
    m = match(Field(SE2.act(G, CORNER)), scan, G[0], WINDOW)
    e = SE2.local(SE2.compose(G, true), m.pose[None])[0]
    assert (np.abs(e) < 1.5 * FLOOR).all(), e
    assert m.edge < 0.01


def test_a_wall_is_weak_along_itself_and_in_the_frame_of_the_scan() -> None:
    """A scan turned by 90 deg sees the same wall across: the weak axis turns with it."""
    for yaw, weak, strong in ((0.0, 0, 1), (np.pi / 2, 1, 0), (-np.pi / 2, 1, 0)):
        pose = np.array([5.0, 1.0, yaw])
        m = match(Field(WALL), seen_from(pose, WALL[15:-15]), pose, WINDOW)
        sigma = np.sqrt(np.diag(m.covariance))
        assert sigma[weak] > 1.2 > 0.4 > sigma[strong], yaw
        direction = np.linalg.eigh(m.covariance[:2, :2])[1][:, -1]
        assert abs(direction[weak]) > 0.97
    oblique = np.array([5.0, 1.0, np.pi / 4])
    C = match(Field(WALL), seen_from(oblique, WALL[15:-15]), oblique, WINDOW).covariance
    assert C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]) < -0.7, "the wall runs along x - y of the scan"


def test_a_row_of_piles_fits_one_pile_further() -> None:
    """A scan of six of ten piles fits at several places, and no noise decides: the match is wide."""
    for period in (2.5, 4.0):
        row = np.concatenate([[period * k, 0.0] + 0.3 * RING for k in range(10)])
        true = np.array([3.5 * period, -3.0, 0.1])
        some = np.abs(row[:, 0] - 3.5 * period) < 3 * period
        guess = true + np.array([0.5 * period, 0.2, 0.02])  # two places are in the window
        m = match(Field(row), seen_from(true, row[some], 0.05), guess, (period, 0.1))
        assert m.ratio > 0.95
        assert verdict(m) == Verdict.WIDE
        hut = np.array([[3.5 * period, 3.0]]) + np.concatenate([WALL[:20], WALL[:20, ::-1]])
        scan = seen_from(true, np.concatenate([row[some], hut]), 0.05)
        decided = match(Field(np.concatenate([row, hut])), scan, guess, (period, 0.1))
        assert decided.ratio < 0.9, "what is there once decides"
        assert verdict(decided) == Verdict.ACCEPTED


def test_a_narrow_window_has_no_second_place() -> None:
    m = match(Field(CORNER), CORNER, np.zeros(3), (0.5, 0.02))
    assert (m.second, m.ratio) == (0, 0)


def test_the_truth_outside_the_window_shows_at_its_rim() -> None:
    true = np.array([4.5, 0.0, 0.0])
    scan = seen_from(true, CORNER)
    assert match(Field(CORNER), scan, np.zeros(3), (3.0, 0.1)).edge > 0.3
    assert match(Field(CORNER), scan, np.zeros(3), (6.0, 0.1)).edge < 1e-3
    turned = seen_from(np.array([0.0, 0.0, 0.25]), CORNER)
    assert match(Field(CORNER), turned, np.zeros(3), (3.0, 0.1)).edge > 0.3, "the yaw has a rim, too"


def test_nothing_fits() -> None:
    m = match(Field(CORNER), CORNER + 100.0, np.zeros(3), (2.0, 0.05))
    assert m.score < 0.01
    assert verdict(m) == Verdict.NO_FIT


def test_many_points_of_one_surface_say_no_more() -> None:
    once, often = (match(Field(CORNER), np.tile(CORNER, (n, 1)), np.zeros(3), WINDOW) for n in (1, 5))
    same(often.covariance, once.covariance, rtol=1e-3)
    assert (np.diag(once.covariance) >= FLOOR**2).all()


def test_verdicts_in_their_order() -> None:
    fine, narrow = np.array([2.0, 0.5, 0.0, 0.3]), np.array([3.0])  # score, ratio, edge, spread; window
    bad = np.array([0.5, 0.99, 0.5, 2.0])
    rows = np.vstack([np.where(np.eye(4), bad, fine), fine, bad])
    reasons = [Verdict.NO_FIT, Verdict.AMBIGUOUS, Verdict.AT_THE_RIM, Verdict.WIDE, Verdict.ACCEPTED, Verdict.NO_FIT]
    assert verdicts(*rows.T, narrow).tolist() == reasons


def test_what_does_not_fit() -> None:
    field = Field(CORNER)
    for points, guess in ((np.empty((0, 2)), np.zeros(3)), (np.zeros((4, 3)), np.zeros(3)), (CORNER, np.zeros(2))):
        refused(lambda p=points, g=guess: match(field, p, g, WINDOW), GraphError, r"match: points .* and guess")
    refused(lambda: match(field, CORNER * np.nan, np.zeros(3), WINDOW), GraphError, "not finite")
    refused(lambda: match(field, CORNER, [0, 0, np.inf], WINDOW), GraphError, "not finite")
    for window in ((0.0, 0.1), (1.0, 0.0), (-1.0, 0.1), (np.nan, 0.1)):
        refused(lambda w=window: match(field, CORNER, np.zeros(3), w), OptionError, "window")


RING = np.column_stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)])


RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-8, 8, (25, 2))


def by_formula(points: Array, q: Array, sigma: float) -> Array:
    """L with a share of 0.05 of strays."""
    d = np.linalg.norm(q[:, None] - points, axis=2).min(axis=1)
    return np.log(0.05 + 0.95 * np.exp(-(d**2) / (2 * sigma**2))) - np.log(0.05)


def test_the_formula_at_any_place() -> None:
    """Points lie in cells: a distance is off by half a diagonal at most, and L by no more than it changes there."""
    q = RNG.uniform(-9, 9, (500, 2))
    for sigma, resolution in ((0.5, 0.05), (1.5, 0.1)):
        L, _ = Field(POINTS, sigma, resolution).at(q)
        steepest = 1.43 / sigma  # of L, over all distances
        same(L, by_formula(POINTS, q, sigma), atol=1.5 * resolution * steepest)
    assert Field(POINTS).L.dtype == np.float32


def test_distances_are_exact_where_points_are_at_centers_of_cells() -> None:
    """Up to four sigmas, along the axes and across them; L is next to 0 beyond."""
    points = 0.25 * RNG.integers(-20, 21, (6, 2)) * [1.0, 3.0]
    for sigma, resolution in ((0.5, 0.25), (0.25, 0.125), (2.0, 0.0625)):
        field = Field(points, sigma, resolution)
        q = field.origin + resolution * np.indices(field.L.shape).reshape(2, -1).T[::7]
        d = np.linalg.norm(q[:, None] - points, axis=2).min(axis=1)
        L = field.L.reshape(-1)[::7]
        near = d <= 4 * sigma
        assert near.any()
        assert not near.all()
        same(L[near], by_formula(points, q[near], sigma), atol=1e-6)
        assert (L[~near] < 0.007).all()
        assert not L[d > 4 * sigma + 1.5 * resolution].any()


def test_the_gradient_is_that_of_L_within_a_cell() -> None:
    field = Field(POINTS, 0.5, 0.2)
    q = field.origin + 0.2 * (RNG.integers(0, 80, (200, 2)) + RNG.uniform(0.1, 0.9, (200, 2)))
    _, slope = field.at(q)
    for axis in range(2):
        step = 1e-3 * np.eye(2)[axis]
        difference = (field.at(q + step)[0] - field.at(q - step)[0]) / 2e-3
        same(slope[:, axis], difference, atol=1e-3)
    assert np.abs(slope).max() > 1


def test_zero_far_from_all_points_and_the_most_on_one() -> None:
    field = Field(POINTS, 0.5, 0.2)
    L, slope = field.at([[100.0, 0.0], [-1e6, 3.0], [0.0, 30.0]])
    assert not L.any()
    assert not slope.any()
    assert field.L.max() == np.float32(-np.log(0.05))
    assert max(field.L[0].max(), field.L[-1].max(), field.L[:, 0].max(), field.L[:, -1].max()) < 0.01


def test_points_that_make_no_field() -> None:
    for points in (np.empty((0, 2)), [1.0, 2.0], np.zeros((3, 3))):
        refused(lambda points=points: Field(points), GraphError, r"Field: points of shape .*; expected \(n, 2\)")
    refused(lambda: Field([[0, 0], [np.nan, 1]]), GraphError, "point 1 is not finite")
    refused(
        lambda: Field([[0, 0], [1e5, 1e5]]), GraphError, "cells of 0.2 m; expected at most 40,000,000: take a larger"
    )
    for sigma, resolution in ((0.0, 0.2), (-1.0, 0.2), (0.5, 0.0), (0.5, np.nan)):
        refused(lambda s=sigma, r=resolution: Field(POINTS, s, r), OptionError, "sigma|resolution")
