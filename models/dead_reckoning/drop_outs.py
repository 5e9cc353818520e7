r"""Drop-outs of the DVL: what counts as one, how it is bridged, and what is not known there.

Between the valid velocities at t_a and t_b around a drop-out the velocity is taken to follow the straight line between
them, in the axes of the DVL. The true one wanders about that line as a random walk tied down at both ends (a Brownian
bridge) of density sigma_bridge, m/s/sqrt(s):

    cov(n(s), n(t)) = sigma_bridge^2 (s - t_a) (t_b - t) / (t_b - t_a),    s <= t

The standard deviation of the velocity is 0 at the ends and sigma_bridge sqrt(T) / 2 in the middle of a gap T; that of
the distance over the whole of it is sigma_bridge T^(3/2) / sqrt(12). A vehicle whose speed changes by about 0.1 m/s in
4 s has 0.1 / sqrt(4) = 0.05. Source: I. Karatzas, S. Shreve, Brownian Motion and Stochastic Calculus, 1991, 5.6.B.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.dead_reckoning.noise import sum_by_leg
from models.errors import OptionError
from models.options import is_number

__all__ = ["from_bridges", "inside", "losses"]

Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
NODES = 8  # at least, in a drop-out: n of them see all of its variance but 1 / (n + 1)^2


def losses(t: Array, ok: Mask, longest: float | None) -> Mask:
    """Whether a drop-out follows each valid sample: a sample that is not valid, or more time than the longest step.

    Parameters
    ----------
    t : (n,) times of all samples, s; ok: (n,) which are valid.
    longest : s; twice the median step of t when None.

    Raises
    ------
    OptionError
        A longest step that is not positive.
    """
    if longest is not None and not (is_number(longest) and longest > 0):
        raise OptionError("longest", longest, "a time above 0, s")
    most = 2 * float(np.median(np.diff(t))) if longest is None else longest
    lost = (np.diff(np.flatnonzero(ok)) > 1) | (np.diff(t[ok]) > most)
    return np.append(lost, False)


def inside(t: Array, lost: Mask) -> Array:
    """Times inside of drop-outs at which a bridge is looked at, evenly spaced, for valid samples at t."""
    a = np.flatnonzero(lost)
    length = t[a + 1] - t[a]
    n = np.maximum(NODES, np.ceil(length / np.median(np.diff(t)))).astype(np.intp)
    place = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n) + 1
    return np.asarray(np.repeat(t[a], n) + np.repeat(length / (n + 1), n) * place)


def from_bridges(C: Array, leg: Index, gap: Index, before: Array, after: Array, k: int) -> Array:
    """Sum over pairs of nodes of C_i cov(n_i, n_j) C_j' for a random walk of density 1, leg by leg.

    Parameters
    ----------
    C : (m, 6, 3) coefficients of the nodes inside of drop-outs.
    leg : (m,) their legs, rising; gap : (m,) their drop-outs, rising too.
    before, after : (m,) time since the drop-out began and until it ends, s.
    k : how many legs there are.

    Returns
    -------
    Sigma : (k, 6, 6) array.
    """
    new = (np.diff(leg, prepend=-1) != 0) | (np.diff(gap, prepend=-1) != 0)
    first = np.flatnonzero(new)  # node of each part of a drop-out in a leg
    weighted = before[:, None, None] * C
    Q = np.cumsum(weighted, axis=0) - weighted  # of all nodes before ...
    Q -= Q[first][np.cumsum(new) - 1]  # ... in the same part
    CQ = C @ (Q + 0.5 * weighted).mT
    return sum_by_leg((after / (before + after))[:, None, None] * (CQ + CQ.mT), leg, k)
