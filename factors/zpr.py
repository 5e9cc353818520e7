"""Depth, pitch and roll of a vehicle, which pressure cell and tilt sensor measure without drift."""

from __future__ import annotations

import numpy.typing as npt

from factors.base import Factor, Jacobians, Model
from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from models import SE3, Manifold, Measured
from models.algebra import Array
from models.sensors import zpr

__all__ = ["ZPR"]


class ZPR(Factor):
    r"""Depth, pitch and roll of a pose, where R = Rz(yaw) Ry(pitch) Rx(roll).

    .. math:: h(X) = (t_z, \; \mathrm{atan2}(-R_{31}, \sqrt{R_{11}^2 + R_{21}^2}), \; \mathrm{atan2}(R_{32}, R_{33}))

    Parameters
    ----------
    pose : the vehicle(s), SE3.
    z : (n, 3) measured z, m, pitch and roll, rad.
    noise : of z (m), pitch and roll (rad).

    Raises
    ------
    GraphError
        A variable not in SE3; z of the wrong shape.
    SingularGeometryError
        At evaluation: gimbal lock, pitch = +-90 deg.

    Notes
    -----
    Says nothing of x, y and yaw. Depth alone is `Position` with ``components=("depth",)``. J. Diebel, "Representing
    attitude", 2006.

    Examples
    --------
    >>> from factors import ZPR, Diagonal, Heading, Isotropic, Position
    >>> from models import SE3, euler
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> here = Position(x[0], [3.0, 4.0], Isotropic(0.1), components=("x", "y"))
    >>> north = Heading(x[0], 0.0, Isotropic(0.01))
    >>> tilt = ZPR(x[0], [7.5, 0.1, -0.2], Diagonal(depth=0.01, pitch=0.002, roll=0.002))
    >>> result = FactorGraph([here, north, tilt]).optimize(Values({x: (SE3, SE3.identity())}))
    >>> euler.from_se3(result.values[x[0]]).round(6)  # roll, pitch, yaw, x, y, z
    array([-0.2,  0.1,  0. ,  3. ,  4. ,  7.5])
    """

    slots = (SE3,)
    frame = "world"

    def __init__(self, pose: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__([pose], z, noise)

    def sizes(self) -> tuple[int, ...]:
        return (3,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("z", "pitch", "roll")

    def tilts(self, model: Model) -> Array:
        return model.z

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        with named_singularity(self):
            h, H = zpr(X[0])
        return h, (H,)
