r"""The rig: a camera and a sonar, mounted together nobody knows how exactly, move past a cloud of points.

position   (4 sin 1.2 a, -1.5 sin 2.2 a, 3 (1 - cos 1.2 a)),   a = 0 ... 1
looks at   mean of the points + (0.8 sin 5 a, 0.5 cos 4 a, 0)
rolls      0.25 sin 6 a about the axis of the camera
"""

from __future__ import annotations

from math import radians, sqrt

import numpy as np

from factors import Diagonal, Projection, RangeAzimuth
from models import SE3, SO3, R
from models.algebra import Array, Index, wrap
from models.errors import GraphError, OptionError
from models.manifolds.so3 import quaternion_from_matrix
from models.sensors import Camera, range_azimuth
from nls import FactorGraph, Values, kinds
from nls.starts.rig import rig as start_of
from sim.camera_sonar import Rig
from sim.checks import check_not_negative, check_rng, check_size
from sim.world import reflected, seed_of

__all__ = ["rig"]

CAMERA = Camera(focal=(600.0, 600.0), center=(640.0, 480.0), size=(1280, 960))
LOW, HIGH = np.array([-4.0, -3.0, 5.0]), np.array([4.0, 3.0, 11.0])  # m, corners of the cloud
NOMINAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # camera to sonar axes: x is the camera's z
TURN, ARM = np.array([0.05, -0.03, 0.04]), np.array([0.10, -0.15, 0.30])  # R_sk = NOMINAL Exp(TURN), p_sk = ARM
HALF = {"u": 5.0, "v": 5.0, "range": 0.05, "azimuth": radians(5.0)}  # half-widths of the noise: pixels, m, rad
DRAWS = 100  # of points that are not in the image; 600 take 2 or 3
OFF_M, OFF_RAD = 0.05, radians(3.0)  # of the guess of the sonar's pose


def rig(
    rng: np.random.Generator,
    poses: int = 20,
    points: int = 600,
    views: int | None = None,
    noise_scale: float = 1.0,
) -> Rig:
    """A camera and a sonar on one frame see the same points from all sides; the pose of the sonar is to be estimated.

    Points lie evenly in a box of 8 m x 6 m x 6 m, 5 m ahead of the first camera, as far as every image has them. The
    camera swings around them by 4 m, looking at their middle and rolling by 15 deg. Noise is uniform: +-5 pixels of 600
    of focal length, +-5 cm, +-5 deg; the factors have its standard deviations, half-widths / sqrt 3. A range below 0 is
    reflected at 0. The guess of the sonar's pose is wrong by 3 deg about a random axis and 5 cm in a random direction,
    the rest of the start is from the measurements.

    Parameters
    ----------
    rng : source of the points, of who sees them, of the noise and of the guess.
    poses : of the camera, at least 2.
    points : at least 4.
    views : from so many poses, drawn at random, each point is seen; from all when omitted.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.

    Returns
    -------
    Rig

    Raises
    ------
    OptionError
        A size or scale that is not possible.
    GraphError
        Points that are in every image were not found.
    SingularGeometryError
        Poses that see too few points in common with those before them: more `views`.

    Notes
    -----
    The first pose is the identity and fixed. The sonar is the offset ``s[0]`` of its factor, sonar to camera axes.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.rig(np.random.default_rng(1), poses=6, points=80, noise_scale=0.0)
    >>> world.poses, world.points, world.rows, world.graph.chi2(world.truth) < 1e-15
    (6, 80, 1920, True)
    >>> print(world.errors(world.truth))
    cameras 0.00 cm, points 0.00 cm rmse (alignment: rigid, of both together); sonar on the camera 0.00 cm, 0.00 deg
    """
    check_rng(rng)
    check_size("poses", poses, 2)
    check_size("points", points, 4)
    views = poses if views is None else views
    check_size("views", views, 1)
    if views > poses:
        raise OptionError("views", views, f"at most the number of poses, {poses}")
    check_size("points", points * views, 4)
    check_not_negative(noise_scale=noise_scale)

    x, l, s = kinds("x", "l", "s")
    i, k = seen_from(rng, poses, points, views)
    X, L = scene(rng, poses, points, i, k)
    sonar = SE3.inverse(np.concatenate([ARM, quaternion_from_matrix(NOMINAL @ SO3.rotation(SO3.exp(TURN)))])[None])
    guess = np.concatenate([sonar[:, :3] + _drawn(rng, OFF_M), SO3.retract(sonar[:, 3:], _drawn(rng, OFF_RAD))], axis=1)
    p = SE3.act(SE3.inverse(X)[i], L[k])  # in the frame of the camera
    images, contacts = CAMERA.project(p)[0], range_azimuth(SE3.act(SE3.inverse(sonar), p))[0]
    half = np.array(list(HALF.values()))
    noise = noise_scale * rng.uniform(-half, half, size=(len(i), 4))
    images, contacts = images + noise[:, :2], contacts + noise[:, 2:]
    contacts = np.column_stack([reflected(contacts[:, 0]), wrap(contacts[:, 1])])
    u, v, r, a = half / sqrt(3)
    graph = FactorGraph(
        [
            Projection(x[i], l[k], images, Diagonal(u=u, v=v), CAMERA),
            RangeAzimuth(x[i], l[k], contacts, Diagonal(range=r, azimuth=a), offset=s[0]),
        ]
    )
    graph.fix(x[0])
    truth = Values({x: (SE3, X), l: (R(3), L), s: (SE3, sonar)})
    unknown = truth.replaced({x: np.repeat(X[:1], poses, axis=0), l: np.zeros(L.shape), s: guess})
    description = (
        f"Rig: {poses} poses of a camera and a sonar, {points} points, each seen from {views} poses by both. Noise is "
        "uniform, +-5 pixels (focal length 600), +-5 cm and +-5 deg"
        f"{'' if noise_scale == 1 else f', drawn {noise_scale:g} times as large'}. The first pose is known; the "
        "pose of the sonar on the camera is guessed 3 deg and 5 cm wrong."
    )
    return Rig("rig", truth, graph, start_of(graph, unknown), CAMERA, seed_of(rng), description)


