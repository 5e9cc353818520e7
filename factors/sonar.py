"""All the factors of the contacts of an imaging sonar: what it measures, and what is done about the lost elevation."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.elevation import Elevation, ElevationHinge
from factors.keys import Keys
from factors.noise import Diagonal, Isotropic, Noise
from factors.range_azimuth import RangeAzimuth
from models.errors import OptionError
from models.sensors import ImagingSonar

__all__ = ["first_contacts", "sonar_factors"]


def sonar_factors(
    pose: Keys,
    target: Keys,
    z: npt.ArrayLike,
    noise: Noise | None,
    sonar: ImagingSonar,
    offset: npt.ArrayLike | Keys | None = None,
    elevation: str = "hinge",
    softness: float = pi / 180,
) -> list[Factor]:
    """Factors of contacts, with a treatment of the elevation by name.

    Parameters
    ----------
    pose : the vehicle(s), SE3.
    target : the point(s), R(3).
    z : (n, 2) measured range, m, and azimuth, rad.
    noise : of ``range`` and ``azimuth``; None: the quantization of the sonar times its quality.
    sonar : its aperture, and the noise when none is given.
    offset : pose of the sonar on the vehicle, (7,) or (n, 7), or a variable in SE3; None: no offset.
    elevation : ``free``: nothing is added, and what the motion did not determine is free. ``hinge`` (default): at every
        contact the target is kept within the aperture. ``prior``: at the first contact of each target (by the number of
        the pose) its elevation is 0 with the sigma aperture / sqrt(12) of an even spread; biased where targets come
        into sight at an edge.
    softness : of the hinge, rad.

    Returns
    -------
    list of Factor
        To be added to a graph.

    Raises
    ------
    OptionError
        No such treatment. The search along the arc is a start, `nls.starts.search_elevation`.

    Examples
    --------
    >>> from factors import sonar_factors
    >>> from models.sensors import DIDSON_HIGH
    >>> from nls import FactorGraph, kinds
    >>> x, l = kinds("x", "l")
    >>> FactorGraph(sonar_factors(x[[0, 1]], l[0], [[5.0, 0.1], [4.8, 0.1]], None, DIDSON_HIGH)).factors
    [RangeAzimuth(x[0, 1], l[0, 0]), ElevationHinge(x[0, 1], l[0, 0])]
    """
    contacts = RangeAzimuth(pose, target, z, Diagonal(sonar.noise_sigmas) if noise is None else noise, offset)
    pose, target = contacts.keys[:2]
    if elevation == "free":
        return [contacts]
    if elevation == "hinge":
        return [contacts, ElevationHinge(pose, target, sonar.aperture / 2, softness, offset)]
    if elevation == "prior":
        spread = Elevation(pose, target, 0.0, Isotropic(sonar.aperture / sqrt(12)), offset)
        return [contacts, spread[first_contacts(pose, target)]]
    raise OptionError(
        "elevation", elevation, "free, hinge or prior; the search along the arc is a start, nls.starts.search_elevation"
    )


def first_contacts(pose: Keys, target: Keys) -> npt.NDArray[np.intp]:
    """Places of the contact from the lowest-numbered pose of every target, in the order of the targets' numbers.

    Examples
    --------
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> first_contacts(x[[2, 1, 3]], l[[7, 7, 5]])
    array([2, 1])
    """
    order = np.lexsort((pose.numbers, target.numbers))
    return order[np.unique(target.numbers[order], return_index=True)[1]]
