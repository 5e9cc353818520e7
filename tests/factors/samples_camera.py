"""Samples of the projection into a camera, by hand through homogeneous matrices and one measurement at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import Factor, Noise, Projection
from factors.keys import Keys
from models import SE3, Manifold, Measured, R
from models.sensors import Camera
from tests.factors.samples import Sample
from tests.factors.samples_sensors import in_frame, mounted

Array = npt.NDArray[np.float64]
BROWN = (-0.01, 0.002, 0.003, -0.002, 1e-5)  # k1 k2 p1 p2 k3
CAMERAS = {
    "normalized": Camera(),
    "pixels": Camera((5.0, 6.0), (3.0, 2.0)),
    "distorted": Camera((5.0, 6.0), (3.0, 2.0), BROWN),
}


def pixel(camera: Camera, p: Array) -> list[float]:
    """The image of one point, term by term as in the manual of OpenCV's calibration."""
    k1, k2, p1, p2, k3 = camera.distortion or (0.0,) * 5
    x, y = p[0] / p[2], p[1] / p[2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return [camera.focal[0] * u + camera.center[0], camera.focal[1] * v + camera.center[1]]


def image(name: str, mode: str, target: Manifold) -> Sample:
    camera = CAMERAS[name]

    def kind(pose: Keys, point: Keys, z: Array, noise: Noise, offset: Array | Keys | None) -> Factor:
        return Projection(pose, point, z, noise, camera, offset)

    name = f"Projection-{name}-{'pose' if target is SE3 else 'point'}"
    predict = lambda S, l: pixel(camera, in_frame(S, l))  # noqa: E731
    return mounted(name, kind, mode, Measured("u", "v"), target, predict, None, in_front=True)


CAMERA_SAMPLES = [
    *(image(name, mode, R(3)) for name in CAMERAS for mode in ("none", "fixed", "variable")),
    *(image("distorted", mode, SE3) for mode in ("none", "variable")),
]
