"""The chi-squared distribution: which sums of squared whitened errors are still explained by noise."""

import numpy as np

from models.algebra import Array, Index
from models.options import check_between, check_whole


def mahalanobis(xi: Array, S: Array) -> Array:
    """Squared Mahalanobis distances xi' S^-1 xi (...) of errors (..., m) with covariances S (..., m, m).

    Examples
    --------
    >>> mahalanobis(np.array([[3.0, 0.0], [0.0, 4.0]]), np.array([np.eye(2), 4 * np.eye(2)])).tolist()
    [9.0, 4.0]
    """
    return np.asarray((xi * np.linalg.solve(S, xi[..., None])[..., 0]).sum(axis=-1))


def innovation_distances(b: Array, C: Array) -> Array:
    """Squared Mahalanobis distances b' S^-1 b (...), S = I + C, of whitened innovations b (..., m).

    Parameters
    ----------
    b : innovations of measurements that the estimate has not used.
    C : (..., m, m) covariance of the whitened prediction, A P A' with P that of the variables.

    Examples
    --------
    >>> innovation_distances(np.array([[4.0], [4.0]]), np.array([[[0.0]], [[3.0]]])).tolist()
    [16.0, 4.0]
    """
    return mahalanobis(b, np.eye(b.shape[-1]) + C)


def chi2_gate(dim: int, probability: float) -> float:
    """The bound that chi-squared of `dim` degrees of freedom stays below with this probability.

    Parameters
    ----------
    dim : degrees of freedom, at least 1.
    probability : between 0 and 1.

    Raises
    ------
    OptionError
        Not such numbers.

    Examples
    --------
    >>> round(chi2_gate(2, 0.95), 3), round(chi2_gate(1, 0.99), 3)
    (5.991, 6.635)
    """
    check_whole("dim", dim, 1)
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.99")
    from scipy.special import gammaincinv

    return float(2 * gammaincinv(dim / 2, probability))


def chi2_interval(dof: float, probability: float = 0.95) -> tuple[float, float]:
    """Within which chi-squared is with this probability, as much below as above; zeros where dof is not above 0.

    Parameters
    ----------
    dof : degrees of freedom; the share of one kind of measurements need not be whole.
    probability : between 0 and 1.

    Examples
    --------
    >>> [round(bound, 2) for bound in chi2_interval(10)]
    [3.25, 20.48]
    """
    from scipy.special import gammaincinv

    if not dof > 0:
        return 0.0, 0.0
    outside = (1 - probability) / 2
    return float(2 * gammaincinv(dof / 2, outside)), float(2 * gammaincinv(dof / 2, 1 - outside))


def chi2_tail(t: Array, dof: Index | Array) -> Array:
    """Probability of chi-squared of dof degrees of freedom, whole or not, above t, elementwise; 1 where there are none.

    Examples
    --------
    >>> chi2_tail(np.array([5.991, 5.991]), np.array([2, 0])).round(3).tolist()
    [0.05, 1.0]
    """
    from scipy.special import gammaincc

    return np.where(dof > 0, gammaincc(np.where(dof > 0, dof, 1) / 2, np.maximum(t, 0.0) / 2), 1.0)


def chi2_log_tail(t: float, dof: int) -> float:
    """Logarithm of `chi2_tail`, of probabilities too small for a float, too.

    Parameters
    ----------
    t : the bound, 0 or above.
    dof : degrees of freedom; 0 where there are none.

    Examples
    --------
    >>> round(chi2_log_tail(5.991, 2), 3), round(chi2_log_tail(20_000.0, 2), 3)
    (-2.995, -10000.0)
    """
    from scipy.special import gammaincc, gammaln

    a, x = dof / 2, t / 2
    if not dof:
        return 0.0
    if (tail := float(gammaincc(a, x))) > 1e-290:  # below, the expansion for large t serves
        return float(np.log(tail))
    return float((a - 1) * np.log(x) - x - gammaln(a) - np.log1p((1 - a) / x))  # first terms of a continued fraction
