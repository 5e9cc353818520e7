"""The torus: a coil around a ring-shaped tube that ends where it began."""

from __future__ import annotations

import numpy as np

from models import SE3
from models.errors import OptionError
from models.manifolds.se3 import join
from models.options import check_positive
from sim.checks import check_fraction, check_poses, check_rng, check_size
from sim.paths import attitudes
from sim.world import World, build

__all__ = ["torus"]


def torus(
    rng: np.random.Generator,
    coils: int = 50,
    per_coil: int = 100,
    radius: float = 20.0,
    tube: float = 8.0,
    closure_share: float = 0.8,
    sigma_t: float = 0.05,
    sigma_r: float = 0.02,
    noise_scale: float = 1.0,
) -> World:
    """A vehicle coils around a ring-shaped tube once and sees, in each coil, the coil before.

    Poses in space, x along the way and z away from the tube. Pose k + `per_coil` is measured from pose k, and the last
    coil from the first, each with probability `closure_share`. The gauge is free: hold any one pose.

    Parameters
    ----------
    rng : source of the closures kept and of the noise.
    coils : turns around the tube, at least 3.
    per_coil : poses a turn, at least 4.
    radius : of the ring, from its center to the middle of the tube, m.
    tube : radius of the tube, m, less than `radius`.
    closure_share : probability that a pose is seen from the next coil.
    sigma_t : standard deviation of measured x, y and z, m.
    sigma_r : standard deviation of each component of the measured rotation vector, rad.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.

    Returns
    -------
    World

    Raises
    ------
    OptionError
        A size or a standard deviation that is too small; a tube as thick as the ring.

    Notes
    -----
    After the torus of L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey
    on rotation estimation and its use in pose graph optimization", ICRA 2015: the same 5000 poses, drawn anew.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.torus(np.random.default_rng(1), coils=8, per_coil=12)
    >>> result = world.graph.optimize(world.start)
    >>> result.converged, sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    (True, True)
    """
    check_rng(rng)
    check_size("coils", coils, 3)
    check_size("per_coil", per_coil, 4)
    check_poses("coils * per_coil", coils * per_coil)
    check_positive(radius=radius, tube=tube)
    if tube >= radius:
        raise OptionError("tube", tube, f"less than the radius of the ring, {radius:g}")
    check_fraction(closure_share=closure_share)
    n = coils * per_coil
    k = np.arange(n)
    turn, way = 2 * np.pi * k / per_coil, 2 * np.pi * k / n  # around the tube, around the ring
    cos, sin = np.cos(way), np.sin(way)
    outward = np.stack([np.cos(turn) * cos, np.cos(turn) * sin, np.sin(turn)], axis=-1)
    around = np.stack([-np.sin(turn) * cos, -np.sin(turn) * sin, np.cos(turn)], axis=-1)
    onward = np.stack([-sin, cos, np.zeros(n)], axis=-1)
    center = radius * np.stack([cos, sin, np.zeros(n)], axis=-1)
    along = tube * around + onward * ((radius + tube * np.cos(turn)) / coils)[:, None]  # d(position) / d(turn)
    X = join(center + tube * outward, attitudes(along, outward))
    i = k[rng.random(n) < closure_share]
    j = (i + per_coil) % n
    description = (
        f"Torus: a coil of {coils} turns around a tube of radius {tube:g} m, bent to a ring of radius {radius:g} m."
    )
    return build("torus", SE3, X, i, j, rng, sigma_t, sigma_r, noise_scale, description)
