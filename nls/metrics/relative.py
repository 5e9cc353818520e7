r"""How fast an estimated trajectory drifts: errors of relative poses over a distance travelled.

    E_ij = (P_i^-1 P_j)^-1 (Q_i^-1 Q_j),   P estimated, Q true,   w_ij = way along Q from pose i to pose j
    translation = mean |t(E_ij)| / w_ij,   rotation = mean |angle(E_ij)| / w_ij

For every pose i, j is the first pose at which the vehicle has travelled the distance since. No alignment is needed:
relative poses are the same in every frame. KITTI divides by the distance itself. The way w_ij is longer by less than a
step; with it a scale error of 1 % is 1 % at every spacing of the poses. KITTI takes every tenth pose as i; here every
pose is one.

Source: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving?", CVPR 2012, and the development kit of
its odometry benchmark; J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, section V.A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models import SE3
from models.algebra import distance_along
from models.errors import GraphError, OptionError
from models.finite import finite
from nls.metrics.absolute import angle, group_of

__all__ = ["DISTANCES", "RelativeError", "rpe"]

DISTANCES = (10.0, 50.0, 100.0)  # m
ROUNDING = 1e-9  # of a distance: ten steps of 1 m are 10 m


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
        j = np.searchsorted(way, way + length * (1 - ROUNDING))
        i = np.flatnonzero(j < len(way))
        j = j[i]
        E = group.between(group.between(P[i], P[j]), group.between(Q[i], Q[j]))
        gone = way[j] - way[i]
        moved, turned = np.linalg.norm(group.position(E), axis=1), angle(E, group is SE3)
        means = (float(np.mean(v)) if len(i) else float("nan") for v in (gone, moved / gone, turned / gone))
        out.append(RelativeError(length, len(i), *means))
    return tuple(out)
