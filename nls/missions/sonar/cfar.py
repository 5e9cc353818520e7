r"""Constant false-alarm rate (CFAR) thresholds, exact for exponentially distributed noise power.

In Rayleigh noise the power x of a cell (its amplitude squared) has the density exp(-x / mu) / mu. A cell is a detection
where x > T Z. Z is made of n training cells on either side, of sums S_1 and S_2, so that mu cancels:

    ca      Z = S_1 + S_2           P = (1 + T)^-2n
    soca    Z = min(S_1, S_2)       P = 2 (1 + T)^-n I_{(1 + T) / (2 + T)}(n, n)
    goca    Z = max(S_1, S_2)       P = 2 (1 + T)^-n I_{1 / (2 + T)}(n, n)
    os      Z = x_(k) of N = 2 n    P = prod_{i=0}^{k-1} (N - i) / (N - i + T),   k = 3 N / 4 rounded

I_p(n, n) is the regularized incomplete beta function. The usual form of the smallest-of rate,

    P = 2 sum_{k=0}^{n-1} binom(n - 1 + k, k) (2 + T)^-(n + k),

is the distribution function of a negative binomial variable, and that is I_p(n, n). T of the first is in closed form,
T of the others a root: log P falls in T.

Source: P. Gandhi and S. Kassam, "Analysis of CFAR processors in nonhomogeneous background", IEEE Trans. Aerospace and
Electronic Systems 24(4), 1988 (all four); H. Rohling, "Radar CFAR thresholding in clutter and multiple target
situations", the same Transactions 19(4), 1983 (ordered statistic).
"""

from __future__ import annotations

from math import exp, expm1, lgamma, log, log1p
from typing import Literal, get_args

import numpy as np

from models.algebra import Array, Mask

__all__ = ["Detector", "above", "detectors", "false_alarm_rate", "multiplier"]

Detector = Literal["ca", "soca", "goca", "os"]
RANK = 0.75  # of the ordered statistic: stays a noise cell while a quarter of the window are echoes (Rohling)
ROOT = 1e-12  # relative tolerance of a multiplier
TINY = 1e-300  # least beta function, met on the way to a root with more than 6,000 training cells


def detectors() -> tuple[str, ...]:
    """Names of all detectors."""
    return get_args(Detector)


def false_alarm_rate(detector: str, sides: int, train: int, T: float) -> float:
    """Probability that noise alone exceeds T Z.

    Parameters
    ----------
    detector : ca, soca, goca or os.
    sides : 2, or 1 where the window has one side only; soca and goca are ca there.
    train : training cells n on a side.
    T : multiplier, at least 0.

    Examples
    --------
    >>> round(false_alarm_rate("soca", 2, 20, 0.5), 6), round(false_alarm_rate("ca", 2, 20, 0.5), 9)
    (0.00054, 9e-08)
    """
    return exp(_log_rate(detector, sides, train, T))


def multiplier(detector: str, sides: int, train: int, false_alarms: float) -> float:
    """Multiplier T of a false-alarm rate, the inverse of `false_alarm_rate`.

    Examples
    --------
    >>> T = multiplier("soca", 2, 20, 1e-3)
    >>> round(T, 4), round(false_alarm_rate("soca", 2, 20, T), 9)
    (0.453, 0.001)
    """
    if detector == "ca" or (sides == 1 and detector != "os"):
        return expm1(-log(false_alarms) / (sides * train))
    from scipy.optimize import brentq

    high = 1.0
    while _log_rate(detector, sides, train, high) > log(false_alarms):
        high *= 2
    return float(brentq(lambda T: _log_rate(detector, sides, train, T) - log(false_alarms), 0.0, high, rtol=ROOT))


def above(x: Array, detector: str, train: int, guard: int, false_alarms: float) -> Mask:
    """Which cells exceed their threshold.

    Parameters
    ----------
    x : (beams, bins) power, at least 2 (train + guard) + 1 bins.
    detector, false_alarms : as in `nls.missions.sonar.detect`.
    train, guard : training and guard cells on a side of a cell.

    Returns
    -------
    (beams, bins) mask. Cells with less than `train` cells on one side are tested with the other side alone and its
    own multiplier.
    """
    reach, bins = train + guard, x.shape[1]
    inner, first, last = slice(reach, bins - reach), slice(0, reach), slice(bins - reach, bins)
    T_2, T_1 = (multiplier(detector, sides, train, false_alarms) for sides in (2, 1))
    out = np.zeros(x.shape, dtype=np.bool_)
    if detector == "os":
        near, far = range(-reach, -guard), range(guard + 1, reach + 1)
        for cells, offsets, T in ((inner, (*near, *far), T_2), (first, far, T_1), (last, near, T_1)):
            out[:, cells] = _smaller(x, cells, offsets, T) >= _rank(len(offsets))
        return out
    total = np.cumsum(np.pad(x, ((0, 0), (1, 0))), axis=1)  # rounding: 1e-16 of the power of a beam
    sums = total[:, train:] - total[:, :-train]  # of the cells k to k + train - 1
    before, after = sums[:, : bins - 2 * reach], sums[:, reach + guard + 1 :]
    Z = {"ca": np.add, "soca": np.minimum, "goca": np.maximum}[detector](before, after)
    out[:, inner] = x[:, inner] > T_2 * Z
    out[:, first] = x[:, first] > T_1 * sums[:, guard + 1 : reach + guard + 1]
    out[:, last] = x[:, last] > T_1 * sums[:, bins - 2 * reach : bins - reach]
    return out


def _smaller(x: Array, cells: slice, offsets: tuple[int, ...] | range, T: float) -> Array:
    """Number of training cells below x / T: at least k of them where x > T x_(k), so nothing has to be sorted."""
    count = np.zeros((len(x), cells.stop - cells.start))
    for offset in offsets:
        count += T * x[:, cells.start + offset : cells.stop + offset] < x[:, cells]
    return count


def _rank(cells: int) -> int:
    return max(1, round(RANK * cells))


def _log_rate(detector: str, sides: int, train: int, T: float) -> float:
    cells = sides * train
    if detector == "os":
        rest = cells - _rank(cells) + 1
        return lgamma(cells + 1) - lgamma(rest) + lgamma(rest + T) - lgamma(cells + 1 + T)
    if detector == "ca" or sides == 1:
        return -cells * log1p(T)
    from scipy.special import betainc

    p = (1 + T if detector == "soca" else 1) / (2 + T)
    return log(2) - train * log1p(T) + log(max(float(betainc(train, train, p)), TINY))
