r"""Poses in the plane, SE(2), stored as (x, y, theta): meters, meters, rad.

With x = theta^2 and the Stumpff functions c_k(x) of `models.algebra.stumpff`:

    Exp(rho, theta) = (V rho, theta),       V = [[c1, -theta c2], [theta c2, c1]]
    V^-1 = [[a, theta/2], [-theta/2, a]],   a = c1 / (2 c2) = (theta/2) cot(theta/2)
    J_l = [[V, u], [0, 1]],                 u = (theta c3 rho_1 + c2 rho_2, -c2 rho_1 + theta c3 rho_2)
    Ad = [[R, (y, -x)'], [0, 1]],           Ad^-1 = [[R', (s x - c y, c x + s y)'], [0, 1]]

Source: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendix C.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply, components, matrix, pack, stumpff, wrap
from models.manifolds.base import LieGroup
from models.manifolds.so2 import rotation2

__all__ = ["SE2"]


class PosesOfThePlane(LieGroup):
    """SE(2): a o b = (t_a + R(theta_a) t_b, wrap(theta_a + theta_b)).

    Examples
    --------
    >>> import numpy as np
    >>> quarter = np.array([1.0, 0.0, np.pi / 2])
    >>> SE2.compose(quarter, quarter).round(6)
    array([ 1.      ,  1.      , -3.141593])
    """

    name, dim, size, components, point_dim = "SE2", 3, 3, ("x", "y", "yaw"), 2
    body_axes = True

    def exp(self, delta: npt.ArrayLike) -> Array:
        rho1, rho2, theta = components(delta)
        c1, c2 = stumpff(theta**2, 1, 2)
        k = theta * c2
        return pack([c1 * rho1 - k * rho2, k * rho1 + c1 * rho2, wrap(theta)])

    def log(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        theta = wrap(theta)
        a, h = _half_cot(theta), theta / 2
        return pack([a * x + h * y, a * y - h * x, theta])

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        xa, ya, tha = components(X)
        xb, yb, thb = components(Y)
        c, s = np.cos(tha), np.sin(tha)
        return pack([xa + c * xb - s * yb, ya + s * xb + c * yb, wrap(tha + thb)])

    def inverse(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        c, s = np.cos(theta), np.sin(theta)
        return pack([-c * x - s * y, s * x - c * y, wrap(-theta)])

    def between(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        xa, ya, tha = components(X)
        xb, yb, thb = components(Y)
        c, s, dx, dy = np.cos(tha), np.sin(tha), xb - xa, yb - ya
        return pack([c * dx + s * dy, c * dy - s * dx, wrap(thb - tha)])

    def adjoint(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        c, s = np.cos(theta), np.sin(theta)
        return matrix([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])

    def adjoint_inverse(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        c, s = np.cos(theta), np.sin(theta)
        return matrix([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0.0, 0.0, 1.0]])

    def jl(self, delta: npt.ArrayLike) -> Array:
        rho1, rho2, theta = components(delta)
        c1, c2, c3 = stumpff(theta**2, 1, 2, 3)
        k, m = theta * c2, theta * c3
        return matrix([[c1, -k, m * rho1 + c2 * rho2], [k, c1, m * rho2 - c2 * rho1], [0.0, 0.0, 1.0]])

    def jl_inv(self, delta: npt.ArrayLike) -> Array:
        rho1, rho2, theta = components(delta)
        c2, c3 = stumpff(theta**2, 2, 3)
        a, h, m = _half_cot(theta), theta / 2, theta * c3
        V_inv = matrix([[a, h], [-h, a]])
        u = apply(V_inv, pack([m * rho1 + c2 * rho2, m * rho2 - c2 * rho1]))
        return matrix([[a, h, -u[..., 0]], [-h, a, -u[..., 1]], [0.0, 0.0, 1.0]])

    def vector(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        return pack([x, y, wrap(theta)])

    def vector_jl(self, X: npt.ArrayLike) -> Array:
        x, y, _ = components(X)
        return matrix([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])

    def vector_jr(self, X: npt.ArrayLike) -> Array:
        theta = components(X)[2]
        c, s = np.cos(theta), np.sin(theta)
        return matrix([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    world_axes = vector_jr  # blkdiag(R, 1): the derivative of (t, theta)

    def rotation(self, X: npt.ArrayLike) -> Array:
        return rotation2(components(X)[2])

    def identity(self, n: int = 1) -> Array:
        return np.zeros((n, 3))

    def position(self, X: Array) -> Array:
        return X[..., :2]


def _half_cot(theta: Array) -> Array:
    """(theta/2) cot(theta/2), 1 at 0."""
    c1, c2 = stumpff(theta**2, 1, 2)
    return c1 / (2 * c2)


SE2 = PosesOfThePlane()
