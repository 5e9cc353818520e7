r"""Distance of a point.

.. math:: r = |p|, \quad \partial r / \partial p = p' / r

A point at the sensor itself has no line of sight: r is 0, its derivative is not defined.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.sensors.singular import CLOSE, refuse

__all__ = ["distance"]


def distance(p: Array) -> tuple[Array, Array]:
    """Range of points p in the frame of the sensor.

    Parameters
    ----------
    p : (n, 2 or 3) array, m.

    Returns
    -------
    r : (n, 1) array, m.
    J : (n, 1, 2 or 3), the line of sight.

    Raises
    ------
    SingularAt
        A point nearer than `CLOSE`.

    Examples
    --------
    >>> import numpy as np
    >>> distance(np.array([[3.0, 4.0]]))
    (array([[5.]]), array([[[0.6, 0.8]]]))
    """
    r = np.sqrt(np.sum(p * p, axis=-1, keepdims=True))
    refuse(
        r[:, 0] < CLOSE,
        "the target is at the sensor itself (zero range), where its direction is not defined; change its initial value",
    )
    return r, (p / r)[:, None, :]
