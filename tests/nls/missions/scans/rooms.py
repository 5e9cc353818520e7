"""A room that a vehicle goes around twice, with the scans it takes and the track it reckons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models import SE2
from models.algebra import Array
from nls.missions.scans import Scans
from sim import Scene

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
