"""What dead reckoning is worth on logs of real and simulated vehicles, against their truth: drift and ATE, one table.

    LEADLINE_DATA=FOLDER python benchmarks/evidence/real_logs.py [--out DIR]

Three public logs, see the folder logs. What stands in for a missing sensor is said beside each figure.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from logs import AuvDvl, Caves, HoloOcean, read_auv_dvl, read_caves, read_holoocean
from script import make_page, markdown

from factors import Between, Covariance, Diagonal, Position, Prior
from models import SE3, wrap
from models.algebra import Array, Index, distance_along
from models.dead_reckoning import Legs, integrate
from models.manifolds.euler import quaternion_from_angles, to_se3
from nls import FactorGraph, LevenbergMarquardt, Values, kinds
from nls.metrics import ate

SEEDS = range(20)
(x,) = kinds("x")


@dataclass(frozen=True)
class Track:
    """A dead-reckoned or optimized track beside the true one: poses (n, 7) at the same times."""

    name: str
    X: Array
    truth: Array

    @property
    def distance(self) -> float:
        """Length of the true path, m."""
        return float(distance_along(self.truth[:, :3])[-1])

    @property
    def drift(self) -> float:
        """Error at the end, % of the distance."""
        return 100 * float(np.linalg.norm(self.X[-1, :3] - self.truth[-1, :3])) / self.distance

    @property
    def ate(self) -> float:
        """Root mean square error of the positions, m, both tracks from the same start."""
        return ate(self.X, self.truth).rmse

    @property
    def height(self) -> float:
        """Root mean square error of z alone, m."""
        return float(np.sqrt(np.mean((self.X[:, 2] - self.truth[:, 2]) ** 2)))


# --- AUV at sea: DVL and an attitude sensor made of the truth ---------------------------------------------------------


def attitude_sensor(rpy: Array, t: Array, rng: np.random.Generator) -> Array:
    """True roll, pitch, yaw with the errors of a sensor: 0.1 deg of noise in roll and pitch, 0.3 in yaw; the yaw is off
    by 0.5 deg (1 sigma) from the start and wanders by 0.02 deg/sqrt(s)."""
    noise = rng.normal(size=rpy.shape) * np.radians([0.1, 0.1, 0.3])
    steps = rng.normal(size=len(t)) * np.radians(0.02) * np.sqrt(np.diff(t, prepend=t[0]))
    noise[:, 2] += np.radians(0.5) * rng.normal() + np.cumsum(steps)
    return np.asarray(wrap(rpy + noise))


def auv_dvl(log: AuvDvl, name: str, seed: int | None = None) -> Track:
    """Dead reckoning by the DVL and the true attitude, or by the simulated attitude sensor of a seed."""
    rpy = log.rpy if seed is None else attitude_sensor(log.rpy, log.t, np.random.default_rng(seed))
    legs = integrate(log.t, log.v_d, attitude=rpy, boundaries=log.t, sigma_v=0.1, sigma_attitude=np.radians(0.3))
    truth = to_se3(np.concatenate([log.rpy, log.p], axis=1))
    start = np.concatenate([log.p[0], quaternion_from_angles(rpy[0])])
    return Track(name, legs.track(start), truth)


# --- HoloOcean: gyro, DVL, depth --------------------------------------------------------------------------------------

EVERY, AROUND = 200, 10  # samples from pose to pose; heights averaged before and after a pose
GYRO_BIAS = 0.03  # rad/s; the gyro of the log is off by up to 0.05, and wanders


def holoocean_legs(log: HoloOcean, k: Index, true_attitude: bool) -> Legs:
    """Legs between the samples k."""
    given = {"boundaries": log.t[k], "sigma_v": log.sigma_v, "mount": log.mount}
    if true_attitude:
        return integrate(log.t, log.v_d, attitude=log.X[:, 3:], sigma_attitude=1e-5, **given)
    return integrate(log.t, log.v_d, log.w, sigma_w=log.sigma_w, sigma_bias=GYRO_BIAS, **given)


def holoocean(log: HoloOcean) -> list[Track]:
    """DVL with the true attitude; DVL with the gyro; the same with heights in a graph."""
    k = np.arange(0, len(log.t), EVERY)
    n, truth = len(k), log.X[k]
    exact, legs = holoocean_legs(log, k, True), holoocean_legs(log, k, False)
    inner = np.flatnonzero((k >= AROUND) & (k < len(log.t) - AROUND))
    window = log.z[k[inner][:, None] + np.arange(-AROUND, AROUND + 1)]
    heights = Diagonal(z=log.sigma_z / np.sqrt(window.shape[1]))
    graph = FactorGraph(
        [
            Prior(x[0], truth[0], Diagonal([1e-3] * 6)),
            Between(x[: n - 1], x[1:n], legs.z, Covariance(legs.Sigma)),
            Position(x[inner], window.mean(axis=1), heights, components=("z",)),
        ]
    )
    start = legs.track(truth[0])
    result = graph.optimize(Values({x: (SE3, start)}), LevenbergMarquardt())
    assert result.converged, result.reason
    return [
        Track("DVL, true attitude", exact.track(truth[0]), truth),
        Track("DVL, gyro", start, truth),
        Track("DVL, gyro, height: optimized", result.values.stacks["x"].X, truth),
    ]


# --- caves: DVL with drop-outs, heading of the published track --------------------------------------------------------


def caves_legs(log: Caves, boundaries: Array) -> tuple[Legs, Array]:
    """Legs between boundaries, and the pose at the first: level, on the published track, heading along it."""
    east = np.diff(log.track[:, :2], axis=0)
    course = np.unwrap(np.arctan2(east[:, 1], east[:, 0]))
    middle = 0.5 * (log.t_track[1:] + log.t_track[:-1])
    level = np.zeros_like(log.t)
    rpy = np.column_stack([level, level, np.interp(log.t, middle, course)])
    sigmas = {"sigma_v": 0.1, "sigma_attitude": 0.2, "sigma_bridge": 0.1, "sigma_turn": 0.05}
    legs = integrate(log.t, log.v, attitude=rpy, boundaries=boundaries, valid=log.valid, **sigmas)
    yaw = np.interp(boundaries[0], middle, course)
    place = [np.interp(boundaries[0], log.t_track, log.track[:, c]) for c in range(3)]
    return legs, to_se3([0.0, 0.0, yaw, *place])


def caves(log: Caves) -> tuple[Track, Legs]:
    """Horizontal dead reckoning beside the published track."""
    known = log.t_track > log.t[log.valid][0]
    legs, start = caves_legs(log, log.t_track[known])
    X, truth = legs.track(start), np.tile(start, (known.sum(), 1))
    truth[:, :2] = log.track[known, :2]
    X[:, 2] = truth[:, 2]
    return Track("DVL, heading of the published course", X, truth), legs


def cones(log: Caves) -> list[tuple[int, int, float, float, float, float]]:
    """Cone, cone, distance by tape, dead-reckoned and in the published track, m, and the seconds between the sightings.

    Depth is that of the depth sensor; the side of a cone, of either sign in the publication, counts for 0.2 m.
    """
    cone, t, ahead, aside = log.sightings.T
    legs, start = caves_legs(log, t)
    X = legs.track(start)
    P = X.copy()
    P[:, :2] = np.column_stack([np.interp(t, log.t_track, log.track[:, c]) for c in range(2)])
    X[:, 2] = P[:, 2] = np.interp(t, log.t_depth, log.depth)
    offset = np.column_stack([ahead, aside, np.zeros_like(t)])
    reckoned, published = SE3.act(X, offset), SE3.act(P, offset)
    out = []
    for a, b, tape in log.distances:
        for i in np.flatnonzero(cone == a):
            j = min(np.flatnonzero(cone == b), key=lambda j, i=i: abs(t[j] - t[i]))
            found = (float(np.linalg.norm(p[i] - p[j])) for p in (reckoned, published))
            out.append((int(a), int(b), float(tape), *found, float(abs(t[j] - t[i]))))
    return out


# --- tables -----------------------------------------------------------------------------------------------------------


def page(data: Path) -> list[str]:
    """The tables, in Markdown."""
    lines = [
        "## AUV at sea",
        "DVL of an AUV of the A18-D class, 1 Hz, 400 s a trajectory, against its fibre-optic INS. The lever arm of "
        "the DVL is\nnot published and not corrected. *True attitude* is that of the INS. *Sensor* is a simulated "
        f"sensor: median and largest\nof {len(SEEDS)} seeds. Its noise is 0.1 deg in roll and pitch and 0.3 deg in "
        "yaw. Its yaw offset is 0.5 deg and its\nrandom walk 0.02 deg/sqrt(s) (1 sigma).",
    ]
    rows = []
    for number in range(1, 8):
        log = read_auv_dvl(data / "underwater-auv-dvl", number)
        true, noisy = auv_dvl(log, "true"), [auv_dvl(log, "sensor", seed) for seed in SEEDS]
        drift, errors = [track.drift for track in noisy], [track.ate for track in noisy]
        numbers = true.drift, true.ate, np.median(drift), max(drift), np.median(errors)
        rows.append([number, f"{true.distance:.0f}", *(f"{x:.2f}" for x in numbers)])
    titles = ["trajectory", "distance [m]", "true attitude: drift [%]", "ATE [m]", "sensor: drift [%]", "most [%]"]
    lines += markdown([*titles, "ATE [m]"], rows, 7 * "-")
    tracks = holoocean(read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz"))
    rows = [[t.name, f"{t.distance:.1f}", f"{t.drift:.2f}", f"{t.ate:.3f}", f"{t.height:.3f}"] for t in tracks]
    lines += [
        "## HoloOcean",
        "Simulated dive of 18 s, 200 Hz, exact truth. The gyro has 1 deg/s of noise and a bias that wanders up to\n"
        "3 deg/s; no sensor of the log sees the heading.",
        *markdown(["sensors", "distance [m]", "drift [%]", "ATE [m]", "z, rms [m]"], rows, 5 * "-"),
    ]
    cave = read_caves(data / "underwater-caves")
    track, legs = caves(cave)
    row = [track.name, f"{track.distance:.0f}", f"{track.drift:.2f}", f"{track.ate:.2f}"]
    taped = [
        [f"{a} to {b}", f"{tape:.0f}", *map("{:.1f}".format, two), f"{s:.0f}"] for a, b, tape, *two, s in cones(cave)
    ]
    titles = ["cones", "tape [m]", "dead-reckoned [m]", "published track [m]", "between the sightings [s]"]
    return [
        *lines,
        "## Caves",
        "DVL of an AUV led by a diver, 33 min. The log has no heading sensor: the heading is the course of the "
        f"published SLAM\ntrack. So these figures show the accuracy of distances, not of the navigation.\n{legs}.",
        *markdown(["sensors", "distance [m]", "end beside the published track [%]", "rms [m]"], [row], 4 * "-"),
        "",
        *markdown(titles, taped, 5 * "-"),
    ]


if __name__ == "__main__":
    make_page("Dead reckoning on public logs", page)
