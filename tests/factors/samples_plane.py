"""Samples of what drives in the plane among walls: by hand, with complex numbers and one measurement at a time."""

from __future__ import annotations

import numpy as np

from factors import DriftingStep, Line, Wheels
from models import LINE, SE2, Measured, R
from models.algebra import Array
from tests.factors.samples import Sample
from tests.factors.samples_sensors import mounted


def line_in_sensor(S: Array, l: Array) -> list[float]:
    """The line through two points of it, both taken to the frame S (3, 3); its normal turns as the axes do."""
    n = np.exp(1j * l[0])
    p, q = (np.linalg.solve(S, [v.real, v.imag, 1.0]) for v in (l[1] * n, l[1] * n + 1j * n))
    along = complex(*(q - p)[:2]) / abs(complex(*(q - p)[:2]))
    normal = -1j * along
    return [float(np.angle(normal)), float((np.conj(normal) * complex(*p[:2])).real)]


def travelled(base: float, X_i: Array, X_j: Array) -> Array:
    """By the turn and the way, seen from the middle of the turn."""
    out = []
    for a, b in zip(X_i, X_j, strict=True):
        turn = np.angle(np.exp(1j * (b[2] - a[2])))
        way = complex(*(b - a)[:2]) * np.exp(-1j * (a[2] + turn / 2))
        out.append([way.real + turn * base / 2, way.real - turn * base / 2, way.imag])
    return np.array(out)


def wheels(name: str, base: float, turned: float) -> Sample:
    return Sample(
        f"Wheels-{name}",
        (SE2, SE2),
        Measured("right", "left", "lateral"),
        3,
        lambda keys, z, noise: Wheels(*keys, z, noise, base),
        lambda X_i, X_j: travelled(base, X_i, X_j),
        around=(np.array([1.0, -2.0, 3.0]), np.array([2.0, -1.5, turned])),
    )


def reckoned(length: float, X_i: Array, X_j: Array, d: Array) -> Array:
    """The step as it was, and the drift for every meter of it."""
    out = []
    for a, b, drift in zip(X_i, X_j, d, strict=True):
        way = complex(*(b - a)[:2]) * np.exp(-1j * a[2]) + length * complex(*drift)
        out.append([way.real, way.imag, np.angle(np.exp(1j * (b[2] - a[2])))])
    return np.array(out)


def drifting(name: str, length: float, turned: float) -> Sample:
    return Sample(
        f"DriftingStep-{name}",
        (SE2, SE2, R(2)),
        Measured("x", "y", "yaw"),
        3,
        lambda keys, z, noise: DriftingStep(*keys, z, noise, np.full(len(z), length)),
        lambda X_i, X_j, d: reckoned(length, X_i, X_j, d),
        around=(np.array([1.0, -2.0, 3.0]), np.array([2.0, -1.5, turned]), np.array([0.1, -0.2])),
    )


PLANE_SAMPLES = [
    *(
        mounted(f"Line-{name}", Line, mode, LINE, LINE, line_in_sensor, (np.array(pose), np.array(wall)))
        for name, mode, pose, wall in (
            *(("wall ahead", mode, [0.0, 0.0, 0.0], [0.2, 8.0]) for mode in ("none", "fixed", "variable")),
            ("at pi", "none", [2.0, 1.0, -3.0], [-3.1, 0.5]),
            ("behind the origin", "none", [2.0, 1.0, 0.5], [1.0, -4.0]),
        )
    ),
    wheels("ahead", 0.5, 3.1),
    wheels("over pi", 1.2, -2.9),
    drifting("ahead", 1.5, 3.1),
    drifting("over pi", 0.7, -2.9),
    drifting("standing", 0.0, 3.0),
]
