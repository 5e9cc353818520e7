r"""From the pressure of sea water to depth: by a constant density, or by the formula of UNESCO for a latitude.

**Density.** With water of one density rho and gravity g, p the pressure above that of the atmosphere:

    depth = p / (rho g)

**UNESCO.** Sea water of 0 degrees and salinity 35, with its compression, and gravity at a latitude, p in decibars
(10,000 Pa):

    depth = (9.72659 p - 2.2512e-5 p^2 + 2.279e-10 p^3 - 1.82e-15 p^4) / g(latitude, p)
    g = 9.780318 (1 + 5.2788e-3 sin^2 latitude + 2.36e-5 sin^4 latitude) + 1.092e-6 p

TEOS-10 has 0.011 % more for the same water at 10,000 decibars, and 0.0001 % at 1,000. Warmer or less salty water is
lighter, and its surface higher: a density says it better in shallow or brackish water. The check value of the source
is 9712.653 m at 10,000 decibars and 30 degrees. Source: N. Fofonoff, R. Millard, "Algorithms for computation of
fundamental properties of seawater", Unesco technical papers in marine science 44, 1983, section 4 (P. Saunders,
N. Fofonoff, "Conversion of pressure to depth in the ocean", Deep-Sea Research 23, 1976).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import OptionError
from models.finite import finite
from models.options import is_number

__all__ = ["ATMOSPHERE", "GRAVITY", "depth_by_density", "depth_unesco"]

ATMOSPHERE = 101325.0  # Pa, the standard one
GRAVITY = 9.80665  # m/s^2, the standard one
DECIBAR = 1e4  # Pa


def depth_by_density(p: npt.ArrayLike, density: float, gravity: float = GRAVITY) -> Array:
    """Depth below the surface of water of one density.

    Parameters
    ----------
    p : pressure above that of the atmosphere, Pa.
    density : kg/m^3, above 0.
    gravity : m/s^2, above 0.

    Returns
    -------
    array of the shape of p, m.

    Raises
    ------
    OptionError
        A density or gravity that is not above 0.

    Examples
    --------
    >>> float(depth_by_density(1e5, 1000.0).round(4))
    10.1972
    """
    for name, number in (("density", density), ("gravity", gravity)):
        if not (is_number(number) and 0 < number < np.inf):
            raise OptionError(name, number, "a number above 0")
    return np.asarray(finite("depth_by_density", "p", p) / (density * gravity))


def depth_unesco(p: npt.ArrayLike, latitude: float) -> Array:
    """Depth below the surface of the sea by the formula of UNESCO 1983.

    Parameters
    ----------
    p : pressure above that of the atmosphere, Pa.
    latitude : degrees, -90 to 90.

    Returns
    -------
    array of the shape of p, m.

    Raises
    ------
    OptionError
        A latitude that is none.

    Examples
    --------
    >>> float(depth_unesco(1e8, 30.0).round(3))
    9712.653
    """
    if not (is_number(latitude) and -90 <= latitude <= 90):
        raise OptionError("latitude", latitude, "degrees, -90 to 90")
    d = finite("depth_unesco", "p", p) / DECIBAR
    x = np.sin(np.radians(latitude)) ** 2
    g = 9.780318 * (1 + (5.2788e-3 + 2.36e-5 * x) * x) + 1.092e-6 * d
    return np.asarray((((-1.82e-15 * d + 2.279e-10) * d - 2.2512e-5) * d + 9.72659) * d / g)
