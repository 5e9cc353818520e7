"""Small rigs measured without error, for what they determine: a camera with a sonar, a vehicle with two odometers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors import (
    Between,
    BetweenSensors,
    Diagonal,
    Factor,
    Isotropic,
    Position,
    Prior,
    Projection,
    Range,
    RangeAzimuth,
    SqrtInformation,
)
from factors.predicted import predicted
from models import SE3, R
from models.algebra import Array
from nls import FactorGraph, Values, kinds

x, l, s, a = kinds("x", "l", "s", "a")
AHEAD = [-0.5, -0.5, -0.5, 0.5]  # quaternion of a sonar that looks where the camera looks
SONAR = SE3.compose([0.1, 0.2, -0.3, *AHEAD], SE3.exp([0, 0, 0, 0.05, -0.03, 0.04]))
HALF_DEG = np.radians(0.5)
FLAT = np.column_stack([np.zeros((5, 2)), [0.5, -0.3, 0.4, 0.2, -0.6]])  # turns about one axis, rad
Motion = Callable[[np.random.Generator, int], Array]


def general(rng: np.random.Generator, n: int) -> Array:
    return SE3.exp(np.hstack([rng.normal(0, 0.8, (n, 3)), rng.normal(0, 0.15, (n, 3))]))


def translation(rng: np.random.Generator, n: int) -> Array:
    return SE3.exp(np.hstack([rng.normal(0, 0.8, (n, 3)), np.zeros((n, 3))]))


def rotation(rng: np.random.Generator, n: int) -> Array:
    return SE3.exp(np.hstack([np.zeros((n, 3)), rng.normal(0, 0.15, (n, 3))]))


def forward(rng: np.random.Generator, n: int) -> Array:
    return SE3.exp(np.hstack([np.zeros((n, 2)), np.linspace(0, 2, n)[:, None], np.zeros((n, 3))]))


def static(rng: np.random.Generator, n: int) -> Array:
    return SE3.identity(n)


def rig(
    sensors: str, moving: Motion = general, seed: int = 0, poses: int = 6, points: int = 40
) -> tuple[FactorGraph, Values]:
    """Camera and sonar, the sonar's place s0 unknown; measured without error, the first pose fixed."""
    rng = np.random.default_rng(seed)
    L = rng.uniform([-4, -3, 5], [4, 3, 11], (points, 3))
    values = Values({x: (SE3, moving(rng, poses)), l: (R(3), L), s: (SE3, SONAR)})
    i, j = np.divmod(np.arange(poses * points), points)
    zeros, sigma_az = np.zeros((len(i), 2)), np.radians(5) / np.sqrt(3)
    noise = {
        "sonar": Diagonal([0.03, sigma_az]),
        "azimuth": SqrtInformation(np.diag([0.0, 1 / sigma_az])),
    }
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


def antenna(turns: Array, depth: bool) -> tuple[FactorGraph, Values]:
    """Satellite fixes of an antenna on an arm a0 unknown, attitudes and, if it has one, a depth cell."""
    n = len(turns)
    X = SE3.exp(np.hstack([np.column_stack([np.arange(n), np.zeros((n, 2))]), turns]))
    values = Values({x: (SE3, X), a: (R(3), [0.5, -0.2, -1.0])})
    fixes = SE3.act(X, values[a[0]])

    def fix(X: Array, a: Array) -> Array:
        return SE3.act(X, a) - fixes

    attitude = Prior(x[0:n], X, Isotropic(0.01), components=("roll", "pitch", "yaw"))
    graph = FactorGraph([Factor.from_function(fix, [x[0:n], a[np.zeros(n, dtype=int)]], 3, Isotropic(0.5)), attitude])
    if depth:
        graph.add(Position(x[0:n], X[:, 2], Isotropic(0.05), components=("z",)))
    i, j = x[0 : n - 1], x[1:n]
    legs = Between(i, j, SE3.identity(n - 1), Isotropic(0.02))
    graph.add(predicted(legs, legs.keys, values))
    return graph, values
