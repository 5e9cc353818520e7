"""The floor: a hovering vehicle mows the sea floor with an imaging sonar that looks down and ahead."""

from __future__ import annotations

from math import pi, radians
from typing import Literal

import numpy as np

from sim.checks import check_poses, check_size
from sim.hauv import STEP, didson, lawn_mower, mounted, scattered, swaying
from sim.mission import Mission, survey
from sim.spoil import spoiled

__all__ = ["hauv_floor"]

SPACING, TURNING = 0.8, 8  # m from leg to leg, and poses
REFERENCE = (750, 18 * 11 * 0.6)  # points in cubic meters


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
    check_size("passes", passes, 1)
    check_size("legs", legs, 1)
    check_size("per_leg", per_leg, 2)
    check_poses("passes * legs * per_leg", passes * legs * (per_leg + TURNING))
    path = lawn_mower(legs, per_leg, [STEP, 0, 0, 0], [0, SPACING, 0, pi], TURNING)
    low = np.array([-6.0, -4.0, 2.2])
    high = np.array([STEP * (per_leg - 1) + 6, SPACING * (legs - 1) + 4.6, 2.8])
    landmarks = scattered(rng, low, high, points, REFERENCE)
    description = (
        f"Floor: {legs} legs of {STEP * (per_leg - 1):g} m, {SPACING:g} m apart, flown {passes} times, over "
        f"{len(landmarks)} points 2.5 +- 0.3 m deep; the sonar is pitched down 35 deg."
    )
    X, sonar, offset = swaying(path, passes), didson(aperture), mounted(radians(-35))
    mission = survey("hauv-floor", rng, X, landmarks, sonar, offset, elevation, noise_scale, description)
    return spoiled(mission, rng, drop_outs, outliers, wrong_associations)
