"""One relative pose as a Python function, for libraries that have none and call back for every edge.

    r = L' e,  information = L L',  e = (translation, wrapped angle or quaternion vector part) of z^-1 X_i^-1 X_j

The Jacobians are with respect to (t, w): the translation added in the world, the rotation R Exp(w).
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin
from typing import Any

import numpy as np

Edge = Callable[[Any, Any], tuple[Any, Any, Any]]

__all__ = ["Edge", "edges", "turn"]


def edges(arrays: dict[str, Any], space: bool) -> list[Edge]:
    """A function X_i, X_j -> r, J_i, J_j for every edge."""
    L = np.linalg.cholesky(arrays["information"])
    make = in_space if space else in_the_plane
    return [make(z, np.ascontiguousarray(M.T)) for z, M in zip(arrays["z"], L, strict=True)]


def in_the_plane(z: Any, W: Any) -> Edge:
    zx, zy, zt = map(float, z)
    cz, sz = cos(zt), sin(zt)

    def edge(X: Any, Y: Any) -> tuple[Any, Any, Any]:
        c, s = cos(X[2]), sin(X[2])
        dx, dy = Y[0] - X[0], Y[1] - X[1]
        hx, hy = c * dx + s * dy, c * dy - s * dx
        ex, ey = hx - zx, hy - zy
        angle = (Y[2] - X[2] - zt + pi) % (2 * pi) - pi
        a, b = c * cz - s * sz, s * cz + c * sz  # of the angle of X and z together
        J = W @ np.array([[a, b, 0.0], [-b, a, 0.0], [0.0, 0.0, 1.0]])
        turned = W @ np.array([cz * hy - sz * hx, -sz * hy - cz * hx, -1.0])
        r = W @ np.array([cz * ex + sz * ey, cz * ey - sz * ex, angle])
        return r, np.column_stack([-J[:, :2], turned]), J

    return edge


def in_space(z: Any, W: Any) -> Edge:
    Rz, conjugate = rotation(z[3:]), z[3:] * np.array([-1.0, -1.0, -1.0, 1.0])

    def edge(X: Any, Y: Any) -> tuple[Any, Any, Any]:
        R = rotation(X[3:])
        d = R.T @ (Y[:3] - X[:3])
        h = product(X[3:] * np.array([-1.0, -1.0, -1.0, 1.0]), Y[3:])
        q = product(conjugate, h)
        if q[3] < 0:
            q = -q
        e = np.concatenate([Rz.T @ (d - z[:3]), q[:3]])
        Ji, Jj = np.zeros((6, 6)), np.zeros((6, 6))
        Jj[:3, :3] = Rz.T @ R.T
        Jj[3:, 3:] = 0.5 * (q[3] * np.eye(3) + cross(q[:3]))
        Ji[:3, :3] = -Jj[:3, :3]
        Ji[:3, 3:] = Rz.T @ cross(d)
        Ji[3:, 3:] = -Jj[3:, 3:] @ rotation(h).T
        return W @ e, W @ Ji, W @ Jj

    return edge


def cross(v: Any) -> Any:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(q: Any) -> Any:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(p: Any, q: Any) -> Any:
    a, b, c, d = p
    x, y, z, w = q
    return np.array(
        [d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w,
         d * w - a * x - b * y - c * z]
    )  # fmt: skip


def turn(q: Any) -> Any:
    """(3, 4): the rotation w of R Exp(w) that a change of a unit quaternion (x, y, z, w) makes."""
    return 2 * np.column_stack([q[3] * np.eye(3) - cross(q[:3]), -q[:3]])
