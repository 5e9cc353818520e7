r"""The hovering vehicle: it mows the sea floor, or strafes along a hull, and its imaging sonar looks on.

    roll = 2 deg sin(0.31 t + 1),   pitch = 2 deg sin(0.23 t),   z += 0.15 m sin(0.17 t)     at pose t of the first pass

Odometry in x, y and heading drifts; depth, pitch and roll do not; the sonar, a DIDSON set to 1-6 m, gives range and
azimuth. The data of the vehicle, with DVL, depth sensor and inertial unit: F. Hover, R. Eustice, A. Kim et al.,
"Advanced perception, navigation and planning for autonomous in-water ship hull inspection", IJRR 31(12), 2012.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians
from typing import Literal

import numpy as np
import numpy.typing as npt

from models import euler
from models.algebra import Array, pack, wrap
from models.options import check_between
from models.sensors import DIDSON_HIGH
from sim.checks import check_poses, check_rng, check_size
from sim.mission import Mission, survey
from sim.spoil import spoiled

__all__ = ["hauv_floor", "hauv_hull"]

STEP = 0.25  # m, from pose to pose along a leg
FLOOR, HULL = 0.8, 0.4  # m from leg to leg, and from level to level


def hauv_floor(
    rng: np.random.Generator,
    passes: int = 2,
    legs: int = 4,
    per_leg: int = 25,
    points: int | None = None,
    aperture: float = radians(14.0),
    elevation: Literal["free", "hinge", "prior"] = "hinge",
    noise_scale: float = 1.0,
    drop_outs: float = 0.0,
    outliers: float = 0.0,
    wrong_associations: float = 0.0,
) -> Mission:
    """A hovering vehicle flies a lawn mower over the sea floor, its sonar pitched down 35 deg, and the same way back.

    Legs along x, 0.25 m a step and 0.8 m apart, flown in turn north and south; between two legs the vehicle turns half
    around in eight poses while it sidles. The vehicle sways by 2 deg and 0.15 m. The floor is 2.5 +- 0.3 m deep. The
    pitch of the sonar turns the way ahead into a motion across its own plane, which is what makes elevations
    observable.

    Parameters
    ----------
    rng : source of the points and of the noise.
    passes : how often the way is flown, there and back in turn, at least 1.
    legs : at least 1.
    per_leg : poses a leg, at least 2.
    points : candidate landmarks; when omitted 750 on the floor of 18 m x 11 m, larger floors in proportion.
    aperture : whole height of the sonar's view, rad: 14 deg, with a spreader lens 28 deg.
    elevation : free, hinge (kept within the aperture) or prior (zero mean at the first contact).
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.
    drop_outs : part of the contacts that is lost, from 0 to 1.
    outliers : part of the contacts that is replaced by false ones anywhere in the image.
    wrong_associations : part of the contacts that is taken for that of a neighbor in the same image.

    Returns
    -------
    Mission

    Raises
    ------
    OptionError
        A size, part or scale that is not possible.
    GraphError
        No point is seen three times.

    Notes
    -----
    A reference scene of this library, drawn after the surveys of T. Huang, M. Kaess, "Towards acoustic structure from
    motion for imaging sonar", IROS 2015.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=12)
    >>> mission.poses, mission.landmarks > 100
    (63, True)
    >>> result = mission.graph.optimize(mission.start)
    >>> result.converged, mission.ate(result.values) < mission.ate(mission.start) / 2
    (True, True)
    """
    return _flown(
        *("hauv-floor", rng, passes, {"legs": legs, "per_leg": per_leg}, [STEP, 0, 0, 0], [0, FLOOR, 0, pi], 8),
        *([-6.0, -4.0, 2.2], [6.0, 4.6, 2.8], points, (750, 18 * 11 * 0.6)),
        f"Floor: {{legs}} legs of {{length:g}} m, {FLOOR:g} m apart, flown {passes} times, over {{points}} points "
        "2.5 +- 0.3 m deep; the sonar is pitched down 35 deg.",
        *(aperture, radians(-35), noise_scale, drop_outs, outliers, wrong_associations),
        elevation=elevation,
    )


def hauv_hull(
    rng: np.random.Generator,
    passes: int = 2,
    levels: int = 4,
    per_level: int = 25,
    points: int | None = None,
    aperture: float = radians(14.0),
    elevation: Literal["free", "hinge", "prior"] = "hinge",
    noise_scale: float = 1.0,
    drop_outs: float = 0.0,
    outliers: float = 0.0,
    wrong_associations: float = 0.0,
) -> Mission:
    """A hovering vehicle strafes along a wall 3 m ahead, level below level, its sonar level, and the same way back.

    Levels along y, 0.25 m a step and 0.4 m apart, flown in turn to starboard and port, three poses down between two of
    them; heading north throughout. The vehicle sways by 2 deg and 0.15 m. A level sonar on a vehicle that strafes sees
    no elevation. What there is comes from the sway and the way down, and undamped Gauss-Newton may cycle.

    Parameters
    ----------
    rng : source of the points and of the noise.
    passes : how often the way is flown, there and back in turn, at least 1.
    levels : at least 1.
    per_level : poses a level, at least 2.
    points : candidate landmarks; when omitted 250 on the wall of 9 m x 3.8 m, larger walls in proportion.
    aperture : whole height of the sonar's view, rad: 14 deg, with a spreader lens 28 deg.
    elevation : free, hinge (kept within the aperture) or prior (zero mean at the first contact).
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.
    drop_outs : part of the contacts that is lost, from 0 to 1.
    outliers : part of the contacts that is replaced by false ones anywhere in the image.
    wrong_associations : part of the contacts that is taken for that of a neighbor in the same image.

    Returns
    -------
    Mission

    Raises
    ------
    OptionError
        A size, part or scale that is not possible.
    GraphError
        No point is seen three times.

    Notes
    -----
    A reference scene of this library, drawn after the surveys of F. Hover, R. Eustice, A. Kim et al., "Advanced
    perception, navigation and planning for autonomous in-water ship hull inspection", IJRR 31(12), 2012.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> mission.poses, mission.landmarks > 20
    (57, True)
    >>> result = mission.graph.optimize(mission.start)
    >>> result.converged, mission.ate(result.values) < mission.ate(mission.start)
    (True, True)
    """
    return _flown(
        *("hauv-hull", rng, passes, {"levels": levels, "per_level": per_level}, [0, STEP, 0, 0], [0, 0, HULL, 0], 3),
        *([2.7, -1.5, -1.2], [3.3, 1.5, 1.4], points, (250, 0.6 * 9 * 3.8)),
        f"Hull: {{legs}} levels of {{length:g}} m, {HULL:g} m apart, flown {passes} times, 3 m from a wall of "
        "{points} points; the sonar looks straight ahead.",
        *(aperture, 0.0, noise_scale, drop_outs, outliers, wrong_associations),
        elevation=elevation,
    )


def _flown(
    name: str,
    rng: np.random.Generator,
    passes: int,
    sizes: dict[str, int],
    along: list[float],
    across: list[float],
    between: int,
    low: list[float],
    high: list[float],
    points: int | None,
    reference: tuple[int, float],
    description: str,
    aperture: float,
    pitch: float,
    noise_scale: float,
    *faults: float,
    elevation: str,
) -> Mission:
    """A lawn mower with points around it, from `low` beside its begin to `high` beside its end, and their contacts.

    Parameters
    ----------
    sizes : names and numbers of the legs, and of the poses of each.
    along, across, between : of `lawn_mower`.
    reference : points, and the cubic meters that hold them, where their number is left open.
    pitch : of the sonar, rad.
    faults : of `sim.spoil.spoiled`.
    """
    check_size("passes", passes, 1)
    for least, (option, size) in enumerate(sizes.items(), 1):
        check_size(option, size, least)
    legs, per_leg = sizes.values()
    check_poses(f"passes * {' * '.join(sizes)}", passes * legs * (per_leg + between))
    path = lawn_mower(legs, per_leg, along, across, between)
    end = np.array(along[:3]) * (per_leg - 1) + np.array(across[:3]) * (legs - 1)
    check_rng(rng)
    box = end + high - low
    points = round(reference[0] * float(np.prod(box)) / reference[1]) if points is None else points
    check_size("points", points, 1)
    landmarks = rng.uniform(low, end + high, size=(points, 3))
    text = description.format(legs=legs, length=STEP * (per_leg - 1), points=points)
    check_between("aperture", aperture, 0, pi, "an angle in (0, pi), rad")
    sonar = replace(DIDSON_HIGH, window=(1.0, 6.0), aperture=aperture)
    offset = euler.to_se3([0.0, pitch, 0.0, 0.3, 0.0, 0.1])  # 0.3 m ahead, 0.1 m below, pitched up
    mission = survey(name, rng, swaying(path, passes), landmarks, sonar, offset, elevation, noise_scale, text)
    return spoiled(mission, rng, *faults)


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
    return np.asarray(u[:, None] * np.asarray(along, dtype=float) + v[:, None] * np.asarray(across, dtype=float))


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
    return np.asarray(X[there_and_back])
