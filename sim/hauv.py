r"""The hovering vehicle of the reference missions: its sonar, what it measures how well, how it sways, where it flies.

    roll = 2 deg sin(0.31 t + 1),   pitch = 2 deg sin(0.23 t),   z += 0.15 m sin(0.17 t)     at pose t of the first pass

Odometry in x, y and heading drifts; depth, pitch and roll do not; the sonar, a DIDSON set to 1-6 m, gives range and
azimuth. The data of the vehicle, with DVL, depth sensor and inertial unit: F. Hover, R. Eustice, A. Kim et al.,
"Advanced perception, navigation and planning for autonomous in-water ship hull inspection", IJRR 31(12), 2012.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

import numpy as np
import numpy.typing as npt

from models import euler
from models.algebra import Array, pack, wrap
from models.options import check_between
from models.sensors import DIDSON_HIGH, ImagingSonar
from sim.checks import check_rng, check_size

__all__ = ["lawn_mower", "swaying"]

STEP = 0.25  # m, from pose to pose along a leg
SIGMA_XYH = np.array([0.01, 0.01, radians(0.25)])  # a step: x and y, m, heading, rad
SIGMA_ZPR = np.array([0.01, radians(0.1), radians(0.1)])  # z, m, pitch and roll, rad
SIGMA_SONAR = np.array([0.01, radians(0.25)])  # range, m, azimuth, rad


def didson(aperture: float) -> ImagingSonar:
    """The sonar: 28.8 deg wide, 1 to 6 m, `aperture` (rad) high; a spreader lens makes it 28 deg.

    Raises
    ------
    OptionError
        No such aperture.
    """
    check_between("aperture", aperture, 0, pi, "an angle in (0, pi), rad")
    return replace(DIDSON_HIGH, window=(1.0, 6.0), aperture=aperture)


def mounted(pitch: float) -> Array:
    """Pose (7,) of the sonar on the vehicle: 0.3 m ahead, 0.1 m below, pitched up by `pitch`, rad."""
    return euler.to_se3([0.0, pitch, 0.0, 0.3, 0.0, 0.1])


def lawn_mower(legs: int, per_leg: int, along: npt.ArrayLike, across: npt.ArrayLike, between: int) -> Array:
    """Parallel legs, flown there and back in turn, and the poses from the end of each to the beginning of the next.

    Parameters
    ----------
    legs, per_leg : how many legs, and poses on each.
    along : (4,) step in x, y, z, m, and yaw, rad, from pose to pose of a leg.
    across : (4,) the same from leg to leg, passed linearly.
    between : intermediate poses from leg to leg.

    Returns
    -------
    (n, 4) array of x, y, z, m, and yaw, rad, not wrapped.

    Examples
    --------
    >>> lawn_mower(2, 3, [1, 0, 0, 0], [0, 2, 0, 0], between=1)[:, :2].tolist()
    [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0], [0.0, 2.0]]
    """
    leg, place = np.divmod(np.arange(legs * (per_leg + between) - between), per_leg + between)
    u = np.minimum(place, per_leg - 1)
    u = np.where(leg % 2, per_leg - 1 - u, u)  # every other leg is flown back
    v = leg + np.maximum(place - per_leg + 1, 0) / (between + 1)
    path: Array = u[:, None] * np.asarray(along, dtype=float) + v[:, None] * np.asarray(across, dtype=float)
    return path


def swaying(path: Array, passes: int) -> Array:
    """Poses (n, 7) of a vehicle that follows a path (m, 4) of x, y, z and yaw, sways, and flies it again backwards.

    The second pass has the same poses as the first, attitude included, in reverse order, the third those of the first:
    n = passes (m - 1) + 1.

    Examples
    --------
    >>> swaying(lawn_mower(4, 25, [0.25, 0, 0, 0], [0, 0.8, 0, np.pi], between=8), passes=2).shape
    (247, 7)
    """
    t = np.arange(len(path))
    x, y, z, yaw = path.T
    roll, pitch = radians(2) * np.sin(0.31 * t + 1), radians(2) * np.sin(0.23 * t)
    X = euler.to_se3(pack([roll, pitch, wrap(yaw), x, y, z + 0.15 * np.sin(0.17 * t)]))
    last = len(path) - 1
    there_and_back = last - np.abs(np.arange(passes * last + 1) % (2 * last) - last)
    poses: Array = X[there_and_back]
    return poses


def scattered(
    rng: np.random.Generator, low: Array, high: Array, count: int | None, reference: tuple[int, float]
) -> Array:
    """Points (count, 3) spread evenly in the box from `low` to `high` (3,), m.

    Parameters
    ----------
    rng : source of the points.
    low, high : two corners of the box.
    count : how many; None for as many a cubic meter as the reference.
    reference : number of points, and the volume that holds them, m^3.

    Raises
    ------
    OptionError
        Less than one point.
    """
    check_rng(rng)
    count = round(reference[0] * float(np.prod(high - low)) / reference[1]) if count is None else count
    check_size("points", count, 1)
    return rng.uniform(low, high, size=(count, 3))
