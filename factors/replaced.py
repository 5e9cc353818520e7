"""Measurements of other variables or with other values: as given, or as one more view would measure them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

from factors.base import Factor
from factors.declared import factors_within
from factors.keys import Keys
from models.algebra import Array

__all__ = ["predicted", "replaced"]


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
            raise factor._refusal(
                f"{[len(k) for k in keys]} variables; expected {len(factor)} for each of its {len(factor.keys)} slots"
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
            raise factor._refusal(f"{len(z)} measured values, expected {len(factor)}")
        substitute._z = z.copy()
        substitute._z.setflags(write=False)
    substitute._model = None
    return substitute


def predicted(factor: Factor, keys: Sequence[Keys], values: Any) -> Factor:
    """A batch like a given one, with other variables, that measures without error: z = h(X).

    Parameters
    ----------
    factor : kind, noise, fixed offsets and robust kernel are taken from it.
    keys : one `Keys` per slot, as many variables each as it has measurements.
    values : `nls.Values` that hold these variables.

    Raises
    ------
    GraphError
        Another number of slots or variables; a factor that eliminates its target: h then is what fits the old z best.
    SingularGeometryError
        There is nothing to measure from there: a target behind the camera, at the sonar.

    Examples
    --------
    >>> from factors import Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import Values, kinds
    >>> x, l = kinds("x", "l")
    >>> seen = Range(x[[0, 0]], l[[0, 1]], [9.9, 8.1], Isotropic([0.1, 0.2]))
    >>> values = Values({x: (SE2, [[0, 0, 0], [6, 0, 0]]), l: (R(2), [[10, 3], [0, 8]])})
    >>> again = predicted(seen, [x[[1, 1]], l[[0, 1]]], values)
    >>> again, again.z.ravel(), again.noise.sigma
    (Range(x[1, 1], l[0, 1]), array([ 5., 10.]), array([0.1, 0.2]))
    """
    template = replaced(factor, keys)
    if factor.eliminated:
        raise factor._refusal(
            "its target is no variable, so nothing says what is measured of it from elsewhere; take "
            "factors that have it as a variable"
        )
    model, X = values.gather(template)
    return replaced(template, z=template.predict(model.manifolds, *X)[0])
