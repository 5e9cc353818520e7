r"""Lines: a vehicle on two wheels drives twice around between walls and sees them as infinite lines.

walls       x = +-10, +-6 and y = +-10, +-6, and the four diagonals 12 m from the origin; half as long as 10, 6, 3 m
in sight    nearer than 5 m, and where the foot of the perpendicular lies on the wall
path        from (-6, -8) with heading +x: 48 steps of 0.25 m, a quarter turn in 12 steps of 0.25 m, and so on
sigmas      wheel travel 5 mm after 1 m, slip 1 mm a step; alpha 0.5 deg, r 3 cm
"""

from __future__ import annotations

from math import pi, radians

import numpy as np

from factors import Diagonal, Line, Prior, Wheels
from models import LINE, SE2
from models.sensors import line_in_frame, normalized
from models.vehicles import differential_drive, travel_sigmas
from nls import FactorGraph, Values, kinds
from nls.starts import locate_points
from sim.checks import check_not_negative, check_poses, check_rng, check_size
from sim.landmark_world import KNOWN_START, LandmarkWorld
from sim.world import chain, seed_of

__all__ = ["lines"]

BASE, STEP = 0.5, 0.25  # m
STRAIGHT, CORNER, TURN = 48, 12, pi / 2 / 12  # steps, and rad a step in a corner
FIRST = np.array([[-6.0, -8.0, 0.0]])
QUARTERS = pi / 2 * np.arange(-2, 2)
WALLS = np.array(
    [*((a, 10.0) for a in QUARTERS), *((a, 6.0) for a in QUARTERS), *((a + pi / 4, 12.0) for a in QUARTERS)]
)
HALF = np.repeat([10.0, 6.0, 3.0], 4)  # m, half the length of each
SIGHT = 5.0  # m
WHEEL, SLIP = 0.005, 1e-3  # m after 1 m; m a step
SIGMAS = (radians(0.5), 0.03)


def lines(rng: np.random.Generator, laps: int = 2, noise_scale: float = 1.0) -> LandmarkWorld:
    """A vehicle on two wheels drives around a square twice, between an inner and an outer row of walls.

    Each wall is a line (alpha, r), seen within 5 m; the inner ones from outside, against their normal. The travel of
    the wheels is measured to 5 mm after 1 m, walls to 0.5 deg and 3 cm. The first pose is known.

    Parameters
    ----------
    rng : source of the noise.
    laps : rounds of 240 steps, 60 m each, at least 1.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.

    Returns
    -------
    LandmarkWorld

    Raises
    ------
    OptionError
        A number that is not possible.

    Notes
    -----
    A reference scene of this library. The vehicle does not slip; the sigma of the slip is what lets a graph take two
    encoders for three numbers, and its rows are 0 at the truth. `rows` does not count them.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.lines(np.random.default_rng(1))
    >>> world.poses, world.landmarks, [f.name for f in world.graph.factors]
    (481, 12, ['Prior', 'Wheels', 'Line'])
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, world.ate(result.values) < 0.2 < world.ate(world.start)
    (True, True)
    """
    check_rng(rng)
    check_size("laps", laps, 1)
    check_poses("laps", 4 * (STRAIGHT + CORNER) * laps + 1)
    check_not_negative(noise_scale=noise_scale)

    x, l = kinds("x", "l")
    turns = np.tile(np.repeat([0.0, TURN], [STRAIGHT, CORNER]), 4 * laps)
    n = len(turns) + 1
    travel = STEP + np.outer(turns, [BASE / 2, -BASE / 2])
    first, rolled = (noise_scale * rng.standard_normal(s) for s in ((1, 3), (n - 1, 2)))
    z_u = travel + travel_sigmas(travel, WHEEL, WHEEL, SLIP)[:, :2] * rolled
    X, reckoned = (
        chain(SE2, start[0], differential_drive(SE2.identity(n - 1), u, BASE)[0])
        for start, u in ((SE2.retract(FIRST, first * KNOWN_START), travel), (FIRST, z_u))
    )

    alpha, r = WALLS.T
    normal, along = np.stack([np.cos(alpha), np.sin(alpha)]), np.stack([-np.sin(alpha), np.cos(alpha)])
    away, foot = r - X[:, :2] @ normal, X[:, :2] @ along
    i, k = np.nonzero((np.abs(away) < SIGHT) & (np.abs(foot) <= HALF))
    h, _ = line_in_frame(X[i], WALLS[k])
    z = normalized(LINE.retract(normalized(h), noise_scale * rng.standard_normal(h.shape) * SIGMAS))

    at = np.arange(n)
    graph = FactorGraph(
        [
            Prior(x[0], FIRST, Diagonal(KNOWN_START)),
            Wheels(x[at[:-1]], x[at[1:]], z_u, Diagonal(travel_sigmas(z_u, WHEEL, WHEEL, SLIP)), BASE),
            Line(x[i], l[k], z, Diagonal(alpha=SIGMAS[0], r=SIGMAS[1])),
        ]
    )
    truth = Values({x: (SE2, X), l: (LINE, WALLS)})
    start = locate_points(graph, Values({x: (SE2, reckoned), l: (LINE, LINE.identity(len(WALLS)))}))
    description = (
        f"Lines: {laps} laps of a rounded square among {len(WALLS)} walls, {n} poses {STEP:g} m apart, {len(i)} "
        f"sightings within {SIGHT:g} m. Standard deviations: wheel travel {1e3 * WHEEL:g} mm after 1 m, slip 1 mm a "
        f"step, alpha 0.5 deg, r {SIGMAS[1]:g} m"
        f"{'' if noise_scale == 1 else f', drawn {noise_scale:g} times as large'}. The first pose is known to 1 mm and "
        "0.1 mrad."
    )
    rows = graph.pattern(truth).measured_rows - (n - 1)  # less the slip, which is not drawn
    return LandmarkWorld("lines", truth, graph, start, rows, "correlated", seed_of(rng), description)
