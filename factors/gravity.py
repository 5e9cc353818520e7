"""The direction of gravity: roll and pitch, as accelerometers and inclinometers measure them without drift."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.constants import constant
from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from models import S2, SE3, SO3, LieGroup, Manifold
from models.algebra import Array
from models.sensors import gravity
from models.sensors.singular import refuse

__all__ = ["Gravity"]


class Gravity(Factor):
    r"""Direction of gravity in the axes of the vehicle: its roll and pitch, whatever its yaw.

    .. math:: h(X) = R^T g, \quad z \boxminus h = B_z^T \, \frac{\alpha}{\sin \alpha} \, (z \times h), \quad
              H = [0, B_h^T]

    with :math:`\alpha` the angle between z and h, and B two axes across z; where the vehicle is level, its x and y.

    Parameters
    ----------
    pose : the vehicle(s), SE3, or attitudes, SO3.
    z : (n, 3) measured directions of gravity along the axes of the body, of any length. A resting accelerometer feels
        the opposite: give minus its accelerations.
    noise : of roll and pitch, rad: the turns about the two axes B.
    down : direction of gravity in the world, (3,); (0, 0, -1) where z of the world is up.

    Raises
    ------
    GraphError
        A variable neither in SE3 nor in SO3; z of the wrong shape, or of length 0.
    SingularGeometryError
        At evaluation: z is opposite to its prediction, where no turn is shorter than all others.

    Notes
    -----
    Says nothing of the position and the yaw. `ZPR` measures depth, pitch and roll as Euler angles, with gimbal lock;
    this factor has none. An accelerometer measures gravity while the vehicle does not accelerate: an acceleration of
    0.1 m/s^2 is an error of 0.01 rad. It is the attitude factor of GTSAM, whose residual is the sine of the angle.
    F. Dellaert, M. Kaess, "Factor graphs for robot perception", 2017, chapter 6, for residuals on manifolds.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Gravity, Heading, Isotropic, Position
    >>> from models import SE3, euler
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> accelerations = np.array([0.98, -1.95, -9.56])  # m/s^2, at rest
    >>> tilt = Gravity(x[0], -accelerations, Isotropic(0.01))
    >>> rest = [Position(x[0], [3.0, 4.0, 7.5], Isotropic(0.1)), Heading(x[0], 0.5, Isotropic(0.01))]
    >>> result = FactorGraph([tilt, *rest]).optimize(Values({x: (SE3, SE3.identity())}))
    >>> euler.from_se3(result.values[x[0]]).round(3)  # roll, pitch, yaw, x, y, z
    array([0.201, 0.1  , 0.5  , 3.   , 4.   , 7.5  ])
    """

    slots = (None,)
    shared = ("down",)

    def __init__(self, pose: Keys, z: npt.ArrayLike, noise: Noise, down: npt.ArrayLike = (0.0, 0.0, 1.0)) -> None:
        super().__init__([pose], z, noise)
        self.down = constant(self, "down", down)

    def sizes(self) -> tuple[int, ...]:
        return (3,)

    def noise_sizes(self) -> tuple[int, ...]:
        return (2,)

    def names(self, space: Manifold) -> tuple[str, ...]:
        return "roll", "pitch"

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        if manifolds[0] not in (SE3, SO3):
            raise self._refusal(f"{self.keys[0][[0]]} is in {manifolds[0]}, expected SE3 or SO3")
        if self.down.shape != (3,) or not self.down.any():
            raise self._refusal(f"down is {self.down.tolist()}, expected a direction of the world such as (0, 0, 1)")
        return S2

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group, z = manifolds[0], np.atleast_2d(self.z)
        assert isinstance(group, LieGroup)
        h, H = gravity(group, X[0], self.down / np.linalg.norm(self.down))
        opposite = (z * h).sum(axis=1) < -(1 - 1e-12) * np.linalg.norm(z, axis=1)
        cure = "an accelerometer at rest measures the opposite direction: give -z; else change the initial attitude"
        with named_singularity(self):
            refuse(opposite, f"its direction is opposite to gravity as predicted; {cure}")
        return h, (H,)
