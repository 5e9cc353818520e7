r"""Directions of space, unit vectors u; a step turns the frame in which u stands about two axes across it.

    B = [[1 - x^2 / (1 + |z|), -x y / (1 + |z|)], [-x y / (1 + |z|), 1 - y^2 / (1 + |z|)], [-s x, -s y]],   s = sign z
    u [+] d = Exp(-B d) u,        local(u, v) = B' w,   w = k v x u,   k = a / sin a,   cos a = u'v

B (3, 2) are the axes, of unit length. Where u is along z, they are x and y. Nothing is singular in B; only from u to -u
no step is shorter than all others.

    z [-] h = -local(z, h) = B_z' (k z x h),        J = B_z' (k [z]x - k' (h x z) z') [h]x B_h,   k' = dk / d cos a

The innovation is about the axes of the measurement, which do not move with the estimate.

Source of B: T. Duff et al., "Building an orthonormal basis, revisited", J. Computer Graphics Techniques 6(1), 2017.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply, components, matrix, product, skew
from models.manifolds.base import Manifold

__all__ = ["S2"]


class DirectionsOfSpace(Manifold):
    """Unit vectors (x, y, z); stacks of other lengths are brought to length 1.

    Examples
    --------
    >>> S2.local(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 1.0]]) / np.sqrt(2)).round(4)  # a roll of 45 deg
    array([[0.7854, 0.    ]])
    """

    name, dim, size, components = "S2", 2, 3, ("a", "b")

    @property
    def units(self) -> tuple[str, ...]:
        return ("rad", "rad")

    def stack(self, X: npt.ArrayLike) -> Array:
        Y = super().stack(X)
        return np.asarray(Y / np.linalg.norm(Y, axis=1, keepdims=True))

    def invalid(self, X: Array) -> tuple[int, str] | None:
        zero = ~X.any(axis=1)
        return super().invalid(X) or ((int(np.argmax(zero)), "it has the length 0") if zero.any() else None)

    def axes(self, X: Array) -> Array:
        """B (..., 3, 2): the two axes about which a step turns."""
        x, y, z = components(X)
        s, k = np.where(z < 0, -1.0, 1.0), 1 / (1 + np.abs(z))
        return matrix([[1 - k * x * x, -k * x * y], [-k * x * y, 1 - k * y * y], [-s * x, -s * y]])

    def retract(self, X: Array, delta: Array) -> Array:
        w = apply(self.axes(X), delta)
        a = np.linalg.norm(delta, axis=-1, keepdims=True)
        Y = np.cos(a) * X + np.sinc(a / np.pi) * np.cross(X, w)
        return np.asarray(Y / np.linalg.norm(Y, axis=-1, keepdims=True))

    def local(self, X: Array, Y: Array) -> Array:
        return self.motion(X, Y)[0]

    def motion(self, X0: Array, X: Array) -> tuple[Array, Array]:
        v, c = np.cross(X, X0), np.sum(X * X0, axis=-1)
        s2 = np.sum(v * v, axis=-1)
        near = (s2 < 1e-8) & (c > 0)  # where k = 1 + a^2 / 6, k' = -1 / 3
        s = np.sqrt(np.where(near, 1.0, np.where(s2 > 0, s2, np.nan)))  # from u to -u every way is the shortest
        k = np.where(near, 1 + s2 / 6, np.arctan2(s, c) / s)
        dk = np.where(near, -1 / 3, (k * c - 1) / (s * s))
        M = dk[..., None, None] * v[..., :, None] * X0[..., None, :] - k[..., None, None] * skew(X0)
        B0 = self.axes(X0).mT
        return apply(B0, k[..., None] * v), product(product(B0, M), product(skew(X), self.axes(X)))

    def innovation(self, h: Array, z: Array) -> tuple[Array, Array | None]:
        c, J = self.motion(z, h)
        return -c, J

    def identity(self, n: int = 1) -> Array:
        return np.tile([0.0, 0.0, 1.0], (n, 1))

    def position(self, X: Array) -> Array:
        return X[..., :0]


S2 = DirectionsOfSpace()
