"""The heading of a vehicle: compass, gyrocompass, two antennas."""

from __future__ import annotations

import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import named_singularity, pose_group
from factors.noise import Noise
from models import LieGroup, Manifold, Measured
from models.algebra import Array
from models.sensors import heading

__all__ = ["Heading"]


class Heading(Factor):
    r"""Yaw of a pose in the plane or in space, where R = Rz(yaw) Ry(pitch) Rx(roll).

    .. math:: h(X) = \mathrm{atan2}(R_{21}, R_{11}), \quad
              H = (0, 0, 0, \; 0, \; \sin roll / \cos pitch, \; \cos roll / \cos pitch)

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    z : (n,) measured headings, rad, from world x towards world y (north towards east where z is down).
    noise : of ``yaw``, rad.

    Raises
    ------
    GraphError
        Not a pose; z of the wrong shape.
    SingularGeometryError
        At evaluation: gimbal lock, pitch = +-90 deg.

    Notes
    -----
    Says nothing of the position, and in space nothing of roll and pitch. J. Diebel, "Representing attitude", 2006.

    Examples
    --------
    >>> from factors import Diagonal, Heading, Isotropic, Prior
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> fix = Prior(x[0], [1.0, 2.0, 0.0], Isotropic(0.1), components=("x", "y"))
    >>> graph = FactorGraph([fix, Heading(x[0], 3.0, Diagonal(heading=0.01))])
    >>> graph.optimize(Values({x: (SE2, [0.0, 0.0, -3.0])})).values[x[0]].round(6)
    array([1., 2., 3.])
    """

    slots = (None,)
    frame = "world"

    def __init__(self, pose: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__([pose], z, noise)

    def sizes(self) -> tuple[int, ...]:
        return (1,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        pose_group(self, manifolds[0])
        return Measured("yaw")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group = manifolds[0]
        assert isinstance(group, LieGroup)
        with named_singularity(self):
            h, H = heading(group, X[0])
        return h, (H,)
