"""The measured difference of two variables: odometry, loop closures, scan matches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians, Model
from factors.keys import Keys
from factors.noise import Noise, whiten
from factors.noise_size import numbers_of_z
from models import SE2, SE3, LieGroup, Manifold
from models.algebra import Array, components
from models.errors import GraphError

__all__ = ["Between"]


class Between(Factor):
    r"""Variable j as seen from variable i, both in the same group.

    .. math:: h(x_i, x_j) = x_i^{-1} x_j, \quad H_i = -\mathrm{Ad}_{h^{-1}}, \quad H_j = I

    Parameters
    ----------
    i, j : the variables, R(n), SO2, SE2, SO3 or SE3.
    z : (n, size) measured differences in the stored form of the group; SE2 (x, y, theta), SE3 (x y z qx qy qz qw).
    noise : of (x, y, yaw) or (x, y, z, roll, pitch, yaw), in the frame of variable j as predicted. For the convention
        ``g2o``: in that of the measurement.
    convention : ``log`` (default), ``g2o``, ``graphslam`` or ``gtsam``, see `factors.conventions`.

    Raises
    ------
    GraphError
        Variables of two spaces.

    Notes
    -----
    Only differences are measured: with no other factor the whole group of motions is free (gauge). A difference of
    points that is not 0 determines headings, too: beside poses a shift alone is free. G. Grisetti et al., "A tutorial
    on graph-based SLAM", 2010.

    Examples
    --------
    >>> from factors import Between, Diagonal
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph()
    >>> _ = graph.add(Between(x[0], x[1], [1.0, 0.2, 0.5], Diagonal([0.1, 0.1, 0.01])))
    >>> graph.optimize(Values({x: (SE2, [[0, 0, 0], [0, 0, 0]])})).values[x[1]].round(6)
    array([1. , 0.2, 0.5])
    """

    slots = (None, None)
    relative = along_world = True
    frame = "first"

    def __init__(self, i: Keys, j: Keys, z: npt.ArrayLike, noise: Noise, convention: str = "log") -> None:
        super().__init__([i, j], z, noise, convention)
        self.framed = convention == "g2o" and type(self).predict is Between.predict

    def knows_axes(self, manifolds: tuple[Manifold | None, ...]) -> bool:
        return super().knows_axes(manifolds) and bool(self.z.any())  # a difference of 0 has no direction

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        if manifolds[0] is not manifolds[1]:
            raise GraphError(f"{self!r} connects {manifolds[0]} and {manifolds[1]}; both must be in the same group")
        if not isinstance(manifolds[0], LieGroup):
            raise GraphError(f"{self!r}: {manifolds[0]} is no group, so it has no differences of elements")
        return manifolds[0]

    def noise_sizes(self) -> tuple[int, ...]:
        return numbers_of_z(self)

    def relative_poses(self, model: Model) -> Array:
        return model.z

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group = manifolds[0]
        assert isinstance(group, LieGroup)
        h = group.between(*X)
        return h, (-group.adjoint_inverse(h), None)

    def innovation(self, model: Model, X: tuple[Array, ...], jacobians: bool = True) -> tuple[Array, tuple[Array, ...]]:
        group = model.space
        assert isinstance(group, LieGroup)
        if not self.framed or group.flat:
            return super().innovation(model, X, jacobians)
        off, J = group.misfit(group.framed(X[0]), group.framed(X[1]), model.framed_z, jacobians)
        return -off, () if J is None else (J[..., : group.dim], J[..., group.dim :])

    def relinearize(self, model: Model, X: Sequence[Array], A: Array) -> Array | None:
        if type(self) is not Between or not self.framed or model.space not in (SE2, SE3):
            return None  # a subclass may have its own innovation
        if model.space is SE3:
            off, J = SE3.misfit(X[0], X[1], model.framed_z)
            A[...] = whiten(model.W, np.asarray(J))
            return -off
        (xi, yi, _, ci, si), (xj, yj, _, cj, sj) = map(components, X)
        dx, dy = xj - xi, yj - yi
        x, y = ci * dx + si * dy, ci * dy - si * dx
        c, s = ci * cj + si * sj, ci * sj - si * cj
        for a in A.transpose(1, 2, 0):  # W R(z)' [-I, (y, -x) | R, 0] + W [0, -1 | 0, 1]: its columns 2 to 4 change
            u, v = a[:2].copy()
            a[2:5] = v * x - u * y - a[5], -u * c - v * s, u * s - v * c
        return -SE2.misfit(X[0], X[1], model.framed_z, jacobians=False)[0]
