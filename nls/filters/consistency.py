r"""Whether an estimator is as good as it says: errors in units of the covariance it reports.

    NEES = e' P^-1 e,   e = X_hat^-1 X   (the tangent step from the estimate to the truth, angles wrapped)

Of a consistent estimator it is chi-squared with as many degrees of freedom d as the pose has, so d in the mean. Over N
independent runs the mean is within chi2_(Nd)(0.025) / N and chi2_(Nd)(0.975) / N in 95 % of all cases. Above: it
believes more than it knows.

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4.2.
"""

from __future__ import annotations

import numpy as np

from factors.keys import Keys
from models import Manifold
from models.algebra import Array, Mask
from models.errors import UnderconstrainedError
from nls.analysis.chi_squared import chi2_gate

__all__ = ["nees", "nees_bounds", "regular"]

SINGULAR = 1e-12  # of a correlation matrix: the rounding of what was subtracted from it


def nees_bounds(dim: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Within which the mean NEES over independent runs stays with this probability, for a consistent estimator.

    Parameters
    ----------
    dim : degrees of freedom of a pose.
    runs : how many independent runs the mean is over; the steps of one run are not independent.
    probability : between 0 and 1.

    Examples
    --------
    >>> [round(bound, 2) for bound in nees_bounds(3, runs=200)]
    [2.67, 3.35]
    """
    outside = (1 - probability) / 2
    low, high = (chi2_gate(dim * runs, p) / runs for p in (outside, 1 - outside))
    return low, high


def nees(keys: Keys, manifold: Manifold, X: Array, P: Array, truth: Array) -> Array:
    """e' P^-1 e of every estimate, e the tangent step from the estimate to the truth.

    Parameters
    ----------
    keys : the n variables, for the message.
    manifold : their space.
    X, P : (n, size) estimates and (n, d, d) their covariances in the tangent space at the estimate.
    truth : (n, size).

    Returns
    -------
    (n,) array.

    Raises
    ------
    UnderconstrainedError
        A covariance that is singular or not positive: errors have no size in its units.

    Examples
    --------
    >>> from models import SE2
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> P = np.diag([0.01, 0.01, 0.04])[None]
    >>> nees(x[[7]], SE2, np.array([[0.0, 0.0, -3.1]]), P, np.array([[0.1, 0.0, 3.1]])).round(1)
    array([1.2])
    """
    values, vectors, scale = _spectra(P)
    if (bad := ~(values[:, 0] > SINGULAR)).any():
        raise UnderconstrainedError(
            f"NEES of {keys[[int(np.argmax(bad))]]}: its covariance is singular, errors have no size in its units; a "
            "particle filter needs more particles than unknowns that differ, and a start a sigma above 0",
            [keys[[int(np.argmax(bad))]]],
        )
    along = np.matvec(vectors.mT, manifold.local(X, truth) / scale)
    return np.asarray((np.square(along) / values).sum(axis=1))


def regular(P: Array) -> Mask:
    """Which covariances (n, d, d) give errors a size: those that are finite, positive and not singular, (n,).

    Examples
    --------
    Of a cloud of two particles the covariance has rank 1, of one it is 0:

    >>> e = np.array([[1.0, 2.0, 0.1]])
    >>> regular(np.stack([np.eye(3), e.T @ e, np.zeros((3, 3))]))
    array([ True, False, False])
    """
    return np.asarray(_spectra(P)[0][:, 0] > SINGULAR)


def _spectra(P: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues (n, d) and vectors of the correlation matrices, and sigmas (n, d); nan where P is no covariance."""
    valid = np.logical_and(np.isfinite(P).all(axis=(1, 2)), (np.diagonal(P, axis1=1, axis2=2) > 0).all(axis=1))
    P = np.where(valid[:, None, None], P, np.eye(P.shape[-1]))
    scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))  # meters and radians do not decide what is singular
    values, vectors = np.linalg.eigh(P / (scale[:, :, None] * scale[:, None, :]))
    return np.where(valid[:, None], values, np.nan), vectors, scale
