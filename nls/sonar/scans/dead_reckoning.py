"""Dead reckoning as it is: steps whose errors are shared by a stretch of the way, and a compass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import Between, Diagonal, DriftingStep, Heading, Isotropic, Prior
from factors.keys import kinds
from models import SE2, R
from models.errors import GraphError
from models.options import check_positive
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["Drift", "dead_reckoning"]

x, d, m = kinds("x", "d", "m")
STILL = 0.3  # m, the least length of a step for its noise: a vehicle that turns on the spot moves too


@dataclass(frozen=True)
class Drift:
    """How wrong dead reckoning is.

    Attributes
    ----------
    mean : sigma of the drift that the whole mission shares, m for every meter of the way.
    stretch : sigma of the drift of one stretch around it.
    length : of a stretch, m.
    step : sigma of x and y over a step of 1 m besides, m.
    yaw : sigma of the turn of a step, rad.
    heading : sigma of the compass, rad; None without one.
    """

    mean: float = 0.2
    stretch: float = 0.15
    length: float = 10.0
    step: float = 0.1
    yaw: float = 0.02
    heading: float | None = 0.05

    def __post_init__(self) -> None:
        check_positive(**{name: value for name, value in vars(self).items() if value is not None})


def dead_reckoning(poses: npt.ArrayLike, drift: Drift | None = None) -> tuple[FactorGraph, Values]:
    r"""The graph of a reckoned track with drifts as variables, and the track as its start.

    .. math:: z_k = (p_k + L_k d_{s(k)}, \psi_{k+1} - \psi_k), \quad d_s = m + w_s

    where :math:`d_s` is the drift of a stretch of the way and m that of the mission: commanded speeds have a bias,
    currents come and go. With independent steps instead, the sigma of a position grows with the root of the way, and is
    several times too small after 100 m.

    Parameters
    ----------
    poses : (n, 3) x, y, m, and yaw, rad, as reckoned; the heading is the compass's.
    drift : how wrong it is; the default is that of commanded speeds with a compass.

    Returns
    -------
    graph : over poses x (SE2), drifts d (R(2)) and their mean m; the first pose is fixed.
    values : the poses as reckoned, without drift.

    Raises
    ------
    GraphError
        Not (n, 3), fewer than two poses, numbers that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> way = np.column_stack([np.arange(31.0), np.zeros(31), np.zeros(31)])
    >>> graph, values = dead_reckoning(way)
    >>> len(values[x]), len(values[d])
    (31, 3)
    """
    X, drift = np.asarray(poses, dtype=float), drift or Drift()
    if X.ndim != 2 or X.shape[1] != 3 or len(X) < 2 or not np.isfinite(X).all():
        raise GraphError(f"dead_reckoning: poses of shape {X.shape}; expected (n, 3), at least two, finite numbers")
    z = SE2.between(X[:-1], X[1:])
    way = np.linalg.norm(z[:, :2], axis=1)
    stretch = np.floor((np.cumsum(way) - way) / drift.length).astype(np.intp)
    stretch = np.unique(stretch, return_inverse=True)[1]
    count, k = int(stretch.max()) + 1, np.arange(len(z))
    root = np.sqrt(np.maximum(way, STILL))
    noise = Diagonal(np.column_stack([drift.step * root, drift.step * root, np.full(len(z), drift.yaw)]))
    graph = FactorGraph(
        [
            DriftingStep(x[k], x[k + 1], d[stretch], z, noise, way),
            Between(m[[0] * count], d[np.arange(count)], np.zeros((count, 2)), Isotropic(drift.stretch)),
            Prior(m[0], np.zeros((1, 2)), Isotropic(drift.mean)),
        ]
    )
    if drift.heading is not None:
        graph.add(Heading(x[np.arange(len(X))], X[:, 2], Isotropic(drift.heading)))
    graph.fix(x[0])
    return graph, Values({x: (SE2, X), d: (R(2), np.zeros((count, 2))), m: (R(2), np.zeros((1, 2)))})
