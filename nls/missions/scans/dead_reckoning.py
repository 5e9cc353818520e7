"""Dead reckoning as it is: steps whose errors are shared by a stretch of the way, and a compass."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import Between, Diagonal, DriftingStep, Factor, Heading, Isotropic, Prior
from factors.keys import kinds
from models import SE2, R
from models.algebra import Array
from models.errors import GraphError
from models.options import check_positive
from nls.graph import FactorGraph
from nls.values import Values

x, d, m = kinds("x", "d", "m")


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


class Reckoning:
    """The factors of dead reckoning, for any number of keyframes at a time.

    Parameters
    ----------
    drift : how wrong it is; the default is that of commanded speeds with a compass.

    Attributes
    ----------
    way : reckoned so far, m.
    stretches : begun so far; each has a drift.

    Examples
    --------
    >>> reckoning = Reckoning(Drift(heading=None))
    >>> reckoning.add([[0.0, 0.0, 0.0]])
    [Prior(m0)]
    >>> reckoning.add([[1.0, 0.0, 0.0]])
    [DriftingStep(x0, x1, d0), Between(m0, d0)]
    >>> reckoning.add([[2.0, 0.0, 0.0]])
    [DriftingStep(x1, x2, d0)]
    """

    def __init__(self, drift: Drift | None = None) -> None:
        self.drift = drift or Drift()
        self.way, self.stretches = 0.0, 0
        self._poses: Array = np.zeros((0, 3))  # the last one
        self._count, self._stretch = 0, -1  # keyframes; in lengths of a stretch, the way before the last step

    def add(self, poses: npt.ArrayLike) -> list[Factor]:
        """The factors of the next keyframes.

        Parameters
        ----------
        poses : (n, 3) as reckoned: x, y, m, and yaw, rad.

        Raises
        ------
        GraphError
            Not (n, 3), no pose, numbers that are not finite.
        """
        new, drift = np.asarray(poses, dtype=float), self.drift
        if new.ndim != 2 or new.shape[1] != 3 or not len(new) or not np.isfinite(new).all():
            raise GraphError(f"dead reckoning: poses of shape {new.shape}; expected (n, 3), finite numbers")
        X = np.concatenate([self._poses, new])
        first, begun = self._count - len(self._poses), not self._count
        z = SE2.between(X[:-1], X[1:])
        length = np.linalg.norm(z[:, :2], axis=1)
        way = np.cumsum(np.append(self.way, length))
        lengths = np.append(self._stretch, np.floor(way[:-1] / drift.length)).astype(np.intp)
        stretch = self.stretches - 1 + np.cumsum(lengths[1:] > lengths[:-1])
        fresh = np.arange(self.stretches, stretch[-1] + 1 if len(z) else self.stretches)
        k = first + np.arange(len(z))
        root = np.sqrt(np.maximum(length, 0.3))  # m: a vehicle that turns on the spot moves too
        noise = Diagonal(np.column_stack([drift.step * root, drift.step * root, np.full(len(z), drift.yaw)]))
        factors: list[Factor] = []
        if len(z):
            factors.append(DriftingStep(x[k], x[k + 1], d[stretch], z, noise, length))
        if len(fresh):
            zeros = np.zeros((len(fresh), 2))
            factors.append(Between(m[[0] * len(fresh)], d[fresh], zeros, Isotropic(drift.stretch)))
        if begun:
            factors.append(Prior(m[0], np.zeros((1, 2)), Isotropic(drift.mean)))
        if drift.heading is not None:
            factors.append(Heading(x[self._count + np.arange(len(new))], new[:, 2], Isotropic(drift.heading)))
        self.way, self.stretches, self._stretch = float(way[-1]), self.stretches + len(fresh), int(lengths[-1])
        self._count, self._poses = self._count + len(new), X[-1:]
        return factors


def dead_reckoning(poses: npt.ArrayLike, drift: Drift | None = None) -> tuple[FactorGraph, Values]:
    r"""The graph of a reckoned track with drifts as variables, and the track as its start.

    .. math:: z_k = (p_k + L_k d_{s(k)}, \psi_{k+1} - \psi_k), \quad d_s = m + w_s

    where :math:`d_s` is the drift of a stretch of the way and m that of the mission. Commanded speeds have a bias,
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
    X = np.asarray(poses, dtype=float)
    if len(X) < 2:
        raise GraphError(f"dead_reckoning: poses of shape {X.shape}; expected (n, 3), at least two, finite numbers")
    reckoning = Reckoning(drift)
    graph = FactorGraph(reckoning.add(X))
    graph.fix(x[0])
    return graph, Values({x: (SE2, X), d: (R(2), np.zeros((reckoning.stretches, 2))), m: (R(2), np.zeros((1, 2)))})
