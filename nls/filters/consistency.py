r"""Whether an estimator is as good as it says: errors in units of the covariance it reports.

    NEES = e' P^-1 e,   e = X_hat^-1 X   (the tangent step from the estimate to the truth, angles wrapped)
    NIS  = nu' S^-1 nu,   nu the innovation z - h(X_hat), S = H P H' + R its covariance

Of a consistent estimator it is chi-squared with as many degrees of freedom d as the pose has, so d in the mean. Over N
independent runs the mean is within chi2_(Nd)(0.025) / N and chi2_(Nd)(0.975) / N in 95 % of all cases. Above: it
believes more than it knows. The NIS of a measurement of m numbers has m in the place of d, and needs no truth.

Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4.2.
"""

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from models import Manifold
from models.algebra import Array, Mask
from models.chi_squared import chi2_gate
from models.errors import GraphError, UnderconstrainedError
from models.finite import finite


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
    if (bad := ~regular(P)).any():
        key, message = keys[[int(np.argmax(bad))]], "its covariance is singular, errors have no size in its units"
        cure = "a particle filter needs more particles than unknowns that differ, and a start a sigma above 0"
        raise UnderconstrainedError(f"NEES of {key}: {message}; {cure}", [key])
    return _squares(manifold.local(X, truth), P)


def nis(nu: npt.ArrayLike, S: npt.ArrayLike) -> Array:
    """nu' S^-1 nu of every innovation, chi-squared with m degrees of freedom where S is right.

    Parameters
    ----------
    nu : (n, m) innovations, z - h at the prediction; angles wrapped.
    S : (n, m, m) their covariances, H P H' + R.

    Returns
    -------
    (n,) array.

    Raises
    ------
    GraphError
        Shapes that do not fit, no finite numbers.
    UnderconstrainedError
        A covariance that is singular or not positive.

    Examples
    --------
    >>> nis([[0.3, -0.1]], [[[0.01, 0.0], [0.0, 0.01]]]).round(9)
    array([10.])
    """
    e, P = finite("nis", "nu", nu), finite("nis", "S", S)
    if e.ndim != 2 or P.shape != (*e.shape, e.shape[1]):
        raise GraphError(f"nis: shapes {e.shape} and {P.shape}, expected (n, m) innovations and (n, m, m) covariances")
    if (bad := ~regular(P)).any():
        raise UnderconstrainedError(f"NIS of innovation {int(np.argmax(bad))}: its covariance is singular", [])
    return _squares(e, P)


def _squares(e: Array, P: Array) -> Array:
    """e' P^-1 e (n,) of errors (n, d)."""
    values, vectors, scale = _spectra(P)
    return np.asarray((np.square(np.matvec(vectors.mT, e / scale)) / values).sum(axis=1))


def regular(P: Array) -> Mask:
    """Which covariances (n, d, d) give errors a size: those that are finite, positive and not singular, (n,).

    Examples
    --------
    Of a cloud of two particles the covariance has rank 1, of one it is 0:

    >>> e = np.array([[1.0, 2.0, 0.1]])
    >>> regular(np.stack([np.eye(3), e.T @ e, np.zeros((3, 3))]))
    array([ True, False, False])
    """
    return np.asarray(_spectra(P)[0][:, 0] > 1e-12)  # of a correlation matrix: rounding


def _spectra(P: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues (n, d) and vectors of the correlation matrices, and sigmas (n, d); nan where P is no covariance."""
    valid = np.logical_and(np.isfinite(P).all(axis=(1, 2)), (np.diagonal(P, axis1=1, axis2=2) > 0).all(axis=1))
    P = np.where(valid[:, None, None], P, np.eye(P.shape[-1]))
    scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))  # meters and radians do not decide what is singular
    values, vectors = np.linalg.eigh(P / (scale[:, :, None] * scale[:, None, :]))
    return np.where(valid[:, None], values, np.nan), vectors, scale
