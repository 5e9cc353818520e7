r"""Imaging sonars: their beams, range bins, fan and aperture, and the measurements that follow.

A beam is fan / beams wide, a bin (far - near) / bins long. A contact is known to one of each. An error spread evenly
over a cell of width w has the standard deviation w / sqrt(12). Finding a contact in a real image is worse than that;
`quality` is how many times worse, and is the user's to say.

The measurement of a point and its Jacobian are `models.sensors.spherical.range_azimuth`.

Every other sonar is its numbers, and a range window is set with `dataclasses.replace`:

    my_sonar = ImagingSonar("mine", beams=256, bins=1000, fan=radians(90), aperture=radians(15), window=(0.5, 20.0))
    close_up = replace(DIDSON_HIGH, window=(1.0, 6.0))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, radians, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask, components, pack
from models.errors import OptionError
from models.options import is_number, is_whole

__all__ = ["ARIS_3000", "BLUEVIEW_M900", "DIDSON_HIGH", "DIDSON_LOW", "OCULUS_M750D", "ImagingSonar"]

Cells = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ImagingSonar:
    """A multibeam imaging sonar that measures range and azimuth in its own frame: x forward, y right, z down.

    Parameters
    ----------
    name : for reports.
    beams : number of beams over the fan.
    bins : number of range bins over the window.
    fan : whole width in azimuth, rad; the fan is -fan/2 to fan/2.
    aperture : whole height in elevation, rad.
    window : nearest and farthest range, m.
    quality : standard deviation of a contact over that of quantization alone.

    Raises
    ------
    OptionError
        A number no sonar can have.

    Examples
    --------
    >>> from dataclasses import replace
    >>> sonar = replace(DIDSON_HIGH, window=(1.0, 6.0))
    >>> round(1e3 * sonar.sigma_range, 2), round(1e3 * sonar.sigma_azimuth, 2)  # mm, mrad
    (2.82, 1.51)
    """

    name: str
    beams: int
    bins: int
    fan: float
    aperture: float
    window: tuple[float, float]
    quality: float = 1.0

    def __post_init__(self) -> None:
        window = self.window
        for option, good, allowed in (
            ("beams", is_whole(self.beams) and self.beams >= 1, "a whole number of at least 1"),
            ("bins", is_whole(self.bins) and self.bins >= 1, "a whole number of at least 1"),
            ("fan", is_number(self.fan) and 0 < self.fan <= 2 * pi, "an angle in (0, 2 pi], rad"),
            ("aperture", is_number(self.aperture) and 0 < self.aperture < pi, "an angle in (0, pi), rad"),
            (
                "window",
                _is_pair(window) and 0 < window[0] < window[1] < np.inf,
                "nearest and farthest range, m, 0 < nearest < farthest",
            ),
            ("quality", is_number(self.quality) and 0 < self.quality < np.inf, "a number above 0"),
        ):
            if not good:
                raise OptionError(f"ImagingSonar {self.name}: {option}", getattr(self, option), allowed)

    @property
    def sigma_range(self) -> float:
        """Standard deviation of a range, m."""
        return (self.window[1] - self.window[0]) / self.bins / sqrt(12) * self.quality

    @property
    def sigma_azimuth(self) -> float:
        """Standard deviation of an azimuth, rad."""
        return self.fan / self.beams / sqrt(12) * self.quality

    @property
    def noise_sigmas(self) -> Array:
        """(sigma_range, sigma_azimuth) (2,), m and rad: ``Diagonal(sonar.noise_sigmas)`` is its noise."""
        return np.array([self.sigma_range, self.sigma_azimuth])

    def sees(self, p: Array) -> Mask:
        """Which points p (n, 3), m, in the frame of the sonar are inside the window, the fan and the aperture, (n,).

        Their edges are inside; a point that is not finite is not. A point behind the sonar is in no fan of less than
        180 deg; what stands between is not asked.

        Examples
        --------
        >>> import numpy as np
        >>> DIDSON_HIGH.sees(np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [3.0, 0.0, 1.0]]))
        array([ True, False, False])
        """
        x, y, z = components(p)
        rho, (near, far) = np.hypot(x, y), self.window
        r, azimuth, elevation = np.hypot(rho, z), np.arctan2(y, x), np.arctan2(z, rho)
        within = (np.abs(azimuth) <= self.fan / 2) & (np.abs(elevation) <= self.aperture / 2)
        return np.asarray((near <= r) & (r <= far) & within)

    def beam(self, azimuth: npt.ArrayLike) -> Cells:
        """Number of the beam of azimuths (n,), rad; 0 to beams - 1 from port to starboard, -1 or beams outside."""
        return _cells(azimuth, -self.fan / 2, self.fan / 2, self.beams)

    def bin(self, range: npt.ArrayLike) -> Cells:
        """Number of the range bin of ranges (n,), m; 0 to bins - 1 from near to far, -1 or bins outside."""
        return _cells(range, *self.window, self.bins)

    def quantized(self, z: Array) -> Array:
        """Measurements z (n, 2) of range and azimuth moved to the center of their bin and beam, m and rad.

        Raises
        ------
        OptionError
            A measurement outside of the window or the fan: it has no cell.

        Examples
        --------
        >>> import numpy as np
        >>> from dataclasses import replace
        >>> coarse = replace(DIDSON_HIGH, bins=5, window=(1.0, 6.0))
        >>> coarse.quantized(np.array([[2.9, 0.001]])).round(4)
        array([[2.5   , 0.0026]])
        """
        r, azimuth = components(z)
        (near, far), bin, beam = self.window, self.bin(r), self.beam(azimuth)
        outside = (bin < 0) | (bin >= self.bins) | (beam < 0) | (beam >= self.beams)
        if outside.any():
            k = int(np.argmax(outside))
            allowed = f"a range from {near:g} to {far:g} m and an azimuth within {self.fan / 2:.4g} rad"
            raise OptionError(f"ImagingSonar {self.name}: z[{k}]", np.asarray(z)[k].tolist(), allowed)
        center_r = near + (bin + 0.5) / self.bins * (far - near)
        center_azimuth = ((beam + 0.5) / self.beams - 0.5) * self.fan
        return pack([center_r, center_azimuth])


def _is_pair(value: Any) -> bool:
    return isinstance(value, Sequence | np.ndarray) and len(value) == 2 and all(map(is_number, value))


def _cells(u: npt.ArrayLike, low: float, high: float, count: int) -> Cells:
    """Which of `count` equal cells from low to high each u is in; -1 below (and for nan), `count` above."""
    u = np.asarray(u, dtype=float)
    inside = (low <= u) & (u <= high)
    cell = np.floor((np.where(inside, u, low) - low) / (high - low) * count)
    cell = np.minimum(cell, count - 1)  # high is the edge of the last one
    return np.where(inside, cell, np.where(u > high, count, -1)).astype(np.int64)


# Beams, fan and aperture: soundmetrics.com, SONAR 101, "DIDSON resolution" (both modes; 512 bins in every window; the
# 48 beams are spaced by 0.6 deg); Ocean Networks Canada, "ARIS sonar data" (128 beams, 28 x 14 deg);
# jake3991/sonar-SLAM, bruce_slam/src/bruce_slam/sonar.py (Oculus: 130 deg, and 20 deg at its low frequency);
# phan1007/MFLS50, README (512 and 768 beams, 130 deg, of Oculus M750d and BlueView M900-130). The aperture of the
# BlueView, every window, and the bins of all but the DIDSON are our choice, to be replaced by those of your recording.
DIDSON_HIGH = ImagingSonar("DIDSON, high frequency", 96, 512, radians(28.8), radians(14.0), (1.0, 11.0))
DIDSON_LOW = ImagingSonar("DIDSON, low frequency", 48, 512, radians(28.8), radians(14.0), (1.0, 41.0))
ARIS_3000 = ImagingSonar("ARIS Explorer 3000", 128, 1000, radians(28.0), radians(14.0), (0.7, 5.7))
OCULUS_M750D = ImagingSonar("Oculus M750d, low frequency", 512, 1000, radians(130.0), radians(20.0), (0.5, 40.5))
BLUEVIEW_M900 = ImagingSonar("BlueView M900-130", 768, 1000, radians(130.0), radians(20.0), (0.5, 40.5))
