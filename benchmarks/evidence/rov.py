"""An ROV without a DVL: compass, depth sensor and USBL of a ship, or positions; are its errors those it states?

    python benchmarks/evidence/rov.py [--seeds N] [--out DIR]

Each mission is simulated, written as logs, imported by a mapping and solved. The vehicle walks at
random in the horizontal, dives evenly and turns to and fro. NEES is e' Sigma^-1 e of x and y, 2 expected.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from script import make_page, markdown

import nls
from models import SE3, euler
from models.algebra import Array
from nls import Marginals
from nls.missions.folder.table import csv_text
from nls.missions.importing import import_logs, read_mapping, write_imported

(x,) = nls.kinds("x")
DURATION, PING, ROW = 1200.0, 4.0, 0.5  # s: of a mission, between two pings, between two rows of compass and depth
HEADING, TILT, DEPTH = np.radians(2.0), np.radians(1.0), 0.1  # sigmas, rad and m
RANGE, DIRECTION, SHARE = 1.0, 0.01, 0.01  # of USBL: m and rad; and of positions, a part of the distance besides
ARM = np.array([0.8, 0.0, -0.6])  # of the transponder on the vehicle, m
FIXED = np.array([0.0, 0.0, 3.0])  # the transceiver of the ship, m
SENSORS = f"""
[ahrs]
file = "attitude.csv"
roll_rad = "roll_rad"
pitch_rad = "pitch_rad"
yaw_rad = "yaw_rad"
[depth]
file = "depth.csv"
z_m = "z_m"
[noise]
sigma_roll_rad = {TILT}
sigma_pitch_rad = {TILT}
sigma_yaw_rad = {HEADING}
sigma_z_m = {DEPTH}
"""
FIXES = """
[fixes]
file = "positions.csv"
position = ["x_m", "y_m", "z_m"]
sigma_position = ["sigma_x_m", "sigma_y_m", "sigma_z_m"]
"""
USBL = f"""
[usbl]
file = "usbl.csv"
range_m = "range_m"
bearing_rad = "bearing_rad"
elevation_rad = "elevation_rad"
sigma_range_m = {RANGE}
sigma_bearing_rad = {DIRECTION}
sigma_elevation_rad = {DIRECTION}
[ship]
file = "ship.csv"
position = ["x_m", "y_m", "z_m"]
roll_rad = "roll_rad"
pitch_rad = "pitch_rad"
yaw_rad = "yaw_rad"
"""
OWN = (
    USBL.split("[ship]")[0].replace("usbl.csv", "own.csv")
    + "beacon = 1\n"
    + "[beacons]\nbeacon = 1\nx_m = 0.0\ny_m = 0.0\nz_m = 3.0\nsigma_position = [0.01, 0.01, 0.01]\n"
)
ARMS = "".join(f"arm_{axis}_m = {float(a)}\n" for axis, a in zip("xyz", ARM, strict=True))
CASES = {  # name: the mapping without the walk, whether the transponder is away from the center
    "positions alone": (FIXES, False),
    "positions, compass, depth": (FIXES + SENSORS, False),
    "positions of a transponder with a lever arm, compass, depth": (FIXES + ARMS + SENSORS, True),
    "range and direction from the ship, compass, depth": (USBL + SENSORS, False),
    "range and direction to a beacon from the vehicle, compass, depth": (OWN + SENSORS, False),
}
WALKS = (0.1, 0.3, 0.5)  # m/sqrt(s)


def simulate(folder: Path, walk: float, seed: int, arm: Array) -> tuple[Array, Array]:
    """Write the logs of a mission; times (n,) of the pings and true places (n, 3)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION + ROW / 2, ROW)
    p = np.column_stack([np.cumsum(rng.normal(0, walk * np.sqrt(ROW), (len(t), 2)), axis=0), 10 + t / 15])
    p[:, 0] += 100
    yaw = 2 * np.sin(t / 40) + 2.5
    rpy = np.column_stack([0.1 * np.sin(t / 7), 0.15 * np.cos(t / 11), yaw])
    measured = rpy + rng.normal(0, [TILT, TILT, HEADING], rpy.shape)
    _write(folder / "attitude.csv", "time_s,roll_rad,pitch_rad,yaw_rad", t, measured)
    _write(folder / "depth.csv", "time_s,z_m", t, p[:, 2] + rng.normal(0, DEPTH, len(t)))
    ping = np.arange(0, len(t), round(PING / ROW))
    X = euler.to_se3(np.column_stack([rpy[ping], p[ping]]))
    place = SE3.act(X, arm) - FIXED
    far = np.linalg.norm(place, axis=1)
    sigma = np.tile((RANGE + SHARE * far)[:, None], 3)
    noisy = place + FIXED + rng.normal(0, 1, sigma.shape) * sigma
    names = "time_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m"
    _write(folder / "positions.csv", names, t[ping], noisy, sigma)
    turn = np.column_stack([0.03 * np.sin(t / 5), 0.03 * np.cos(t / 6), 0.4 + 0.2 * np.sin(t / 90)])
    ship = euler.to_se3(np.column_stack([turn, np.tile(FIXED, (len(t), 1))]))
    _write(folder / "ship.csv", "time_s,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad", t, ship[:, :3], turn)
    sight = SE3.act(SE3.inverse(ship[ping]), place + FIXED)
    _directions(folder / "usbl.csv", t[ping], sight, rng)
    _directions(folder / "own.csv", t[ping], SE3.act(SE3.inverse(X), np.tile(FIXED, (len(ping), 1))), rng)
    return t[ping], p[ping]


