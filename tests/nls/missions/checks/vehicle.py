"""The raw log of a small simulated vehicle: lanes with turns, dives and climbs, and what its sensors say of them."""

from __future__ import annotations

from functools import cache

import numpy as np

from models import SE3
from models.algebra import Array, apply
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.checks.log import Fixes, Log

__all__ = ["clean"]
SIGMAS = {"sigma_v_m_s": 0.01, "scale": 0.002, "sigma_bridge_m_s_sqrt_s": 0.05, "sigma_roll_rad": 0.003}
SIGMAS |= {"sigma_pitch_rad": 0.003, "sigma_yaw_rad": 0.01, "sigma_z_m": 0.03}
DT = 0.2


@cache
def clean(seed: int, minutes: float = 20.0, drop_outs: bool = True) -> Log:
    """A right log; fixes every 5 s with a sigma of 0.5 m."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60 * minutes, DT)
    n = len(t)
    leg = 60.0 + 20.0 * rng.random()
    phase = 2 * np.pi * t / leg
    yaw = rng.uniform(-np.pi, np.pi) + _smooth(np.cumsum(_turns(t, leg, rng)), 25)
    yaw_rate = np.gradient(yaw, DT)
    pitch = _smooth(np.where(np.sin(phase / 1.7) > 0, -0.2, 0.2) * (np.abs(np.sin(phase / 3.1)) > 0.4), 15)
    roll = 0.02 * np.sin(phase * 3) + 0.4 * yaw_rate
    u = 1.4 + 0.2 * np.sin(phase / 2.3)
    v = -0.9 * yaw_rate + 0.12 * np.sin(phase / 4.7)
    w = 0.15 * np.sin(phase / 1.3 + 1)
    rpy, body = np.column_stack([roll, pitch, yaw]), np.column_stack([u, v, w])
    velocity = apply(rotation3(quaternion_from_angles(rpy)), body)
    p = np.vstack([np.zeros(3), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * DT, axis=0)])
    p[:, 2] += 30.0 + max(0.0, -float(p[:, 2].min()))
    bias = rng.normal(0, 0.01)
    angles = rpy + rng.normal(0, [0.003, 0.003, 0.005], (n, 3)) + [0, 0, bias]
    angles[:, 2] = (angles[:, 2] + np.pi) % (2 * np.pi) - np.pi
    measured = body * (1 + rng.normal(0, 0.002)) + rng.normal(0, 0.01, (n, 3))
    valid = np.ones(n, dtype=bool)
    for start in rng.integers(50, n - 50, 4) if drop_outs else ():
        valid[start : start + 15] = False
        measured[start : start + 15] = 0.0
    k, deep = np.arange(0, n, 25), np.arange(0, n, 5)
    places = p[k, :2] + rng.normal(0, 0.5, (len(k), 2))
    fixes = Fixes(t[k], places, np.full(len(k), 0.7), ("x_m", "y_m"), np.arange(len(k)))
    z = p[deep, 2] + rng.normal(0, 0.03, len(deep))
    return Log(t, measured, valid, t, angles, t[deep], z, SE3.identity()[0], SIGMAS, fixes)


def _turns(t: Array, leg: float, rng: np.random.Generator) -> Array:
    """Steps of the heading: half turns at the ends of legs, to either side, and a slow weave."""
    out = 0.004 * np.sin(2 * np.pi * t / 37.0) * DT * 10
    side = 1
    for k in range(1, int(t[-1] / leg) + 1):
        begin = int(k * leg / DT)
        angle = rng.uniform(0.6, 1.2) * np.pi
        width = int(12.0 / DT)
        out[begin : begin + width] += side * angle / width
        side = -side if rng.random() < 0.7 else side
    return out


def _smooth(y: Array, width: int) -> Array:
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(y, width // 2, mode="edge"), kernel / kernel.sum(), mode="valid")[: len(y)]
