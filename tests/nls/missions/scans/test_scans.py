"""Scans: points by keyframe, from the frame of the sensor to that of the vehicle and back."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2
from models.errors import GraphError
from nls.missions.scans import Scans
from nls.missions.scans.scans import in_world
from tests.factors.evaluated import refused, same

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
