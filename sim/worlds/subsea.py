r"""Subsea: a vehicle circles twice among six landmarks on the sea floor and measures their bearing and range.

circle      radius 30 m about the origin, from (30, 0) with heading +y, 4 deg and d = 2.094 m a step, 180 steps
landmarks   (39, 9) (13.5, 18) (-10.5, 39) (-22.5, 1.5) (-19.5, -34.5) (19.5, -18) m, in sight up to 30 m
sigmas      odometry 0.01 d, 0.01 d, 0.5 deg a step; bearing 0.2 deg, range 0.2 m
start       2 m, 2 m, 0.5 deg about the one believed; where it is known 1 mm, 1 mm, 0.1 mrad
"""

from __future__ import annotations

from math import cos, pi, radians, sin
from typing import Literal

import numpy as np

from factors import BearingRange, Between, Diagonal, Factor, Heading, Isotropic, Prior
from models import SE2, R
from models.algebra import Array, wrap
from models.errors import OptionError
from models.sensors import direction, distance, point_in_frame
from nls import FactorGraph, Values, kinds
from nls.starts import locate_points
from sim.checks import check_not_negative, check_poses, check_rng, check_size
from sim.landmark_world import KNOWN_START, LandmarkWorld
from sim.world import chain, reflected, seed_of

__all__ = ["subsea"]

RADIUS, TURN = 30.0, radians(4.0)
PER_LAP, STEP = 90, 2 * RADIUS * sin(TURN / 2)  # steps, m
LANDMARKS = np.array([[39, 9], [13.5, 18], [-10.5, 39], [-22.5, 1.5], [-19.5, -34.5], [19.5, -18]])
BELIEVED = np.array([[RADIUS, 0.0, pi / 2]])
SIGHT = 30.0  # m
BEARING, RANGE = radians(0.2), 0.2
ODOMETRY = (0.01 * STEP, 0.01 * STEP, radians(0.5))
START = (2.0, 2.0, radians(0.5))
AZIMUTH = radians(0.5)
INDEPENDENT, KNOWN = 4.0, 0.1  # m, of landmarks: charted roughly, and surveyed
TEXTS = {
    "correlated": "No landmark is charted.",
    "first-sight": (
        f"No landmark is charted; a filter is to give each {INDEPENDENT:g} m of its own, uncorrelated, when first "
        "seen, which is no measurement: the graph is that of 'correlated'."
    ),
    "independent": f"Landmarks are charted to {INDEPENDENT:g} m.",
}


