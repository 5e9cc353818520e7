"""Worlds with known truth: poses, measurements with seeded noise, graphs, and ways to spoil them."""

from sim.camera_sonar import Rig, RigErrors
from sim.corrupt import outliers
from sim.landmark_world import LandmarkWorld
from sim.mission import Mission
from sim.sonar_image import contacts, sonar_image
from sim.spoil import drop_contacts, exchange_contacts, false_contacts, poor_odometry
from sim.world import World, chain, measure, position_error
from sim.worlds.grid3d import grid3d
from sim.worlds.hauv_floor import hauv_floor
from sim.worlds.hauv_hull import hauv_hull
from sim.worlds.lines import lines
from sim.worlds.manhattan import manhattan
from sim.worlds.rig import rig
from sim.worlds.ring import ring
from sim.worlds.sphere import sphere
from sim.worlds.subsea import subsea
from sim.worlds.torus import torus

__all__ = [
    "LandmarkWorld",
    "Mission",
    "Rig",
    "RigErrors",
    "World",
    "chain",
    "contacts",
    "drop_contacts",
    "exchange_contacts",
    "false_contacts",
    "grid3d",
    "hauv_floor",
    "hauv_hull",
    "lines",
    "manhattan",
    "measure",
    "outliers",
    "poor_odometry",
    "position_error",
    "rig",
    "ring",
    "sonar_image",
    "sphere",
    "subsea",
    "torus",
]
