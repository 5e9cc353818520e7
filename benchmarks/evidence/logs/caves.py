"""Underwater caves: an AUV led by a diver for 32 minutes; its DVL with drop-outs, depth, and cones on the floor.

Files ``dvl_linkquest.csv.gz``, ``depth_sensor.csv.gz``, ``asekf_slam.csv`` (the published trajectory, of scan-matching
SLAM), ``cones.csv`` and ``cone_distances.csv``. The heading sensor is not among them.

The mounting of the DVL is read off the data, over steps of 8.6 s. The published motion has a correlation of -0.99 with
its first velocity carried along the published course (slope -1.02). The change of depth has one of -0.87 with the
third. So its x points aft and its z up: half a turn about y, which leaves y as the vehicle's y.

Source: A. Mallios, E. Vidal, R. Campos, M. Carreras, "Underwater caves sonar data set", IJRR 36(12), 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from models.algebra import Array, Mask

from .table import columns

__all__ = ["Caves", "read_caves"]

NANO = 1e-9


@dataclass(frozen=True)
class Caves:
    """The log; all times in seconds from the first row of the published trajectory.

    Attributes
    ----------
    t : (n,) times of the DVL.
    v_d : (n, 3) its velocity in its own axes, m/s.
    valid : (n,) whether it had the bottom.
    t_depth, depth : (m,) times, and depth, m.
    t_track, track : (k,) times, and published positions (k, 3), m, z down.
    sightings : (12, 4) cone, time, and its offset from the vehicle forward and to starboard as published, m.
    distances : (4, 3) cone, cone, and the distance between them by tape, m.
    mount : (7,) pose of the DVL on the vehicle.
    """

    t: Array
    v_d: Array
    valid: Mask
    t_depth: Array
    depth: Array
    t_track: Array
    track: Array
    sightings: Array
    distances: Array
    mount: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)


def read_caves(folder: str | Path) -> Caves:
    """Read the log.

    Raises
    ------
    GraphFileError
        A file that cannot be read, or has other columns.
    """
    folder = Path(folder)
    velocity = [f"field.velocityInst{k}" for k in range(3)]
    dvl = columns(folder / "dvl_linkquest.csv.gz", ("%time", *velocity, "field.velocityInstFlag"))
    depth = columns(folder / "depth_sensor.csv.gz", ("%time", "field.depth"))
    track = columns(folder / "asekf_slam.csv", None, skip=0).T
    cones = columns(folder / "cones.csv", ("cone", "time_s", "offset_x_m", "offset_y_m_as_published"))
    distances = columns(folder / "cone_distances.csv", ("cone_a", "cone_b", "distance_m"))
    t_0 = track[0, 0]
    cones[:, 1] -= t_0
    return Caves(
        dvl[:, 0] * NANO - t_0,
        dvl[:, 1:4],
        dvl[:, 4] == 1,
        depth[:, 0] * NANO - t_0,
        depth[:, 1],
        track[:, 0] - t_0,
        track[:, 1:],
        cones,
        distances,
    )
