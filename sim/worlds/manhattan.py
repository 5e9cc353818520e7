"""The Manhattan world: a drive through a city of right angles, in the plane."""

from __future__ import annotations

import numpy as np

from models import SE2
from sim.paths import grid_walk, meetings
from sim.world import World, build

__all__ = ["manhattan"]


def manhattan(
    rng: np.random.Generator,
    n_poses: int = 3500,
    streets: int | None = None,
    block: int = 4,
    spacing: float = 1.0,
    radius: float = 1.5,
    closure_ratio: float = 0.6,
    sigma_t: float = 0.02,
    sigma_r: float = 0.02,
    noise_scale: float = 1.0,
) -> World:
    """A vehicle drives random streets of a square city and recognizes places it has passed.

    Poses in the plane one step apart, right-angle turns only. Loop closures join poses within `radius`, ten steps or
    more apart along the drive. The gauge is free: hold any one pose.

    Parameters
    ----------
    rng : source of the drive and of the noise.
    n_poses : number of poses, at least 3.
    streets : parallel streets along each axis, at least 2; as many as are driven about three times when omitted.
    block : steps between two streets.
    spacing : length of a step, m.
    radius : largest distance of two poses that a loop closure joins, m.
    closure_ratio : loop closures per pose, chosen at random; fewer where fewer pairs meet.
    sigma_t : standard deviation of measured x and y, m.
    sigma_r : standard deviation of measured yaw, rad.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.

    Returns
    -------
    World

    Raises
    ------
    OptionError
        A size or a standard deviation that is too small.

    Notes
    -----
    After the data set of E. Olson, J. Leonard, S. Teller, "Fast iterative alignment of pose graphs with poor initial
    estimates", ICRA 2006; drawn anew, no copy of it.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.manhattan(np.random.default_rng(1), n_poses=200)
    >>> world.poses, world.closures > 50
    (200, True)
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    (True, True)
    """
    positions, directions = grid_walk(rng, n_poses, 2, streets, block, spacing)
    yaw = np.arctan2(directions[:, 1], directions[:, 0])
    X = SE2.stack(np.column_stack([positions, yaw]))
    i, j = meetings(rng, positions, radius, 10, closure_ratio)
    description = f"Manhattan: a drive of {spacing:g} m steps through a city with streets every {block * spacing:g} m."
    return build("manhattan", SE2, X, i, j, rng, sigma_t, sigma_r, noise_scale, description)
