"""Samples of measurements that a calibration shifts: those of the factor within, moved by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from factors import Shifted
from models import SE2, SE3, LieGroup, R
from tests.factors.samples import Sample, between, prior
from tests.factors.samples_sensors import MOUNT, PLANE_AND_SPACE, TILTED, head, position

Array = npt.NDArray[np.float64]


def shifted(sample: Sample, k: int) -> Sample:
    """A sample with a calibration of k numbers, and rates that are the same for all measurements."""
    space = sample.space
    assert isinstance(space, LieGroup)
    G = np.random.default_rng(k).normal(0, 0.3, (space.dim, k))

    def truth(*X: Array) -> Array:
        h = np.asarray(sample.truth(*X[:-1]), dtype=float)
        return np.asarray(space.retract(h, (G @ X[-1][..., None])[..., 0]))

    return replace(
        sample,
        name=f"Shifted-{sample.name}-by {k}",
        manifolds=(*sample.manifolds, R(k)),
        build=lambda keys, z, noise: Shifted(sample.build(keys[:-1], z, noise), G, keys[-1]),
        truth=truth,
        around=None if sample.around is None else (*sample.around, np.zeros(k)),
    )


SHIFTED_SAMPLES = [
    shifted(head(SE3, "tilted", TILTED), 1),
    shifted(shifted(head(SE2, "level", np.array([1.0, 2.0, -3.0])), 1), 2),
    shifted(position(SE3, ("z", "x"), MOUNT[SE3][:3]), 2),
    shifted(prior(SE2, "log", ("yaw", "x")), 1),
    *(shifted(between(group, "log"), 2) for group in PLANE_AND_SPACE),
]
