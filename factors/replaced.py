"""The same measurements with other variables or other measured values."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

from factors.base import Factor
from factors.declared import factors_within
from factors.keys import Keys
from models.algebra import Array
from models.errors import GraphError

__all__ = ["replaced"]


def replaced(factor: Factor, keys: Sequence[Keys] | None = None, z: Array | None = None) -> Factor:
    """A batch like a given one, with other variables or other measured values.

    Parameters
    ----------
    factor : noise, fixed offsets and robust kernel are taken from it; not changed.
    keys : one `Keys` per slot, as many variables each as it has measurements; its own when omitted.
    z : (n, size) measured values in the stored form of its space; its own when omitted.

    Raises
    ------
    GraphError
        Another number of slots, variables or measurements.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> step = Between(x[0], x[1], [1.0, 0.0, 0.5], Isotropic(0.1))
    >>> replaced(step, keys=step.keys[::-1], z=np.array([[1.0, 0.0, -0.5]]))
    Between(x1, x0)
    """
    substitute = copy(factor)
    if keys is not None:
        if [len(k) for k in keys] != [len(factor)] * len(factor.keys):
            raise GraphError(
                f"{factor!r}: {[len(k) for k in keys]} variables; expected {len(factor)} for each of its "
                f"{len(factor.keys)} slots",
                factor.keys,
                factor.name,
            )
        substitute.keys = tuple(keys)
        for name in factor.per_measurement:
            if isinstance(held := getattr(factor, name), Keys):  # an offset that is a variable is one of the slots too
                setattr(substitute, name, substitute.keys[factor.keys.index(held)])
    for name in factors_within(factor):
        within = getattr(factor, name)
        setattr(substitute, name, replaced(within, substitute.keys[: len(within.keys)], z))
    if z is not None:
        if len(z) != len(factor):
            raise GraphError(f"{factor!r}: {len(z)} measured values, expected {len(factor)}", factor.keys, factor.name)
        substitute._z = z.copy()
        substitute._z.setflags(write=False)
    substitute._model = None
    return substitute
