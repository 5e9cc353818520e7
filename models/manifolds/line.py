r"""Lines of the plane, x cos(alpha) + y sin(alpha) = r, stored as (alpha, r): rad, meters.

alpha is the direction of the normal, r the distance of the line from the origin along it. A line has two normals, so

    (alpha, r) ~ (alpha + pi, -r)

are one line. The angle tells which of the two is meant: `local` takes the one whose normal is within 90 deg of the
other line's. The sign of r cannot tell, for a line through the origin has none. r is free to change its sign while an
estimate moves; `models.sensors.normalized` makes it positive for output.

The space is a Moebius band: going round once by alpha = pi comes back with r reversed. It is no group.

Source: R. Siegwart, I. Nourbakhsh, D. Scaramuzza, Introduction to Autonomous Mobile Robots, 2011, section 4.7, for
the parameters.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, components, pack, wrap
from models.manifolds.base import Manifold

__all__ = ["LINE"]


class LinesOfThePlane(Manifold):
    """Lines (alpha, r); the step (d alpha, d r) is added, the angle wrapped.

    Examples
    --------
    The wall x = 2, and the same wall 0.1 m farther away given by its other normal:

    >>> import numpy as np
    >>> LINE.local(np.array([[0.0, 2.0]]), np.array([[-np.pi, -2.1]])).round(6)
    array([[0. , 0.1]])
    """

    name, dim, size, components = "LINE", 2, 2, ("alpha", "r")

    def retract(self, X: Array, delta: Array) -> Array:
        (alpha, r), (turn, away) = components(X), components(delta)
        return pack([wrap(alpha + turn), r + away])

    def local(self, X: Array, Y: Array) -> Array:
        (alpha_x, r_x), (alpha_y, r_y) = components(X), components(Y)
        turn = wrap(alpha_y - alpha_x)
        flipped = np.cos(turn) < 0  # the other normal of Y is nearer
        return pack([np.where(flipped, wrap(turn + np.pi), turn), np.where(flipped, -r_y, r_y) - r_x])

    def identity(self, n: int = 1) -> Array:
        return np.zeros((n, 2))

    def position(self, X: Array) -> Array:
        return X[..., :0]  # it is nowhere in particular; an increment is no displacement


LINE = LinesOfThePlane()
