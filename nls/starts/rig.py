r"""Start values for a camera and a sonar that sees into space on one vehicle: poses, points, and where the sonar sits.

A pixel is a ray and a range a sphere around the sonar. Together they place a point in the frame of the vehicle, in each
view on its own (`models.ray_range`). Then, view by view,

    1. next is the pose that shares most points with those known so far; it is aligned to them (`models.alignment`),
    2. its other points become known from it, their first view: l = X p.

Poses that are fixed come first, and fixed points are known from the beginning. Points that no view places, such as
those the sonar never saw, are put where the rays of their pixels meet.

Source: B. Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A 4, 1987.
"""

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from models import SE3
from models.algebra import Array, Mask
from models.alignment import align
from models.alignment import three_points as from_three
from models.errors import SingularGeometryError
from models.sensors import SingularAt
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.starts.landmarks import locate_points
from nls.starts.mounting import Pairs, at_the_camera, sightings, turned_to_azimuths, unknown_mountings, where_ranges_say
from nls.values import Values


def rig(graph: FactorGraph, values: Values, calibrate: bool = False, three_points: bool = False) -> Values:
    """Poses and points observed by a camera and a sonar together; without a guess also the pose of the sonar.

    Parameters
    ----------
    graph : its `Projection` and `RangeAzimuth` factors of points in R(3) are used, with their noise. What is fixed
        stays.
    values : every variable. The places of camera and sonar on the vehicle are used and kept; of the poses those that
        are fixed, or the one of lowest number where nothing is.
    calibrate : estimate the places of the sonar, where they are variables, from the measurements alone:
        `nls.starts.mounting`. The value given is not used.
    three_points : align each pose to three points, far apart, instead of all it shares with the map: to compare.

    Returns
    -------
    Values
        Poses that saw nothing, and points nothing places, have the values given.

    Raises
    ------
    GraphError
        No factors of one of the two sensors, or no common points; several kinds of poses, points or sonars.
    SingularGeometryError
        A pose that shares fewer than three points with the map, or three in line; with `calibrate`, azimuths that leave
        the rotation of a sonar free.
    UnderconstrainedError
        With `calibrate`: the motion does not determine where a sonar is.

    Examples
    --------
    Three points seen from two places, the sonar 0.3 m below the camera:

    >>> import numpy as np
    >>> from factors import Diagonal, Isotropic, Projection, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> X = np.array([[0, 0, 0, 0, 0, 0, 1], [0.5, 0, 0, 0, 0.0998, 0, 0.995]])
    >>> L = np.array([[-1, 0, 4], [1, 0, 4], [0, 1, 5.0]])
    >>> i, j, sonar = np.repeat([0, 1], 3), np.tile([0, 1, 2], 2), np.array([0, 0.3, 0, -0.5, -0.5, -0.5, 0.5])
    >>> p = SE3.act(SE3.inverse(X[i]), L[j])
    >>> q = SE3.act(SE3.inverse(sonar), p)
    >>> contacts = np.column_stack([np.linalg.norm(q, axis=1), np.arctan2(q[:, 1], q[:, 0])])
    >>> pixels = Projection(x[i], l[j], p[:, :2] / p[:, 2:], Isotropic(1e-3))
    >>> echoes = RangeAzimuth(x[i], l[j], contacts, Diagonal(range=0.01, azimuth=0.02), sonar)
    >>> start = rig(FactorGraph([pixels, echoes]), Values({x: (SE3, SE3.identity(2)), l: (R(3), np.zeros((3, 3)))}))
    >>> start[x[1]].round(2) + 0.0, start[l[2]].round(2)
    (array([0.5, 0. , 0. , 0. , 0.1, 0. , 1. ]), array([0., 1., 5.]))
    """
    pairs = sightings(graph, values)
    if not calibrate:
        values, known = _placed(graph, values, pairs, three_points)
    else:
        unknown = unknown_mountings(graph, values, pairs)
        values = at_the_camera(values, pairs, unknown)
        pairs = sightings(graph, values)
        values, known = _placed(graph, values, pairs, three_points)
        values = where_ranges_say(graph, values, pairs, unknown)
        values = turned_to_azimuths(values, pairs, unknown)
    views = [(factor, ~known[pairs.points.index(factor.keys[1])]) for factor in pairs.factors]
    # the points that are not known where the rays of their pixels meet, or where they were
    return locate_points(FactorGraph([factor[alone] for factor, alone in views if alone.any()]), values)


