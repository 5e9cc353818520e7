"""The image of a point in a camera with unknown focal length and distortion: bundle adjustment."""

from __future__ import annotations

import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from models import Manifold, Measured, R
from models.algebra import Array
from models.sensors import project

__all__ = ["CAMERA", "LENS", "BundleProjection"]

CAMERA = Measured("wx", "wy", "wz", "tx", "ty", "tz")  # vectors, with names for messages
LENS = Measured("f", "k1", "k2")


class BundleProjection(Factor):
    r"""Pixels of a point, with the camera of the "bundle adjustment in the large" problems.

    .. math:: P = R(w) X + t, \quad p = -P_{xy} / P_z, \quad h = f \, (1 + k_1 |p|^2 + k_2 |p|^4) \, p

    The Jacobians are in `models.sensors.bundle`.

    Parameters
    ----------
    camera : in `CAMERA`, rotation vector w and translation t, *world to camera*, as in the files; steps add up.
    intrinsics : in `LENS`, focal length f in pixels and radial distortion k1, k2.
    point : R(3), the point in the world.
    z : (n, 2) pixels from the middle of the image, x to the right, y up.
    noise : of ``u`` and ``v``, pixels.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit.
    SingularGeometryError
        At evaluation: a point in the plane of the camera, P_z = 0.

    Notes
    -----
    The camera looks along its negative z axis. A point behind it (P_z > 0) is not refused, as the data sets do not
    exclude it either. A point needs two cameras. Besides the six motions of the whole scene its *scale* is free. Hold a
    second thing, or let the damping of Levenberg-Marquardt choose, as `damped` asks. S. Agarwal, N. Snavely, S. Seitz,
    R. Szeliski, "Bundle adjustment in the large", ECCV 2010.

    Examples
    --------
    >>> from factors import BundleProjection, Isotropic, check_jacobians
    >>> from factors.bundle import CAMERA, LENS
    >>> from models import R
    >>> from nls import Values, kinds
    >>> c, f, l = kinds("c", "f", "l")
    >>> seen = BundleProjection(c[0], f[0], l[0], [60.0, 0.0], Isotropic(1.0))
    >>> values = Values({c: (CAMERA, [0, 0, 0, 0, 0, -2.0]), f: (LENS, [100.0, 0.1, 0.0]), l: (R(3), [1, 0, 0])})
    >>> seen.chi2(values), check_jacobians(seen, values) < 1e-6
    (array([76.5625]), True)
    """

    slots = (CAMERA, LENS, R(3))
    relative = True
    unmoved = (1,)
    damped = True

    def __init__(self, camera: Keys, intrinsics: Keys, point: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__([camera, intrinsics, point], z, noise)

    def sizes(self) -> tuple[int, ...]:
        return (2,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("u", "v")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        with named_singularity(self):
            return project(*X)
