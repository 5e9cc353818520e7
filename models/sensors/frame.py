r"""Points seen from a moving frame, and points carried by it, with their derivatives for right increments.

With a pose S = (R, t), an increment S Exp(rho, phi) and a point l of the world:

    p = S^-1 l = R' (l - t)          dp/d(rho, phi) = [-I, [p]x],        dp/dl = R'
    q = S a    = t + R a             dq/d(rho, phi) = [R, -R [a]x]

and in the plane, with one angle, (p_y, -p_x)' in the place of [p]x. Both follow from R Exp(phi) = R + R [phi]x + ... A
point s has the axes of the world: p = l - s.

Source: T. Barfoot, State Estimation for Robotics, 2017, section 7.1.8, for increments on the right.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply, components, pack, product, skew
from models.manifolds.base import LieGroup

__all__ = ["point_in_frame", "point_on_body"]


def point_in_frame(group: LieGroup, S: Array, l: Array) -> tuple[Array, tuple[Array, Array]]:
    """p = S^-1 l, the points l in the frame of the poses S, or as seen from points S along the axes of the world.

    Parameters
    ----------
    group : SE2 or SE3; R(2) or R(3) of points.
    S : (n, size) poses, frame to world, or points, m.
    l : (n, 2 or 3) points of the world, m.

    Returns
    -------
    p : (n, 2 or 3) array, m.
    H_S, H_l : [-I, [p]x] (n, d, dim) and R' (n, d, d); of points -I and I.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2
    >>> p, _ = point_in_frame(SE2, np.array([[1.0, 0.0, np.pi / 2]]), np.array([[1.0, 2.0]]))
    >>> p.round(6)
    array([[2., 0.]])
    """
    R_inv = group.rotation(S).mT
    p = apply(R_inv, l - group.position(S))
    if group.flat:
        return p, (-R_inv, R_inv)
    return p, (_beside(-np.eye(p.shape[-1]), _cross(p)), R_inv)


def point_on_body(group: LieGroup, S: Array, a: Array) -> tuple[Array, Array]:
    """q = S a, the points a of the body in the world.

    Parameters
    ----------
    group : SE2 or SE3.
    S : (n, size) poses, body to world.
    a : (n, 2 or 3) or (1, 2 or 3) points of the body, m.

    Returns
    -------
    q : (n, 2 or 3) array, m.
    H_S : [R, -R [a]x] (n, d, dim).

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2
    >>> point_on_body(SE2, np.array([[1.0, 0.0, np.pi / 2]]), np.array([[2.0, 0.0]]))[0].round(6)
    array([[1., 2.]])
    """
    R = group.rotation(S)
    return group.position(S) + apply(R, a), _beside(R, -product(R, _cross(a)))


def _cross(p: npt.ArrayLike) -> Array:
    """[p]x, or (p_y, -p_x)' in the plane."""
    p = np.asarray(p)
    if p.shape[-1] == 3:
        return skew(p)
    x, y = components(p)
    return pack([y, -x])[..., None]


def _beside(A: Array, B: Array) -> Array:
    """[A, B] for stacks of matrices, components first in memory; the batches broadcast."""
    batch = np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
    out = np.moveaxis(np.empty((A.shape[-2], A.shape[-1] + B.shape[-1], *batch)), (0, 1), (-2, -1))
    out[..., : A.shape[-1]] = A
    out[..., A.shape[-1] :] = B
    return out
