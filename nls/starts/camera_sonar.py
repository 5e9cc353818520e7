r"""Camera and sonar of one vehicle together: pixel and contact of a point, paired view by view.

The ray of the pixel meets the sphere of the range in a point p of the vehicle (`models.ray_range`); where it meets it
twice, the azimuth decides. A pair whose ray passes the sphere, touches it, or meets it only behind the camera places
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.noise import square
from factors.sighting import Sighting
from models import SE3, R, wrap
from models.algebra import Array, Index, Mask
from models.errors import GraphError
from models.ray_range import RayRange, ray_range
from models.sensors.singular import CLOSE
from nls.graph import FactorGraph
from nls.values import Stack, Values

__all__ = ["AHEAD", "Pairs", "covariance", "sightings"]
Columns = list[npt.NDArray[Any]]
AHEAD = np.array([0.0, 0.0, 0.0, -0.5, -0.5, -0.5, 0.5])  # axes x ahead, y right, z down in those of a camera


class Pairs(NamedTuple):
    """Sightings of points by a camera and a sonar at once; n of them, of one kind of poses and one kind of points.

    Attributes
    ----------
    factors : those of the graph that see the points, of camera and sonar.
    poses, points : the stacks.
    pose, point : rows (n,) of these.
    C : (n, 7) poses of the camera on the vehicle.
    b, J_b : (n, 3) rays of the pixels in the frame of the camera, (n, 3, 2) their derivatives.
    Sigma_uv : (n, 2, 2) covariance of the pixels.
    O : (n, 7) poses of the sonar on the vehicle, at the values they were read with.
    z : (n, 2) range, m, and azimuth, rad.
    sigma_r : (n,) standard deviation of the range, m.
    sonar : (n,) row of the variable that O is, -1 where it is none.
    mounting : the kind of these variables; empty where there is none.
    """

    factors: list[Sighting]
    poses: Stack
    points: Stack
    pose: Index
    point: Index
    C: Array
    b: Array
    J_b: Array
    Sigma_uv: Array
    O: Array
    z: Array
    sigma_r: Array
    sonar: Index
    mounting: str

    def placed(self, O: Array) -> tuple[Index, Array, Array]:
        """The points of the pairs that place one, with the sonar at O (n, 7).

        Returns
        -------
        rows : (k,) numbers of these pairs.
        p : (k, 3) points in the frame of the vehicle, m.
        variance : (k,) of a coordinate of p, the mean over the three, m^2.
        """
        s = SE3.position(SE3.between(self.C, O))
        crossings = ray_range(self.b, s, self.z[:, 0])
        nearer = self._nearer(O, crossings)
        d = np.where(nearer, crossings.depth[1], crossings.depth[0])
        rows = np.flatnonzero(np.abs(d - crossings.closest) > CLOSE)  # nan is not
        crossings = ray_range(self.b[rows], s[rows], self.z[rows, 0])
        Sigma = crossings.covariance(self.J_b[rows], self.Sigma_uv[rows], self.sigma_r[rows], near=nearer[rows])
        p = SE3.act(self.C[rows], d[rows, None] * self.b[rows])
        return rows, p, np.trace(Sigma, axis1=1, axis2=2) / 3

    def _nearer(self, O: Array, crossings: RayRange) -> Mask:
        """Which (n,) of the pairs with two points in front have the azimuth of the near one."""
        twice = np.flatnonzero(crossings.roots == 2)
        off = []
        for p in crossings.points[:, twice]:
            q = SE3.act(SE3.between(O[twice], self.C[twice]), p)
            off.append(np.abs(wrap(np.arctan2(q[:, 1], q[:, 0]) - self.z[twice, 1])))
        nearer = np.zeros(len(O), dtype=bool)
        nearer[twice] = off[1] < off[0]
        return nearer


def sightings(graph: FactorGraph, values: Values) -> Pairs:
    """The pairs of a graph; of several sightings of a point from a pose by one sensor the first.

    A measurement whose noise says nothing in some direction is passed over.

    Raises
    ------
    GraphError
        No `Projection`, or no `RangeAzimuth`, of points; several kinds of poses, of points or of sonars.
    SingularGeometryError
        A pixel without a ray.
    """
    both = [f for f in graph.factors if isinstance(f, Sighting) and (f.contact or f.states("rays"))]
    both = [f for f in both if len(f) and values.stack(f.keys[1].kind).manifold is R(3)]
    pixels, contacts = ([f for f in both if f.contact == sonar] for sonar in (False, True))
    for name, factors in (("Projection", pixels), ("RangeAzimuth", contacts)):
        if not factors:
            raise GraphError(
                f"rig: the graph has no {name} of points in R3; this start needs `Projection` and `RangeAzimuth` of "
                "the same points from the same poses"
            )
    poses, points = (values.stack(_only(w, both, k)) for k, w in enumerate(("poses", "points")))
    mounted = [f for f in contacts if len(f.keys) == 3]
    camera, sonar = _joined([_pixels(f, values) for f in pixels]), _joined([_contacts(f, values) for f in contacts])
    codes = [rows[0] * len(points) + rows[1] for rows in (camera, sonar)]
    _, k, m = np.intersect1d(codes[0], codes[1], return_indices=True)
    if not len(k):
        raise GraphError(
            f"rig: no point was seen by camera and sonar from one pose ({len(codes[0])} pixels, {len(codes[1])} "
            "contacts); check that both name the same poses and points"
        )
    pose, point, C, b, J_b, Sigma_uv = (column[k] for column in camera)
    _, _, O, z, sigma_r, row = (column[m] for column in sonar)
    mounting = _only("sonars", mounted, 2) if mounted else ""
    return Pairs(both, poses, points, pose, point, C, b, J_b, Sigma_uv, O, z, sigma_r, row, mounting)


def _only(role: str, factors: Sequence[Factor], slot: int) -> str:
    """The one kind in a slot of factors."""
    kinds = sorted({f.keys[slot].kind for f in factors})
    if len(kinds) > 1:
        raise GraphError(f"rig: {role} of several kinds, {', '.join(kinds)}; this start takes one: give them one kind")
    return kinds[0]


def _pixels(factor: Sighting, values: Values) -> Columns:
    """pose, point, C, b, J_b, Sigma_uv of those that say something."""
    model, X = values.gather(factor)
    Sigma, good = covariance(factor, values)
    rays = factor.rays(model.z)
    assert rays is not None
    return [column[good] for column in (*_rows(factor, values), on_vehicle(factor, X), *rays, Sigma)]


def _contacts(factor: Sighting, values: Values) -> Columns:
    """pose, point, O, z, sigma_r, sonar of those that say something."""
    model, X = values.gather(factor)
    Sigma, good = covariance(factor, values)
    variable = [values.stack(k.kind).index(k) for k in factor.keys[2:]]
    sonar = variable[0] if variable else np.full(len(factor), -1)
    sigma_r = np.sqrt(Sigma[:, 0, 0])
    return [column[good] for column in (*_rows(factor, values), on_vehicle(factor, X), model.z, sigma_r, sonar)]


def _rows(factor: Sighting, values: Values) -> Columns:
    """Rows of poses and points."""
    return [values.stack(keys.kind).index(keys) for keys in factor.keys[:2]]


def _joined(parts: Sequence[Columns]) -> Columns:
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def on_vehicle(factor: Sighting, X: Sequence[Array]) -> Array:
    """Where the sensor of each measurement sits, (n, 7), from the stacks of its variables."""
    return factor.sensor_pose(SE3, SE3.identity(len(factor)), *X[2:])


def covariance(factor: Factor, values: Values) -> tuple[Array, Mask]:
    """Covariance (n, m, m) of measurements, and whether (n,) they have one: whether all directions are informed."""
    model, _ = values.gather(factor)
    n, m = len(factor), model.dim
    W = square(model.W)
    good = np.linalg.svd(W)[1][:, -1] > 0
    inverse = np.linalg.inv(np.where(good[:, None, None], W, np.eye(m)))
    return np.broadcast_to(inverse @ inverse.mT, (n, m, m)), np.broadcast_to(good, n)