def subsea(
    rng: np.random.Generator,
    laps: int = 2,
    known_start: bool = False,
    landmarks: Literal["correlated", "first-sight", "independent"] = "correlated",
    azimuth: Literal["increment", "absolute"] = "increment",
    known_landmarks: int = 0,
    noise_scale: float = 1.0,
) -> LandmarkWorld:
    """An underwater vehicle circles twice among six landmarks, whose bearing and range it measures within 30 m.

    A circle of 60 m across, 2.1 m and 4 deg a step. Odometry drifts by 1 % of the way and 0.5 deg a step; the sonar
    measures 0.2 m and 0.2 deg, relative to the heading. The first pose is known to 2 m and 0.5 deg.

    Parameters
    ----------
    rng : source of the start and of the noise.
    laps : rounds of 90 steps, at least 1.
    known_start : whether the first pose is known, to 1 mm and 0.1 mrad.
    landmarks : correlated: a landmark is as uncertain as what saw it first; first-sight: for filters, 4 m of its own;
        independent: charted before, to 4 m.
    azimuth : increment: each turn is measured to 0.5 deg, the heading drifts; absolute: a gyrocompass measures the
        heading itself as well, to 0.5 deg at each step.
    known_landmarks : so many landmarks, the first ones, are known to 0.1 m.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.

    Returns
    -------
    LandmarkWorld

    Raises
    ------
    OptionError
        A number or word that is not possible.

    Notes
    -----
    A reference scene of this library. In a graph a prior is a measurement, so ``independent`` is one `Prior` of 4 m for
    each landmark, drawn about the truth. ``first-sight`` counts as information what is none (a filter then believes
    more than it knows) and no measurement says the same. The graph is that of ``correlated``. For one seed all variants
    have the same noise; the odometry and its heading stay when the azimuth is absolute, and headings are added.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.subsea(np.random.default_rng(1), known_start=True)
    >>> world.poses, world.landmarks, [f.name for f in world.graph.factors]
    (181, 6, ['Prior', 'Between', 'BearingRange'])
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, world.ate(result.values) < 0.3 < world.ate(world.start)
    (True, True)
    """
    check_rng(rng)
    check_size("laps", laps, 1)
    check_poses("laps", laps * PER_LAP + 1)
    check_not_negative(noise_scale=noise_scale)
    check_size("known_landmarks", known_landmarks, 0)
    if known_landmarks > len(LANDMARKS):
        raise OptionError("known_landmarks", known_landmarks, f"at most {len(LANDMARKS)}")
    if not isinstance(known_start, bool):
        raise OptionError("known_start", known_start, "True or False")
    if landmarks not in tuple(TEXTS):
        raise OptionError("landmarks", landmarks, "one of " + ", ".join(TEXTS))
    if azimuth not in ("increment", "absolute"):
        raise OptionError("azimuth", azimuth, "one of increment, absolute")

    x, l = kinds("x", "l")
    n, m = laps * PER_LAP + 1, len(LANDMARKS)
    first, walk, heading, chart = (noise_scale * rng.standard_normal(s) for s in ((1, 3), (n - 1, 3), n - 1, (m, 2)))
    start_sigmas = KNOWN_START if known_start else START
    step = np.tile([STEP * cos(TURN / 2), STEP * sin(TURN / 2), TURN], (n - 1, 1))
    X = chain(SE2, SE2.retract(BELIEVED, first * start_sigmas)[0], step)
    odometry = SE2.retract(step, walk * ODOMETRY)

    observations = sightings(rng, X, LANDMARKS, SIGHT, noise_scale)
    at = np.arange(n)
    factors: list[Factor] = [
        Prior(x[0], BELIEVED, Diagonal(start_sigmas)),
        Between(x[at[:-1]], x[at[1:]], odometry, Diagonal(ODOMETRY)),
        observations,
    ]
    if azimuth == "absolute":
        factors.append(Heading(x[at[1:]], wrap(X[1:, 2] + AZIMUTH * heading), Isotropic(AZIMUTH)))
    charted = m if landmarks == "independent" else known_landmarks
    if charted:
        sigmas = np.where(np.arange(charted) < known_landmarks, KNOWN, INDEPENDENT)
        factors.append(
            Prior(l[np.arange(charted)], LANDMARKS[:charted] + sigmas[:, None] * chart[:charted], Isotropic(sigmas))
        )

    graph, truth = FactorGraph(factors), Values({x: (SE2, X), l: (R(2), LANDMARKS)})
    reckoned = Values({x: (SE2, chain(SE2, BELIEVED[0], odometry)), l: (R(2), np.zeros((m, 2)))})
    description = (
        f"Subsea: {laps} laps of a circle {2 * RADIUS:g} m across, {n} poses {STEP:.4g} m apart, {m} landmarks, "
        f"{len(observations)} sightings within {SIGHT:g} m. Standard deviations: odometry {ODOMETRY[0]:.3g} m and "
        f"0.5 deg a step, bearing 0.2 deg, range {RANGE:g} m"
        f"{'' if noise_scale == 1 else f', drawn {noise_scale:g} times as large'}. "
        f"The first pose is known to {'1 mm and 0.1 mrad' if known_start else '2 m and 0.5 deg'}. {TEXTS[landmarks]}"
        f"{f' Surveyed to {KNOWN:g} m: {known_landmarks}.' if known_landmarks else ''}"
        f"{' The heading is measured to 0.5 deg at each step.' if azimuth == 'absolute' else ''}"
    )
    start = locate_points(graph, reckoned)
    return LandmarkWorld(
        "subsea", truth, graph, start, graph.pattern(truth).measured_rows, landmarks, seed_of(rng), description
    )


def sightings(rng: np.random.Generator, X: Array, L: Array, sight: float, noise_scale: float = 1.0) -> BearingRange:
    """Bearing and range of landmarks L (m, 2) from poses X (n, 3), wherever they are at most `sight` away, m.

    A range that the noise takes below 0 is reflected at 0, see `sim.world.reflected`.
    """
    x, l = kinds("x", "l")
    i, k = np.nonzero(np.linalg.norm(X[:, None, :2] - L, axis=2) <= sight)
    p = point_in_frame(SE2, X[i], L[k])[0]
    noise = noise_scale * rng.standard_normal((len(i), 2)) * (BEARING, RANGE)
    z = np.concatenate([wrap(direction(p)[0] + noise[:, :1]), reflected(distance(p)[0] + noise[:, 1:])], axis=1)
    return BearingRange(x[i], l[k], z, Diagonal(bearing=BEARING, range=RANGE))