def scene(rng: np.random.Generator, poses: int, points: int, i: Index, k: Index) -> tuple[Array, Array]:
    """Camera poses (n, 7) and points (m, 3), in the frame of the first camera, so that pose i sees point k.

    Points in a corner of the box that one of their cameras does not have in its image, 1 %, are drawn anew.

    Raises
    ------
    GraphError
        No such points were found.
    """
    L = rng.uniform(LOW, HIGH, size=(points, 3))
    for _ in range(DRAWS):
        X = flown(L.mean(axis=0), poses)
        unseen = ~CAMERA.sees(SE3.act(SE3.inverse(X)[i], L[k]))
        if not unseen.any():
            first = SE3.inverse(X[:1])
            return SE3.compose(first, X), SE3.act(first, L)
        out = np.unique(k[unseen])
        L[out] = rng.uniform(LOW, HIGH, size=(len(out), 3))
    raise GraphError(f"rig: {len(out)} of {points} points are not in every image; give more points, or another seed")


def flown(middle: Array, poses: int) -> Array:
    """Poses (n, 7) of the camera around points with this middle (3,), camera to world, x right, y down, z forward."""
    a = np.linspace(0.0, 1.0, poses)
    position = np.column_stack([4 * np.sin(1.2 * a), -1.5 * np.sin(2.2 * a), 3 * (1 - np.cos(1.2 * a))])
    target = middle + np.column_stack([0.8 * np.sin(5 * a), 0.5 * np.cos(4 * a), np.zeros(poses)])
    forward = _unit(target - position)
    right = _unit(np.cross([0.0, 1.0, 0.0], forward))
    level = quaternion_from_matrix(np.stack([right, np.cross(forward, right), forward], axis=-1))
    roll = np.column_stack([np.zeros((poses, 2)), 0.25 * np.sin(6 * a)])
    return np.concatenate([position, SO3.retract(level, roll)], axis=1)


def seen_from(rng: np.random.Generator, poses: int, points: int, views: int) -> tuple[Index, Index]:
    """Pairs (pose, point), each point with `views` different poses drawn at random; by pose, then by point.

    Examples
    --------
    >>> i, k = seen_from(np.random.default_rng(0), poses=5, points=4, views=2)
    >>> len(i), np.bincount(k).tolist(), bool((np.diff(i) >= 0).all())
    (8, [2, 2, 2, 2], True)
    """
    if views == poses:
        i, k = np.divmod(np.arange(poses * points), points)
        return i, k
    i = np.argsort(rng.random((points, poses)), axis=1)[:, :views].ravel()
    k = np.repeat(np.arange(points), views)
    order = np.lexsort((k, i))
    return i[order], k[order]


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _drawn(rng: np.random.Generator, length: float) -> Array:
    """A vector (1, 3) of this length in a random direction."""
    return length * _unit(rng.standard_normal((1, 3)))
