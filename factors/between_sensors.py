"""The measured difference of two poses, made by sensors that are not at the origin of the vehicle's frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians, Model
from factors.keys import Keys
from factors.mount import check_offset, fixed_offset
from factors.noise import Noise
from factors.noise_size import numbers_of_z
from models import LieGroup, Manifold
from models.algebra import Array, product
from models.errors import GraphError

__all__ = ["BetweenSensors"]


class BetweenSensors(Factor):
    r"""Sensor j as seen from sensor i: scan matches and visual odometry in the frame of the sensor.

    .. math:: h = (X_i \circ O_i)^{-1} (X_j \circ O_j), \quad
              H_i = -\mathrm{Ad}_h^{-1} \mathrm{Ad}_{O_i}^{-1}, \quad H_j = \mathrm{Ad}_{O_j}^{-1}, \quad
              H_O = I - \mathrm{Ad}_h^{-1}

    Parameters
    ----------
    i, j : the vehicles, in one group: SE2, SE3, ...
    z : (n, size) measured differences in the stored form of the group.
    noise : in the frame of sensor j as predicted (for the convention ``g2o``: of the measurement).
    offset : where the sensors sit on the vehicles: a pair (O_i, O_j) of poses, each (size,) or (n, size); or one
        variable of the group that is both (H_O above).
    convention : ``log`` (default), ``g2o``, ``graphslam`` or ``gtsam``, see `factors.conventions`.

    Raises
    ------
    GraphError
        Variables of several spaces; offsets that do not fit.

    Notes
    -----
    The gauge is that of `Between`. Only turns calibrate a variable offset, and one turn leaves free what commutes with
    it. There have to be turns about two centers (plane) or two axes (space). K. Daniilidis, "Hand-eye calibration using
    dual quaternions", 1999.

    Examples
    --------
    >>> from factors import BetweenSensors, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> bow, keel = [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    >>> graph = FactorGraph([BetweenSensors(x[0], x[1], [1.0, 0.0, 0.0], Isotropic(0.1), (bow, keel))])
    >>> graph.optimize(Values({x: (SE2, [[0, 0, 0], [0, 0, 0]])})).values[x[1]].round(6)
    array([3., 0., 0.])
    """

    relative = along_world = True
    frame = "first"
    per_measurement = ("offset",)

    def __init__(
        self,
        i: Keys,
        j: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        offset: tuple[npt.ArrayLike, npt.ArrayLike] | Keys,
        convention: str = "log",
    ) -> None:
        keys = [i, j, offset] if isinstance(offset, Keys) else [i, j]
        super().__init__(keys, z, noise, convention)
        self.slots, self.unmoved = (None,) * len(keys), tuple(range(2, len(keys)))
        self.offset: tuple[Array, Array] | Keys
        if isinstance(offset, Keys):
            self.offset = self.keys[2]
        elif isinstance(offset, tuple | list) and len(offset) == 2:
            self.offset = fixed_offset(self, offset[0]), fixed_offset(self, offset[1])
        else:
            raise GraphError(
                f"{self!r}: expected a pair of offsets or one variable, got {offset!r:.60}", keys, self.name
            )

    def knows_axes(self, manifolds: tuple[Manifold | None, ...]) -> bool:
        O_i, O_j = (0.0, 0.0) if isinstance(self.offset, Keys) else self.offset  # one offset of both cancels
        return super().knows_axes(manifolds) and bool(np.any(self.z + O_i - O_j))  # a difference of 0 has no direction

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        group = manifolds[0]
        if manifolds[1] is not group or not isinstance(group, LieGroup):
            raise GraphError(
                f"{self!r} connects {group} and {manifolds[1]}; both must be in the same group", self.keys, self.name
            )
        for offset in [self.offset] if isinstance(self.offset, Keys) else self.offset:
            check_offset(self, offset, group, manifolds[-1])
        return group

    def noise_sizes(self) -> tuple[int, ...]:
        return numbers_of_z(self)

    def relative_poses(self, model: Model) -> Array | None:
        group = model.manifolds[0]
        if isinstance(self.offset, Keys):  # known by its estimate alone
            return None
        assert isinstance(group, LieGroup)
        return group.compose(group.compose(self.offset[0], model.z), group.inverse(self.offset[1]))

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group = manifolds[0]
        assert isinstance(group, LieGroup)
        O_i, O_j = (X[2], X[2]) if isinstance(self.offset, Keys) else self.offset
        h = group.between(group.compose(X[0], O_i), group.compose(X[1], O_j))
        Ad_h_inv = group.adjoint_inverse(h)
        H_i, H_j = -product(Ad_h_inv, group.adjoint_inverse(O_i)), group.adjoint_inverse(O_j)
        if isinstance(self.offset, Keys):
            return h, (H_i, H_j, np.eye(group.dim) - Ad_h_inv)
        return h, (H_i, H_j)
