"""The step of a vehicle by a DVL whose scale and mounting angle are not known exactly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Jacobians
from factors.constants import constant
from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from factors.xyh import HorizontalStep
from models import SE3, Manifold, R
from models.algebra import Array
from models.sensors import levelled

__all__ = ["DvlLeg"]


class DvlLeg(HorizontalStep):
    r"""Horizontal step from pose i to pose j, as `XYH`, by a DVL with a scale error s, turned by an angle a.

    .. math:: h(X_i, X_j, s, a) = h_{XYH}(X_i, X_j) + \bigl(w(s_0, a_0) - w(s, a), \; 0\bigr), \quad
              w(s, a) = \frac{1 + s_0}{1 + s} \bigl(\cos(a - a_0)\,p + \sin(a - a_0)\,q + u\bigr)

    The DVL reads :math:`(1 + s) R_z(a)^T` times the velocity along the axes of its mounting. The step z was integrated
    with :math:`s_0, a_0`, and w is the part of it that comes from the readings; with s and a it would have been
    :math:`z + w(s, a) - w(s_0, a_0)`. In a level vehicle, :math:`q = R_z(90^\circ) p` and u = 0: x and y of the leg
    are :math:`(1 + s) R_z(a)^T` of the true ones.

    Parameters
    ----------
    i, j : the poses, SE3.
    z : (n, 3) measured x ahead and y to starboard, m, and yaw, rad, integrated with `at`.
    noise : of x, y (m) and yaw (rad), along the measured axes.
    ways : (n, 3, 2) p, q and u, each x and y of a step, m. p is by the velocities ahead and to starboard alone. q is by
        the same turned by 90 deg to starboard, u by the velocity downwards alone. All are without the way that the
        lever arm of the DVL adds.
    scale : the scale error s in R(1), a fraction; None where it is as in `at`.
    yaw : the angle a in R(1), rad; None where it is as in `at`.
    at : s_0 and a_0.

    Raises
    ------
    GraphError
        Variables in other spaces; z or ways of the wrong shape.
    SingularGeometryError
        At evaluation: a pose at gimbal lock, pitch = +-90 deg.

    Notes
    -----
    Exact in s and a, whatever the tilt and the lever arm, as a leg is linear in the velocities. A straight way without
    other measurements of the position determines neither. The angle turns the whole track as a declination does:
    positions determine the sum of both. J. Kinsey, L. Whitcomb, "Adaptive identification on the group of rigid-body
    rotations and its application to underwater vehicle navigation", IEEE Transactions on Robotics 23(1), 2007.

    Examples
    --------
    A level leg of 100 m by a DVL that reads 2 % too much, between two known places:

    >>> from factors import ZPR, DvlLeg, Isotropic, Position
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, s = kinds("x", "s")
    >>> fix = Position(x[1], [100.0, 0.0, 5.0], Isotropic(0.1))
    >>> tilt = ZPR(x[1], [5.0, 0.0, 0.0], Isotropic(0.01))
    >>> leg = DvlLeg(x[0], x[1], [102.0, 0.0, 0.0], Isotropic(0.1), [[[102.0, 0], [0, 102.0], [0, 0]]], scale=s[0])
    >>> values = Values({x: (SE3, SE3.identity(2)), s: (R(1), [0.0])})
    >>> FactorGraph([fix, tilt, leg], [x[0]]).optimize(values).values[s[0]].round(4)
    array([0.02])
    """

    slots: tuple[Manifold | None, ...] = (SE3, SE3)
    per_measurement = ("ways", "scale", "yaw")
    shared = ("at",)

    def __init__(
        self,
        i: Keys,
        j: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        ways: npt.ArrayLike,
        scale: Keys | None = None,
        yaw: Keys | None = None,
        at: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        calibrations = [key for key in (scale, yaw) if key is not None]
        super().__init__([i, j, *calibrations], z, noise)
        own = iter(self.keys[2:])
        self.scale, self.yaw = (None if key is None else next(own) for key in (scale, yaw))
        self.slots = (SE3, SE3, *[R(1)] * len(calibrations))
        self.unmoved = tuple(range(2, len(self.slots)))
        self.ways, self.at = constant(self, "ways", ways), (float(at[0]), float(at[1]))
        if self.ways.shape != (len(self), 3, 2) or not np.isfinite(self.ways).all():
            raise self._refusal(f"its ways have shape {self.ways.shape}, expected finite numbers ({len(self)}, 3, 2)")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        with named_singularity(self):
            h, (H_i, H_j) = levelled(X[0], X[1])
        calibrations, (s_0, a_0) = iter(X[2:]), self.at
        s = s_0 if self.scale is None else next(calibrations)  # (n, 1)
        a = a_0 if self.yaw is None else next(calibrations)
        p, q, u = self.ways.transpose(1, 0, 2)  # (n, 2) each
        ratio, cos, sin = (1 + s_0) / (1 + s), np.cos(a - a_0), np.sin(a - a_0)
        w = ratio * (cos * p + sin * q + u)
        h[:, :2] += p + u - w
        H = {"scale": w / (1 + s), "yaw": ratio * (sin * p - cos * q)}  # of -w
        columns = (np.pad(H[name], ((0, 0), (0, 1)))[:, :, None] for name in H if getattr(self, name) is not None)
        return h, (H_i, H_j, *columns)
