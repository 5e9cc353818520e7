"""Scans: points by keyframe in the frames of sensor and vehicle; submaps, and which may show the same place."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2
from models.errors import GraphError, OptionError
from nls.missions.scans import Scans, submap
from nls.missions.scans.scans import centers, in_world, pairs
from tests.factors.evaluated import refused, same
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
