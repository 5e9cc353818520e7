r"""Drop-outs: what counts as one, how it is bridged, and what is not known there.

**Velocity.** A drop-out of length T has valid velocities at t_a before and t_b after it. In between, the velocity is
taken to follow the straight line between the two, in the axes of the DVL. The true one wanders about that line as a
random walk tied down at both ends (a Brownian bridge) of density sigma_bridge, m/s/sqrt(s):

    cov(n(s), n(t)) = sigma_bridge^2 (s - t_a) (t_b - t) / T,    s <= t

Its standard deviation is 0 at the ends and sigma_bridge sqrt(T) / 2 in the middle, that of the distance over the whole
of it sigma_bridge T^(3/2) / sqrt(12). A vehicle whose speed changes by about 0.1 m/s in 4 s has 0.1 / sqrt(4) = 0.05.

Legs i, j in one drop-out share the error of its bridge, C_ij = cov(d_i, d_j) > 0, and factors cannot say so. Each leg
therefore counts with its covariance with the whole of the drop-out, which has a closed form:

    Sigma_i = sum_j C_ij = sigma_bridge^2 (F(end) - F(begin)),    F(t) = T t^2 / 4 - t^3 / 6,    t from t_a on

Their sum is the variance T^3 / 12 over the whole, however many legs there are. The matrix diag(Sigma_i) - C is positive
semi-definite: its rows add up to 0, and nothing off its diagonal is above 0. So no combination of legs is better known
than the bridge allows. Where the vehicle turns meanwhile, which makes the distances less alike, that is on the safe
side. Source: I. Karatzas, S. Shreve, Brownian Motion and Stochastic Calculus, 1991, 5.6.B.

**Attitude.** Between two attitudes (or rates) that far apart the vehicle is taken to turn evenly. Its attitude wanders
from that as a random walk of density sigma_turn, rad/sqrt(s). Every step adds to the walk. It is not tied down at the
far end: who measures the attitude there, as `Heading` does, ties it.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Mask
from models.errors import OptionError
from models.options import is_number

__all__ = ["longest_step", "losses"]

NODES = 8  # in a drop-out of the attitude, so that a turn late in it swings less of the way than an early one


def longest_step(t: Array, longest: float | None = None) -> float:
    """The time between samples (n,) above which there is a drop-out, s: twice their median step, unless it is given.

    Raises
    ------
    OptionError
        A longest step that is not positive.
    """
    if longest is not None and not (is_number(longest) and longest > 0):
        raise OptionError("longest", longest, "a time above 0, s")
    return 2 * float(np.median(np.diff(t))) if longest is None else longest


def losses(t: Array, ok: Mask, longest: float | None = None) -> Mask:
    """Whether a drop-out follows each valid sample: a sample that is not valid, or more time than the longest step.

    Parameters
    ----------
    t : (n,) times of all samples, s; ok: (n,) which are valid.
    longest : s; twice the median step of t when None.

    Examples
    --------
    >>> import numpy as np
    >>> losses(np.array([0.0, 1.0, 2.0, 5.0, 6.0]), np.array([True, True, True, True, True]))
    array([False, False,  True, False, False])
    """
    most = longest_step(t, longest)
    lost = (np.diff(np.flatnonzero(ok)) > 1) | (np.diff(t[ok]) > most)
    return np.append(lost, False)


def inside(t: Array, lost: Mask) -> Array:
    """Times evenly spaced inside of the drop-outs that follow some of the samples at t."""
    a = np.flatnonzero(lost)
    return np.linspace(t[a], t[a + 1], NODES + 2)[1:-1].ravel()


def bridged_variance(begin: Array, end: Array, T: Array) -> Array:
    """Covariance of the way in parts of drop-outs with the way over their whole, for a random walk of density 1, s^3.

    Parameters
    ----------
    begin, end : (m,) of the parts, since the drop-out began, s.
    T : (m,) lengths of the drop-outs, s.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 10.0, 6)
    >>> parts = bridged_variance(t[:-1], t[1:], np.full(5, 10.0))
    >>> parts.round(3), round(float(parts.sum()), 3), round(10**3 / 12, 3)
    (array([ 8.667, 20.667, 24.667, 20.667,  8.667]), 83.333, 83.333)
    """
    F = [T * t**2 / 4 - t**3 / 6 for t in (begin, end)]
    return np.asarray(F[1] - F[0])
