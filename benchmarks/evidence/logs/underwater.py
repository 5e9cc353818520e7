"""Public logs of underwater vehicles as arrays: an AUV at sea, an AUV in caves, and a simulated one.

**AUV at sea**, 400 s a trajectory at 1 Hz: its DVL, and position and attitude of a post-processed INS. Latitudes and
longitudes become meters north and east of the first; down is the fall of the altitude. Source: N. Cohen, I. Klein,
"Adaptive Kalman-informed transformer", Engineering Applications of Artificial Intelligence 146, 2025.

**Caves**: an AUV led by a diver for 32 minutes; its DVL with drop-outs, depth, cones on the floor, and the published
trajectory, of scan-matching SLAM. The heading sensor is not among them. The mounting of the DVL is read off the data,
over steps of 8.6 s. The published motion has a correlation of -0.99 with its first velocity carried along the
published course (slope -1.02). The change of depth has one of -0.87 with the third. So its x points aft and its z up:
half a turn about y, which leaves y as the vehicle's y, as docs/missions/caves.toml says. Source: A. Mallios, E. Vidal,
R. Campos, M. Carreras, "Underwater caves sonar data set", IJRR 36(12), 2017.

**HoloOcean**, a simulated dive of 18 s: gyro, accelerometer, DVL and depth at 200 Hz, with exact truth. The log has six
lines a step, ``NAME dt values...``, with NAME R, V, P, IMU, DVL, DEPTH. The world has z **up**: the depth sensor gives
z, which is negative. Mounting and noise are those the publishers use with the file; the rotation of the DVL is given to
three digits, and the nearest rotation is taken. Source: E. Potokar, K. Norman, J. Mangelson, "Invariant extended Kalman
filtering for underwater navigation", IEEE RA-L 6(3), 2021; E. Potokar et al., "HoloOcean: an underwater robotics
simulator", ICRA 2022.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from models.algebra import Array, Mask
from models.manifolds.so3 import quaternion_from_matrix
from nls.io.files import read_bytes
from nls.missions.importing import Mapping, import_logs

MISSIONS = Path(__file__).parents[3] / "docs" / "missions"
DVL_TO_BODY = [[0.0, -0.995, 0.105], [0.999, 0.005, 0.052], [-0.052, 0.104, 0.993]]
DVL_AT = (-0.17137, 0.00922, -0.33989)


def tables(name: str, logs: Sequence[Path], zero: float | None = None) -> dict[str, Array]:
    """Tables (n, columns) that `nls import` makes of logs by a mapping of docs/missions.

    Times are seconds from `zero`, s since 1970, where it is given.
    """
    path = MISSIONS / f"{name}.toml"
    head = "" if zero is None else f"time_zero = {zero!r}\n"
    files = import_logs(logs, Mapping(head + path.read_text(encoding="utf-8"), str(path))).files
    return {
        file.removesuffix(".csv"): np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)
        for file, content in files.items()
        if file.endswith(".csv")
    }


class AuvDvl(NamedTuple):
    """One trajectory; world north, east, down; body forward, starboard, down.

    Attributes
    ----------
    t : (n,) s.
    v_d : (n, 3) velocity of the DVL in body axes, m/s, as measured: with the lever arm, which is not given.
    p : (n, 3) true position from the first, m.
    rpy : (n, 3) true roll, pitch, yaw, rad.
    """

    t: Array
    v_d: Array
    p: Array
    rpy: Array


def read_auv_dvl(folder: Path, number: int) -> AuvDvl:
    """Trajectory of a number."""
    mission = tables("auv-dvl", [folder / f"{prefix}_trajectory{number}.csv" for prefix in ("DVL", "GT")])
    dvl, true = mission["dvl"], mission["truth"]
    assert np.array_equal(dvl[:, 0], true[:, 0]), "the times of DVL and truth differ"
    return AuvDvl(dvl[:, 0], dvl[:, 1:4], true[:, 4:] - [0, 0, true[0, 6]], true[:, 1:4])


class Caves(NamedTuple):
    """The log of the caves; all times in seconds from the first row of the published trajectory.

    Attributes
    ----------
    t : (n,) times of the DVL.
    v : (n, 3) its velocity in the axes of the vehicle, m/s.
    valid : (n,) whether it had the bottom.
    t_depth, depth : (m,) times, and depth, m.
    t_track, track : (k,) times, and published positions (k, 3), m, z down.
    sightings : (12, 4) cone, time, and its offset from the vehicle forward and to starboard as published, m.
    distances : (4, 3) cone, cone, and the distance between them by tape, m.
    """

    t: Array
    v: Array
    valid: Mask
    t_depth: Array
    depth: Array
    t_track: Array
    track: Array
    sightings: Array
    distances: Array


def read_caves(folder: Path) -> Caves:
    """The log of the caves."""
    track = np.loadtxt(folder / "asekf_slam.csv", delimiter=",").T
    t_0 = float(track[0, 0])
    cones = np.loadtxt(folder / "cones.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3, 4))
    distances = np.loadtxt(folder / "cone_distances.csv", delimiter=",", skiprows=1)
    mission = tables("caves", [folder / f"{name}.csv.gz" for name in ("dvl_linkquest", "depth_sensor")], t_0)
    dvl, depth = mission["dvl"], mission["depth"]
    own = dvl[:, 0], dvl[:, 1:4], dvl[:, 4] == 1, depth[:, 0], depth[:, 1]
    return Caves(*own, track[:, 0] - t_0, track[:, 1:], cones - [0, t_0, 0, 0], distances)


class HoloOcean(NamedTuple):
    """The simulated log; world z up.

    Attributes
    ----------
    t : (n,) s, from 0.
    w : (n, 3) rates of the gyro, rad/s, body axes.
    v_d : (n, 3) velocity of the DVL in its own axes, m/s.
    z : (n,) measured height of the vehicle in the world, m.
    X : (n, 7) true poses, SE3.
    mount : (7,) pose of the DVL on the vehicle.
    sigma_v, sigma_w, sigma_z : noise of one velocity, m/s; of the gyro, rad/s/sqrt(Hz); of one height, m.
    """

    t: Array
    w: Array
    v_d: Array
    z: Array
    X: Array
    mount: Array
    sigma_v: float = 0.0101 * 2.6
    sigma_w: float = float(np.radians(0.005 * np.sqrt(200)))
    sigma_z: float = 0.255


def read_holoocean(path: Path) -> HoloOcean:
    """The simulated log."""
    lines = read_bytes(path).decode().splitlines()
    R, _, p, imu, dvl, depth = (np.array([line.split()[1:] for line in lines[k::6]], dtype=float) for k in range(6))
    t = np.cumsum(np.r_[0.0, R[:-1, 0]])
    X = np.concatenate([p[:, 1:], quaternion_from_matrix(R[:, 1:].reshape(-1, 3, 3))], axis=1)
    U, _, Vt = np.linalg.svd(np.array(DVL_TO_BODY))
    mount = np.concatenate([DVL_AT, quaternion_from_matrix(U @ Vt)])
    return HoloOcean(t, imu[:, 1:4], dvl[:, 1:], depth[:, 1], X, mount)
