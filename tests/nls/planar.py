"""A vehicle with a level sonar in the plane, and points around that plane: what sonar knows least about."""

from __future__ import annotations

import numpy as np

from factors import XYH, ZPR, Diagonal, Heading, Isotropic, Position, RangeAzimuth
from models import SE3, R, euler
from models.algebra import Array
from models.sensors import levelled, range_azimuth, zpr
from nls import FactorGraph, Values, kinds

SIGMA = np.array([0.01, np.radians(0.25)])  # range, m, azimuth, rad
x, l = kinds("x", "l")


def mission(
    rng: np.random.Generator,
    heights: Array,
    roll: float = 0.0,
    heave: float = 0.0,
    noise: float = 1.0,
) -> tuple[FactorGraph, Values, Values]:
    """Graph, truth and a start: six poses that see points at some heights over the plane (m, positive below).

    The start is off in the plane only; roll (rad) and heave (m) are those of every other pose.
    """
    t, odd = np.arange(6), np.arange(6) % 2
    X = euler.to_se3(np.stack([roll * odd, 0 * t, 0.1 * t, 0.3 * t, 0.1 * t, heave * odd], axis=1))
    n = len(heights)
    L = np.stack([rng.uniform(4, 6, n), rng.uniform(-1, 1, n), heights], axis=1)
    i, k = (grid.reshape(-1) for grid in np.meshgrid(t, np.arange(n), indexing="ij"))
    z, _ = range_azimuth(SE3.act(SE3.inverse(X[i]), L[k]))
    steps, _ = levelled(X[:-1], X[1:])
    sigma = np.array([0.01, 0.01, 0.005])
    graph = FactorGraph(
        [
            Position(x[0], [0, 0], Isotropic(1e-3), components=("x", "y")),
            Heading(x[0], 0.0, Isotropic(1e-4)),
            XYH(x[t[:-1]], x[t[1:]], steps + noise * sigma * rng.normal(size=steps.shape), Diagonal(sigma)),
            ZPR(x[t], zpr(X)[0], Diagonal([0.01, 0.002, 0.002])),
            RangeAzimuth(x[i], l[k], z + noise * SIGMA * rng.normal(size=z.shape), Diagonal(SIGMA)),
        ]
    )
    truth = Values({x: (SE3, X), l: (R(3), L)})
    off = rng.normal(size=(6, 6)) * [0.03, 0.03, 0, 0, 0, 0.01]
    aside = rng.normal(size=(n, 3)) * [0.1, 0.1, 0]
    return graph, truth, Values({x: (SE3, SE3.retract(X, off)), l: (R(3), L + aside)})
