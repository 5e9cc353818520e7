"""A simulated AUV that dives for 18 s: gyro, accelerometer, DVL and depth at 200 Hz, with exact truth.

File ``underwater_data.txt``, six lines a step, ``NAME dt values...``, with NAME R, V, P, IMU, DVL, DEPTH. The world has
z **up**: the depth sensor gives z, which is negative. Mounting and noise are those the publishers use with the file;
the rotation of the DVL is given to three digits, and the nearest rotation is taken.

Source: E. Potokar, K. Norman, J. Mangelson, "Invariant extended Kalman filtering for underwater navigation", IEEE RA-L
6(3), 2021; E. Potokar et al., "HoloOcean: an underwater robotics simulator", ICRA 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.algebra import Array
from models.manifolds.so3 import quaternion_from_matrix
from nls.io.text import plain_lines

__all__ = ["HoloOcean", "read_holoocean"]

LINES = {b"R": 9, b"V": 3, b"P": 3, b"IMU": 6, b"DVL": 3, b"DEPTH": 1}
DVL_TO_BODY = [[0.0, -0.995, 0.105], [0.999, 0.005, 0.052], [-0.052, 0.104, 0.993]]
DVL_AT = (-0.17137, 0.00922, -0.33989)


@dataclass(frozen=True)
class HoloOcean:
    """The whole log; world z up.

    Attributes
    ----------
    t : (n,) s, from 0.
    w : (n, 3) rates of the gyro, rad/s, body axes.
    f : (n, 3) specific force, m/s^2, body axes.
    v_d : (n, 3) velocity of the DVL in its own axes, m/s.
    z : (n,) measured height of the vehicle in the world, m.
    X : (n, 7) true poses, SE3.
    mount : (7,) pose of the DVL on the vehicle.
    sigma_v, sigma_w, sigma_z : noise of one velocity, m/s; of the gyro, rad/s/sqrt(Hz); of one height, m.
    """

    t: Array
    w: Array
    f: Array
    v_d: Array
    z: Array
    X: Array
    mount: Array
    sigma_v: float = 0.0101 * 2.6
    sigma_w: float = float(np.radians(0.005 * np.sqrt(200)))
    sigma_z: float = 0.255


def read_holoocean(path: str | Path) -> HoloOcean:
    """Read the log, plain or gzip-compressed.

    Raises
    ------
    GraphFileError
        With the line: another name than its turn has, or another count of numbers.
    """
    text, lines, count, _ = plain_lines(path, "no line; expected six lines a step")
    turn = np.arange(len(lines)) % len(LINES)
    expected = np.array([size + 2 for size in LINES.values()])[turn]
    wrong = count != expected
    for k, name in enumerate(LINES):
        mine = turn == k
        wrong[mine] |= (text.characters(text.first[lines[mine]], len(name) + 1) != [*name, 0]).any(axis=1)
    if wrong.any():
        k = int(np.argmax(wrong))
        name = list(LINES)[turn[k]].decode()
        raise text.error(f"expected {name}, dt and {expected[k] - 2} numbers", int(lines[k]))
    if len(lines) % len(LINES):
        raise text.error(f"ends within a step: {len(lines)} lines, expected six a step", int(lines[-1]))
    R, _, p, imu, dvl, depth = (
        text.table(lines[k :: len(LINES)], size + 1, f"dt and {size} numbers") for k, size in enumerate(LINES.values())
    )
    t = np.cumsum(np.r_[0.0, R[:-1, 0]])
    X = np.concatenate([p[:, 1:], quaternion_from_matrix(R[:, 1:].reshape(-1, 3, 3))], axis=1)
    U, _, Vt = np.linalg.svd(np.array(DVL_TO_BODY))
    mount = np.concatenate([DVL_AT, quaternion_from_matrix(U @ Vt)])
    return HoloOcean(t, imu[:, 1:4], imu[:, 4:], dvl[:, 1:], depth[:, 1], X, mount)
