"""Harbors as scenes, and the closed way of a vehicle in them.

The way is a rounded rectangle about the origin, W by W / 2, its longer sides along x, driven clockwise from above. With
x north, y east and z down a turn to starboard is positive.

marina    a basin 10 m around the way with finger pontoons, boats and piles on its walls, and a pontoon in the middle
quay      one straight wall 10 m east of the way, without any mark, that ends beyond the reach of the sonar
rocks     boulders on an open floor, heaps of points: they hide nothing
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, distance_along
from sim.scene import Scene

__all__ = ["GEOMETRIES", "sides", "way"]

MARGIN = 10.0  # m, from the way to the walls
CORNER = 0.1  # W, radius of the corners
WANDER, TURN = 1.0, np.radians(2.0)  # m, rad: sigmas about the way, over some 15 m, and of the heading beside it


def sides(loop: float) -> Array:
    """W and H (2,) of a way of given length, m."""
    return np.asarray(np.array([1.0, 0.5]) * loop / (3.0 - (8 - 2 * np.pi) * CORNER))


def way(rng: np.random.Generator, keyframes: int, loop: float) -> Array:
    """Poses (n, 3), 1 m apart: laps of the way, each a little beside the one before."""
    s = np.arange(0.0, keyframes + 2.0, 0.1)
    p, normal = _around(s, loop)
    wave, phase = rng.uniform(15.0, 40.0, 6), rng.uniform(0.0, 2 * np.pi, 6)
    beside = WANDER * np.sqrt(2 / 6) * np.sin(2 * np.pi * s[:, None] / wave + phase).sum(axis=1)
    p = p + np.clip(beside, -2 * WANDER, 2 * WANDER)[:, None] * normal
    along = distance_along(p)
    at = np.arange(keyframes)
    xy = np.column_stack([np.interp(at, along, p[:, k]) for k in range(2)])
    ahead = np.column_stack([np.interp(at + 0.5, along, p[:, k]) for k in range(2)]) - xy
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + TURN * rng.standard_normal(keyframes)
    return np.column_stack([xy, (yaw + np.pi) % (2 * np.pi) - np.pi])


def _around(s: Array, loop: float) -> tuple[Array, Array]:
    """Points (n, 2) of the rounded rectangle after a way s (n,), and its normals to starboard, inward."""
    (W, H), r = sides(loop), CORNER * sides(loop)[0]
    lengths = np.tile([W - 2 * r, np.pi / 2 * r, H - 2 * r, np.pi / 2 * r], 2)
    ends = np.cumsum(lengths)
    u = np.mod(s, ends[-1])
    leg = np.searchsorted(ends, u, side="right")
    rest = u - (ends - lengths)[leg]
    heading = leg // 2 * np.pi / 2
    turned = np.where(leg % 2 == 1, rest / r, 0.0)  # rad, in a corner
    start = np.array([[r - W / 2, -H / 2], [W / 2, r - H / 2], [W / 2 - r, H / 2], [-W / 2, H / 2 - r]])[leg // 2]
    straight = np.where(leg % 2 == 1, lengths[leg - 1], rest)
    c, d = np.cos(heading), np.sin(heading)
    ahead = straight + r * np.sin(turned)
    aside = r * (1 - np.cos(turned))
    p = start + np.column_stack([c * ahead - d * aside, d * ahead + c * aside])
    return p, np.column_stack([-np.sin(heading + turned), np.cos(heading + turned)])


def marina(rng: np.random.Generator, loop: float, reach: float) -> Scene:
    """A basin with pontoons, boats and piles; the wall in the west has a gate."""
    W, H = sides(loop)
    a, b = W / 2 + MARGIN, H / 2 + MARGIN
    gate = rng.uniform(-0.5, 0.2) * a
    walls = [[[-a, b], [a, b]], [[a, b], [a, -b]], [[-a, -b], [-a, b]]]
    walls += [[[a, -b], [gate + 8, -b]], [[gate, -b], [-a, -b]], [[gate, -b], [gate - 6, -b - 25]]]
    x = np.arange(-a + 4, a - 4, 9.0)
    x = x + rng.uniform(-2.0, 2.0, len(x))
    for u, length in zip(x, rng.uniform(3.0, 6.0, len(x)), strict=True):  # fingers on the wall in the east
        walls += [[[u, b], [u, b - length]], [[u, b - length], [u + 1, b - length]], [[u + 1, b - length], [u + 1, b]]]
    for u in rng.permutation(x)[: len(x) // 2]:  # boats beside some of them
        walls += _box(u + 3.0, b - 3.0, 1.2, 2.4, rng.normal(0.0, 0.05))
    y = rng.uniform(-b + 2, b - 2, max(2, int(b / 6)))
    walls += [wall for v in y for wall in _box(a - 2.5, v, 2.0, 1.0, rng.normal(0.0, 0.1))]
    u = rng.uniform(-a, a, max(4, int(a / 4)))
    piles = [[k, -b + rng.uniform(1.0, 4.0), rng.uniform(0.2, 0.5)] for k in u]
    inner = np.array([W, H]) / 2 - 5.0
    if inner.min() > 3.0:  # between the legs of the way
        length, tilt = inner[0] * rng.uniform(0.6, 0.9), rng.normal(0.0, 0.05)
        walls += _box(rng.uniform(-1, 1), rng.uniform(-1, 1), length, 1.0, tilt)
        piles += [[k, rng.choice([-1, 1]) * rng.uniform(2.0, inner[1]), 0.3] for k in rng.uniform(-length, length, 5)]
    return Scene(walls=np.array(walls), piles=np.array(piles))


def quay(rng: np.random.Generator, loop: float, reach: float) -> Scene:
    """A straight wall that is longer than anybody on the way can see."""
    W, H = sides(loop)
    a, b = W / 2 + reach + MARGIN, H / 2 + MARGIN
    return Scene(walls=np.array([[[-a, b], [a, b]]]))


def rocks(rng: np.random.Generator, loop: float, reach: float) -> Scene:
    """A heap of points for every 150 m^2, as far as anybody on the way can see."""
    half = sides(loop) / 2 + reach
    heaps = rng.uniform(-half, half, (int(4 * half.prod() / 150.0), 2))
    size, points = rng.uniform(0.2, 1.5, len(heaps)), 1 + rng.poisson(6.0, len(heaps))
    heap = np.repeat(np.arange(len(heaps)), points)
    return Scene(rocks=heaps[heap] + 0.5 * size[heap, None] * rng.standard_normal((len(heap), 2)))


def _box(x: float, y: float, a: float, b: float, yaw: float) -> list[list[list[float]]]:
    """Four walls of a box about (x, y), half its sides a and b."""
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    p = [x, y] + np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) @ R.T
    walls: list[list[list[float]]] = np.stack([p, np.roll(p, -1, axis=0)], axis=1).tolist()
    return walls


GEOMETRIES = {f.__name__: f for f in (marina, quay, rocks)}
