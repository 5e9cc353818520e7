r"""The motion that brings points onto others: of n points by least squares, of three in closed form.

Points v_i of one frame and u_i of another, with weights w_i, and the motion T = (R, t) of

    min sum w_i |u_i - (R v_i + t)|^2

With the weighted means u', v' and M = sum w_i (u_i - u') (v_i - v')' = U S V', S falling,

    R = U diag(1, .., det(U) det(V)) V',   t = u' - R v'

Without the determinant the best orthogonal matrix may be a reflection. Of coplanar points, as three always are, it is
one in about every other case. R is unique where S_2 + det(U) det(V) S_3 > 0 (in the plane S_1 + det S_2): points on one
line, or on one spot, leave a rotation free. S_3 = 0, a plane, is fine.

Three points also have a closed form. D(p) = [p_1 - p_2, p_1 - p_3, (p_1 - p_2) x (p_1 - p_3)] turns with the points,

    D(u) = R D(v),   R = D(u) D(v)^-1,   t = mean(u_i - R v_i)

and is regular where the points are not in line. From noisy points the product is no rotation; the one nearest to it is
taken, with the same determinant. The difference from the least-squares motion is of the size of the noise.

With a scale s as well, min sum w_i |u_i - (s R v_i + t)|^2, R is the same, and

    s = (S_1 + .. + det(U) det(V) S_d) / sum w_i |v_i - v'|^2,   t = u' - s R v'

With a rotation R_z(psi) about the third axis alone, as where gravity is known,

    tan psi = (M_21 - M_12) / (M_11 + M_22)

Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE PAMI 13(4),
1991; B. Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A 4, 1987; Z. Zhang, D.
Scaramuzza, "A tutorial on quantitative trajectory evaluation for visual(-inertial) odometry", IROS 2018 (one axis).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply
from models.errors import GraphError
from models.finite import finite
from models.manifolds.so3 import quaternion_from_matrix
from models.sensors.singular import refuse

__all__ = ["align", "align_similarity", "align_yaw", "three_points"]

UNIQUE = 1e-9  # of the largest singular value, a square: points within 3e-5 of their length of one line are refused


def align(u: npt.ArrayLike, v: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Array:
    """The motion T for which the points T v are nearest to the points u.

    Parameters
    ----------
    u, v : (..., n, 3) or (..., n, 2) points, m, the same n in the same order; the leading axes are a batch.
    weights : (..., n), not negative: 1 / sigma^2 of u_i - T v_i where that differs from point to point. A weight of 0
        leaves a point out, so that alignments of different sizes fit into one batch.

    Returns
    -------
    T : (..., 7) in SE3 or (..., 3) in SE2.

    Raises
    ------
    GraphError
        Shapes that do not fit; a number that is not finite, or whose square is not; a negative weight.
    SingularAt
        A `SingularGeometryError`: fewer than three points of space (two of the plane), or all on one line (spot). Its
        `index` is the alignment, counted over the batch.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE3
    >>> v = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
    >>> T = SE3.exp([1.0, 0.0, 0.5, 0.0, 0.0, 3.0])
    >>> np.allclose(align(SE3.act(T, v), v), T)
    True
    """
    u, v, w = _weighted("align", u, v, weights)
    M, u_mean, v_mean, _ = _moments(u, v, w)
    R, _ = _rotation(M, v.shape)
    return _motion(R, u_mean, v_mean)


def align_similarity(u: npt.ArrayLike, v: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> tuple[Array, Array]:
    """The motion T = (R, t) and the scale s for which the points s R v + t are nearest to the points u.

    Parameters
    ----------
    u, v, weights : as for `align`.

    Returns
    -------
    T : (..., 7) in SE3 or (..., 3) in SE2.
    s : (...) scale.

    Raises
    ------
    GraphError, SingularAt
        As for `align`.

    Examples
    --------
    >>> T, s = align_similarity([[5, 0], [5, 2], [3, 0]], [[0, 0], [1, 0], [0, 1]])
    >>> T.round(6) + 0.0, round(float(s), 6)
    (array([5.      , 0.      , 1.570796]), 2.0)
    """
    u, v, w = _weighted("align_similarity", u, v, weights)
    M, u_mean, v_mean, spread = _moments(u, v, w)
    R, trace = _rotation(M, v.shape)
    s = np.asarray(trace / spread)
    return _motion(R, u_mean, s[..., None] * v_mean), s


def align_yaw(u: npt.ArrayLike, v: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Array:
    """The motion T for which the points T v of space are nearest to the points u, turned about the third axis alone.

    Parameters
    ----------
    u, v, weights : as for `align`, points of space: the third axis is the vertical.

    Returns
    -------
    T : (..., 7) in SE3, its rotation about the third axis.

    Raises
    ------
    GraphError
        As for `align`; points of the plane, for which `align` is the same.
    SingularAt
        A `SingularGeometryError`: all points on one vertical line. Its `index` counts over the batch.

    Examples
    --------
    >>> align_yaw([[5, 0, 3], [5, 2, 3.0]], [[0, 0, 2], [2, 0, 2]]).round(6)
    array([5.    , 0.    , 1.    , 0.    , 0.    , 0.7071, 0.7071])
    """
    u, v, w = _weighted("align_yaw", u, v, weights)
    if v.shape[-1] != 3:
        raise GraphError(
            f"align_yaw: shape {v.shape}, expected (..., n, 3): points of space; those of the plane: align"
        )
    M, u_mean, v_mean, spread = _moments(u, v, w)
    cosine, sine = M[..., 0, 0] + M[..., 1, 1], M[..., 1, 0] - M[..., 0, 1]
    refuse(
        np.ravel(~(np.hypot(cosine, sine) > UNIQUE * np.maximum(spread, TINIEST))),
        f"{v.shape[-2]} points on one vertical line leave the yaw free; align more points, of another place",
    )
    psi = np.arctan2(sine, cosine)
    R = np.zeros((*psi.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(psi)
    R[..., 1, 0], R[..., 0, 1], R[..., 2, 2] = np.sin(psi), -np.sin(psi), 1.0
    return _motion(R, u_mean, v_mean)


def three_points(u: npt.ArrayLike, v: npt.ArrayLike) -> Array:
    """The motion T = (R, t), R = D(u) D(v)^-1, of three points of space.

    Parameters
    ----------
    u, v : (..., 3, 3) three points each, m, one per row; the leading axes are a batch.

    Returns
    -------
    T : (..., 7) in SE3, with T v = u for points without noise.

    Raises
    ------
    GraphError
        Shapes that do not fit; a number that is not finite, or whose square is not.
    SingularAt
        A `SingularGeometryError`: three points in line. Its `index` counts over the batch.

    Examples
    --------
    >>> three_points([[5, 0, 0], [5, 1, 0], [4, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]).round(6)
    array([5.    , 0.    , 0.    , 0.    , 0.    , 0.7071, 0.7071])
    """
    u, v = _points("three_points", u, v)
    if v.shape[-2:] != (3, 3):
        raise GraphError(f"three_points: shape {v.shape}, expected (..., 3, 3): three points of space, one per row")
    with np.errstate(over="ignore", invalid="ignore"):
        D_u, D_v = _frame(u), _frame(v)
    if not (np.isfinite(D_u).all() and np.isfinite(D_v).all()):
        raise GraphError("three_points: squares of these coordinates are beyond the largest number; expected m")
    for D in (D_u, D_v):
        sides = np.maximum(np.sum(D[..., 0] ** 2, axis=-1), np.sum(D[..., 1] ** 2, axis=-1))
        _refuse_line(np.sum(D[..., 2] ** 2, axis=-1), sides**2, v.shape)  # squares: (area / side^2)^2
    U, _, Vt = np.linalg.svd(np.matmul(D_u, np.linalg.inv(D_v)))
    return _motion(_proper(U, _determinant(U, Vt), Vt), u.mean(axis=-2), v.mean(axis=-2))


TINIEST = np.finfo(float).tiny


def _frame(p: Array) -> Array:
    """D(p) (..., 3, 3)."""
    a, b = p[..., 0, :] - p[..., 1, :], p[..., 0, :] - p[..., 2, :]
    return np.stack([a, b, np.cross(a, b)], axis=-1)


def _weighted(
    who: str, u: npt.ArrayLike, v: npt.ArrayLike, weights: npt.ArrayLike | None
) -> tuple[Array, Array, Array]:
    """Points, and their weights (..., n, 1), of which the largest is 1."""
    u, v = _points(who, u, v)
    w = np.ones(v.shape[-2]) if weights is None else finite(who, "weights", weights)
    if w.shape[-1:] != v.shape[-2:-1] or np.ndim(w) >= v.ndim or (w < 0).any():
        raise GraphError(f"{who}: weights have shape {w.shape}, expected {v.shape[:-1]}, and none below 0")
    w = w / np.maximum(w.max(axis=-1, keepdims=True, initial=0.0), TINIEST)
    return u, v, np.broadcast_to(w, v.shape[:-1])[..., None]


def _moments(u: Array, v: Array, w: Array) -> tuple[Array, Array, Array, Array]:
    """M (..., d, d), the means u' and v' (..., d), and sum w |v - v'|^2 (...)."""
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
        total = np.maximum(w.sum(axis=-2, keepdims=True), TINIEST)
        u_mean, v_mean = (w * u).sum(axis=-2, keepdims=True) / total, (w * v).sum(axis=-2, keepdims=True) / total
        M = np.matmul((w * (u - u_mean)).mT, v - v_mean)
        spread = (w * np.square(v - v_mean)).sum(axis=(-2, -1))
    if not (np.isfinite(M).all() and np.isfinite(spread).all()):
        raise GraphError("align: squares of these coordinates are beyond the largest number; expected m, below 1e150")
    return M, u_mean[..., 0, :], v_mean[..., 0, :], spread


def _rotation(M: Array, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """R = U diag(1, .., sign) V' of M = U S V', and sum S with that sign on the last."""
    U, S, Vt = np.linalg.svd(M)
    sign = _determinant(U, Vt)
    _refuse_line(S[..., -2] + sign * S[..., -1], S[..., 0], shape)
    return _proper(U, sign, Vt), np.asarray(S[..., :-1].sum(axis=-1) + sign * S[..., -1])


def _determinant(U: Array, Vt: Array) -> Array:
    """det(U) det(V), 1 or -1."""
    return np.asarray(np.sign(np.linalg.det(U) * np.linalg.det(Vt)))


def _proper(U: Array, sign: Array, Vt: Array) -> Array:
    """U diag(1, .., sign) V'."""
    diagonal = np.ones((*np.shape(sign), U.shape[-1]))
    diagonal[..., -1] = sign
    return np.asarray(np.matmul(U, diagonal[..., None] * Vt))


def _motion(R: Array, u: Array, v: Array) -> Array:
    """(R, u - R v) in the stored form of SE2 or SE3."""
    t = u - apply(R, v)
    if R.shape[-1] == 2:
        return np.concatenate([t, np.arctan2(R[..., 1, :1], R[..., 0, :1])], axis=-1)
    return np.concatenate([t, quaternion_from_matrix(R)], axis=-1)


def _refuse_line(second: Array, first: Array, shape: tuple[int, ...]) -> None:
    """Refuse points whose spread across the longest line is nothing beside that along it."""
    (n, d), bad = shape[-2:], ~(second > UNIQUE * np.maximum(first, TINIEST))
    spot = d == 2 or not np.any(np.where(bad, first, 0.0) > 0)
    refuse(
        np.ravel(bad),
        f"{n} points on one {'spot' if spot else 'line'} leave a rotation free; align more points, of another place",
    )


def _points(who: str, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[Array, Array]:
    """Two stacks of points of one shape."""
    U, V = finite(who, "u", u), finite(who, "v", v)
    if U.shape != V.shape or V.ndim < 2 or V.shape[-1] not in (2, 3) or not V.shape[-2]:
        raise GraphError(f"{who}: shapes {U.shape} and {V.shape}, expected the same: (..., n, 3) or (..., n, 2)")
    return U, V
