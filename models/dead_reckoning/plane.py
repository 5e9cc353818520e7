r"""From velocities in the plane, sample by sample, to relative poses SE2 with covariances.

Each sample holds until the next. Over the time dt of one step the vehicle turns and moves evenly:

    T_k+1 = T_k Exp(xi_k),   xi_k = twist_k dt                   exact for constant twist
    z = T_i^-1 T_j                                               a leg, from one boundary to the next
    Sigma = sum over its steps of  A_k A_k' dt,   A_k = Ad(T_k+1^-1 T_j)^-1 J_r(xi_k) S_k

The error of the twist is white noise S e, and every column of S is a source of unit density. Twice as many steps have
twice the variance of the twist. Cutting a leg in two where a step begins changes nothing. Within a step its error is
held. The turn adds to the variance across. In a leg of K equal steps this part is smaller by 1 / (4 K^2) of itself:
25 % with one step, 0.25 % with ten. Errors that last, such as a wheel of another diameter, are no white noise.

Source: T. Barfoot, State Estimation for Robotics, 2017, section 7.3.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models.algebra import Array, gram
from models.dead_reckoning.chain import chain
from models.dead_reckoning.checks import rising, within
from models.dead_reckoning.noise import sum_by_leg
from models.errors import GraphError
from models.finite import finite
from models.manifolds.se2 import SE2

__all__ = ["PlaneLegs", "integrate_plane"]


@dataclass(frozen=True)
class PlaneLegs:
    """Relative poses of the vehicle from each boundary to the next.

    Attributes
    ----------
    t : (k + 1,) boundaries, s.
    z : (k, 3) pose at boundary i + 1 as seen from that at i, SE2.
    Sigma : (k, 3, 3) covariance of (x, y, yaw), the right increment of z, m and rad.
    """

    t: Array
    z: Array = field(repr=False)
    Sigma: Array = field(repr=False)

    def track(self, start: npt.ArrayLike) -> Array:
        """Poses (k + 1, 3) at the boundaries, dead-reckoned from the pose start (3,)."""
        return chain(SE2, SE2.stack(start)[0], self.z)


def integrate_plane(
    t: npt.ArrayLike, twist: npt.ArrayLike, density: npt.ArrayLike, *, boundaries: npt.ArrayLike
) -> PlaneLegs:
    r"""Relative poses between boundaries, from velocities in the axes of the vehicle.

    Parameters
    ----------
    t : (n,) times of the samples, s, rising; each holds until the next.
    twist : (n, 3) velocity ahead and to the left, m/s, and rate of turn, rad/s.
    density : S (n, 3, m) or (3, m), the error of the twist per unit of m independent white noises, m/s/sqrt(Hz) and
        rad/s/sqrt(Hz); all columns together of rank 3 somewhere in each leg, or its Sigma is singular.
    boundaries : (k + 1,) times at which legs begin and end, s, rising, within those of the samples.

    Returns
    -------
    PlaneLegs

    Raises
    ------
    GraphError
        Shapes that do not fit, times that do not rise, numbers that are not finite.

    Examples
    --------
    A quarter of a circle of 2 m in two legs, the rate of turn known to 0.02 rad/s/sqrt(Hz):

    >>> import numpy as np
    >>> S = np.diag([0.1, 0.01, 0.02])
    >>> legs = integrate_plane([0.0, 5.0], [[0.2 * np.pi, 0, 0.1 * np.pi]] * 2, S, boundaries=[0.0, 2.0, 5.0])
    >>> legs.track([0.0, 0.0, 0.0]).round(3) + 0.0
    array([[0.   , 0.   , 0.   ],
           [1.176, 0.382, 0.628],
           [2.   , 2.   , 1.571]])
    >>> np.sqrt(legs.Sigma[:, 2, 2]).round(4)
    array([0.0283, 0.0346])
    """
    t, b = rising("t", t), rising("boundaries", boundaries)
    u, S = finite("integrate_plane", "twist", twist), finite("integrate_plane", "density", density)
    if u.shape != (len(t), 3) or S.ndim < 2 or S.shape[-2] != 3 or S.shape[:-2] not in ((), (len(t),)):
        raise GraphError(f"integrate_plane: twist {u.shape} and density {S.shape}, expected ({len(t)}, 3) and (3, m)")
    within(b, t, "velocities")
    S = np.broadcast_to(S, (len(t), *S.shape[-2:]))

    grid = np.unique(np.concatenate([b, t[(t > b[0]) & (t < b[-1])]]))
    dt, held = np.diff(grid), np.searchsorted(t, grid[:-1], side="right") - 1
    xi = u[held] * dt[:, None]
    T = chain(SE2, SE2.identity()[0], SE2.exp(xi))
    cut, k = np.searchsorted(grid, b), len(b) - 1
    leg = np.repeat(np.arange(k), np.diff(cut))
    to_end = SE2.between(T[1:], T[cut[1:]][leg])
    A = SE2.adjoint_inverse(to_end) @ SE2.jr(xi) @ S[held]
    Sigma = sum_by_leg(dt[:, None, None] * gram(A.mT), leg, k)
    return PlaneLegs(b, SE2.between(T[cut[:-1]], T[cut[1:]]), Sigma)
