"""Scenes for filters, small ones."""

from __future__ import annotations

from dataclasses import replace

import sim
from factors import BearingRange, Between, Diagonal
from models import SE2, R
from nls import FactorGraph, Values, kinds

__all__ = ["thinned"]

x, l = kinds("x", "l")


def thinned(world: sim.LandmarkWorld) -> sim.LandmarkWorld:
    """Every third pose of a subsea scene with what is seen from there; charts and headings are left out."""
    n = (world.poses - 1) // 3
    z = world.odometry.z.reshape(n, 3, 3)
    steps = SE2.compose(SE2.compose(z[:, 0], z[:, 1]), z[:, 2])
    seen = world.sightings[world.sightings.keys[0].numbers % 3 == 0]
    sight = BearingRange(x[seen.keys[0].numbers // 3], seen.keys[1], seen.z, seen.noise)
    odometry = Between(x[0:n], x[1 : n + 1], steps, Diagonal([0.17, 0.17, 0.015]))
    truth, start = (Values({x: (SE2, v[x][::3]), l: (R(2), v[l])}) for v in (world.truth, world.start))
    rows = 3 + 3 * n + 2 * len(sight)
    return replace(world, truth=truth, start=start, graph=FactorGraph([world.first, odometry, sight]), rows=rows)
