r"""Measurements with other sigmas: every sigma times a scale, correlations as they were.

Sigma <- D Sigma D,   W <- W D^-1,   D = diag(scale) by component
"""

from __future__ import annotations

from copy import copy

from factors.base import Factor, Model
from factors.noise import Covariance, Diagonal, Information, Isotropic, Noise, SqrtInformation, square
from factors.robust import Robust
from models.algebra import Array

__all__ = ["rescaled"]


def rescaled(model: Model, scale: Array) -> Factor:
    """A factor with sigmas times a scale; a robust kernel stays, and counts the new sigmas.

    Parameters
    ----------
    model : the bound factor.
    scale : (n, m) or (1, m) by component, above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Diagonal, Isotropic, Prior, Range
    >>> from models import SE2, R
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> ranges = Range(x[[3, 4]], l[0], [10.0, 11.0], Isotropic(0.1)).bind(SE2, R(2))
    >>> rescaled(ranges, np.array([[5.0]])).noise, rescaled(ranges, np.array([[5.0], [2.0]])).noise
    (Isotropic(0.5), Isotropic([0.5, 0.2]))
    >>> fix = Prior(x[0], [1.0, 2.0, 0.3], Diagonal(x=0.1, y=0.1, yaw=0.02)).bind(SE2)
    >>> rescaled(fix, np.array([[3.0, 3.0, 0.5]])).noise
    Diagonal(x=0.3, y=0.3, yaw=0.01)
    """
    if len(scale) > 1 and (scale == scale[:1]).all():
        scale = scale[:1]
    factor = copy(model.factor)
    factor._noise = _noise(model.factor.noise, scale, model)
    return factor


def _noise(noise: Noise, scale: Array, model: Model) -> Noise:
    """A noise of the same type where there is one; of a type that is not ours a `SqrtInformation`."""
    names = model.names
    if isinstance(noise, Robust):
        return Robust(_noise(noise.noise, scale, model), noise.kernel)
    if isinstance(noise, Isotropic) and (scale == scale[:, :1]).all():
        return Isotropic(noise.sigma * scale[:, 0])
    if isinstance(noise, Isotropic):
        return Diagonal(noise.sigma[:, None] * scale)
    if isinstance(noise, Diagonal) and noise.sigmas is not None:
        return Diagonal(noise.sigmas * scale)
    if isinstance(noise, Diagonal):
        return Diagonal(**{name: noise.named[name] * scale[:, k] for k, name in enumerate(names)})
    products = scale[:, :, None] * scale[:, None, :]
    if isinstance(noise, Covariance):
        return Covariance(noise.matrix * products)
    if isinstance(noise, Information):
        return Information(noise.matrix / products)
    return SqrtInformation(square(noise.sqrt_information(len(model.z), names)) / scale[:, None, :])
