r"""Where a sonar sits beside a camera, from what both saw from several poses, without a guess.

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

from __future__ import annotations

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from factors.noise import Isotropic
from factors.prior import Prior
from factors.range import Range
from factors.sighting import Sighting
from models import SE3
from models.advice import Advice
from models.algebra import Array
from models.errors import GraphError, SingularGeometryError, UnderconstrainedError
from models.manifolds.so3 import quaternion_from_matrix
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts.camera_sonar import AHEAD, Pairs, covariance
from nls.starts.parts import Masks, Parts, put_back
from nls.values import Values

__all__ = ["at_the_camera", "axes_from_azimuths", "turned_to_azimuths", "unknown_mountings", "where_ranges_say"]

ENOUGH = Stop(1e-6, 1e-3, 1e-10)  # more digits are the business of the solve from this start
DETERMINED = 1e-6  # second smallest over largest singular value
UPRIGHT = 0.5  # least singular value of (r_1, r_2), 1 for two axes


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
    values[unknown] = SE3.compose(np.array(C), AHEAD)
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
    advice = Advice("move rig"), Advice("guess")
    try:
        result = subgraph.optimize(within, LevenbergMarquardt(ENOUGH))
    except UnderconstrainedError as error:
        raise UnderconstrainedError(
            f"rig: pixels and ranges do not tell where {unknown} is: {error.message}",
            [unknown],
            error.nullity,
            error.components,
            values,
            advice,
        ) from error
    if result.underconstrained:
        free = result.underconstrained
        message = f"rig: pixels and ranges do not tell where {unknown} is; free: {'; '.join(free)}"
        raise UnderconstrainedError(message, [unknown], len(free), free, values, advice)
    return put_back(values, subgraph, result.values)


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
    if len(S) < 5 or not S[4] > DETERMINED * S[0] or not upright > UPRIGHT:
        raise SingularGeometryError(
            f"the azimuths of {len(p)} contacts leave its rotation free; let it see points above and below its plane"
        )
    ahead = np.sign(c * (q @ r_1)[:, None] + s * (q @ r_2)[:, None]).sum()
    axes = np.sign(ahead) * np.array([r_1, r_2])
    U, _, Wt = np.linalg.svd(np.stack([*axes, np.cross(*axes)], axis=1))
    return np.asarray(U @ Wt)
