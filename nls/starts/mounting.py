r"""Camera and sonar of one vehicle: pixel and contact of a point, paired view by view; where the sonar sits.

The ray of the pixel meets the sphere of the range in a point p of the vehicle (`models.ray_range`); where it meets it
twice, the azimuth decides. A pair whose ray passes the sphere, touches it, or meets it only behind the camera places
nothing.

Where the sonar sits beside the camera follows from what both saw from several poses, without a guess.

First the place. Started with the sonar at the camera, pixels and ranges determine poses, points and the sonar's origin
s in one optimization. A wrong s bends the points of every view another way, which motion tells apart. Ranges do not
know the axes of the sonar, so its rotation is held meanwhile.

Then the axes, from the azimuths. With q = (p - s) / |p - s| the direction of a point in the axes of the vehicle, and
r_1 and r_2 the axes x and y of the sonar,

    tan az = q'r_2 / q'r_1     so     sin(az) q'r_1 - cos(az) q'r_2 = 0

one equation per contact, linear and homogeneous in the six numbers (r_1, r_2): they are the right singular vector of
the smallest singular value. Its sign is right where most lengths cos(az) q'r_1 + sin(az) q'r_2 are positive. The
rotation nearest to (r_1, r_2, r_1 x r_2) is taken. Azimuths have noise, so the coefficients have, too. With +-5 deg of
noise, 12,000 contacts, the axes are 0.5 deg (rms) off the optimum, near enough for a start.

The axes stay free, or the noise decides them, if all q are nearly in one plane. Then r_1 and r_2 are far from a right
angle and equal lengths, and are refused.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from factors import Factor, Isotropic, Prior, Range, Sighting
from factors.keys import Keys
from factors.noise import square
from models import SE3, R, wrap
from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.errors import GraphError, SingularGeometryError, UnderconstrainedError
from models.manifolds.so3 import quaternion_from_matrix
from models.ray_range import RayRange, ray_range
from models.sensors.singular import CLOSE
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts.parts import Masks, Parts, put_back
from nls.values import Stack, Values


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
        return rows, SE3.act(self.C[rows], d[rows, None] * self.b[rows]), np.trace(Sigma, axis1=1, axis2=2) / 3

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
                f"rig: the graph has no {name} of points in R3; this initial guess needs `Projection` and "
                "`RangeAzimuth` of the same points from the same poses"
            )
    poses, points = (values.stack(_only(w, both, k)) for k, w in enumerate(("poses", "points")))
    mounted = [f for f in contacts if len(f.keys) == 3]
    camera, sonar = (
        [np.concatenate(columns) for columns in zip(*(_read(factor, values) for factor in factors), strict=True)]
        for factors in (pixels, contacts)
    )
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
        raise GraphError(f"rig: {role} of several kinds, {', '.join(kinds)}, expected one: give them one kind")
    return kinds[0]


def _read(factor: Sighting, values: Values) -> list[npt.NDArray[Any]]:
    """Sightings that say something: pose, point and C, b, J_b, Sigma_uv of pixels, O, z, sigma_r, sonar of contacts."""
    model, X = values.gather(factor)
    Sigma, good = covariance(factor, values)
    pose, point, *sonar = (values.stack(keys.kind).index(keys) for keys in factor.keys)
    columns = [pose, point, factor.sensor_pose(SE3, SE3.identity(len(factor)), *X[2:])]
    if factor.contact:
        columns += [model.z, np.sqrt(Sigma[:, 0, 0]), *(sonar or [np.full(len(factor), -1)])]
    else:
        rays = factor.rays(model.z)
        assert rays is not None
        columns += [*rays, Sigma]
    return [column[good] for column in columns]


def covariance(factor: Factor, values: Values) -> tuple[Array, Mask]:
    """Covariance (n, m, m) of measurements, and whether (n,) they have one: whether all directions are informed."""
    model, _ = values.gather(factor)
    n, m = len(factor), model.dim
    W = square(model.W)
    good = np.linalg.svd(W)[1][:, -1] > 0
    inverse = np.linalg.inv(np.where(good[:, None, None], W, np.eye(m)))
    return np.broadcast_to(inverse @ inverse.mT, (n, m, m)), np.broadcast_to(good, n)


def unknown_mountings(graph: FactorGraph, values: Values, pairs: Pairs) -> Keys:
    """The variables that say where a sonar of the pairs is, without those that are fixed.

    Raises
    ------
    GraphError
        There is none.
    """
    numbers = np.zeros(0, dtype=np.int64)
    if pairs.mounting:
        numbers = values.stack(pairs.mounting).numbers[np.unique(pairs.sonar[pairs.sonar >= 0])]
        for keys in graph.fixed:
            numbers = numbers[~np.isin(numbers, keys.numbers)] if keys.kind == pairs.mounting else numbers
    if not len(numbers):
        raise GraphError(
            "rig: calibrate=True estimates where the sonar is, but no RangeAzimuth has a free variable as its offset; "
            "give offset=s[0], or leave calibrate out"
        )
    return Keys(pairs.mounting, numbers)


def at_the_camera(values: Values, pairs: Pairs, unknown: Keys) -> Values:
    """The sonars at the camera, looking where it looks."""
    stack = values.stack(unknown.kind)
    C = [pairs.C[np.argmax(pairs.sonar == row)] for row in stack.index(unknown)]
    values = values.copy()
    ahead = np.array([0.0, 0.0, 0.0, -0.5, -0.5, -0.5, 0.5])  # axes x ahead, y right, z down in those of a camera
    values[unknown] = SE3.compose(np.array(C), ahead)
    return values


def where_ranges_say(graph: FactorGraph, values: Values, pairs: Pairs, unknown: Keys) -> Values:
    """Poses, points and the places of the sonars from pixels and ranges alone; their axes stay.

    Raises
    ------
    UnderconstrainedError
        The motion leaves a place free.
    """
    rows, _, _ = pairs.placed(pairs.O)
    code = pairs.pose[rows] * len(pairs.points) + pairs.point[rows]
    distances, masks, held = FactorGraph(fixed=graph.fixed), [], Masks()
    for factor in pairs.factors:
        Sigma, good = covariance(factor, values)
        i, j = (stack.index(keys) for stack, keys in zip((pairs.poses, pairs.points), factor.keys, strict=False))
        masks.append(good & np.isin(i * len(pairs.points) + j, code))
        distances.add(_distance(factor, values, Sigma[:, 0, 0]) if factor.contact else factor)
        for keys in factor.keys[2:]:  # where the cameras are, which may be of the kind of the sonars
            stack = values.stack(keys.kind)
            mask = held.setdefault(keys.kind, np.zeros(len(stack), dtype=bool))
            mask[stack.index(keys)] |= not factor.contact
    axes = Prior(unknown, values[unknown], Isotropic(1.0), components=("roll", "pitch", "yaw"))
    distances.add(axes)
    subgraph, within = Parts(distances, values).take([*masks, np.ones(len(axes), dtype=bool)], held, values)
    message, advice = f"rig: pixels and ranges do not determine {unknown}", (Advice("move rig"), Advice("guess"))
    try:
        stop = Stop(chi2_rtol=1e-3)  # more digits are the business of the solve from this start
        result = subgraph.optimize(within, LevenbergMarquardt(stop))
    except UnderconstrainedError as error:
        message, free = f"{message}: {error.message}", error.components
        raise UnderconstrainedError(message, [unknown], error.nullity, free, values, advice) from error
    if free := result.underconstrained:
        message = f"{message}; free: {'; '.join(free)}"
        raise UnderconstrainedError(message, [unknown], len(free), free, values, advice)
    return put_back(values, result.values, subgraph.fixed)


def _distance(factor: Sighting, values: Values, variance: Array) -> Factor:
    """The ranges of contacts, under the same robust kernel."""
    pose, target = factor.keys[:2]
    z = values.gather(factor)[0].z[:, 0]
    ranges = Range(pose, target, z, Isotropic(np.sqrt(variance)), factor.offset)
    return ranges if factor.kernel is None else ranges.robust(factor.kernel)


def turned_to_azimuths(values: Values, pairs: Pairs, unknown: Keys) -> Values:
    """The sonars with the axes their azimuths tell, from the poses, the points and their places."""
    X, L = values.stack(pairs.poses.kind).X, values.stack(pairs.points.kind).X
    p = SE3.act(SE3.inverse(X[pairs.pose]), L[pairs.point])
    values = values.copy()
    for key, row in zip(unknown, values.stack(unknown.kind).index(unknown), strict=True):
        mine, s = pairs.sonar == row, SE3.position(values[key])
        try:
            R = axes_from_azimuths(p[mine] - s, pairs.z[mine, 1])
        except SingularGeometryError as error:
            message = f"rig: {key}: {error}, or give a guess and leave calibrate out"
            raise SingularGeometryError(message, "", [key]) from error
        values[key] = np.concatenate([s, quaternion_from_matrix(R)])
    return values


def axes_from_azimuths(p: Array, azimuth: Array) -> Array:
    """Rotation (3, 3), sonar to vehicle, of a sonar from the azimuths of points.

    Parameters
    ----------
    p : (n, 3) points from the sonar, in axes of the vehicle, m.
    azimuth : (n,) rad.

    Raises
    ------
    SingularGeometryError
        Fewer than five points, or points whose azimuths leave an axis free.

    Examples
    --------
    >>> p = np.array([[4.0, 0, 0], [4, 1, 0], [4, 0, 1], [4, -1, -1], [4, 2, -2], [4, -2, 1]])
    >>> axes_from_azimuths(p, np.arctan2(p[:, 1], p[:, 0])).round(6) + 0.0
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    q = p / np.linalg.norm(p, axis=1, keepdims=True)
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    _, S, Vt = np.linalg.svd(np.linalg.qr(np.concatenate([s * q, -c * q], axis=1), mode="r"))  # all six rows of V'
    r_1, r_2 = np.sqrt(2) * Vt[-1].reshape(2, 3)
    upright = np.linalg.svd(np.stack([r_1, r_2]))[1][-1]
    if len(S) < 5 or not S[4] > 1e-6 * S[0] or not upright > 0.5:  # upright is 1 for two axes
        cure = "let it see points above and below its plane"
        raise SingularGeometryError(f"the azimuths of {len(p)} contacts leave its rotation free; {cure}")
    ahead = np.sign(c * (q @ r_1)[:, None] + s * (q @ r_2)[:, None]).sum()
    axes = np.sign(ahead) * np.array([r_1, r_2])
    U, _, Wt = np.linalg.svd(np.stack([*axes, np.cross(*axes)], axis=1))
    return np.asarray(U @ Wt)
