"""Scans by keyframe, submaps, and which may show the same place; dead reckoning with drifts as variables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factors import Isotropic, Prior
from models import SE2
from models.errors import GraphError, OptionError
from nls import FactorGraph, Marginals, kinds
from nls.missions.scans import Drift, Scans, dead_reckoning, submap
from nls.missions.scans.scans import centers, in_world, pairs
from tests.combinations import for_all
from tests.factors.evaluated import Array, refused, same
from tests.nls.missions.scans.room_files import drive, laps

MOUNT = [0.5, -0.2, 0.3]
RNG = np.random.default_rng(0)
POINTS, KEYFRAME = RNG.normal(0, 9, (40, 2)), RNG.integers(1, 6, 40)


def test_points_are_turned_into_the_vehicle_and_sorted_by_keyframe() -> None:
    scans = Scans(POINTS, KEYFRAME, 8, MOUNT)
    c, s = np.cos(0.3), np.sin(0.3)
    by_hand = POINTS @ np.array([[c, s], [-s, c]]) + [0.5, -0.2]
    for k in range(8):
        same(scans[k], by_hand[KEYFRAME == k], atol=1e-12)
    assert scans.with_points.tolist() == [False, True, True, True, True, True, False, False]
    assert len(scans) == 8


def test_another_mount_and_the_mirror_are_those_of_the_sensor() -> None:
    scans = Scans(POINTS, KEYFRAME, 8, MOUNT)
    same(scans.at([0, 0, 0]).points, Scans(POINTS, KEYFRAME, 8).points, atol=1e-12)
    same(scans.mirrored().points, Scans(POINTS * [1, -1], KEYFRAME, 8, MOUNT).points, atol=1e-12)
    same(scans.mirrored().mirrored().points, scans.points, atol=1e-12)


def test_in_the_world_from_its_keyframe() -> None:
    scans, poses = Scans(POINTS, KEYFRAME, 8), RNG.normal(size=(8, 3))
    q = in_world(poses, scans)
    for k in range(1, 6):
        same(q[scans.starts[k] : scans.starts[k + 1]], SE2.act(poses[[k]], scans[k]), atol=1e-12)


def test_without_points() -> None:
    scans = Scans(np.empty((0, 2)), np.empty(0, dtype=int), 3)
    assert [len(scans[k]) for k in range(3)] == [0, 0, 0]
    assert len(scans.at(MOUNT).mirrored().points) == 0


def test_what_does_not_fit() -> None:
    bad = POINTS.copy()
    bad[7, 1] = np.nan
    for points, keyframe, mount, named in (
        (POINTS[:, 0], KEYFRAME, MOUNT, r"points \(40,\)"),
        (POINTS, KEYFRAME[1:], MOUNT, r"keyframe \(39,\)"),
        (POINTS, KEYFRAME, [0, 0], r"mount \(2,\)"),
        (bad, KEYFRAME, MOUNT, "point 7 is"),
        (POINTS, KEYFRAME, [0, np.inf, 0], "mount"),
        (POINTS, KEYFRAME - 2, MOUNT, "keyframes -1 to"),
        (POINTS, KEYFRAME + 3, MOUNT, "keyframes 4 to 8; expected whole numbers from 0 to 7"),
        (POINTS, KEYFRAME + 0.0, MOUNT, "expected whole numbers"),
    ):
        refused(lambda p=points, k=keyframe, m=mount: Scans(p, k, 8, m), GraphError, named)
    for k in (-1, 8):
        with pytest.raises(IndexError, match=f"keyframe {k}; expected 0 to 7"):
            Scans(POINTS, KEYFRAME, 8)[k]


POSES = RNG.normal(0, 5, (9, 3))
LANDMARKS = RNG.uniform(-20, 20, (9, 6, 2))
SCANS = Scans(
    np.concatenate([SE2.act(SE2.inverse(POSES[[k]]), LANDMARKS[k]) for k in range(9)]), np.repeat(np.arange(9), 6), 9
)


def test_points_of_the_neighbors_in_the_frame_of_the_middle() -> None:
    for center, half, members in (
        (4, 2, range(2, 7)),
        (4, 0, [4]),
        (4, (3, 0), range(1, 5)),
        (4, (0, 9), range(4, 9)),
        (0, 2, range(3)),
        (8, 2, range(6, 9)),
    ):
        points = submap(POSES, SCANS, center, half)  # type: ignore[arg-type]
        same(SE2.act(POSES[[center]], points), np.concatenate([LANDMARKS[k] for k in members]), atol=1e-9)


def test_keyframes_without_points() -> None:
    scans = Scans([[5.0, 0.0]], [3], 9)
    assert len(submap(POSES, scans, 6, 2)) == 0
    same(SE2.act(POSES[[5]], submap(POSES, scans, 5, 2)), SE2.act(POSES[[3]], [[5.0, 0.0]]), atol=1e-12)


def test_submaps_that_do_not_fit() -> None:
    for center in (-1, 9):
        refused(lambda c=center: submap(POSES, SCANS, c, 2), OptionError, "center.*0 to 8")
    for half in (-1, (2, -3)):
        refused(lambda h=half: submap(POSES, SCANS, 4, h), OptionError, "half")


def test_pairs_by_brute_force() -> None:
    """Of every eight keyframes the submap of largest overlap, the eight best of them, twenty keyframes before."""
    truth = laps(3)
    scans = drive(truth).scans
    middle, points = centers(scans), in_world(truth, scans)
    near = {k: points[np.abs(scans.keyframe - k) <= 4] for k in middle.tolist()}
    feet = {k: {tuple(cell) for cell in np.floor(p / 5.0).astype(int).tolist()} for k, p in near.items()}

    def share(i: int, j: int) -> float:
        return len(feet[i] & feet[j]) / min(len(feet[i]), len(feet[j]))

    a, b = pairs(truth, scans, middle)
    assert len(a) > 50
    for j in middle.tolist():
        best: dict[int, float] = {}
        for i in middle[middle <= j - 20].tolist():
            if share(i, j) >= 0.25:
                best[i // 8] = max(best.get(i // 8, 0.0), share(i, j))
        chosen = middle[a[middle[b] == j]].tolist()
        assert len({i // 8 for i in chosen}) == len(chosen), "one of each piece"
        assert sorted(share(i, j) for i in chosen) == sorted(best.values())[-8:]


def test_centers_have_their_neighbors_and_sixty_points() -> None:
    few = Scans(np.ones((60, 2)), np.repeat([20, 40], [30, 30]), 60)
    assert len(centers(few)) == 0
    alone = Scans(np.ones((60, 2)), np.full(60, 20), 60)
    assert centers(alone).tolist() == [16, 20, 24]
    assert len(centers(Scans(np.ones((99, 2)), np.zeros(99, dtype=int), 5))) == 0, "shorter than a submap"


x, d, m = kinds("x", "d", "m")
DRIFT = Drift(mean=0.2, stretch=0.15, length=10.0, step=0.1, yaw=1e-5, heading=None)


def straight(length: float, step: float = 1.0) -> Array:
    s = np.arange(0.0, length + step / 2, step)
    return np.column_stack([s, 0 * s, 0 * s])


def sigmas(drift: Drift, way: Array) -> Array:
    """(n, 2) of x and y of the poses after the first."""
    graph, values = dead_reckoning(way, drift)
    C = Marginals(graph, values).all(x, frame="world")[1:]
    return np.sqrt(C[:, [0, 1], [0, 1]])


@for_all(step=[0.5, 1.0, 2.5])
def test_the_sigma_of_a_position_grows_with_the_way(step: float) -> None:
    r"""sigma^2 = mean^2 s^2 + stretch^2 (sum of squares of the ways in each stretch) + step^2 s."""
    s = np.arange(step, 100 + step / 2, step)
    whole, rest = np.floor(s / 10 + 1e-9), s - 10 * np.floor(s / 10 + 1e-9)
    expected = np.sqrt(0.2**2 * s**2 + 0.15**2 * (whole * 10**2 + rest**2) + 0.1**2 * s)
    same(sigmas(DRIFT, straight(100, step)), np.column_stack([expected, expected]), rtol=1e-3)


def test_a_wrong_compass_swings_the_way() -> None:
    """Yaws of a random walk: to the side yaw^2 s^3 / 3; a compass holds it at its own sigma and less."""
    drift = Drift(mean=1e-3, stretch=1e-3, step=1e-3, yaw=0.02, heading=None)
    side = sigmas(drift, straight(100))
    k = np.arange(1, 101)
    same(side[:, 1], 0.02 * np.sqrt((k - 1) * k * (2 * k - 1) / 6), rtol=0.02, atol=0.02)
    with_compass = sigmas(replace(drift, heading=0.05), straight(100))
    assert with_compass[-1, 1] < 0.2 * side[-1, 1]


def test_a_return_to_the_start_cancels_the_mean() -> None:
    """There and back with the same heading: the body moves backwards, and the drift is for every meter of the way."""
    there = straight(50)
    ahead_and_back = np.vstack([there, there[-2::-1]])
    turned = np.vstack([there, there[-2::-1] + np.array([0, 0, np.pi])])
    drift = replace(DRIFT, stretch=1e-3, step=1e-3)
    same(sigmas(drift, ahead_and_back)[-1], 0.2 * 100, rtol=1e-3)
    assert sigmas(drift, turned)[-1].max() < 0.5


def test_the_reckoned_track_is_its_own_optimum_and_fixes_determine_the_drift() -> None:
    rng = np.random.default_rng(0)
    yaw = np.cumsum(rng.normal(0, 0.3, 60))
    truth = np.column_stack([np.vstack([[0, 0], np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), 0)[:-1]]), yaw])
    step = SE2.between(truth[:-1], truth[1:])
    off = step + np.array([0.15, -0.1, 0.0])
    reckoned = truth[:1]
    for one in off:
        reckoned = np.vstack([reckoned, SE2.compose(reckoned[-1:], one[None])])
    graph, values = dead_reckoning(reckoned)
    assert graph.chi2(values) < 1e-18
    held = Prior(x[[20, 40, 59]], truth[[20, 40, 59]], Isotropic(0.05))
    result = FactorGraph([*graph.factors, held], graph.fixed).optimize(values)
    length = np.linalg.norm(off[:, :2], axis=1).mean()
    same(result.values[m[0]], np.array([0.15, -0.1]) / length, atol=0.05)
    assert np.abs(result.values[x] - truth)[:, :2].max() < 1.0
    assert np.abs(reckoned - truth)[:, :2].max() > 4.0


def test_a_vehicle_that_stands_or_turns_on_the_spot() -> None:
    spot = np.zeros((5, 3))
    spot[:, 2] = [0, 0.5, 1.0, 1.0, 1.5]
    graph, values = dead_reckoning(spot)
    assert len(values[d]) == 1
    C = Marginals(graph, values).all(x, frame="world")[1:]
    same(np.sqrt(C[:, 0, 0]), 0.1 * np.sqrt(0.3 * np.arange(1, 5)), rtol=1e-6)


def test_stretches_are_numbered_without_gaps() -> None:
    """A step of 35 m is one of its stretch; the next stretch is the next drift."""
    way = np.array([[0.0, 0, 0], [35, 0, 0], [36, 0, 0], [37, 0, 0], [80, 0, 0]])
    _, values = dead_reckoning(way)
    assert len(values[d]) == 2
    assert values[m].shape == (1, 2)


def test_poses_and_drifts_that_do_not_fit() -> None:
    for poses in (np.zeros((1, 3)), np.zeros((4, 2)), np.zeros(3), [[0, 0, 0], [1, np.nan, 0]]):
        refused(lambda p=poses: dead_reckoning(p), GraphError, r"dead.reckoning: poses of shape .*; expected \(n, 3\)")
    for name in ("mean", "stretch", "length", "step", "yaw", "heading"):
        for value in (0.0, -0.1, np.nan):
            refused(lambda n=name, v=value: Drift(**{n: v}), OptionError, name)
    assert Drift(heading=None).heading is None
