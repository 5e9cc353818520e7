"""The log of a small simulated vehicle, and missions of every kind made of it, with columns that a test changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from models import SE3
from models.algebra import Array, apply
from models.geodesy import LocalPlane
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.checks.findings import Implausible
from nls.missions.checks.inspection import implausible
from nls.missions.checks.log import Fixes, Log
from nls.missions.folder.columns import COLUMNS, optional
from nls.missions.folder.table import Table, csv_text
from tests.nls.missions.folder.mission_files import RAW

__all__ = [
    "FIXES",
    "Change",
    "changed",
    "clean",
    "dive",
    "files_of",
    "findings",
    "kinds",
    "numbers_of",
    "path_of",
    "tables_of",
    "with_fixes",
]
FIXES = ["time_s", "x_m", "y_m", "sigma_x_m", "sigma_y_m"]
Change = Callable[[Array], Array]


def files_of(log: Log) -> dict[str, str]:
    """The files of a log without its fixes."""
    names = list(log.sigmas)
    tables = {
        "dvl": csv_text(RAW["dvl"], log.t_v, log.v, log.valid.astype(int)),
        "ahrs": csv_text(RAW["ahrs"], log.t_a, log.rpy),
        "depth": csv_text(RAW["depth"], log.t_z, log.z),
        "noise": csv_text(names, np.array([[log.sigmas[name] for name in names]])),
    }
    return {name: text.decode() for name, text in tables.items()}


def with_fixes(log: Log) -> dict[str, str]:
    """The files of a log and its fixes."""
    return files_of(log) | {"fixes": fixes_of(log)}


def fixes_of(log: Log) -> str:
    fixes = log.fixes
    assert fixes is not None
    sigma = np.column_stack([fixes.sigma, fixes.sigma]) / np.sqrt(2)
    return csv_text(FIXES, fixes.t, fixes.p, sigma).decode()


def path_of(log: Log) -> dict[str, str]:
    """A path by dead reckoning, with depth and heading, and the fixes."""
    thin = log.thinned()
    z, yaw = np.interp(thin.t_v, log.t_z, log.z), np.interp(thin.t_v, log.t_a, np.unwrap(log.rpy[:, 2]))
    yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
    start = np.zeros(2) if log.fixes is None else log.fixes.p[0]
    names = ["time_s", "x_m", "y_m", "z_m", "yaw_rad", "sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_yaw_rad"]
    sigmas = np.tile([0.05, 0.05, 0.05, 0.01], (len(z), 1))
    table = csv_text(names, thin.t_v, thin.way()[:, :2] + start, z, yaw, sigmas).decode()
    return {"path": table} | ({"fixes": fixes_of(log)} if log.fixes else {})


def kinds(log: Log) -> dict[str, dict[str, str]]:
    """The files of a mission of every kind by its name."""
    motion = {"motion": "sigma_walk_m_sqrt_s\n1.0\n", "fixes": fixes_of(log)}
    return {"log": with_fixes(log), "path": path_of(log), "motion": motion}


@cache
def dive(seed: int, on_deck: float = 0.0, minutes: float = 12.0) -> Log:
    """A dive with fixes in its first and last six seconds, and `on_deck` seconds before and after it."""
    log = clean(seed, minutes=minutes)
    t, end = log.t_z, float(log.t_v[-1])
    depth = np.clip(0.25 * np.minimum(t - 6.0, end - 6.0 - t), 0.0, 12.0) + 0.02 * np.sin(t)
    v = np.array(log.v)
    v[:, 2] = np.gradient(np.interp(log.t_v, t, depth), log.t_v)
    level = replace(log, v=v, rpy=log.rpy * [0, 0, 1], z=np.asarray(depth))
    way = level.way()
    t_f = np.concatenate([np.arange(-on_deck, 6.5), np.arange(end - 6.0, end + on_deck + 0.5)])
    p = np.column_stack([np.interp(t_f, log.t_v, column) for column in way[:, :2].T])
    p += np.random.default_rng(seed).normal(0, 0.3, p.shape)
    return replace(level, fixes=Fixes(t_f, p, np.full(len(t_f), 0.42), ("x_m", "y_m"), np.arange(len(t_f))))


def numbers_of(table: str) -> tuple[list[str], Array]:
    """The names and the numbers (n, k) of a file."""
    head, *lines = table.splitlines()
    return head.split(","), np.array([[float(cell) for cell in line.split(",")] for line in lines])


def changed(files: dict[str, str], table: str, whole: Change | None = None, **columns: Change) -> dict[str, str]:
    """The files with columns of one table changed, or all of it (n, k); whole numbers stay whole."""
    names, numbers = numbers_of(files[table])
    numbers = whole(numbers) if whole else numbers
    for name, change in columns.items():
        numbers[:, names.index(name)] = change(numbers[:, names.index(name)])
    written = [y.astype(int) if (y == y.astype(int)).all() else y for y in numbers.T]
    return {**files, table: csv_text(names, *written).decode()}


def tables_of(files: dict[str, str]) -> dict[str, Table]:
    """The tables of files, as they are read."""
    return {
        name: Table(f"{name}.csv", COLUMNS[name], optional(name, files), data=text.encode())
        for name, text in files.items()
    }


def findings(files: dict[str, str], plane: LocalPlane | None = None) -> list[Implausible]:
    """What is implausible in files."""
    return implausible(tables_of(files), plane)


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
