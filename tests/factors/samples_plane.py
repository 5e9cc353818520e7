"""Samples of what drives in the plane among walls: by hand, with complex numbers and one measurement at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import Factor, Line, Noise, Wheels
from factors.keys import Keys
from models import LINE, SE2, Manifold, Measured
from tests.factors.samples import Sample, homogeneous
from tests.factors.samples_sensors import MOUNT

Array = npt.NDArray[np.float64]
HERE = SE2.identity()[0]


def line_in_sensor(S: Array, l: Array) -> list[float]:
    """The line through two points of it, both taken to the frame S (3, 3); its normal turns as the axes do."""
    n = np.exp(1j * l[0])
    p, q = (np.linalg.solve(S, [v.real, v.imag, 1.0]) for v in (l[1] * n, l[1] * n + 1j * n))
    along = complex(*(q - p)[:2]) / abs(complex(*(q - p)[:2]))
    normal = -1j * along
    return [float(np.angle(normal)), float((np.conj(normal) * complex(*p[:2])).real)]


def line(name: str, mode: str, around: tuple[Array, ...]) -> Sample:
    """mode: no offset, a fixed one, or a variable."""
    manifolds: tuple[Manifold, ...] = (SE2, LINE, SE2) if mode == "variable" else (SE2, LINE)

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        return Line(keys[0], keys[1], z, noise, {"none": None, "fixed": MOUNT[SE2], "variable": keys[-1]}[mode])

    def truth(X: Array, L: Array, *O: Array) -> Array:
        mounts = O[0] if O else np.tile(MOUNT[SE2] if mode == "fixed" else HERE, (len(X), 1))
        frames = [homogeneous(SE2, x) @ homogeneous(SE2, o) for x, o in zip(X, mounts, strict=True)]
        return np.array([line_in_sensor(S, l) for S, l in zip(frames, L, strict=True)])

    return Sample(f"Line-{name}-offset {mode}", manifolds, LINE, 2, build, truth, around=around)


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


PLANE_SAMPLES = [
    *(
        line("wall ahead", mode, (HERE, np.array([0.2, 8.0]), HERE)[: 3 if mode == "variable" else 2])
        for mode in ("none", "fixed", "variable")
    ),
    line("at pi", "none", (np.array([2.0, 1.0, -3.0]), np.array([-3.1, 0.5]))),
    line("behind the origin", "none", (np.array([2.0, 1.0, 0.5]), np.array([1.0, -4.0]))),
    wheels("ahead", 0.5, 3.1),
    wheels("over pi", 1.2, -2.9),
]