def _directions(path: Path, t: Array, sight: Array, rng: np.random.Generator) -> None:
    """Ranges and directions of targets (n, 3), with noise."""
    far = np.linalg.norm(sight, axis=1)
    z = np.column_stack([far, np.arctan2(sight[:, 1], sight[:, 0]), np.arcsin(sight[:, 2] / far)])
    z += rng.normal(0, [RANGE, DIRECTION, DIRECTION], z.shape)
    _write(path, "time_s,range_m,bearing_rad,elevation_rad", t, z)


def _write(path: Path, names: str, *columns: Array) -> None:
    path.write_bytes(csv_text(names.split(","), *columns))


def errors(folder: Path, mapping: str, walk: float, truth: tuple[Array, Array]) -> dict[str, float]:
    """A mission imported and solved: rmse of x and y, their NEES, chi2 per degree of freedom, and how many warnings."""
    file = folder / "map.toml"
    file.write_text(f'time_s = "time_s"\n[motion]\nsigma_walk_m_sqrt_s = {walk}\n{mapping}', encoding="utf-8")
    logs = [path for path in sorted(folder.glob("*.csv")) if f'"{path.name}"' in mapping]
    with TemporaryDirectory() as mission:
        write_imported(mission, import_logs(logs, read_mapping(file)), logs)
        graph, start, report = nls.load(mission)
    result = graph.optimize(start)
    if not result.converged:
        raise SystemExit(f"{mapping}: {result.message}")
    t, p = truth
    poses = np.searchsorted(t, report.vertex_times["x"])
    away = SE3.position(np.asarray(result.values[x]))[:, :2] - p[poses, :2]
    Sigma = Marginals(graph, result.values).covariance(x[result.values.stack(x).numbers], view="position")[:, :2, :2]
    nees = np.einsum("ni,nij,nj->n", away, np.linalg.inv(Sigma), away)
    return {
        "rmse": float(np.sqrt(np.square(away).sum(axis=1).mean())),
        "stated": float(np.sqrt(np.trace(Sigma, axis1=1, axis2=2).mean())),
        "nees": float(nees.mean()),
        "ratio": result.chi2_final / result.dof,
        "warnings": float(len(report.warnings)),
    }


def raw(folder: Path, truth: tuple[Array, Array]) -> float:
    """Root mean square error of the positions as they are, without a filter, m."""
    z = np.loadtxt(folder / "positions.csv", delimiter=",", skiprows=1)[:, 1:3]
    return float(np.sqrt(np.square(z - truth[1][:, :2]).sum(axis=1).mean()))


def page(seeds: int) -> list[str]:
    """The table, in Markdown."""
    rows = []
    for walk, (name, (mapping, away)) in product(WALKS, CASES.items()):
        found = []
        for seed in range(seeds):
            with TemporaryDirectory() as folder:
                truth = simulate(Path(folder), walk, seed, ARM * away)
                found.append({"raw": raw(Path(folder), truth), **errors(Path(folder), mapping, walk, truth)})
        mean = {key: float(np.mean([one[key] for one in found])) for key in found[0]}
        spread = float(np.std([one["nees"] for one in found], ddof=1) / np.sqrt(seeds)) if seeds > 1 else np.nan
        cells = [name, f"{walk:g}", *(f"{mean[key]:.2f}" for key in ("raw", "rmse", "stated"))]
        cells += [f"{mean['nees']:.2f} +- {spread:.2f}", f"{mean['ratio']:.3f}", f"{mean['warnings'] * seeds:.0f}"]
        rows.append(cells)
    titles = ("mission", "walk", "positions", "solution", "stated", "NEES", "chi2 / dof", "warnings")
    return [
        f"{seeds} missions of {DURATION / 60:g} min each, a ping every {PING:g} s. Compass {np.degrees(HEADING):.0f} "
        f"deg, tilt {np.degrees(TILT):.0f} deg, depth {DEPTH} m.\nPositions: {RANGE:g} m + {100 * SHARE:g} % of the "
        f"distance. Ranges {RANGE:g} m, directions {DIRECTION} rad.\nWalk: m/sqrt(s), as simulated and as stated. "
        "Positions: rmse of x and y of the raw USBL positions, m.\nSolution: rmse of x and y, m; stated: root of the "
        "mean of the trace of its covariance. NEES: 2 expected.",
        *markdown(titles, rows),
        "Raw positions of a transponder with a lever arm are not positions of the vehicle.",
    ]


if __name__ == "__main__":
    make_page("An ROV without a DVL", page, seeds=(20, "missions of every row"))
