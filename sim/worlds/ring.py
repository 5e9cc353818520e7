"""The ring: a few laps of a wavy circle, in the plane."""

from __future__ import annotations

import numpy as np

from models import SE2
from models.options import check_positive
from sim.checks import check_not_negative, check_poses, check_rng, check_size
from sim.paths import meetings
from sim.world import World, build

__all__ = ["ring"]


def ring(
    rng: np.random.Generator,
    laps: int = 4,
    per_lap: int = 100,
    diameter: float = 32.0,
    wobble: float = 0.3,
    radius: float = 1.0,
    closure_ratio: float = 0.25,
    sigma_t: float = 0.03,
    sigma_r: float = 0.01,
    noise_scale: float = 1.0,
) -> World:
    """A vehicle drives a circle a few times, never twice along the same line, and recognizes the lap before.

    Poses in the plane that look along the way; the distance from the center sways slowly by `wobble`. Loop closures
    join poses within `radius`, half a lap or more apart. The gauge is free: hold any one pose.

    Parameters
    ----------
    rng : source of the path and of the noise.
    laps : how often around, at least 1; a single lap closes only where it ends.
    per_lap : poses a lap, at least 4.
    diameter : of the circle, m.
    wobble : standard deviation of the distance from the circle, m.
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

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.ring(np.random.default_rng(1), laps=2, per_lap=60)
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    (True, True)
    """
    check_rng(rng)
    check_size("laps", laps, 1)
    check_size("per_lap", per_lap, 4)
    check_poses("laps * per_lap", laps * per_lap)
    check_positive(diameter=diameter)
    check_not_negative(wobble=wobble)
    n = laps * per_lap
    angle = 2 * np.pi * np.arange(n + 1) / per_lap  # one more than driven: the last pose looks along a step as well
    waves = np.arange(1, 8) / laps  # swayings a lap: slow ones, none of which repeats with the lap
    a, b = rng.standard_normal((2, len(waves)))
    phase = angle[:, None] * waves
    sway = (np.cos(phase) @ a + np.sin(phase) @ b) / np.sqrt(len(waves))
    r = diameter / 2 + wobble * sway
    path = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)
    step = np.diff(path, axis=0)
    X = SE2.stack(np.column_stack([path[:-1], np.arctan2(step[:, 1], step[:, 0])]))
    i, j = meetings(rng, path[:-1], radius, per_lap // 2, closure_ratio)
    description = f"Ring: {laps} laps of a circle {diameter:g} m across that sways by {wobble:g} m."
    return build("ring", SE2, X, i, j, rng, sigma_t, sigma_r, noise_scale, description)
