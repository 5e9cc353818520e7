"""The odometry of a vehicle on two wheels or tracks, as its encoders count it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians, Model
from factors.keys import Keys
from factors.noise import Noise
from models import SE2, Manifold, Measured
from models.algebra import Array, components, pack
from models.vehicles import wheel_travel
from models.vehicles.differential_drive import check_base

__all__ = ["Wheels"]


class Wheels(Factor):
    r"""Travel of the right and of the left wheel from pose i to pose j, and no slip across.

    .. math:: h(X_i, X_j) = (s + b\,\varphi, \; s - b\,\varphi, \; t), \quad (s, t) = R(-\varphi)\,(d_x, d_y),

    .. math:: (d_x, d_y, 2 \varphi) = X_i^{-1} X_j

    Parameters
    ----------
    i, j : the poses, SE2; x ahead, y to the *left*.
    z : (n, 2) travel of the right and of the left wheel, m, negative backwards; (n, 3) where the slip across, along y,
        is measured too.
    noise : of ``right``, ``left`` and ``lateral`` (the slip across, taken for measured as 0), m; sigmas that grow
        with the way are those of `models.vehicles.travel_sigmas`.
    base : distance of the wheels, m.

    Raises
    ------
    GraphError
        Variables not in SE2; z of the wrong shape.
    OptionError
        A base that is not above 0.

    Notes
    -----
    Encoders give two numbers of three: without the third, across, nothing would hold the vehicle on its heading. Its
    sigma is what wheels slip in a step; `z` of the factor has it as a third column of zeros. Travel is taken for the
    chord of the step, which is shorter than the arc by 1/24 of the squared angle. A step turns by less than 180 deg.
    R. Siegwart, I. Nourbakhsh, D. Scaramuzza, Introduction to Autonomous Mobile Robots, 2011, section 5.2.4.

    Examples
    --------
    >>> from factors import Diagonal, Wheels
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Wheels(x[0], x[1], [1.1, 0.9], Diagonal(right=0.01, left=0.01, lateral=0.001), base=0.5)])
    >>> graph.optimize(Values({x: (SE2, SE2.identity(2))})).values[x[1]].round(4)
    array([0.9801, 0.1987, 0.4   ])
    """

    slots = (SE2, SE2)
    relative = True

    def __init__(self, i: Keys, j: Keys, z: npt.ArrayLike, noise: Noise, base: float) -> None:
        super().__init__([i, j], z, noise)
        self.base = check_base("Wheels: base", base)
        if self._z.ndim not in (1, 2) or self._z.shape[-1] not in (2, 3):
            raise self._refusal(
                f"z has shape {self._z.shape}, expected (n, 2): travel of the right and of the left wheel"
            )
        if self._z.shape[-1] == 2:
            self._z = np.concatenate([self._z, np.zeros((*self._z.shape[:-1], 1))], axis=-1)
            self._z.setflags(write=False)

    def sizes(self) -> tuple[int, ...]:
        return (3,)

    def noise_sizes(self) -> tuple[int, ...]:
        return self.sizes()

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("right", "left", "lateral")

    def relative_poses(self, model: Model) -> Array:
        right, left, t = components(model.z)
        s, phi = (right + left) / 2, (right - left) / (2 * self.base)
        cos, sin = np.cos(phi), np.sin(phi)
        return pack([s * cos - t * sin, s * sin + t * cos, 2 * phi])

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        X_i, X_j = X
        return wheel_travel(X_i, X_j, self.base)
