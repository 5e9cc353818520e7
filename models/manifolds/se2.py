r"""Poses in the plane, SE(2), stored as (x, y, theta): meters, meters, rad.

With x = theta^2 and the Stumpff functions c_k(x) of `models.algebra.stumpff`:

    Exp(rho, theta) = (V rho, theta),       V = [[c1, -theta c2], [theta c2, c1]] = sinc(h) R(h),  h = theta/2
    V^-1 = [[a, h], [-h, a]],               a = h cot h = c1 / (2 c2)
    J_l = [[V, u], [0, 1]],                 u = (theta c3 rho_1 + c2 rho_2, -c2 rho_1 + theta c3 rho_2)
    J_l^-1 = [[V^-1, -V^-1 u], [0, 1]],     -V^-1 u = (g rho_1 - rho_2/2, rho_1/2 + g rho_2)
                                            g = (1 - a) / theta = theta (c3 - 2 c4) / (2 c2)
    Ad = [[R, (y, -x)'], [0, 1]],           Ad^-1 = [[R', (s x - c y, c x + s y)'], [0, 1]]

Source: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendix C.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, components, matrix, pack, sinc, stumpff, wrap
from models.manifolds.base import LieGroup
from models.manifolds.rigid import rigid_parts
from models.manifolds.so2 import angle2, rotation2

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

    def from_matrix(self, T: npt.ArrayLike) -> Array:
        """Poses (3,) or (n, 3) of homogeneous matrices (3, 3) or (n, 3, 3), body to world; `matrix` is the inverse.

        Raises
        ------
        GraphError
            No such matrices; a matrix that is no rigid motion, by more than 0.001 in an entry of R'R.

        Examples
        --------
        >>> SE2.from_matrix([[0, -1, 5], [1, 0, 6], [0, 0, 1]]).round(6)
        array([5.      , 6.      , 1.570796])
        """
        R, t = rigid_parts("SE2.from_matrix", T, 2)
        return pack([t[..., 0], t[..., 1], angle2(R)])

    def exp(self, delta: npt.ArrayLike) -> Array:
        rho1, rho2, theta = components(delta)
        h = theta / 2
        chord, c, s = sinc(h), np.cos(h), np.sin(h)
        return pack([chord * (c * rho1 - s * rho2), chord * (s * rho1 + c * rho2), wrap(theta)])

    def retract(self, X: Array, delta: Array) -> Array:
        x, y, theta = components(X)  # t + R(theta) sinc(h) R(h) rho: along the chord, at the mean angle
        rho1, rho2, turn = components(delta)
        h = turn / 2
        chord, c, s = sinc(h), np.cos(theta + h), np.sin(theta + h)
        return pack([x + chord * (c * rho1 - s * rho2), y + chord * (s * rho1 + c * rho2), wrap(theta + turn)])

    def log(self, X: npt.ArrayLike) -> Array:
        x, y, theta = components(X)
        theta = wrap(theta)
        h = theta / 2
        a = np.cos(h) / sinc(h)
        return pack([a * x + h * y, a * y - h * x, theta])

    def coordinates(self, X: Array) -> Array:
        return X

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

    def framed(self, X: Array) -> Array:
        if X.shape[-1] > self.size:
            return X
        x, y, theta = components(X)
        return pack([x, y, theta, np.cos(theta), np.sin(theta)])

    def misfit(self, X: Array, Y: Array, Z: Array, jacobians: bool = True) -> tuple[Array, Array | None]:
        (xa, ya, tha, ca, sa), (xb, yb, thb, cb, sb), (xz, yz, thz, cz, sz) = map(components, (X, Y, Z))
        dx, dy = xb - xa, yb - ya
        hx, hy = ca * dx + sa * dy, ca * dy - sa * dx
        u, v = hx - xz, hy - yz
        off = pack([cz * u + sz * v, cz * v - sz * u, wrap(thb - tha - thz)])
        if not jacobians:
            return off, None
        c, s = ca * cz - sa * sz, sa * cz + ca * sz
        ce, se = cb * c + sb * s, sb * c - cb * s
        J_1 = [-cz, -sz, cz * hy - sz * hx, ce, -se, 0.0]
        J_2 = [sz, -cz, -cz * hx - sz * hy, se, ce, 0.0]
        return off, matrix([J_1, J_2, [0.0, 0.0, -1.0, 0.0, 0.0, 1.0]])

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
        c1, c2, c3 = stumpff(theta * theta, 1, 2, 3)
        k, m = theta * c2, theta * c3
        return matrix([[c1, -k, m * rho1 + c2 * rho2], [k, c1, m * rho2 - c2 * rho1], [0.0, 0.0, 1.0]])

    def jl_inv(self, delta: npt.ArrayLike) -> Array:
        rho1, rho2, theta = components(delta)
        c1, c2, c3, c4 = stumpff(theta * theta, 1, 2, 3, 4)
        h = theta / 2
        a, g = c1 / (2 * c2), h * (c3 - 2 * c4) / c2
        return matrix([[a, h, g * rho1 - rho2 / 2], [-h, a, rho1 / 2 + g * rho2], [0.0, 0.0, 1.0]])

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


SE2 = PosesOfThePlane()
