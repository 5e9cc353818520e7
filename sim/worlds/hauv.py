"""The hovering vehicle: it mows the sea floor, or strafes along a hull, and its imaging sonar looks on."""

from __future__ import annotations

from math import pi, radians
from typing import Literal

import numpy as np

from sim.checks import check_poses, check_size
from sim.hauv import STEP, didson, lawn_mower, mounted, scattered, swaying
from sim.mission import Mission, survey
from sim.spoil import spoiled

__all__ = ["hauv_floor", "hauv_hull"]

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
    along, across, between : of `sim.hauv.lawn_mower`.
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
    landmarks = scattered(rng, np.array(low), end + high, points, reference)
    text = description.format(legs=legs, length=STEP * (per_leg - 1), points=len(landmarks))
    X, sonar, offset = swaying(path, passes), didson(aperture), mounted(pitch)
    mission = survey(name, rng, X, landmarks, sonar, offset, elevation, noise_scale, text)
    return spoiled(mission, rng, *faults)
