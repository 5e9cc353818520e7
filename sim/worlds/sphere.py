"""The sphere: a spiral from pole to pole, each ring tied to the next."""

from __future__ import annotations

import numpy as np

from models import SE3
from models.manifolds.se3 import join
from models.options import check_positive
from sim.checks import check_poses, check_size
from sim.paths import attitudes
from sim.world import World, build

__all__ = ["sphere"]


def sphere(
    rng: np.random.Generator,
    rings: int = 50,
    per_ring: int = 50,
    radius: float = 50.0,
    sigma_t: float = 0.1,
    sigma_r: float = 0.03,
    noise_scale: float = 1.0,
) -> World:
    """A vehicle spirals over a sphere from pole to pole and sees, in each ring, the ring below.

    Poses in space, x along the way and z outward. Pose k + `per_ring` is measured from pose k; with the default noise
    the odometry alone is a crumpled ball. The gauge is free: hold any one pose.

    Parameters
    ----------
    rng : source of the noise.
    rings : turns of the spiral, at least 2.
    per_ring : poses a turn, at least 4.
    radius : of the sphere, m.
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
    After the data set sphere2500 of M. Kaess, H. Johannsson, R. Roberts, V. Ila, J. Leonard, F. Dellaert, "iSAM2:
    incremental smoothing and mapping using the Bayes tree", IJRR 31, 2012: the same 2500 poses and 4949 measurements,
    drawn anew.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.sphere(np.random.default_rng(1), rings=8, per_ring=12)
    >>> world.poses, len(world.graph)
    (96, 179)
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    (True, True)
    """
    check_size("rings", rings, 2)
    check_size("per_ring", per_ring, 4)
    check_poses("rings * per_ring", rings * per_ring)
    check_positive(radius=radius)
    n = rings * per_ring
    k = np.arange(n)
    east, polar = 2 * np.pi * k / per_ring, np.pi * (k + 0.5) / n  # longitude; angle from the lower pole, never 0
    c, s = np.cos(east), np.sin(east)
    outward = np.stack([np.sin(polar) * c, np.sin(polar) * s, -np.cos(polar)], axis=-1)
    upward = np.stack([np.cos(polar) * c, np.cos(polar) * s, np.sin(polar)], axis=-1)
    eastward = np.stack([-s, c, np.zeros(n)], axis=-1)
    along = eastward * np.sin(polar)[:, None] + upward / (2 * rings)  # d(outward) / d(east)
    X = join(radius * outward, attitudes(along, outward))
    i = k[:-per_ring]
    description = (
        f"Sphere: a spiral of {rings} rings over a sphere of radius {radius:g} m, each pose tied to the ring below."
    )
    return build("sphere", SE3, X, i, i + per_ring, rng, sigma_t, sigma_r, noise_scale, description)
