"""Small rigs measured without error, for what they determine: a camera with a sonar, a vehicle with two odometers."""

from __future__ import annotations

import numpy as np

import factors
from factors import Between, BetweenSensors, Diagonal, Factor, Isotropic, Projection, Range, RangeAzimuth
from factors.replaced import predicted
from models import SE3, R
from models.algebra import Array
from nls import FactorGraph, Values, kinds

x, l, s = kinds("x", "l", "s")
AHEAD = [-0.5, -0.5, -0.5, 0.5]  # quaternion of a sonar that looks where the camera looks
SONAR = SE3.compose([0.1, 0.2, -0.3, *AHEAD], SE3.exp([0, 0, 0, 0.05, -0.03, 0.04]))
HALF_DEG = np.radians(0.5)
FLAT = np.column_stack([np.zeros((5, 2)), [0.5, -0.3, 0.4, 0.2, -0.6]])  # turns about one axis, rad


def rig(sensors: str, seed: int = 0, poses: int = 6, points: int = 40) -> tuple[FactorGraph, Values]:
    """Camera and sonar, the sonar's place s0 unknown; measured without error, the first pose fixed."""
    rng = np.random.default_rng(seed)
    L = rng.uniform([-4, -3, 5], [4, 3, 11], (points, 3))
    X = SE3.exp(np.hstack([rng.normal(0, 0.8, (poses, 3)), rng.normal(0, 0.15, (poses, 3))]))
    values = Values({x: (SE3, X), l: (R(3), L), s: (SE3, SONAR)})
    i, j = np.divmod(np.arange(poses * points), points)
    zeros, sigma_az = np.zeros((len(i), 2)), np.radians(5) / np.sqrt(3)
    noise = {"sonar": Diagonal([0.03, sigma_az]), "azimuth": factors.SqrtInformation(np.diag([0.0, 1 / sigma_az]))}
    graph = FactorGraph()
    for name in sensors.split(" + "):
        factor: Factor
        if name == "camera":
            factor = Projection(x[i], l[j], zeros, Isotropic(5 / 600 / np.sqrt(3)))
        elif name == "range":
            factor = Range(x[i], l[j], zeros[:, 0], Isotropic(0.03), s[0])
        else:
            factor = RangeAzimuth(x[i], l[j], zeros, noise[name], s[0])
        graph.add(predicted(factor, factor.keys, values))
    graph.fix(x[0])
    return graph, values


def odometers(turns: Array) -> tuple[FactorGraph, Values]:
    """Odometry of a vehicle and of a sensor on it, for legs of one meter with turns (n, 3)."""
    legs = SE3.exp(np.hstack([np.tile([1.0, 0.1, 0.0], (len(turns), 1)), turns]))
    X = [SE3.identity()[0]]
    for leg in legs:
        X.append(SE3.compose(X[-1], leg))
    values = Values({x: (SE3, np.array(X)), s: (SE3, SE3.exp([0.4, 0.2, -0.3, 0.1, -0.2, 0.5]))})
    i, j, n = x[0 : len(legs)], x[1 : len(legs) + 1], len(legs)
    vehicle = Between(i, j, SE3.identity(n), Diagonal([0.02] * 3 + [HALF_DEG] * 3))
    sensor = BetweenSensors(i, j, SE3.identity(n), Isotropic(0.01), s[0])
    return FactorGraph([predicted(f, f.keys, values) for f in (vehicle, sensor)]), values
