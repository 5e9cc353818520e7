r"""How far an estimated trajectory is from the true one, in meters, after a named alignment.

The absolute trajectory error compares positions, pose by pose, after one motion T = (R, t) of the whole estimate:

    e_i = q_i - (R p_i + t),   rmse = sqrt(sum |e_i|^2 / n),   p estimated, q true

- ``none``: T is the identity: both are in one frame, and every error counts
- ``first``: T = Q_0 o P_0^-1 takes the first estimated pose to the first true one: drift from the start
- ``rigid``: the T of least rmse: the shape of the trajectory alone

The last is that of `models.alignment`. No scale is estimated: sonar and odometry measure meters.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models import SE2, SE3, LieGroup
from models.algebra import Array
from models.alignment import align
from models.errors import GraphError, OptionError, SingularGeometryError
from models.finite import numbers
from models.sensors import SingularAt

__all__ = ["ALIGNMENTS", "TrajectoryError", "ate", "displacements"]

ALIGNMENTS = ("none", "first", "rigid")


@dataclass(frozen=True)
class TrajectoryError:
    """Absolute trajectory error; ``print`` gives the sentence with its alignment.

    Attributes
    ----------
    rmse, mean, largest : of the distances, m.
    align : the alignment, one of `ALIGNMENTS`.
    T : (3,) or (7,) the motion in SE2 or SE3 that was applied to the estimate.
    distances : (n,) array, m.
    """

    rmse: float
    mean: float
    largest: float
    align: str
    T: Array = field(repr=False)
    distances: Array = field(repr=False)

    def __str__(self) -> str:
        return (
            f"ATE {self.rmse:.4g} m rmse, {self.mean:.4g} m mean, {self.largest:.4g} m at most over "
            f"{len(self.distances)} poses (alignment: {self.align})"
        )


def ate(estimate: npt.ArrayLike, truth: npt.ArrayLike, align: str = "none") -> TrajectoryError:
    """Absolute trajectory error of poses, pose by pose.

    Parameters
    ----------
    estimate, truth : (n, 3) SE2 or (n, 7) SE3, the same n poses in the same order. Of the orientations only those of
        the first poses matter, and only for ``first``.
    align : ``none``, ``first`` or ``rigid``, see the module.

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
        ``rigid`` over positions that do not determine the rotation: all on one spot, or on one line of space.

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
    P, Q = (np.atleast_2d(numbers("ate", name, X)) for name, X in (("estimate", estimate), ("truth", truth)))
    group = {3: SE2, 7: SE3}.get(P.shape[-1])
    if group is None or P.shape != Q.shape or P.ndim != 2 or not len(P):
        raise GraphError(f"ate: shapes {P.shape} and {Q.shape}, expected the same: (n, 3) for SE2 or (n, 7) for SE3")
    P, Q = group.stack(P), group.stack(Q)
    p, q = group.position(P), group.position(Q)
    T = group.identity()
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
        if align == "first":
            T = group.compose(Q[:1], group.inverse(P[:1]))
        elif align == "rigid":
            T = _rigid(group, p, q)
        distances = np.linalg.norm(q - group.act(T, p), axis=1)
        rmse = float(np.sqrt(np.mean(distances**2)))
    if not np.isfinite(rmse):
        raise _too_far()
    return TrajectoryError(rmse, float(distances.mean()), float(distances.max()), align, T[0], distances)


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


def _rigid(group: LieGroup, p: Array, q: Array) -> Array:
    """The motion (1, size) that takes the points p (n, d) closest to q."""
    try:
        return align(q, p)[None]
    except SingularAt as error:
        shape = "on one spot" if group is SE2 else "on one line"
        raise SingularGeometryError(
            f"ate: {len(p)} positions {shape} do not determine the rotation of a rigid alignment; use align='first'"
        ) from error
    except GraphError as error:  # the positions are finite: their squares are not
        raise _too_far() from error
