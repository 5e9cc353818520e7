r"""Poses, points and lines of the world relative to a pose: a common motion of everything does not change them.

    Y = S^-1 X                 X Exp(d):  Y Exp(H_X d),   S Exp(d):  Y Exp(H_S d)
    (G S)^-1 (G X) = S^-1 X    for every motion G of the group

of poses H_S = -Ad(Y)^-1, H_X = I; of points and lines as in `models.sensors.point_in_frame` and `line_in_frame`.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.manifolds.base import LieGroup, Manifold
from models.manifolds.line import LINE
from models.manifolds.rn import R
from models.manifolds.se2 import SE2
from models.sensors.frame import point_in_frame
from models.sensors.line import line_in_frame

__all__ = ["seen_from"]


def seen_from(group: LieGroup, S: Array, space: Manifold, X: Array) -> tuple[Array, tuple[Array, Array]] | None:
    """Elements of a space in the frame of poses; None where motions of the group do not move the space.

    Parameters
    ----------
    group, S : the poses (..., size), frame to world.
    space, X : the elements (..., size): of the same group, points of its plane or space, m, or lines of the plane.

    Returns
    -------
    Y : (..., size) array.
    H_S, H_X : (..., dim, dim of the group) and (..., dim, dim).

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2, R
    >>> Y, _ = seen_from(SE2, np.array([[1.0, 0.0, np.pi / 2]]), R(2), np.array([[1.0, 2.0]]))
    >>> Y.round(6)
    array([[2., 0.]])
    """
    if space is group:
        Y = group.between(S, X)
        return Y, (-group.adjoint_inverse(Y), np.eye(space.dim))
    if group.position(S).shape[-1] == group.point_dim > 0 and space is R(group.point_dim):
        return point_in_frame(group, S, X)
    return line_in_frame(S, X) if space is LINE and group is SE2 else None
