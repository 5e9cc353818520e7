r"""Inverting blocks of information that may be singular, without inventing anything where they say nothing.

    H = sum_k w_k v_k v_k',      H^+ = sum over w_k > max(tau w_max, floor) of v_k v_k' / w_k

Put in the place of H_ll^-1 when landmarks l are eliminated from the poses p,

    S = H_pp - H_pl H_ll^+ H_lp,   g_S = g_p - H_pl H_ll^+ g_l,   D_p = S^-1 g_S,   D_l = H_ll^+ (g_l - H_lp D_p),

it gives the step of least |A D - b| among those in which no landmark moves along a direction left out. V are the
directions kept, D_l = V y: V'H_ll V is regular and H_ll^+ = V (V'H_ll V)^-1 V'. Along a direction that is *free*, A_l v
= 0, nothing is lost and S is exact. One that is only *weak* is taken for known, so its information goes to the poses.
So `floor` leaves out directions that the measurements see worse than they are known without them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import OptionError
from models.options import is_number

__all__ = ["truncated_inverse"]


def truncated_inverse(H: npt.ArrayLike, tau: float = 1e-3, floor: npt.ArrayLike = 0.0) -> Array:
    """Inverse of symmetric blocks on the directions they say something about, zero on the others.

    Parameters
    ----------
    H : (..., d, d) information, of whitened Jacobians, in units in which its directions compare (a point: 1/m^2).
    tau : directions with at most this part of the largest eigenvalue are left out.
    floor : (...) those of at most this information are left out as well: 1 / (m known anyway)^2.

    Returns
    -------
    (..., d, d) array: the inverse where nothing is left out, zeros where all is.

    Raises
    ------
    OptionError
        A tau not in [0, 1), a floor that is negative.

    Notes
    -----
    A relative threshold on whitened Jacobians does not depend on how many measurements there are; a bound on the
    eigenvalues of unwhitened ones does, and on the units. J. Zhang, M. Kaess, S. Singh, "On degeneracy of
    optimization-based state estimation problems", ICRA 2016, leave such directions out of the solution.

    Examples
    --------
    >>> import numpy as np
    >>> truncated_inverse(np.diag([4.0, 2.0, 1e-6]))
    array([[0.25, 0.  , 0.  ],
           [0.  , 0.5 , 0.  ],
           [0.  , 0.  , 0.  ]])
    """
    if not is_number(tau) or not 0 <= tau < 1:
        raise OptionError("tau", tau, "a number of at least 0 and below 1, such as 1e-3")
    if not (np.asarray(floor) >= 0).all():
        raise OptionError("floor", floor, "information of at least 0")
    w, V = np.linalg.eigh(np.asarray(H, dtype=float))
    mask = (w > tau * w[..., -1:]) & (w > np.asarray(floor)[..., None])
    inverse = np.where(mask, 1 / np.where(mask, w, 1.0), 0.0)
    return np.asarray((V * inverse[..., None, :]) @ V.mT)
