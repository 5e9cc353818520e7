"""Free directions of single points in the frame of the sensor that sees them: range, azimuth, elevation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import Sighting
from factors.keys import Keys
from models import LieGroup
from models.algebra import Array
from models.sensors import point_in_frame

if TYPE_CHECKING:
    from models.algebra import Index
    from nls.sparse.pattern import Pattern
    from nls.values import Values

__all__ = ["Sight", "named", "sights"]

ALIGNED = 0.99  # cosine of the angle between an axis and the free directions


@dataclass(frozen=True)
class Sight:
    """One of the sightings of a point, the first, and how many there are.

    Attributes
    ----------
    pose : from where.
    count : sightings of the point, by all factors.
    axes : (d, d) unit vectors in the world, a row for each of `names`; nan straight above the sensor.
    names : range, azimuth, elevation; range, bearing in the plane.
    """

    pose: Keys
    count: int
    axes: Array
    names: tuple[str, ...]


def sights(pattern: Pattern, values: Values, points: Index) -> dict[int, Sight]:
    """The first sighting of each of some variables (n,) that are points and seen from a pose."""
    out: dict[int, Sight] = {}
    count = np.zeros(len(pattern.dims), dtype=np.intp)
    for batch in pattern.batches:
        factor = batch.model.factor
        if not isinstance(factor, Sighting) or batch.model.manifolds[1] is batch.model.manifolds[0]:
            continue
        rows = np.flatnonzero(np.isin(batch.variables[1], points))
        if not len(rows):
            continue
        count += np.bincount(batch.variables[1], minlength=len(count))
        group = batch.model.manifolds[0]
        assert isinstance(group, LieGroup)
        _, X = values.gather(factor)
        S = factor.sensor_pose(group, X[0], *X[2:])
        p = np.broadcast_to(point_in_frame(group, S, X[1])[0], (len(batch), group.point_dim))[rows]
        R = np.broadcast_to(group.rotation(S), (len(batch), group.point_dim, group.point_dim))[rows]
        names, E = _spherical(p)
        E = E @ R.mT  # rows, in the world
        variables, first = np.unique(batch.variables[1][rows], return_index=True)
        for v, k in zip(variables.tolist(), first.tolist(), strict=True):
            if v not in out:
                out[v] = Sight(factor.keys[0][[rows[k]]], 0, E[k], names)
    return {v: Sight(s.pose, int(count[v]), s.axes, s.names) for v, s in out.items()}


def _spherical(p: Array) -> tuple[tuple[str, ...], Array]:
    """Directions in which range, azimuth and elevation grow, (n, d, d), a row for each, at points p (n, d)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        e = p / np.linalg.norm(p, axis=1, keepdims=True)
        if p.shape[1] == 2:
            return ("range", "bearing"), np.stack([e, np.stack([-e[:, 1], e[:, 0]], axis=1)], axis=1)
        across = np.stack([-p[:, 1], p[:, 0], 0 * p[:, 0]], axis=1)
        across = across / np.linalg.norm(across, axis=1, keepdims=True)
        return ("range", "azimuth", "elevation"), np.stack([e, across, np.cross(e, across)], axis=1)


def named(U: Array, axes: Array, names: tuple[str, ...]) -> tuple[str, ...]:
    """The axes (rows) that lie in the span of orthonormal columns U (d, q); () where these are others."""
    cosines = np.linalg.norm(axes @ U, axis=1)
    along = tuple(name for name, c in zip(names, cosines, strict=True) if c > ALIGNED)
    return along if len(along) == U.shape[1] else ()
