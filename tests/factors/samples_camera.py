"""Samples of the projection into a camera, by hand through homogeneous matrices and one measurement at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import Factor, Noise, Projection
from factors.keys import Keys
from models import SE3, Manifold, Measured, R
from models.sensors import Camera
from tests.factors.samples import Sample, homogeneous
from tests.factors.samples_sensors import MOUNT, in_sensor

Array = npt.NDArray[np.float64]
HERE = SE3.identity()[0]
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


def image(name: str, mode: str, target: str = "point") -> Sample:
    """mode: no offset, a fixed one, or a variable; target: point or pose."""
    camera = CAMERAS[name]
    manifolds: tuple[Manifold, ...] = (SE3, R(3) if target == "point" else SE3)
    if mode == "variable":
        manifolds = (*manifolds, SE3)

    def mounts(X: Array, *O: Array) -> Array:
        return O[0] if O else np.tile(MOUNT[SE3] if mode == "fixed" else HERE, (len(X), 1))

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        offset = {"none": None, "fixed": MOUNT[SE3], "variable": keys[-1]}[mode]
        return Projection(keys[0], keys[1], z, noise, camera, offset)

    def truth(X: Array, L: Array, *O: Array) -> Array:
        seen = zip(X, L, mounts(X, *O), strict=True)
        return np.array([pixel(camera, in_sensor(SE3, x, l, o)) for x, l, o in seen])

    def visible(X: Array, L: Array, *O: Array) -> tuple[Array, ...]:
        """Targets at least 3 m in front of their cameras: z becomes |z| + 3."""
        L = L.copy()
        for k, (x, o) in enumerate(zip(X, mounts(X, *O), strict=True)):
            p = in_sensor(SE3, x, L[k], o)
            S = homogeneous(SE3, x) @ homogeneous(SE3, o)
            L[k, :3] = (S @ [p[0], p[1], abs(p[2]) + 3, 1.0])[:3]
        return X, L, *O

    return Sample(
        f"Projection-{name}-{target}-offset {mode}", manifolds, Measured("u", "v"), 2, build, truth, visible=visible
    )


CAMERA_SAMPLES = [
    *(image(name, mode) for name in CAMERAS for mode in ("none", "fixed", "variable")),
    *(image("distorted", mode, "pose") for mode in ("none", "variable")),
]
