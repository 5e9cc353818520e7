r"""Detections in the image of an imaging sonar: cells that stand out from the cells around them.

The threshold of a cell follows the level of the noise beside it, along range in its own beam. That level is of `train`
cells on either side, after `guard` cells that the echo itself may fill:

    x = amplitude^2,      x > T Z       Z from the training cells, T (`nls.missions.sonar.cfar`) of the false-alarm rate

An amplitude in Rayleigh noise has an exponentially distributed power. Then the share of noise cells above their
threshold is the stated one whatever the level. Two things raise it (benchmarks, "Detections in sonar images"): spiky
noise, and a level that falls within the window, as before a shadow. For soca at 1e-3 K-distributed noise of shape 4 to
0.5 raises it 6 to 36 times. There the greatest-of detector keeps the rate best and the smallest-of one worst.

The image stays in beams and range bins. Of the cells within 5 m a Cartesian raster of squares of 0.1 m drops 95 to 99
%. One of squares as large as a bin drops up to 70 %; far away it repeats cells. Repeated cells are no independent
training cells, and the rate would not be the stated one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError, OptionError
from models.options import check_between, check_whole, did_you_mean, is_number
from models.sensors import ImagingSonar
from nls.missions.sonar.cfar import Detector, above, detectors

__all__ = ["Detections", "detect"]


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
    if detector not in detectors():
        raise OptionError("detector", detector, f"one of {', '.join(detectors())}{did_you_mean(detector, detectors())}")
    check_between("false_alarms", false_alarms, 0, 1, "a rate between 0 and 1")
    check_whole("train", train, 1)
    check_whole("guard", guard, 0)
    if 2 * (train + guard) + 1 > sonar.bins:
        raise OptionError(
            f"detect: a window of 2 (train + guard) + 1 = {2 * (train + guard) + 1} bins is longer than a beam of "
            f"{sonar.name}, {sonar.bins} bins: take fewer training cells"
        )
