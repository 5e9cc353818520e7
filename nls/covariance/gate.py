r"""How far measurements are from what a graph without them predicts.

    nu = z [-] h(X_hat),   S = H Sigma H' + R,   d2 = nu' S^-1 nu  =  b' (A Sigma A' + I)^-1 b      (A, b whitened)

Sigma is that of the variables of one measurement. A few measurements are asked for together, as their columns are.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from models.algebra import Array, Index, congruence
from models.chi_squared import innovation_distances
from nls.covariance.inverse import ONE_BLOCK


class Gate(NamedTuple):
    """Squared Mahalanobis distances d2 (n,) of measurements, and the limit that those of right ones are below."""

    d2: Array
    limit: float


def predicted_distances(A: Sequence[Array], b: Array, columns: Index, covariance: Callable[[Index], Array]) -> Array:
    """Squared Mahalanobis distances (n,) of measurements from their predictions.

    Parameters
    ----------
    A, b : whitened Jacobians (n, m, d_k), one per slot, and innovations (n, m).
    columns : (n, D) those of the variables of each measurement, D the sum of d_k.
    covariance : Sigma (k, k) of so many columns (k,).
    """
    A_i, d2, D = np.concatenate(A, axis=2), np.empty(len(b)), columns.shape[1]
    together = max(ONE_BLOCK // D, 1)
    for begin in range(0, len(b), together):
        rows = slice(begin, begin + together)
        n = len(b[rows])
        P = covariance(columns[rows].reshape(-1)).reshape(n, D, n, D)[np.arange(n), :, np.arange(n), :]
        d2[rows] = innovation_distances(b[rows], congruence(A_i[rows], P))
    return d2
