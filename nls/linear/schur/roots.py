"""Roots X of the inverses of a stack of blocks, X'X = H^-1: exact, or of what is to be taken for the inverse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models.algebra import Array
from models.errors import OptionError
from nls.linear.singular import SINGULAR, SingularSystemError

__all__ = ["BlockInverse", "cholesky_root", "inverse_root", "missing_directions"]

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
