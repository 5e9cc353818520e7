"""Worlds with known truth: poses, measurements with seeded noise, graphs, and ways to spoil them."""

from sim.corrupt import outliers
from sim.world import World, chain, measure, position_error
from sim.worlds.grid3d import grid3d
from sim.worlds.manhattan import manhattan
from sim.worlds.ring import ring
from sim.worlds.sphere import sphere
from sim.worlds.torus import torus

__all__ = [
    "World",
    "chain",
    "grid3d",
    "manhattan",
    "measure",
    "outliers",
    "position_error",
    "ring",
    "sphere",
    "torus",
]
