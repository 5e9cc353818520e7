r"""Detections in the image of an imaging sonar: cells that stand out from the cells around them.

The threshold of a cell follows the level of the noise beside it, along range in its own beam. That level is of `train`
cells on either side, after `guard` cells that the echo itself may fill:

    x = amplitude^2,      x > T Z       Z from the training cells, T of the false-alarm rate

An amplitude in Rayleigh noise has an exponentially distributed power. Then the share of noise cells above their
threshold is the stated one whatever the level. Two things raise it (benchmarks, "Detections in sonar images"): spiky
noise, and a level that falls within the window, as before a shadow. For soca at 1e-3 K-distributed noise of shape 4 to
0.5 raises it 6 to 36 times. There the greatest-of detector keeps the rate best and the smallest-of one worst.

The image stays in beams and range bins. Of the cells within 5 m a Cartesian raster of squares of 0.1 m drops 95 to 99
%. One of squares as large as a bin drops up to 70 %; far away it repeats cells. Repeated cells are no independent
training cells, and the rate would not be the stated one.

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

from dataclasses import dataclass
from math import exp, expm1, lgamma, log, log1p
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask
from models.errors import GraphError, OptionError
from models.options import check_between, check_whole, did_you_mean, is_number
from models.sensors import ImagingSonar

Detector = Literal["ca", "soca", "goca", "os"]


@dataclass(frozen=True, eq=False)
class Detections:
    """Cells of a sonar image that hold an echo, by beam from port to starboard, then by range.

    Attributes
    ----------
    range : (n,) of the center of the cell, m.
    azimuth : (n,) of the center of the cell, rad; 0 ahead, positive to starboard (z is down), as `ImagingSonar` has it.
    intensity : (n,) amplitude of the cell, in the unit of the image.
    sigma : (n, 2) of range, m, and azimuth, rad: the width of a cell over sqrt(12), times `ImagingSonar.quality`.
    """

    range: Array
    azimuth: Array
    intensity: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.range)

    @property
    def points(self) -> Array:
        """Points (n, 2) of the plane of the sonar, x ahead and y to starboard, m, as if at elevation 0."""
        return np.stack([self.range * np.cos(self.azimuth), self.range * np.sin(self.azimuth)], axis=1)


def detect(
    image: npt.ArrayLike,
    sonar: ImagingSonar,
    detector: Detector = "soca",
    false_alarms: float = 1e-3,
    train: int = 20,
    guard: int = 5,
    floor: float = 0.0,
    thin: float = 0.0,
) -> Detections:
    r"""Cells of an image that exceed a threshold of constant false-alarm rate, along range in their beam.

    .. math:: x_k = |I_k|^2 > T Z(x_{k-g-n}, ..., x_{k-g-1}, x_{k+g+1}, ..., x_{k+g+n})

    Parameters
    ----------
    image : (beams, bins) amplitudes, at least 0, from port to starboard and from near to far.
    sonar : that made it.
    detector : Z is the sum of all training cells ("ca", cell averaging), or the smaller or greater of the sums of both
        sides ("soca", "goca"). With "os" it is the 3/4 ordered statistic. "soca" and "os" detect an echo beside a
        stronger one; "goca" has the fewest false alarms where the level of the noise changes.
    false_alarms : share of noise cells that become detections, in Rayleigh noise, 0 to 1.
    train : training cells n on each side.
    guard : guard cells g on each side: at least the length of an echo in bins.
    floor : least amplitude of a detection, in the unit of the image.
    thin : edge, m, of squares of the x-y plane, counted from the sonar, of which only the strongest detection is kept;
        0 keeps all. Two detections on either side of an edge may be closer.

    Returns
    -------
    Detections

    Raises
    ------
    GraphError
        An image of another sonar, amplitudes below 0 or not finite.
    OptionError
        Another detector, a rate outside (0, 1), a window 2 (train + guard) + 1 longer than a beam.

    Notes
    -----
    In the first and the last train + guard bins one side of the window is cut. There the other side alone decides, with
    the multiplier of its n cells, so that the rate is the same; smallest-of and greatest-of are cell averaging there.
    The rate holds for independent cells: an image interpolated or smoothed along range has fewer false alarms or more.
    Where the training cells of Z are all 0, every amplitude above 0 is a detection, unless `floor` holds it back.

    Source: P. Gandhi, S. Kassam, IEEE Trans. Aerospace and Electronic Systems 24(4), 1988; H. Rohling, the same 19(4),
    1983.

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_HIGH
    >>> image = np.random.default_rng(0).rayleigh(0.05, (96, 512))
    >>> image[60, 200] = 1.0
    >>> detections = detect(image, DIDSON_HIGH, false_alarms=1e-6)
    >>> len(detections), detections.points.round(2), detections.sigma.round(4)
    (1, array([[4.91, 0.32]]), array([[0.0056, 0.0015]]))
    """
    I = _amplitudes(image, sonar)
    _check_options(sonar, detector, false_alarms, train, guard)
    for option, value in (("floor", floor), ("thin", thin)):
        if not (is_number(value) and 0 <= value < np.inf):
            raise OptionError(option, value, "a number of at least 0")
    beam, bin = np.nonzero(above(I * I, detector, train, guard, false_alarms) & (I >= floor))
    near, far = sonar.window
    r, azimuth = near + (bin + 0.5) / sonar.bins * (far - near), ((beam + 0.5) / sonar.beams - 0.5) * sonar.fan
    everything = Detections(r, azimuth, I[beam, bin], np.tile(sonar.noise_sigmas, (len(r), 1)))
    return _thinned(everything, thin) if thin > 0 and len(r) else everything


def _thinned(detections: Detections, edge: float) -> Detections:
    """The strongest in each square, in the order they had."""
    strongest = np.argsort(-detections.intensity, kind="stable")
    squares = np.floor(detections.points[strongest] / edge)
    _, first = np.unique(squares, axis=0, return_index=True)
    kept = np.sort(strongest[first])
    return Detections(*(column[kept] for column in vars(detections).values()))


def _amplitudes(image: npt.ArrayLike, sonar: ImagingSonar) -> Array:
    I = np.asarray(image, dtype=float)
    if I.shape != (sonar.beams, sonar.bins):
        raise GraphError(
            f"detect: an image of shape {I.shape}, {sonar.name} makes ({sonar.beams}, {sonar.bins}): beams, bins"
        )
    wrong = ~(np.isfinite(I) & (I >= 0))
    if wrong.any():
        beam, bin = np.argwhere(wrong)[0].tolist()
        raise GraphError(
            f"detect: image[{beam}, {bin}] is {I[beam, bin]:g}, one of {int(wrong.sum())} such cells; expected "
            "amplitudes, finite and at least 0: no decibels, and 0 where there is no sample"
        )
    return I


def _check_options(sonar: ImagingSonar, detector: str, false_alarms: float, train: int, guard: int) -> None:
    if detector not in (known := get_args(Detector)):
        raise OptionError("detector", detector, f"one of {', '.join(known)}{did_you_mean(detector, known)}")
    check_between("false_alarms", false_alarms, 0, 1, "a rate between 0 and 1")
    check_whole("train", train, 1)
    check_whole("guard", guard, 0)
    if 2 * (train + guard) + 1 > sonar.bins:
        raise OptionError(
            f"detect: a window of 2 (train + guard) + 1 = {2 * (train + guard) + 1} bins is longer than a beam of "
            f"{sonar.name}, {sonar.bins} bins: take fewer training cells"
        )


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
    return float(brentq(lambda T: _log_rate(detector, sides, train, T) - log(false_alarms), 0.0, high, rtol=1e-12))


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
    """Of the ordered statistic: a noise cell while less than a quarter of the window are echoes (Rohling)."""
    return max(1, round(0.75 * cells))


def _log_rate(detector: str, sides: int, train: int, T: float) -> float:
    cells = sides * train
    if detector == "os":
        rest = cells - _rank(cells) + 1
        return lgamma(cells + 1) - lgamma(rest) + lgamma(rest + T) - lgamma(cells + 1 + T)
    if detector == "ca" or sides == 1:
        return -cells * log1p(T)
    from scipy.special import betainc

    p = (1 + T if detector == "soca" else 1) / (2 + T)
    beta = max(float(betainc(train, train, p)), 1e-300)  # less on the way to a root of more than 6,000 training cells
    return log(2) - train * log1p(T) + log(beta)
