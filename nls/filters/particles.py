r"""A cloud of weighted elements of a manifold: mean, covariance, and drawing anew.

    mean         sum_k w_k local(mean, X_k) = 0            headings on the circle, whatever side of +-pi they are on
    covariance   sum_k w_k e_k e_k',  e_k = local(mean, X_k)
    effective    1 / sum w_k^2

Sources: R. Hartley et al., "Rotation averaging", IJCV 2013, section 5 (the mean); G. Kitagawa, "Monte Carlo filter and
smoother for non-Gaussian nonlinear state space models", 1996 (systematic resampling); S. Thrun, W. Burgard, D. Fox,
Probabilistic Robotics, 2005, table 4.4.
"""

from __future__ import annotations

import numpy as np

from models import Manifold
from models.algebra import Array, Index

__all__ = ["covariance", "effective", "mean", "normalized_weights", "systematic"]

MOST = 30  # steps of the mean: it settles in 3 to 5 unless the elements are spread around the circle


def normalized_weights(log_w: Array) -> Array:
    """Weights (N,) that add up to 1, from their logarithms up to a constant.

    Examples
    --------
    >>> import numpy as np
    >>> normalized_weights(np.array([-2000.0, -2000.0, -np.inf]))
    array([0.5, 0.5, 0. ])
    """
    w = np.exp(log_w - log_w.max())
    return np.asarray(w / w.sum())


def effective(w: Array) -> float:
    """How many equal weights say as much as these do, 1 to N.

    Examples
    --------
    >>> import numpy as np
    >>> effective(np.array([0.5, 0.5, 0.0]))
    2.0
    """
    return float(1 / np.square(w).sum())


def systematic(w: Array, rng: np.random.Generator) -> Index:
    """Which particle each new one descends from, (N,): weight k has N w_k descendants, rounded up or down.

    Examples
    --------
    >>> import numpy as np
    >>> systematic(np.array([0.5, 0.0, 0.25, 0.25]), np.random.default_rng(1))
    array([0, 0, 2, 3])
    """
    N = len(w)
    below = np.cumsum(w)
    below[-1] = 1.0  # rounding must leave nobody above the last
    return np.searchsorted(below, (rng.random() + np.arange(N)) / N, side="right")


def mean(manifold: Manifold, X: Array, w: Array) -> Array:
    """Weighted mean (m, size) of clouds X (N, m, size) with weights w (N,).

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2
    >>> mean(SE2, np.array([[[0.0, 0.0, 3.0]], [[2.0, 0.0, -3.0]]]), np.array([0.5, 0.5]))[0, 2] + np.pi
    np.float64(0.0)
    """
    center: Array = X[int(np.argmax(w))].copy()
    for _ in range(MOST):
        step = np.einsum("n,nmd->md", w, manifold.local(np.broadcast_to(center, X.shape), X))
        center = manifold.retract(center, step)
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    return center


def covariance(manifold: Manifold, center: Array, X: Array, w: Array) -> Array:
    """Weighted second moment (m, d, d) about the center (m, size), in the tangent space there."""
    e = manifold.local(np.broadcast_to(center, X.shape), X)
    return np.asarray(np.einsum("n,nmi,nmj->mij", w, e, e))
