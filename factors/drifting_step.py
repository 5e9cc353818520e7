"""The step of a vehicle whose reckoned speed drifts: by a current, by a propeller that is not calibrated."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.constants import constant
from factors.keys import Keys
from factors.noise import Noise
from models import SE2, Manifold, Measured, R
from models.algebra import Array, wrap

__all__ = ["DriftingStep"]


class DriftingStep(Factor):
    r"""Step from pose i to pose j in the plane, off by a drift d for every meter of the reckoned way.

    .. math:: h(X_i, X_j, d) = \bigl(p + L\,d, \; \psi_j - \psi_i\bigr), \quad p = R(\psi_i)^T (t_j - t_i)

    .. math:: H_i = \begin{pmatrix} -I & (p_y, -p_x)^T \\ 0 & -1 \end{pmatrix}, \quad
              H_j = \begin{pmatrix} R(\psi_j - \psi_i) & 0 \\ 0 & 1 \end{pmatrix}, \quad
              H_d = \begin{pmatrix} L\,I \\ 0 \end{pmatrix}

    Parameters
    ----------
    i, j : the poses, SE2.
    drift : d in R(2), ahead and to the side: 0.1 ahead where 1.1 m are reckoned on a way of 1 m.
    z : (n, 3) reckoned x and y, m, and yaw, rad, in the frame of pose i.
    noise : of x, y (m) and yaw (rad), without the drift.
    length : (n,) length L of the reckoned way, m; of z when omitted.

    Raises
    ------
    GraphError
        Variables in other spaces; z of another shape; lengths that are not one number from 0 for every step.

    Notes
    -----
    A drift that is shared by the steps of a stretch makes their errors correlated. Those of a current or of a commanded
    speed are such errors. The uncertainty grows with the way instead of its root. S. Thrun, W. Burgard, D. Fox,
    Probabilistic Robotics, 2005, section 5.4 (odometry), with a bias as a state.

    Examples
    --------
    >>> from factors import DriftingStep, Isotropic, Prior
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, d = kinds("x", "d")
    >>> step = DriftingStep(x[0], x[1], d[0], [11.0, 0.0, 0.0], Isotropic(0.1), length=[10.0])
    >>> fix = Prior(x[1], [10.0, -1.0, 0.0], Isotropic(0.1))
    >>> values = Values({x: (SE2, SE2.identity(2)), d: (R(2), [[0.0, 0.0]])})
    >>> FactorGraph([step, fix], [x[0]]).optimize(values).values[d[0]].round(4)
    array([0.1, 0.1])
    """

    slots = (SE2, SE2, R(2))
    relative = True
    unmoved = (2,)
    frame = "first"
    per_measurement = ("length",)

    def __init__(
        self, i: Keys, j: Keys, drift: Keys, z: npt.ArrayLike, noise: Noise, length: npt.ArrayLike | None = None
    ) -> None:
        super().__init__([i, j, drift], z, noise)
        if self._z.ndim not in (1, 2) or self._z.shape[-1] != 3:
            raise self._refusal(f"z has shape {self._z.shape}, expected (n, 3): x, y, m, and yaw, rad")
        ways = np.linalg.norm(np.atleast_2d(self._z)[:, :2], axis=1)
        ways = np.repeat(ways, len(self)) if len(ways) == 1 else ways  # one step that all measured
        self.length = constant(self, "length", ways if length is None else length)
        if self.length.shape != (len(self),) or not (np.isfinite(self.length) & (self.length >= 0)).all():
            raise self._refusal(f"lengths of shape {self.length.shape}, expected ({len(self)},), numbers from 0")

    def sizes(self) -> tuple[int, ...]:
        return (3,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("x", "y", "yaw")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        X_i, X_j, d = X
        (cos, sin), (dx, dy) = (np.cos(X_i[:, 2]), np.sin(X_i[:, 2])), (X_j[:, :2] - X_i[:, :2]).T
        p_x, p_y, turn = cos * dx + sin * dy, cos * dy - sin * dx, wrap(X_j[:, 2] - X_i[:, 2])
        h = np.column_stack([p_x, p_y, turn])
        h[:, :2] += self.length[:, None] * d
        H_i, H_j, H_d = (np.zeros((len(h), 3, columns)) for columns in (3, 3, 2))
        H_i[:, [0, 1, 2], [0, 1, 2]] = -1.0
        H_i[:, 0, 2], H_i[:, 1, 2] = p_y, -p_x
        H_j[:, 0, 0] = H_j[:, 1, 1] = np.cos(turn)
        H_j[:, 1, 0] = np.sin(turn)
        H_j[:, 0, 1] = -H_j[:, 1, 0]
        H_j[:, 2, 2] = 1.0
        H_d[:, 0, 0] = H_d[:, 1, 1] = self.length
        return h, (H_i, H_j, H_d)