def _placed(graph: FactorGraph, values: Values, pairs: Pairs, three_points: bool) -> tuple[Values, Mask]:
    """Poses and points from the pairs, and which points (n,) are known."""
    poses, points = pairs.poses, pairs.points
    rows, p, variance = pairs.placed(pairs.O)
    pose, point = pairs.pose[rows], pairs.point[rows]
    X, L, known = np.array(poses.X), np.array(points.X), fixed_of(graph.fixed, points)
    order = np.argsort(pose, kind="stable")
    first = np.searchsorted(pose[order], np.arange(len(X) + 1))
    shared = sp.csr_array((np.ones(len(rows), dtype=np.intp), (point, pose)), shape=(len(L), len(X)))
    count = shared[known].sum(axis=0)  # (n,) points each pose shares with the known ones

    todo = np.zeros(len(poses), dtype=bool)  # poses that saw a point with camera or sonar
    for factor in pairs.factors:
        todo[poses.index(factor.keys[0])] = True
    held = np.flatnonzero(todo & fixed_of(graph.fixed, poses))
    if not len(held) and not known.any():
        held = np.flatnonzero(todo)[[np.argmin(poses.numbers[todo])]]
    ready = held[np.argsort(poses.numbers[held])].tolist()
    while todo.any():
        k = ready.pop(0) if ready else int(np.argmax(np.where(todo, count, -1)))
        mine = order[first[k] : first[k + 1]]
        common = mine[known[point[mine]]]
        if k not in held:
            key = Keys(poses.kind, int(poses.numbers[k]))
            X[k] = _aligned(key, L[point[common]], p[common], variance[common], three_points)
        new = mine[~known[point[mine]]]
        L[point[new]] = SE3.act(X[k], p[new])
        known[point[new]] = True
        count = count + shared[point[new]].sum(axis=0)
        todo[k] = False
    return values.replaced({poses.kind: X, points.kind: L}), known


def _aligned(key: Keys, u: Array, v: Array, variance: Array, three_points: bool) -> Array:
    """The pose (7,) that takes the points v (n, 3) it sees to where they are known to be, u."""
    cure = f"fix {key} where it is known, leave it out, or let it see more points of the others with camera and sonar"
    if len(v) < 3:
        message = f"rig: {key} shares {len(v)} points with the poses placed before it, at least 3 are needed; {cure}"
        raise SingularGeometryError(message, "", [key])
    weights = 1 / variance
    mean = weights @ v / weights.sum()
    middle = np.linalg.eigvalsh((weights[:, None] * (v - mean)).T @ (v - mean) / weights.sum())[1]
    spread = max(middle, 0.0) ** 0.5  # on a line rounding may leave it below zero
    sigma = (len(v) / weights.sum()) ** 0.5
    try:
        if not spread > 2.0 * sigma:  # what spreads less across its longest line does not tell the turn about it
            line = f"{len(v)} points spread {spread:.2g} m across their line, with a sigma of {sigma:.2g} m"
            raise SingularAt(line, 0)
        if not three_points:
            return align(u, v, weights)
        corners = _far_apart(v)
        return from_three(u[corners], v[corners])
    except SingularAt as error:
        message = f"rig: {key} sees the points known so far in one line: {error}; {cure}"
        raise SingularGeometryError(message, "", [key]) from error


def _far_apart(v: Array) -> list[int]:
    """Three of the points (n, 3): the farthest from their mean, the farthest from that, the farthest from the two."""
    a = int(np.argmax(np.linalg.norm(v - v.mean(axis=0), axis=1)))
    b = int(np.argmax(np.linalg.norm(v - v[a], axis=1)))
    return [a, b, int(np.argmax(np.linalg.norm(np.cross(v - v[a], v[b] - v[a]), axis=1)))]
