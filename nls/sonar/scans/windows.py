"""How far around a guess a match is searched: three sigmas of the relative pose."""

from __future__ import annotations

import numpy as np

from factors.keys import kinds
from models.algebra import Array, Index
from nls.analysis.motions import motion_covariances
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["half_widths", "windows"]

SIGMAS = 3.0  # of the relative pose
LIMITS = ((3.0, 20.0), (np.radians(3.0), np.radians(10.0)))  # least and largest half width: m, rad
x = kinds("x")[0]


def windows(graph: FactorGraph, values: Values, i: Index, j: Index) -> Array:
    """Half widths (n, 2), m and rad, of the search for keyframes j (n,) from i: by their relative covariance."""
    return half_widths(motion_covariances(graph, values, x[i], x[j]))


def half_widths(relative: Array) -> Array:
    """Half widths (n, 2), m and rad, of the search for poses whose covariance (n, 3, 3) from their partner is known."""
    variance = np.column_stack([np.linalg.eigvalsh(relative[:, :2, :2])[:, -1], relative[:, 2, 2]])
    sigma = np.sqrt(np.maximum(variance, 0.0))  # below 0 by rounding, where both poses are as good as one
    return np.column_stack([np.clip(SIGMAS * sigma[:, k], *LIMITS[k]) for k in range(2)])
