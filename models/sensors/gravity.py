r"""The direction of gravity in the axes of a body: roll and pitch, and nothing of the yaw.

    h = R' g,      R Exp(phi):  h becomes Exp(-phi) h,      H_phi = B(h)'

with g the direction in the world and B(h) the axes of a step on the sphere, `models.S2`. Where a sensor measures roll
and pitch instead, h is (-sin pitch, sin roll cos pitch, cos roll cos pitch) for z down.

Source: T. Barfoot, State Estimation for Robotics, 2017, section 7.1, for increments on the right.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, apply
from models.manifolds.base import LieGroup
from models.manifolds.s2 import S2

__all__ = ["gravity"]


def gravity(group: LieGroup, X: Array, g: Array) -> tuple[Array, Array]:
    """A direction of the world in the axes of bodies.

    Parameters
    ----------
    group : SO3 or SE3.
    X : (n, size) attitudes or poses, body to world.
    g : (3,) or (n, 3) unit vectors of the world.

    Returns
    -------
    h : (n, 3) unit vectors along the axes of the body.
    H : (n, 2, dim) array, rad.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE3
    >>> rolled = SE3.from_rpy(0, 0, 5, np.radians(30), 0, np.radians(70))
    >>> gravity(SE3, rolled[None], np.array([0.0, 0.0, 1.0]))[0].round(3)
    array([[0.   , 0.5  , 0.866]])
    """
    h = apply(group.rotation(X).mT, g)
    H = np.zeros((len(h), 2, group.dim))
    H[:, :, -3:] = S2.axes(h).mT
    return h, H
