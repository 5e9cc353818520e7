"""Time and memory of closing loops by scans as missions grow, all at once and while the vehicle drives.

    python benchmarks/scans.py [--quick] [--largest KEYFRAMES] [--out DIR]

A vehicle goes twice around each basin of a made-up harbor, basin after basin, a keyframe every meter with 100 points.
Each size is measured in fresh processes with one BLAS thread.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import numpy.typing as npt
from pinv import ONE_THREAD, RESULTS, exponent, machine, peak_memory, positive, write_page  # the script beside this one

SIZES = (250, 500, 1000, 2000, 4000)
POINTS = 100  # of a keyframe
SIDE, LAPS = 25, 2  # m of a basin; rounds of each
APART = 60.0  # m from basin to basin
SIGHT, FIELD = 25.0, np.radians(65)  # m; to either side
NOISE = 0.1  # m, of a point
DRIFT = 0.05  # of the way
ROUNDS = 2  # of closing
UPPER = 3  # sizes to which exponents are fitted
STAGES = ("pairs", "windows", "matching", "solving", "other")

Array = npt.NDArray[np.float64]


# --- the made-up mission ----------------------------------------------------------------------------------------------


def way(count: int) -> Array:
    """True poses (count, 3), 1 m apart: around squares, one beside the other."""
    x = np.zeros((count, 3))
    for k in range(1, count):
        px, py, yaw = x[k - 1]
        lap = k % (4 * SIDE * LAPS + int(APART))
        if lap < 4 * SIDE * LAPS:
            yaw = (lap // SIDE % 4) * np.pi / 2
        else:
            yaw = 0.0  # on to the next one
        x[k] = px + np.cos(yaw), py + np.sin(yaw), yaw
    return x


def structures(poses: Array, rng: np.random.Generator) -> Array:
    """Points (m, 2) on piers of 3 to 12 m around the way, away from it."""
    low, high = poses[:, :2].min(axis=0) - 20, poses[:, :2].max(axis=0) + 20
    count = int(np.prod(high - low) / 80)
    start, angle, length = rng.uniform(low, high, (count, 2)), rng.uniform(0, np.pi, count), rng.uniform(3, 12, count)
    along = np.arange(0, 12, 0.25)
    points = start[:, None] + along[None, :, None] * np.column_stack([np.cos(angle), np.sin(angle)])[:, None]
    return np.asarray(points[along[None] < length[:, None]])


def mission(count: int) -> tuple[Array, Array, list[Array]]:
    """True poses (count, 3), reckoned ones, and the points (100, 2) of every keyframe in the frame of the vehicle."""
    from scipy.spatial import cKDTree

    from models import SE2

    rng = np.random.default_rng(0)
    truth = way(count)
    world = structures(truth, rng)
    steps = SE2.between(truth[:-1], truth[1:])
    drift = rng.normal(0, DRIFT, (count // 25 + 1, 2))[np.arange(count - 1) // 25]
    steps += np.column_stack([drift + rng.normal(0, 0.03, (count - 1, 2)), rng.normal(0, 0.002, count - 1)])
    reckoned = [truth[0]]
    for step in steps:
        reckoned.append(SE2.compose(reckoned[-1][None], step[None])[0])
    tree, scans = cKDTree(world), []
    for pose, near in zip(truth, tree.query_ball_point(truth[:, :2], SIGHT), strict=True):
        q = SE2.act(SE2.inverse(np.repeat(pose[None], len(near), axis=0)), world[near])
        ahead = np.flatnonzero(np.abs(np.arctan2(q[:, 1], q[:, 0])) < FIELD)
        rows = rng.permutation(ahead)[:POINTS]
        scans.append(q[rows] + rng.normal(0, NOISE, (len(rows), 2)))
    return truth, np.array(reckoned), scans
