"""Factors as rows of files: their measured numbers and standard deviations, or why no file has columns for them."""

from __future__ import annotations

import numpy as np

from factors import Diagonal, Isotropic
from factors.base import Factor
from factors.robust import Robust
from models.algebra import Array
from models.errors import GraphError

__all__ = ["measured_numbers", "no_file", "standard_deviations"]


def no_file(factor: Factor, why: str) -> GraphError:
    """The error of a factor that no file of a mission holds."""
    return GraphError(f"{factor!r} has no file in a mission folder: {why}", factor.keys, factor.name)


def measured_numbers(factor: Factor) -> Array:
    """Measurements (n, m); of one number each they may be (n,)."""
    z = factor.z.reshape(-1, factor.sizes()[-1])  # of space
    return np.broadcast_to(z, (len(factor), z.shape[1]))


def standard_deviations(factor: Factor, names: tuple[str, ...]) -> Array:
    """Standard deviations (n, m) of the named components of each measurement.

    Raises
    ------
    GraphError
        The noise has correlations, for which there are no columns.
    """
    noise, shape = factor.noise, (len(factor), len(names))
    noise = noise.noise if isinstance(noise, Robust) else noise
    if isinstance(noise, Isotropic):
        return np.broadcast_to(noise.sigma[:, None], shape)
    if isinstance(noise, Diagonal) and noise.sigmas is not None:
        return np.broadcast_to(noise.sigmas, shape)
    if isinstance(noise, Diagonal):
        return np.stack([np.broadcast_to(noise.named[name], shape[0]) for name in names], axis=1)
    raise no_file(factor, f"its noise is {type(noise).__name__}; files hold standard deviations, Diagonal or Isotropic")
