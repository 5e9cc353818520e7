r"""How far an estimated trajectory is from the true one after a named alignment, and how fast it drifts.

The absolute trajectory error compares positions, pose by pose, after one motion T = (R, t) of the whole estimate:

    e_i = q_i - (s R p_i + t),   rmse = sqrt(sum |e_i|^2 / n),   p estimated, q true

- ``none``: T is the identity: both are in one frame, and every error counts
- ``first``: T = Q_0 o P_0^-1 takes the first estimated pose to the first true one: drift from the start
- ``yaw``: the T of least rmse whose rotation is about the vertical: roll and pitch are measured, by gravity
- ``rigid``: the T of least rmse: the shape of the trajectory alone
- ``similarity``: the T and the scale s of least rmse: the shape, whatever its size

The last three are those of `models.alignment`. s = 1 but for the last: sonar and odometry measure meters.

The rotation error is the angle of Q_i^-1 T P_i, its rmse as that of the distances.

Navigators state accuracy by the circle that holds 50 % or 95 % of the errors, and by 2DRMS:

    CEP(p) = the p-quantile of d_i,   d_i = sqrt(e_x^2 + e_y^2),   2DRMS = 2 sqrt(mean d_i^2)

Both are of the errors x and y, in the horizontal. CEP is counted, not computed from a normal distribution, so that
outliers count as they are. Of normal errors without correlation and of one sigma, CEP(0.5) is 1.177 sigma, CEP(0.95)
2.448 sigma and 2DRMS 2.828 sigma, which holds 98.2 %.

Drift is the error of relative poses over a distance travelled:

    E_ij = (P_i^-1 P_j)^-1 (Q_i^-1 Q_j),   P estimated, Q true,   w_ij = way along Q from pose i to pose j
    translation = mean |t(E_ij)| / w_ij,   rotation = mean |angle(E_ij)| / w_ij

For every pose i, j is the first pose at which the vehicle has travelled the distance since. No alignment is needed:
relative poses are the same in every frame. KITTI divides by the distance itself. The way w_ij is longer by less than a
step; with it a scale error of 1 % is 1 % at every spacing of the poses. KITTI takes every tenth pose as i; here every
pose is one.

Source: J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, sections V.A and V.B; Z.
Zhang, D. Scaramuzza, "A tutorial on quantitative trajectory evaluation for visual(-inertial) odometry", IROS 2018; F.
van Diggelen, "GPS accuracy: lies, damn lies, and statistics", GPS World 9(1), 1998; A. Geiger, P. Lenz, R. Urtasun,
"Are we ready for autonomous driving?", CVPR 2012, and the development kit of its odometry benchmark.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models import SE2, SE3, SO2, SO3, LieGroup
from models.algebra import Array, distance_along
from models.alignment import align, align_similarity, align_yaw
from models.errors import GraphError, OptionError, SingularGeometryError
from models.finite import finite, numbers
from models.options import check_between
from models.sensors import SingularAt

ALIGNMENTS = ("none", "first", "yaw", "rigid", "similarity")
DISTANCES = (10.0, 50.0, 100.0)  # m


@dataclass(frozen=True)
class TrajectoryError:
    """Absolute trajectory error; ``print`` gives the sentence with its alignment.

    Attributes
    ----------
    rmse, mean, largest : of the distances, m.
    rotation : rmse of the angles, rad.
    align : the alignment, one of `ALIGNMENTS`.
    T : (3,) or (7,) the motion in SE2 or SE3 that was applied to the estimate.
    distances : (n,) array, m.
    scale : that was applied to the estimate, 1 but for ``similarity``.
    errors : (n, 2) or (n, 3) array, e_i along the axes of the truth, m.
    angles : (n,) array, of the rotations that are left, 0 to pi, rad.
    """

    rmse: float
    mean: float
    largest: float
    align: str
    T: Array = field(repr=False)
    distances: Array = field(repr=False)
    scale: float
    errors: Array = field(repr=False)
    angles: Array = field(repr=False)

    @property
    def rotation(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.angles))))

    def __str__(self) -> str:
        scaled = f", scale {self.scale:.6g}" if self.align == "similarity" else ""
        return (
            f"ATE {self.rmse:.4g} m rmse, {self.mean:.4g} m mean, {self.largest:.4g} m at most over "
            f"{len(self.distances)} poses (alignment: {self.align}{scaled})"
        )


def ate(estimate: npt.ArrayLike, truth: npt.ArrayLike, align: str = "none") -> TrajectoryError:
    """Absolute trajectory error of poses, pose by pose.

    Parameters
    ----------
    estimate, truth : (n, 3) SE2 or (n, 7) SE3, the same n poses in the same order. Of the orientations only those of
        the first poses matter for the alignment, and only for ``first``.
    align : one of `ALIGNMENTS`, see the module. In the plane ``yaw`` is ``rigid``.

    Returns
    -------
    TrajectoryError

    Raises
    ------
    GraphError
        Different or wrong shapes, no poses, no numbers; errors beyond the largest number.
    OptionError
        No such alignment.
    SingularGeometryError
        ``yaw``, ``rigid`` or ``similarity`` over positions that do not determine the rotation. They are all on one spot
        or on one line of space, for ``yaw`` on one vertical line.

    Examples
    --------
    >>> import numpy as np
    >>> truth = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], dtype=float)
    >>> estimate = truth + [5.0, -2.0, 0.0]
    >>> print(ate(estimate, truth, align="rigid"))
    ATE ... m rmse, ... m mean, ... m at most over 3 poses (alignment: rigid)
    >>> round(ate(estimate, truth).rmse, 6), ate(estimate, truth, align="first").T.tolist()
    (5.385165, [-5.0, 2.0, 0.0])
    """
    if align not in ALIGNMENTS:
        raise OptionError("align", align, "one of " + ", ".join(ALIGNMENTS))
    group, P, Q = group_of("ate", estimate, truth)
    p, q = group.position(P), group.position(Q)
    T, scale = group.identity(), 1.0
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
        if align == "first":
            T = group.compose(Q[:1], group.inverse(P[:1]))
        elif align != "none":
            T, scale = _least(group, p, q, align)
        errors = q - group.act(T, scale * p)
        distances = np.linalg.norm(errors, axis=1)
        rmse = float(np.sqrt(np.mean(distances**2)))
    if not np.isfinite(rmse):
        raise _too_far()
    largest = float(distances.max())
    angles = angle(group.between(group.compose(T, P), Q), group is SE3)
    return TrajectoryError(rmse, float(distances.mean()), largest, align, T[0], distances, scale, errors, angles)


def angle(E: Array, space: bool) -> Array:
    """Angles (n,) of the rotations of motions, 0 to pi."""
    return np.asarray(np.linalg.norm(SO3.log(E[:, 3:]), axis=1) if space else np.abs(SO2.log(E[:, 2:])[:, 0]))


def group_of(who: str, estimate: npt.ArrayLike, truth: npt.ArrayLike) -> tuple[LieGroup, Array, Array]:
    """SE2 or SE3, and the poses of two trajectories (n, size), pose by pose.

    Raises
    ------
    GraphError
        Different or wrong shapes, no poses, no numbers.
    """
    P, Q = (np.atleast_2d(numbers(who, name, X)) for name, X in (("estimate", estimate), ("truth", truth)))
    group = {3: SE2, 7: SE3}.get(P.shape[-1])
    if group is None or P.shape != Q.shape or P.ndim != 2 or not len(P):
        raise GraphError(f"{who}: shapes {P.shape} and {Q.shape}, expected the same: (n, 3) for SE2 or (n, 7) for SE3")
    return group, group.stack(P), group.stack(Q)


def displacements(p: Array, q: Array) -> Array:
    """Distances (n,) of points q (n, d) from points p (n, d) after the rigid motion of least squares, m.

    Unlike `ate` it serves points on one line, where the rotation is not unique and the distances are.
    """
    p, q = p - p.mean(axis=0), q - q.mean(axis=0)
    U, _, Vt = np.linalg.svd(q.T @ p)
    U[:, -1] *= np.linalg.det(U) * np.linalg.det(Vt)  # a rotation, no reflection
    return np.asarray(np.linalg.norm(q - p @ (U @ Vt).T, axis=1))


def _too_far() -> GraphError:
    return GraphError(
        "ate: the squares of these positions are beyond the largest number; expected positions in meters, below 1e150"
    )


def _least(group: LieGroup, p: Array, q: Array, how: str) -> tuple[Array, float]:
    """The motion (1, size) and the scale that take the points p (n, d) closest to q."""
    try:
        if how == "similarity":
            T, scale = align_similarity(q, p)
            return T[None], float(scale)
        return (align_yaw if how == "yaw" and group is SE3 else align)(q, p)[None], 1.0
    except SingularAt as error:
        line = "a vertical line" if how == "yaw" else "one line"
        shape = "on one spot" if group is SE2 else f"on {line}"
        raise SingularGeometryError(
            f"ate: {len(p)} positions {shape} do not determine the rotation of the alignment {how}; use align='first'"
        ) from error
    except GraphError as error:  # the positions are finite: their squares are not
        raise _too_far() from error


def cep(errors: npt.ArrayLike, probability: float = 0.5) -> float:
    """Circular error probable: the radius about the truth that holds this share of the estimates, m.

    Parameters
    ----------
    errors : (n, 2) or (n, 3), m: x and y first, as `TrajectoryError.errors`. A third column does not count.
    probability : between 0 and 1; 0.95 gives R95.

    Raises
    ------
    GraphError
        Another shape, no errors, no finite numbers.
    OptionError
        A probability that is not between 0 and 1.

    Examples
    --------
    >>> cep([[3.0, 4.0], [0.0, 1.0], [0.0, 2.0]]), cep([[3.0, 4.0], [0.0, 1.0], [0.0, 2.0]], 0.95)
    (2.0, 4.7)
    """
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.95")
    return float(np.quantile(_horizontal("cep", errors), probability))


def drms2(errors: npt.ArrayLike) -> float:
    """2DRMS, twice the root mean square of the horizontal errors, m; parameters and errors as for `cep`.

    Examples
    --------
    >>> drms2([[3.0, 4.0], [0.0, 5.0]])
    10.0
    """
    return float(2 * np.sqrt(np.mean(np.square(_horizontal("drms2", errors)))))


def circles(errors: npt.ArrayLike) -> dict[str, float]:
    """Radii about the truth that hold half and 95 % of the horizontal errors, and twice their rms, m; as for `cep`.

    Examples
    --------
    >>> circles([[3.0, 4.0], [0.0, 5.0]])
    {'cep50_m': 5.0, 'cep95_m': 5.0, 'drms2_m': 10.0}
    """
    return {"cep50_m": cep(errors), "cep95_m": cep(errors, 0.95), "drms2_m": drms2(errors)}


def _horizontal(who: str, errors: npt.ArrayLike) -> Array:
    """Horizontal distances (n,)."""
    e = np.atleast_2d(finite(who, "errors", errors))
    if e.ndim != 2 or e.shape[1] not in (2, 3) or not len(e):
        raise GraphError(f"{who}: errors have shape {e.shape}, expected (n, 2) or (n, 3): x and y, or x, y and z")
    return np.asarray(np.hypot(e[:, 0], e[:, 1]))


@dataclass(frozen=True)
class RelativeError:
    """Errors of relative poses over one distance; ``print`` gives the sentence.

    Attributes
    ----------
    distance : travelled, m.
    pairs : how many pairs of poses are that far apart; 0 where the track is shorter.
    way : mean of the ways between them, m: the distance, and up to a step more; nan without pairs.
    translation : mean error over the way, a fraction; nan without pairs.
    rotation : mean error over the way, rad/m; nan without pairs.
    """

    distance: float
    pairs: int
    way: float
    translation: float
    rotation: float

    def __str__(self) -> str:
        if not self.pairs:
            return f"RPE over {self.distance:g} m: the track is shorter"
        return (
            f"RPE over {self.distance:g} m: {100 * self.translation:.3g} %, {np.degrees(self.rotation):.3g} deg/m "
            f"({self.pairs} pairs)"
        )


def rpe(
    estimate: npt.ArrayLike, truth: npt.ArrayLike, distances: Sequence[float] = DISTANCES
) -> tuple[RelativeError, ...]:
    """Relative pose error over distances travelled.

    Parameters
    ----------
    estimate, truth : (n, 3) SE2 or (n, 7) SE3, the same n poses in the order of time.
    distances : along the truth, m, above 0.

    Returns
    -------
    tuple of RelativeError
        One for each distance.

    Raises
    ------
    GraphError
        Different or wrong shapes, no poses, no numbers; a way beyond the largest number.
    OptionError
        A distance that is not above 0, or none.

    Examples
    --------
    >>> truth = np.zeros((31, 3))
    >>> truth[:, 0] = np.arange(31)
    >>> print(*rpe(1.01 * truth, truth, distances=[10, 50]), sep="\\n")
    RPE over 10 m: 1 %, 0 deg/m (21 pairs)
    RPE over 50 m: the track is shorter
    """
    group, P, Q = group_of("rpe", estimate, truth)
    lengths = np.atleast_1d(finite("rpe", "distances", distances))
    if lengths.ndim != 1 or not len(lengths) or not (lengths > 0).all():
        raise OptionError("distances", list(lengths.tolist()), "distances above 0, in meters")
    with np.errstate(over="ignore", invalid="ignore"):
        way = distance_along(group.position(Q))
    if not np.isfinite(way[-1]):
        raise GraphError("rpe: the way along the truth is beyond the largest number; expected positions in meters")
    out = []
    for length in lengths.tolist():
        j = np.searchsorted(way, way + length * (1 - 1e-9))  # rounding: ten steps of 1 m are 10 m
        i = np.flatnonzero(j < len(way))
        j = j[i]
        E = group.between(group.between(P[i], P[j]), group.between(Q[i], Q[j]))
        gone = way[j] - way[i]
        moved, turned = np.linalg.norm(group.position(E), axis=1), angle(E, group is SE3)
        means = (float(np.mean(v)) if len(i) else float("nan") for v in (gone, moved / gone, turned / gone))
        out.append(RelativeError(length, len(i), *means))
    return tuple(out)
