"""The three-dimensional grid: a flight along the edges of cubes."""

from __future__ import annotations

import numpy as np

from models import SE3
from models.manifolds.se3 import join
from sim.paths import grid_walk, meetings, quarter_turns
from sim.world import World, build

__all__ = ["grid3d"]


def grid3d(
    rng: np.random.Generator,
    n_poses: int = 2000,
    streets: int | None = None,
    block: int = 3,
    spacing: float = 1.0,
    radius: float = 1.5,
    closure_ratio: float = 1.0,
    sigma_t: float = 0.05,
    sigma_r: float = 0.02,
    noise_scale: float = 1.0,
) -> World:
    """A vehicle moves along the edges of a cubic lattice, always forward, and recognizes places it has passed.

    Poses in space one step apart; every turn is a quarter turn about the axis across the old and the new direction, so
    all 24 attitudes of a cube occur. Loop closures join poses within `radius`, ten steps or more apart along the path.
    The gauge is free: hold any one pose.

    Parameters
    ----------
    rng : source of the path and of the noise.
    n_poses : number of poses, at least 3.
    streets : parallel lines along each axis, at least 2; as many as are followed about three times when omitted.
    block : steps between two lines.
    spacing : length of a step, m.
    radius : largest distance of two poses that a loop closure joins, m.
    closure_ratio : loop closures per pose, chosen at random; fewer where fewer pairs meet.
    sigma_t : standard deviation of measured x, y and z, m.
    sigma_r : standard deviation of each component of the measured rotation vector, rad.
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
    After the grid of L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey
    on rotation estimation and its use in pose graph optimization", ICRA 2015; drawn anew, no copy of it.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.grid3d(np.random.default_rng(1), n_poses=150)
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    (True, True)
    """
    positions, directions = grid_walk(rng, n_poses, 3, streets, block, spacing)
    X = join(positions, quarter_turns(directions))
    i, j = meetings(rng, positions, radius, 10, closure_ratio)
    description = (
        f"Grid in space: a path of {spacing:g} m steps along a lattice with lines every {block * spacing:g} m."
    )
    return build("grid3d", SE3, X, i, j, rng, sigma_t, sigma_r, noise_scale, description)
