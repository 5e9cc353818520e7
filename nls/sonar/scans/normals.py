r"""Which way the surfaces of a scan face: a straight wall shows how far away it is, and no place along it.

    N = sum_k w_k n_k n_k',      w_k = 1 - l_0 / l_1

with the normal n_k of the points around point k and the eigenvalues l_0 <= l_1 of their covariance; a point with few
neighbors faces all ways, I / 2. Where N is nearly of rank one, all surfaces face the same way, and the scan does not
show its place at right angles to it. The ends of the points on a wall are those of the view and not of the wall: a
match that lays one end on the other invents that place.

Source: J. Zhang, M. Kaess, S. Singh, "On degeneracy of optimization-based state estimation problems", ICRA 2016.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array

__all__ = ["hidden_direction"]

RADIUS = 6.0  # m, of the neighbors: the points of a wall in a submap lie up to 1 m beside it
NEIGHBORS = 60  # at most
POINTS = 150  # whose normals are taken, evenly among all
LEAST = 5  # neighbors with which a point has a normal
SHOWN = (
    0.15  # least eigenvalue of N over the largest: straight walls have 0.03 to 0.14, harbors with corners 0.17 to 0.9
)


def hidden_direction(points: npt.ArrayLike) -> Array | None:
    """Unit vector (2,) along which points (n, 2) do not show their place; None where they show both.

    Examples
    --------
    >>> import numpy as np
    >>> wall = np.column_stack([np.arange(40.0), np.zeros(40)])
    >>> abs(hidden_direction(wall))
    array([1., 0.])
    >>> hidden_direction(np.concatenate([wall, wall[:, ::-1]])) is None
    True
    """
    from scipy.spatial import cKDTree

    p = np.asarray(points, dtype=float)
    distance, k = cKDTree(p).query(p[:: 1 + len(p) // POINTS], np.arange(1, NEIGHBORS + 1), distance_upper_bound=RADIUS)
    near = np.isfinite(distance)
    count = near.sum(axis=1)
    e = np.where(near[..., None], p[np.where(near, k, 0)], 0.0)
    e = (e - (e.sum(axis=1) / count[:, None])[:, None]) * near[..., None]
    l, V = np.linalg.eigh(e.mT @ e)
    line = (count >= LEAST) & (l[:, 1] > 0)
    w = 1 - l[line, 0] / l[line, 1]
    n = V[line, :, 0]
    N = (w[:, None] * n).T @ n + 0.5 * np.count_nonzero(~line) * np.eye(2)
    shown, directions = np.linalg.eigh(N)
    return None if shown[0] >= SHOWN * shown[1] or shown[1] == 0 else np.asarray(directions[:, 0])
