"""Rooms that a vehicle goes around twice: the tables of a scan mission, and a track with its scans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models import SE2
from models.algebra import Array
from nls.missions.folder.table import csv_text
from nls.missions.scans import Scans
from sim import Scene

CORNERS = np.array([[-9.0, -7.0], [10.0, -7.0], [10.0, 3.0], [6.0, 8.0], [-9.0, 8.0]])
PILLAR = np.array([[-1.0, -1.0], [1.5, -1.0], [0.0, 1.0]])
CURRENT = np.array([0.04, 0.02])  # drift of dead reckoning in the world, m for every meter


def walls() -> Array:
    """Points (n, 2) on the walls, 0.25 m apart."""
    sides = [np.stack([shape, np.roll(shape, -1, axis=0)], axis=1) for shape in (CORNERS, PILLAR)]
    ends = [(a, b - a) for a, b in np.concatenate(sides)]
    return np.concatenate([a + np.arange(0, 1, 0.25 / np.linalg.norm(d))[:, None] * d for a, d in ends])


def track(laps: int) -> Array:
    """True poses (n, 3) on an ellipse, about 0.7 m apart."""
    t = np.linspace(0, 2 * np.pi * laps, 45 * laps, endpoint=False)
    heading = np.arctan2(3.5 * np.cos(t), -6.0 * np.sin(t))
    return np.column_stack([6.0 * np.cos(t), 3.5 * np.sin(t), heading])


def room(laps: int = 2, side: float = 1.0, mount: Array | None = None) -> dict[str, bytes]:
    """The tables by name: keyframes are numbered 100, 103, ..., and every tenth has no scan.

    Parameters
    ----------
    laps : through the room.
    side : 1 where azimuths are positive to the left, -1 to the right.
    mount : (3,) of the sonar on the vehicle.
    """
    rng = np.random.default_rng(3)
    true = track(laps)
    reckoned = true.copy()
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1)))
    reckoned[:, :2] += way[:, None] * CURRENT
    numbers, times = 100 + 3 * np.arange(len(true)), 5.0 + 2.0 * np.arange(len(true))
    points, k = walls(), np.arange(len(true))[:, None]
    sonar = SE2.compose(true, np.zeros_like(true) if mount is None else np.tile(mount, (len(true), 1)))
    q = SE2.act(SE2.inverse(np.repeat(sonar, len(points), axis=0)), np.tile(points, (len(true), 1)))
    q = (q + rng.normal(scale=0.03, size=q.shape)).reshape(len(true), -1, 2)
    r, azimuth = np.hypot(*q.T).T, np.arctan2(q[:, :, 1], q[:, :, 0])
    visible = (np.abs(azimuth) < np.radians(65)) & (r < 15) & (k % 10 != 9)
    i = numbers[np.nonzero(visible)[0]]
    known = np.column_stack([times, true])
    return {
        "keyframes": csv_text(("keyframe", "time", "x", "y", "yaw"), numbers, times, reckoned),
        "scans": csv_text(("keyframe", "range", "azimuth"), i, r[visible], side * azimuth[visible]),
        "truth": csv_text(("time", "x", "y", "yaw"), known),
    }


def write(folder: Path, files: dict[str, bytes]) -> Path:
    """The folder, with these tables in it; names with a suffix are taken as they are."""
    folder.mkdir()
    for name, data in files.items():
        (folder / (name if "." in name else f"{name}.csv")).write_bytes(data)
    return folder


WALLS = [[[0, 0], [30, 0]], [[30, 0], [30, 14]], [[30, 14], [22, 20]], [[22, 20], [0, 20]], [[0, 20], [0, 0]]]
ROOM = Scene(walls=[*WALLS, [[10, 0], [10, 3]], [[0, 9], [4, 9]]], piles=[[14.0, 9.0, 0.15], [19.0, 11.0, 0.15]])
FAN = np.radians(np.linspace(-65, 65, 66))


@dataclass(frozen=True)
class Drive:
    """True and reckoned poses (n, 3), and the scans."""

    truth: Array
    reckoned: Array
    scans: Scans


def drive(truth: Array, scene: Scene = ROOM) -> Drive:
    """Points within 20 m with a sigma of 5 cm, and a track with a drift, one of every 10 m besides, and a compass."""
    rng = np.random.default_rng(0)
    r = scene.first_hits(truth, FAN, (0.5, 20.0))
    keyframe, ray = np.nonzero(np.isfinite(r))
    z = r[keyframe, ray] + rng.normal(0, 0.05, len(ray))
    points = np.column_stack([z * np.cos(FAN[ray]), z * np.sin(FAN[ray])])

    yaw = truth[:, 2] + rng.normal(0, 0.02, len(truth))
    step = SE2.between(truth[:-1], truth[1:])[:, :2]
    length = np.linalg.norm(step, axis=1)
    stretch = (np.cumsum(length) // 10).astype(int)
    step = step + length[:, None] * ([0.2, 0.15] + rng.normal(0, 0.1, (stretch.max() + 1, 2))[stretch])
    turned = SE2.act(np.column_stack([np.zeros((len(step), 2)), yaw[:-1]]), step)
    place = truth[0, :2] + np.vstack([np.zeros((1, 2)), np.cumsum(turned, axis=0)])
    return Drive(truth, np.column_stack([place, yaw]), Scans(points, keyframe, len(truth)))


def laps(count: int = 2, step: float = 1.0) -> Array:
    """Poses (n, 3) on a rounded rectangle within the room, counterclockwise."""
    corners = 7 + 7j, 23 + 7j, 23 + 12.5j, 7 + 12.5j
    radius = 2.5
    pieces = []
    for k, corner in enumerate(corners):  # the turn about the middle of the rounded corner
        angle = np.pi / 2 * (k - 1) + np.linspace(0, np.pi / 2, 20)
        pieces.append(corner + radius * np.exp(1j * angle))
    ring = np.concatenate([*pieces, pieces[0][:1]])
    along = np.append(0.0, np.cumsum(np.abs(np.diff(ring))))
    s = np.arange(0.0, count * along[-1], step)
    place = np.interp(s % along[-1], along, ring)
    ahead = np.interp((s + 0.01) % along[-1], along, ring) - place
    return np.column_stack([place.real, place.imag, np.angle(ahead)])
