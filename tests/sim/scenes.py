"""Small worlds of every kind, and a smaller one for filters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import sim
from factors import BearingRange, Between, Diagonal
from models import SE2, R
from nls import FactorGraph, Values, kinds

__all__ = ["MADE", "four_sigma", "made", "thinned"]

x, l = kinds("x", "l")
MADE: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "manhattan": (sim.manhattan, {"n_poses": 150}),
    "grid3d": (sim.grid3d, {"n_poses": 120}),
    "ring": (sim.ring, {"laps": 2, "per_lap": 50}),
    "sphere": (sim.sphere, {"rings": 6, "per_ring": 10}),
    "torus": (sim.torus, {"coils": 6, "per_coil": 10}),
    "hauv-floor": (sim.hauv_floor, {"legs": 2, "per_leg": 12}),
    "hauv-hull": (sim.hauv_hull, {"levels": 2, "per_level": 13}),
    "subsea": (sim.subsea, {}),
    "subsea of filters": (sim.subsea, {"landmarks": "independent", "azimuth": "absolute"}),
    "subsea in part known": (sim.subsea, {"known_landmarks": 2}),
    "lines": (sim.lines, {}),
    "rig": (sim.rig, {"poses": 6, "points": 60}),
    "survey": (sim.survey, {"legs": 3, "leg": 60.0}),
    "harbor": (sim.harbor, {"keyframes": 80}),
}


def made(name: str, seed: int = 0, **options: Any) -> Any:
    make, sizes = MADE[name]
    return make(np.random.default_rng(seed), **{**sizes, **options})


def four_sigma(chi2: float, dof: float) -> bool:
    """A chi-square variable has mean dof and variance 2 dof."""
    return abs(chi2 - dof) < 4 * np.sqrt(2 * dof)


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
