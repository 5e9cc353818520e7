r"""The rig: a camera and a sonar, mounted together nobody knows how exactly, move past a cloud of points.

position   (4 sin 1.2 a, -1.5 sin 2.2 a, 3 (1 - cos 1.2 a)),   a = 0 ... 1
looks at   mean of the points + (0.8 sin 5 a, 0.5 cos 4 a, 0)
rolls      0.25 sin 6 a about the axis of the camera
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, radians, sqrt

import numpy as np
import numpy.typing as npt

from factors import Diagonal, Projection, RangeAzimuth
from models import SE3, SO3, R
from models.algebra import Array, Index, wrap
from models.errors import GraphError, OptionError
from models.manifolds.so3 import quaternion_from_matrix
from models.options import check_positive
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
MOUNTED = SE3.inverse(np.concatenate([ARM, quaternion_from_matrix(NOMINAL @ SO3.rotation(SO3.exp(TURN)))])[None])
OFF_M, OFF_RAD = 0.05, radians(3.0)  # of the guess of the sonar's pose


def rig(
    rng: np.random.Generator,
    poses: int | Array = 20,
    points: int | Array = 600,
    views: int | None = None,
    noise_scale: float = 1.0,
    *,
    camera: Camera = CAMERA,
    sonar: npt.ArrayLike | None = None,
    noise: Mapping[str, float] | None = None,
) -> Rig:
    """A camera and a sonar on one frame see the same points from all sides; the pose of the sonar is to be estimated.

    Points lie evenly in a box of 8 x 6 x 6 m, 5 m ahead of the first camera, as far as every image has them. The camera
    swings around them by 4 m, looking at their middle and rolling by 15 deg. Noise is uniform: +-5 pixels of 600 of
    focal length, +-5 cm, +-5 deg. The factors have its standard deviations, half-widths / sqrt 3. A range below 0 is
    reflected at 0. The guess of the sonar's pose is wrong by 3 deg about a random axis and 5 cm in a random direction.
    The rest of the start is from the measurements.

    Arrays of poses and points are a rig of your own. Each camera then measures the points that are in its image.

    Parameters
    ----------
    rng : source of the points, of who sees them, of the noise and of the guess.
    poses : how many poses of the camera, at least 2. In Python also the poses themselves, (n, 7), camera to world.
    points : how many points, at least 4. In Python also their places, (m, 3), m, where `poses` are an array.
    views : from so many poses, drawn at random, each point is seen; from all when omitted. Not with arrays.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with the same weights.
    camera : its calibration.
    sonar : its true pose (7,) in the frame of the camera, sonar to camera axes.
    noise : half-widths of the noise that differ from those above, by name: u and v in pixels, range in m, azimuth in
        rad; above 0.

    Returns
    -------
    Rig

    Raises
    ------
    OptionError
        A size, scale or noise that is not possible; an array beside a number.
    GraphError
        Points that are in every image were not found; a given point is in no image; arrays of another shape.
    SingularGeometryError
        Poses that see too few points in common with those before them: more `views`.

    Notes
    -----
    The first pose is fixed, and the identity where poses are drawn. The sonar is the offset ``s[0]`` of its factor,
    sonar to camera axes.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.rig(np.random.default_rng(1), poses=6, points=80, noise_scale=0.0)
    >>> world.poses, world.points, world.rows, world.graph.chi2(world.truth) < 1e-15
    (6, 80, 1920, True)
    >>> print(world.errors(world.truth))
    cameras 0.00 cm, points 0.00 cm rmse (alignment: rigid, of both together); sonar on the camera 0.00 cm, 0.00 deg

    A rig of your own, three poses that move to the right past a wall:

    >>> poses = np.array([[x, 0, 0, 0, 0, 0, 1] for x in (0.0, 0.5, 1.0)])
    >>> points = np.array([[x, y, 4 + x * y] for x in (-1.0, 0.0, 1.0, 2.0) for y in (-1.0, 0.0, 1.0)])
    >>> mine = sim.rig(np.random.default_rng(1), poses, points, noise={"range": 0.01})
    >>> mine.poses, mine.points, len(mine.images), bool(np.allclose(mine.truth.stack("x").X, poses))
    (3, 12, 36, True)
    """
    check_rng(rng)
    check_not_negative(noise_scale=noise_scale)
    half = HALF | dict(noise or {})
    if set(half) != set(HALF):
        raise OptionError("noise", sorted(set(half) - set(HALF)), f"names among {', '.join(HALF)}")
    check_positive(**half)
    x, l, s = kinds("x", "l", "s")
    O = MOUNTED if sonar is None else Values({s: (SE3, np.atleast_2d(sonar))}).stack(s).X
    if isinstance(poses, np.ndarray) and isinstance(points, np.ndarray):
        if views is not None:
            raise OptionError("views", views, "none beside arrays of poses and points: who sees what follows from them")
        given = Values({x: (SE3, poses), l: (R(3), points)})
        X, L = given.stack(x).X, given.stack(l).X
        i, k = in_image(camera, X, L)
        who = "each seen by both where it is in the image"
    elif isinstance(poses, np.ndarray) or isinstance(points, np.ndarray):
        raise OptionError("poses, points", (type(poses), type(points)), "two whole numbers, or two arrays")
    else:
        views = poses if views is None else views
        check_views(poses, points, views)
        i, k = seen_from(rng, poses, points, views)
        X, L = scene(rng, camera, poses, points, i, k)
        who = f"each seen from {views} poses by both"

    guess = np.concatenate([O[:, :3] + _drawn(rng, OFF_M), SO3.retract(O[:, 3:], _drawn(rng, OFF_RAD))], axis=1)
    p = SE3.act(SE3.inverse(X)[i], L[k])  # in the frame of the camera
    images, contacts = camera.project(p)[0], range_azimuth(SE3.act(SE3.inverse(O), p))[0]
    widths = np.array([half[name] for name in HALF])
    drawn = noise_scale * rng.uniform(-widths, widths, size=(len(i), 4))
    images, contacts = images + drawn[:, :2], contacts + drawn[:, 2:]
    contacts = np.column_stack([reflected(contacts[:, 0]), wrap(contacts[:, 1])])
    u, v, r, a = widths / sqrt(3)
    graph = FactorGraph(
        [
            Projection(x[i], l[k], images, Diagonal(u=u, v=v), camera),
            RangeAzimuth(x[i], l[k], contacts, Diagonal(range=r, azimuth=a), offset=s[0]),
        ]
    )
    graph.fix(x[0])
    truth = Values({x: (SE3, X), l: (R(3), L), s: (SE3, O)})
    unknown = truth.replaced({x: np.repeat(X[:1], len(X), axis=0), l: np.zeros(L.shape), s: guess})
    description = (
        f"Rig: {len(X)} poses of a camera and a sonar, {len(L)} points, {who}. Noise is uniform, +-{half['u']:g} "
        f"pixels (focal length {camera.focal[0]:g}), +-{100 * half['range']:g} cm and "
        f"+-{degrees(half['azimuth']):g} deg"
        f"{'' if noise_scale == 1 else f', drawn {noise_scale:g} times as large'}. The first pose is known; the "
        "pose of the sonar on the camera is guessed 3 deg and 5 cm wrong."
    )
    return Rig("rig", truth, graph, start_of(graph, unknown), camera, seed_of(rng), description)


def check_views(poses: int, points: int, views: int) -> None:
    """Sizes of a drawn scene.

    Raises
    ------
    OptionError
    """
    check_size("poses", poses, 2)
    check_size("points", points, 4)
    check_size("views", views, 1)
    if views > poses:
        raise OptionError("views", views, f"at most the number of poses, {poses}")
    check_size("points", points * views, 4)


def in_image(camera: Camera, X: Array, L: Array) -> tuple[Index, Index]:
    """Pairs (pose, point) of the points L (m, 3) that are in the image of a camera at X (n, 7), by pose.

    Raises
    ------
    GraphError
        A point is in no image.
    """
    i, k = np.divmod(np.arange(len(X) * len(L)), len(L))
    visible = camera.sees(SE3.act(SE3.inverse(X)[i], L[k]))
    lost = np.setdiff1d(k, k[visible])
    if len(lost):
        raise GraphError(f"rig: {len(lost)} of {len(L)} points are in no image, the first in row {lost[0]} of points")
    return i[visible], k[visible]


def scene(rng: np.random.Generator, camera: Camera, poses: int, points: int, i: Index, k: Index) -> tuple[Array, Array]:
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
        unseen = ~camera.sees(SE3.act(SE3.inverse(X)[i], L[k]))
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
