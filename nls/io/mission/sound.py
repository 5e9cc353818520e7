r"""The speed of sound along a straight line between two depths, from a profile of sound-speed.csv.

A sound that goes straight from depth a to depth b needs, over each meter of depth, a time in proportion to 1 / c(z):

    c = (b - a) / (S(b) - S(a)),   S(z) = int dz / c(z)

the harmonic mean. Between two rows c is on the line between them, with the gradient g: S grows by ln(c_1 / c_0) / g.
Above the first row and below the last one c is that of the row. The bending of the ray is left out. It makes the way
longer by a fraction of (g L / c)^2 / 24, 2e-6 over 1 km with 0.01 1/s.

Source: H. Medwin, C. Clay, Fundamentals of Acoustical Oceanography, 1998, section 3.3.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from nls.io.mission.table import Table

__all__ = ["NOMINAL", "Profile"]

NOMINAL = 1500.0  # m/s
NEAR = 1e-3  # m: depths that are one
SLOWEST, FASTEST = 300.0, 3000.0  # m/s: of sound in air, and faster than in any water


class Profile:
    """The speed of sound over depth, as straight lines between the rows of sound-speed.csv.

    Parameters
    ----------
    table : of the file.

    Raises
    ------
    GraphFileError
        Depths that do not rise, a speed that no water has.
    """

    def __init__(self, table: Table) -> None:
        self.z, self.c = table.rising("z_m"), table.measured("sound_speed_m_s")[:, 0]
        wrong = (self.c < SLOWEST) | (self.c > FASTEST)
        expected = "expected m/s, near 1500 in water"
        table.refuse_rows(wrong, lambda k: f"sound_speed_m_s is {float(self.c[k])!r}; {expected}")
        change = np.diff(self.c)
        mean = change / np.where(change == 0, 1.0, np.log1p(change / self.c[:-1]))  # no cancellation where it is small
        self._mean = np.where(change == 0, self.c[:-1], mean)  # g / ln(c_1 / c_0), times the thickness
        self._S = np.append(0.0, np.cumsum(np.diff(self.z) / self._mean))

    def mean(self, a: Array, b: Array) -> Array:
        """Harmonic mean (n,) of the speeds between depths a and b (n,), m/s."""
        away = np.abs(b - a) > NEAR
        S = self._time(b) - self._time(a)
        return np.where(away, (b - a) / np.where(away, S, 1.0), np.interp(a, self.z, self.c))

    def _time(self, z: Array) -> Array:
        """S(z) (n,), s, from the first row."""
        z, c, zs = np.asarray(z, dtype=float), self.c, self.z
        k = np.clip(np.searchsorted(zs, z, side="right") - 1, 0, max(len(zs) - 2, 0))
        inside = np.clip(z, zs[0], zs[-1])
        at = np.interp(inside, zs, c)
        change = at - c[k]
        slowness = np.where(change == 0, 1 / c[k], np.log1p(change / c[k]) / np.where(change == 0, 1.0, change))
        S = self._S[k] + (inside - zs[k]) * slowness
        return np.asarray(S + np.minimum(z - zs[0], 0.0) / c[0] + np.maximum(z - zs[-1], 0.0) / c[-1])
