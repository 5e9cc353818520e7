"""The hull: a hovering vehicle strafes along a wall with a level imaging sonar, level by level."""

from __future__ import annotations

from math import radians
from typing import Literal

import numpy as np

from sim.checks import check_poses, check_size
from sim.hauv import STEP, didson, lawn_mower, mounted, scattered, swaying
from sim.mission import Mission, survey
from sim.spoil import spoiled

__all__ = ["hauv_hull"]

SPACING, BETWEEN = 0.4, 3  # m from level to level, and poses
REFERENCE = (250, 0.6 * 9 * 3.8)  # points in cubic meters


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
    check_size("passes", passes, 1)
    check_size("levels", levels, 1)
    check_size("per_level", per_level, 2)
    check_poses("passes * levels * per_level", passes * levels * (per_level + BETWEEN))
    path = lawn_mower(levels, per_level, [0, STEP, 0, 0], [0, 0, SPACING, 0], BETWEEN)
    low = np.array([2.7, -1.5, -1.2])
    high = np.array([3.3, STEP * (per_level - 1) + 1.5, SPACING * (levels - 1) + 1.4])
    landmarks = scattered(rng, low, high, points, REFERENCE)
    description = (
        f"Hull: {levels} levels of {STEP * (per_level - 1):g} m, {SPACING:g} m apart, flown {passes} times, 3 m from a "
        f"wall of {len(landmarks)} points; the sonar looks straight ahead."
    )
    X, sonar, offset = swaying(path, passes), didson(aperture), mounted(0.0)
    mission = survey("hauv-hull", rng, X, landmarks, sonar, offset, elevation, noise_scale, description)
    return spoiled(mission, rng, drop_outs, outliers, wrong_associations)
