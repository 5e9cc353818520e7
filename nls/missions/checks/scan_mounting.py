r"""Where the sensor sits and how late its clock is, from scans of consecutive keyframes against dead reckoning.

The scans were placed on the vehicle with the assumed mounting. With a motion G that takes it to the true one, scan j as
seen from scan i is

    z = (X_i Exp(-w_i c) G)^-1 (X_j Exp(-w_j c) G)

with the twist w of the vehicle by dead reckoning and the time c by which the stamps of the scans are late. This is the
calibration of a sensor against odometry: A. Censi, A. Franchi, L. Marchionni, G. Oriolo, "Simultaneous calibration of
odometry and sensor parameters for mobile robots", IEEE Trans. Robotics 29(2), 2013.

- x and y of G change z by (R(turn) - I) G: a lever arm shows in steps that turn, and in no other.
- yaw of G turns the way of every step, exactly as a drift to the side does. So it is determined as well as that drift.
- c changes z by (w_j - w_i) c: a late clock shows where speed or rate of turn change.

Closures say little of it. The graph follows them to the way of the sensor, and submaps that are built from there agree
with it. With a sensor 1 m off, closures of the third round ask for 0.1 m of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import BetweenSensors, Cauchy, Covariance, Diagonal, Isotropic, Prior, Robust, Shifted
from factors.base import Factor
from factors.keys import Keys, kinds
from models import SE2, R
from models.algebra import Array, Index
from models.errors import GraphError
from nls.analysis.clock import central_differences
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.scans.correlation import Field, match
from nls.missions.scans.matches import ACCEPTED, MatchTable, verdicts
from nls.missions.scans.scans import Scans
from nls.values import Values

PRIOR = (2.0, 2.0, float(np.radians(10.0)), 10.0)  # sigmas of x, y, m, yaw, rad, and time, s, before the scans
COMPONENTS = ("x", "y", "yaw", "time")
SIGMAS = 3.0  # from the assumed value, above which a component is wrong, where it is by as much as LIMITS
LIMITS = (0.5, 0.5, float(np.radians(3.0)), 0.5)  # m, rad, s: 1 m costs 0.3 m of a map, 1 s all of it
x, m, mount, clock = kinds("x", "m", "scans_mount", "scans_clock_s")


@dataclass(frozen=True)
class Mounting:
    """Where the sensor sits, from the assumed place on, and how late its clock is.

    Attributes
    ----------
    steps : matched scans of consecutive keyframes.
    value, sigma : (4,) x, y, m, yaw, rad, and time, s. nan for a time without stamps.
    sigma_before : (4,) without the scans.
    mount : (3,) assumed pose of the sensor with the correction.
    drift : correlation of yaw with the drift to the side, nan where the graph has no drift m.
    lateral : yaw that is missing if nothing drifts to the side, and its sigma, rad; nan where the graph has no drift m.
    """

    steps: int
    value: Array
    sigma: Array
    sigma_before: Array
    mount: Array
    drift: float
    lateral: tuple[float, float]

    @property
    def share(self) -> Array:
        """(4,) part of the sigma before that is left: 1 where the scans say nothing."""
        return self.sigma / self.sigma_before

    @property
    def determined(self) -> npt.NDArray[np.bool_]:
        """(4,) whether the scans leave less than 0.9 of the sigma before."""
        return np.asarray(self.share <= 0.9)

    @property
    def wrong(self) -> npt.NDArray[np.bool_]:
        """(4,) whether a component is determined, and far from the assumed one: by 3 sigmas, and by what matters."""
        return self.determined & (np.abs(self.value) > np.maximum(SIGMAS * self.sigma, LIMITS))


def mounting(graph: FactorGraph, values: Values, scans: Scans, times: npt.ArrayLike | None = None) -> Mounting:
    """Estimate where the sensor sits and how late its clock is.

    Parameters
    ----------
    graph, values : keyframes x (SE2) and their dead reckoning, see `nls.missions.scans.dead_reckoning`.
    scans : as placed by the assumed mounting.
    times : (count,) of the keyframes, s, rising. Without them the clock is taken for right.

    Raises
    ------
    GraphError
        Times that are not one rising number for every keyframe.

    Notes
    -----
    A late clock bends the scans of a vehicle that turns, and with them the mounting: correct it first, and estimate
    again.
    """
    poses = values[x]
    stamps = None if times is None else np.asarray(times, dtype=float)
    shape = (len(poses),)
    if stamps is not None and (stamps.shape != shape or not np.isfinite(stamps).all() or (np.diff(stamps) <= 0).any()):
        expected = f"expected one rising number for each of {len(poses)} keyframes, s"
        raise GraphError(f"times: shape {stamps.shape}; {expected}")
    i, pose, covariance = neighbors(poses, scans)
    start = values.copy()
    start.add(mount, SE2, np.zeros((1, 3)))
    factors: list[Factor] = [*graph.factors, Prior(mount[0], np.zeros((1, 3)), Diagonal(list(PRIOR[:3])))]
    if len(i):
        noise = Robust(Covariance(covariance), Cauchy(2.0))  # some matches of single scans are wrong
        shown: Factor = BetweenSensors(x[i], x[i + 1], pose, noise, mount[0])
        if stamps is not None:
            w = central_differences(SE2, poses, stamps)
            H = shown.predict((SE2, SE2, SE2), poses[i], poses[i + 1], np.zeros((len(i), 3)))[1]
            assert H is not None
            rates = -np.matvec(np.asarray(H[0]), w[i]) - np.matvec(np.asarray(H[1]), w[i + 1])
            shown = Shifted(shown, rates[:, :, None], clock[0])
        factors.append(shown)
    if stamps is not None:
        start.add(clock, R(1), np.zeros((1, 1)))
        factors.append(Prior(clock[0], [[0.0]], Isotropic(PRIOR[3])))
    whole = FactorGraph(factors, graph.fixed)
    result = whole.optimize(start)
    keys = [mount[0], *([m[0]] if _drifts(values) else []), *([clock[0]] if stamps is not None else [])]
    return _read(result.values, Marginals(whole, result.values), keys, len(i), scans)


def lateral_drift(graph: FactorGraph, values: Values) -> tuple[float, float]:
    """The mean drift to the side and its sigma, m for every meter; nan where the graph has no drift m."""
    if not _drifts(values):
        return float("nan"), float("nan")
    sigma = np.sqrt(Marginals(graph, values).covariance(m[0])[1, 1])
    return float(values[m][0, 1]), float(sigma)


def _drifts(values: Values) -> bool:
    """Whether the mean drift m of `dead_reckoning` is among the values."""
    return m.name in values.stacks and values.stack(m).manifold is R(2)


def _read(values: Values, marginals: Marginals, keys: list[Keys], steps: int, scans: Scans) -> Mounting:
    C = marginals.joint(keys, frame="body").matrix
    drifts, timed = m[0] in keys, clock[0] in keys
    G, s = values[mount][0], np.sqrt(np.diagonal(C))
    value, sigma = np.append(G, values[clock][0] if timed else np.nan), np.append(s[:3], s[-1] if timed else np.nan)
    correlation, lateral = float("nan"), (float("nan"), float("nan"))
    if drifts:
        correlation = float(C[2, 4] / (s[2] * s[4]))
        lateral = float(G[2] + values[m][0, 1]), float(np.sqrt(C[2, 2] + C[4, 4] + 2 * C[2, 4]))
    placed = SE2.compose(G[None], scans.mount[None])[0]
    return Mounting(steps, value, sigma, np.array(PRIOR), placed, correlation, lateral)


def neighbors(poses: Array, scans: Scans) -> tuple[Index, Array, Array]:
    """Matched scans of consecutive keyframes, from poses (count, 3); those that are ambiguous are left out.

    Returns
    -------
    i : (n,) keyframes, matched with the next ones j.
    pose : (n, 3) of j in the frame of i, x, y, m, and yaw, rad; of vehicle frames that belong to the assumed mounting.
    covariance : (n, 3, 3) in the frame of j.
    """
    i, window = _chosen(*turns(poses, scans)), (2.0, 0.35)  # m, rad: a clock that is 3 s late at 7 deg/s
    fits = match_steps(poses, scans, i, window)
    good = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, np.full(len(i), window[0])) == ACCEPTED
    return i[good], fits.pose[good], 2 * fits.covariance[good]  # a scan is in two matches


def turns(poses: Array, scans: Scans) -> tuple[Index, Array]:
    """Keyframes i (n,) whose scan and the next one have 30 points, and the turns (n,) to i + 1, rad, 0 or above."""
    enough = np.diff(scans.starts) >= 30
    i = np.flatnonzero(enough[:-1] & enough[1:])
    return i, np.abs(SE2.between(poses[i], poses[i + 1])[:, 2])


def match_steps(poses: Array, scans: Scans, i: Index, window: tuple[float, float]) -> MatchTable:
    """Scans of keyframes i + 1 matched with those of keyframes i (n,), around the steps of poses (count, 3)."""
    S = SE2.between(poses[i], poses[i + 1])
    pairs = zip(i.tolist(), S, strict=True)
    return MatchTable.of([match(Field(scans[k]), scans[k + 1], T, window) for k, T in pairs])


def _chosen(i: Index, turn: Array, half: int = 200) -> Index:
    """Of steps i (n,) half with the largest turns (n,), which show a lever arm and a late clock, half of the rest."""
    if len(i) <= 2 * half:
        return i
    order = np.argsort(-turn, kind="stable")
    rest = np.sort(order[half:])
    return np.sort(i[np.append(order[:half], rest[np.linspace(0, len(rest) - 1, half).astype(np.intp)])])
