"""The same measurements of other variables, as they would be: what one more view would measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from factors.base import Factor
from factors.keys import Keys
from factors.replaced import replaced
from models.errors import GraphError

__all__ = ["predicted"]


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
        raise GraphError(
            f"{factor!r}: its target is no variable, so nothing says what is measured of it from elsewhere; take "
            "factors that have it as a variable",
            factor.keys,
            factor.name,
        )
    model, X = values.gather(template)
    return replaced(template, z=template.predict(model.manifolds, *X)[0])
