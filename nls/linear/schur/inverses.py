r"""Roots X of the inverses of a stack of blocks, X'X = H^-1: exact, or of a substitute for the inverse.

`truncated_inverse` is for blocks of information that may be singular. It invents nothing where they say nothing:

    H = sum_k w_k v_k v_k',      H^+ = sum over w_k > max(tau w_max, floor) of v_k v_k' / w_k

Put in the place of H_ll^-1 when landmarks l are eliminated from the poses p,

    S = H_pp - H_pl H_ll^+ H_lp,   g_S = g_p - H_pl H_ll^+ g_l,   D_p = S^-1 g_S,   D_l = H_ll^+ (g_l - H_lp D_p),

it gives the step of least |A D - b| among those in which no landmark moves along a direction left out. V are the
directions kept, D_l = V y: V'H_ll V is regular and H_ll^+ = V (V'H_ll V)^-1 V'. Along a direction that is *free*, A_l v
= 0, nothing is lost and S is exact. One that is only *weak* is taken for known, so its information goes to the poses.
So `floor` leaves out directions that the measurements see worse than they are known without them.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import OptionError
from models.options import is_number
from nls.linear.factorization import SINGULAR, SingularSystemError

BlockInverse = Callable[[Array], Array]
"""Blocks (k, d, d), symmetric, -> their inverses or what stands for them (k, d, d), positive semi-definite."""


def cholesky_root(H: Array) -> tuple[Array, Array, Array]:
    """H = L L' and X = L^-1 of a stack (k, d, d), and the squared pivots (k, d); X'X = H^-1.

    Column by column over the whole stack, whose pivots `numpy.linalg.cholesky` does not tell.

    Raises
    ------
    SingularSystemError
        A pivot vanishes beside its diagonal entry.

    Examples
    --------
    >>> import numpy as np
    >>> L, X, pivots = cholesky_root(np.array([[[4.0, 2.0], [2.0, 2.0]]]))
    >>> L.tolist(), X.tolist(), pivots.tolist()
    ([[[2.0, 0.0], [1.0, 1.0]]], [[[0.5, 0.0], [-0.5, 1.0]]], [[4.0, 1.0]])
    """
    k, d, _ = H.shape
    L, X, pivots = np.zeros((d, d, k)), np.zeros((d, d, k)), np.empty((d, k))
    for j in range(d):
        column = H[:, j:, j].T - np.einsum("ikn,kn->in", L[j:, :j], L[j, :j])
        if not (column[0] > SINGULAR * H[:, j, j]).all():
            raise SingularSystemError("a pivot of A'A vanishes in a variable that is eliminated by itself")
        pivots[j] = column[0]
        L[j:, j] = column / np.sqrt(column[0])
        X[j, :j] = -np.einsum("in,ijn->jn", L[j, :j], X[:j, :j]) / L[j, j]
        X[j, j] = 1 / L[j, j]
    return L.transpose(2, 0, 1), X.transpose(2, 0, 1), pivots.T


def inverse_root(block_inverse: BlockInverse, H: Array) -> Array:
    """X (k, d, d) with X'X = V, the inverses that were given for a stack of blocks.

    Raises
    ------
    OptionError
        V has another shape, is not finite, not symmetric or not positive semi-definite.
    """
    V = np.asarray(block_inverse(H.copy()), dtype=float)
    if V.shape != H.shape or not np.isfinite(V).all():
        raise OptionError("block_inverse", V.shape, f"finite inverses {H.shape}, one for every block")
    size = np.abs(V).max(axis=(1, 2), initial=0.0)[:, None]
    w, Q = np.linalg.eigh(V)
    if (w < -1e-9 * size).any() or (np.abs(V - V.mT).max(axis=2, initial=0.0) > 1e-9 * size).any():
        raise OptionError("block_inverse", "a result", "symmetric positive semi-definite inverses")
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, :, None] * Q.mT)


def missing_directions(X: Array) -> int:
    """How many directions the roots X (k, d, d) of `inverse_root` leave out, all blocks together.

    Examples
    --------
    >>> import numpy as np
    >>> missing_directions(inverse_root(lambda H: H, np.array([np.diag([4.0, 0.0]), np.eye(2), np.zeros((2, 2))])))
    3
    """
    w = np.square(X).sum(axis=2)  # eigenvalues of the inverses
    return int(np.count_nonzero(w <= SINGULAR * w.max(axis=1, initial=0.0)[:, None]))


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
