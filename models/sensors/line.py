r"""Straight lines of the plane as a vehicle sees them: walls, quays, the foot of a pile, the edge of a trench.

A line x cos(alpha) + y sin(alpha) = r, seen from the pose X = (x, y, theta), is in the axes of that pose the line

    alpha' = wrap(alpha - theta),      r' = r - (x cos alpha + y sin alpha)

    H_X = [[0, 0, -1], [-cos alpha', -sin alpha', 0]]             X Exp(rho, phi)
    H_l = [[1, 0], [x sin alpha - y cos alpha, 1]]

and back, alpha = alpha' + theta, r = r' + x cos alpha + y sin alpha. There is no geometry in which this has no value.
r' changes its sign where the vehicle crosses the line or its extension; nothing else happens there.

Source: R. Siegwart, I. Nourbakhsh, D. Scaramuzza, Introduction to Autonomous Mobile Robots, 2011, section 5.6.8, with
the increments of the pose in the axes of its body.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, components, matrix, pack, wrap

__all__ = ["line_from_frame", "line_in_frame", "normalized"]


def line_in_frame(X: Array, l: Array) -> tuple[Array, tuple[Array, Array]]:
    """Lines of the world in the axes of poses.

    Parameters
    ----------
    X : (n, 3) poses SE2, frame to world.
    l : (n, 2) lines (alpha, r) of the world, rad and m.

    Returns
    -------
    h : (n, 2) the same lines, alpha' in [-pi, pi), r' of either sign.
    H_X, H_l : (n, 2, 3) and (n, 2, 2).

    Examples
    --------
    The wall x = 10, which a vehicle at x = 8 that looks along y has 2 m to its right:

    >>> import numpy as np
    >>> h, _ = line_in_frame(np.array([[8.0, 3.0, np.pi / 2]]), np.array([[0.0, 10.0]]))
    >>> h.round(4)
    array([[-1.5708,  2.    ]])
    """
    x, y, theta = components(X)
    alpha, r = components(l)
    c, s = np.cos(alpha), np.sin(alpha)
    azimuth = wrap(alpha - theta)
    H_X = matrix([[0.0, 0.0, -1.0], [-np.cos(azimuth), -np.sin(azimuth), 0.0]])
    return pack([azimuth, r - (x * c + y * s)]), (H_X, matrix([[1.0, 0.0], [x * s - y * c, 1.0]]))


def line_from_frame(X: Array, z: Array) -> Array:
    """Lines (n, 2) of the world from lines z (n, 2) in the axes of poses X (n, 3): the inverse of `line_in_frame`.

    Examples
    --------
    >>> import numpy as np
    >>> line_from_frame(np.array([[8.0, 3.0, np.pi / 2]]), np.array([[-np.pi / 2, 2.0]])).round(6)
    array([[ 0., 10.]])
    """
    x, y, theta = components(X)
    azimuth, r = components(z)
    alpha = wrap(azimuth + theta)
    return pack([alpha, r + x * np.cos(alpha) + y * np.sin(alpha)])


def normalized(l: Array) -> Array:
    """Lines (..., 2) written with r >= 0, for tables, pictures and files; an estimator leaves the sign alone.

    Examples
    --------
    >>> import numpy as np
    >>> normalized(np.array([[0.5, 3.0], [0.5, -3.0]])).round(4)
    array([[ 0.5   ,  3.    ],
           [-2.6416,  3.    ]])
    """
    alpha, r = components(l)
    return pack([np.where(r < 0, wrap(alpha + np.pi), alpha), np.abs(r)])
