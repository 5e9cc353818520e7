"""The step of a vehicle that knows its depth and tilt: ahead, to starboard, and turned (x, y, heading)."""

from __future__ import annotations

from collections.abc import Callable

import numpy.typing as npt

from factors.base import Factor, Jacobians, Model
from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from models import SE3, Manifold, Measured
from models.algebra import Array
from models.errors import OptionError
from models.sensors import levelled, relative_xyh

__all__ = ["XYH"]

FORMS: dict[str, Callable[[Array, Array], tuple[Array, tuple[Array, Array]]]] = {
    "levelled": levelled,
    "relative": relative_xyh,
}


class HorizontalStep(Factor):
    """A measured step of a pose in the horizontal: x ahead and y to starboard, m, and yaw, rad."""

    frame = "first"

    def sizes(self) -> tuple[int, ...]:
        return (3,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("x", "y", "yaw")

    def level_steps(self, model: Model) -> Array:
        return model.z


class XYH(HorizontalStep):
    r"""Step from pose i to pose j in the horizontal: the odometry of a vehicle with a depth sensor and a tilt sensor.

    .. math:: h(X_i, X_j) = \bigl( [R_z(\psi_i)^T (t_j - t_i)]_{xy}, \; \psi_j - \psi_i \bigr)

    with :math:`\psi` the yaw of R = Rz(yaw) Ry(pitch) Rx(roll).

    Parameters
    ----------
    i, j : the poses, SE3.
    z : (n, 3) measured x ahead and y to starboard, m, and yaw, rad.
    noise : of x, y (m) and yaw (rad), along the measured axes.
    form : ``levelled`` (default), in the horizontal axes of pose i, as above; ``relative``: the components x, y and yaw
        of X_i^-1 X_j, in its tilted axes.

    Raises
    ------
    GraphError
        Variables not in SE3; z of the wrong shape.
    OptionError
        No such form.
    SingularGeometryError
        At evaluation: a pose (``relative``: the relative pose) at gimbal lock, pitch = +-90 deg.

    Notes
    -----
    Says nothing of z, pitch and roll, which `ZPR` measures; with that one, x, y and yaw of one pose are the gauge. Hold
    it by a `Position` and a `Heading`, which are in world axes as these are. x and y of a `Prior` are along the axes of
    the body. The two forms differ by about sin(tilt) dz + (1 - cos(tilt)) times the step. Level steps of 1 m differ by
    4 mm at 5 deg and by 60 mm at 20 deg. J. Diebel, "Representing attitude", 2006, for the angles.

    Examples
    --------
    >>> from factors import XYH, ZPR, Diagonal, Heading, Isotropic, Position
    >>> from models import SE3, euler
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> here = Position(x[0], [0.0, 0.0], Isotropic(0.01), components=("x", "y"))
    >>> north = Heading(x[0], 0.0, Isotropic(0.001))
    >>> step = XYH(x[0], x[1], [1.0, 0.2, 0.5], Diagonal(x=0.01, y=0.01, yaw=0.004))
    >>> tilt = ZPR(x[[0, 1]], [[5.0, 0.1, 0.0], [5.5, 0.2, -0.1]], Diagonal(z=0.01, pitch=0.002, roll=0.002))
    >>> result = FactorGraph([here, north, step, tilt]).optimize(Values({x: (SE3, SE3.identity(2))}))
    >>> euler.from_se3(result.values[x[1]]).round(6)  # roll, pitch, yaw, x, y, z
    array([-0.1,  0.2,  0.5,  1. ,  0.2,  5.5])
    """

    slots = (SE3, SE3)

    def __init__(self, i: Keys, j: Keys, z: npt.ArrayLike, noise: Noise, form: str = "levelled") -> None:
        if not isinstance(form, str) or form not in FORMS:
            raise OptionError("XYH: form", form, "levelled or relative")
        super().__init__([i, j], z, noise)
        self.form = form
        self.relative = form == "relative"  # a tilted world has another horizontal

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        with named_singularity(self):
            return FORMS[self.form](*X)
