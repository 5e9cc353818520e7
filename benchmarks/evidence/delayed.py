"""EKF-SLAM from sightings that do not locate: ranges, bearings, contacts, beside the graph of the same measurements.

    python benchmarks/evidence/delayed.py [--seeds 60] [--out DIR]

The last pose of one lap of `sim.subsea` with a known start, and of a vehicle that heaves while it circles above twelve
points with a sonar. The first row is the control: sightings that locate, by the filter of `correlated`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from script import Table, make_page, over

import sim
from factors import Bearing, Between, Diagonal, Isotropic, Prior, Range, RangeAzimuth
from models import SE3, R, euler
from models.sensors import point_in_frame, range_azimuth, spherical
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters import EKF
from nls.filters.consistency import nees, nees_bounds

x, l = kinds("x", "l")
POSES, POINTS = 60, 12
WALK = np.array([0.01, 0.01, 0.01, 0.002, 0.002, 0.004])
CONTACT = np.array([0.01, 0.005])  # m, rad
MOUNTED = euler.to_se3([0, -0.4, 0, 0.3, 0, 0.1])


def lap(seed: int, seen: str) -> tuple[FactorGraph, Values]:
    """A circle among six landmarks, of which ranges, bearings, both in turn or whole sightings are known."""
    world = sim.subsea(np.random.default_rng(seed), laps=1, known_start=True)
    whole, pose = world.sightings, world.sightings.keys[0].numbers
    ranges = Range(*whole.keys, whole.z[:, 1], Isotropic(0.2))
    bearings = Bearing(*whole.keys, whole.z[:, 0], Isotropic(np.radians(0.2)))
    turn = [ranges[pose % 3 == 0], bearings[pose % 3 == 1], whole[(pose % 3 == 2) & (pose > 12)]]
    factors = {"whole": [whole], "ranges": [ranges], "bearings": [bearings], "in turn": turn}[seen]
    return FactorGraph([world.first, world.odometry, *factors]), world.truth


def heaving(seed: int) -> tuple[FactorGraph, Values]:
    """One and a half circles above a floor, with contacts of a sonar that looks ahead and down."""
    rng, t = np.random.default_rng(seed), np.arange(POSES)
    a = 3 * np.pi * t / POSES
    tilt = [0.03 * np.sin(0.5 * t), 0.03 * np.cos(0.4 * t), a + np.pi + 0.2 * np.sin(0.3 * t)]
    X = euler.to_se3(np.stack([*tilt, 4 * np.cos(a), 4 * np.sin(a), 1.0 + 0.5 * np.sin(0.35 * t)], axis=1))
    L = np.column_stack([rng.uniform(-2, 2, (POINTS, 2)), rng.uniform(2, 3.5, POINTS)])
    i, k = np.divmod(np.arange(POSES * POINTS), POINTS)
    p = point_in_frame(SE3, SE3.compose(X[i], MOUNTED), L[k])[0]
    r, az, el = spherical(p)[0].T
    i, k, p = (part[(np.abs(az) < 0.5) & (np.abs(el) < 0.3) & (r < 6)] for part in (i, k, p))
    z = range_azimuth(p)[0] + CONTACT * rng.normal(size=(len(p), 2))
    steps = SE3.retract(SE3.between(X[:-1], X[1:]), WALK * rng.normal(size=(POSES - 1, 6)))
    factors = [
        Prior(x[0], X[:1], Isotropic(1e-3)),
        Between(x[t[:-1]], x[t[1:]], steps, Diagonal(WALK)),
        RangeAzimuth(x[i], l[k], z, Diagonal(CONTACT), MOUNTED),
    ]
    return FactorGraph(factors), Values({x: (SE3, X), l: (R(3), L)})


def compared(seed: int, make: Callable[[int], tuple[FactorGraph, Values]], landmarks: Any) -> dict[str, float]:
    """NEES and error of the last pose, by filter and graph, and what waits in the end."""
    graph, truth = make(seed)
    ekf = EKF(landmarks)
    track = ekf.run(graph, truth)
    best = graph.optimize(truth).values
    last = track.x[[-1]]
    P = Marginals(graph, best).covariance(last, frame="body")

    def off(X: Any) -> float:
        return float(np.linalg.norm(track.manifold.position(X) - track.manifold.position(truth[last])))

    return {
        "nees": float(track.nees(truth)[-1]),
        "nees of the graph": float(nees(last, track.manifold, best[last], P, truth[last])[0]),
        "off": off(track.X[-1:]),
        "off of the graph": off(best[last]),
        "waiting": len(ekf.waiting),
        "given up": ekf.given_up,
    }


def page(seeds: int) -> list[str]:
    """The page without its head."""
    titles = ["sightings", "landmarks", "NEES, EKF", "NEES, graph", "95 % of means", "error, EKF", "error, graph"]
    table = Table([*titles, "waiting", "given up"], names=2)
    cases = [("range with bearing, the control", partial(lap, seen="whole"), "correlated", 3)]
    cases += [(name, partial(lap, seen=name), "delayed", 3) for name in ("whole", "ranges", "bearings", "in turn")]
    cases += [("range and azimuth in space", heaving, "delayed", 6)]
    for name, make, landmarks, d in cases:
        found = over(partial(compared, make=make, landmarks=landmarks), seeds)
        mean, (low, high) = {key: numbers.mean() for key, numbers in found.items()}, nees_bounds(d, seeds)
        numbers = [f"{mean['nees']:.2f}", f"{mean['nees of the graph']:.2f}", f"{low:.1f} to {high:.1f}"]
        numbers += [f"{mean['off']:.3f} m", f"{mean['off of the graph']:.3f} m"]
        table.add(name, f"`{landmarks}`", *numbers, *(found[key].sum() for key in ("waiting", "given up")))
    return [
        f"The last pose, means over seeds 0 to {seeds - 1}. Waiting: landmarks seen but not located at the end, over "
        "all runs. Given up: sightings that were dropped with their pose.",
        *table,
    ]


if __name__ == "__main__":
    make_page("EKF-SLAM from ranges, bearings or contacts alone", page, seeds=(60, "of each row"))
