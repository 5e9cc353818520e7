"""Closing loops while the vehicle drives: every keyframe once, as it comes, and the estimate of all after each.

A submap is complete when the keyframes behind its middle have come. It is matched then with older ones whose footprints
overlap, in windows of three sigmas of their relative pose, as in `close`. A match that is accepted waits until as many
have come as are a part of those in the map; then all that ever were accepted are tested again (`nls.gnc`), and those
that are kept enter as one factor, in place of the one before. So nothing enters the map unjudged. Rejected matches come
back when the others agree with them, and each counts as its submaps are used by then. Each is matched once, by the
submaps as they were then.
"""

from dataclasses import fields

import numpy as np
import numpy.typing as npt

from factors import Factor, Isotropic, Prior
from factors.keys import kinds
from models import SE2, R
from models.algebra import Array, Index, Mask
from models.errors import OptionError
from models.options import check_positive
from nls.covariance.frames import of_motions
from nls.graph import FactorGraph
from nls.incremental import Incremental
from nls.missions.scans.closing import Matches, chosen
from nls.missions.scans.dead_reckoning import Drift, Reckoning
from nls.missions.scans.scans import FOOTPRINT_CELL, SUBMAP_HALF, SUBMAP_STEP, Scans, centers, half_widths, pairs
from nls.values import Values

x, d, m = kinds("x", "d", "m")


class OnlineClosing:
    """A map that closes its loops while keyframes come.

    Parameters
    ----------
    drift : how wrong dead reckoning is; the default is that of commanded speeds with a compass.
    mount : (3,) pose of the sensor on the vehicle, x, y, m, and yaw, rad.
    enough : how many new closures, as a part of those in the map, make all be tested again.

    Attributes
    ----------
    smoother : the estimate and its measurements, see `nls.Incremental`.
    reckoned : (n, 3) the keyframes as reckoned.

    Notes
    -----
    For the best map at the end, ``close(*dead_reckoning(online.reckoned, drift), online.scans)``: there all submaps are
    built, and all closures measured, from the better estimate.

    Examples
    --------
    >>> online = OnlineClosing()
    >>> for k in range(3):
    ...     pose = online.update([1.0 * k, 0.0, 0.0], points=[[5.0 - k, 2.0], [6.0 - k, 2.0]])
    >>> pose.round(3), len(online), len(online.scans[2])
    (array([2., 0., 0.]), 3, 2)
    """

    def __init__(
        self, drift: Drift | None = None, mount: npt.ArrayLike = (0.0, 0.0, 0.0), enough: float = 0.02
    ) -> None:
        check_positive(enough=enough)
        if not isinstance(drift, Drift | None):
            raise OptionError("drift", drift, "a Drift, or None")
        self.mount, self.enough = Scans(np.zeros((0, 2)), np.zeros(0, dtype=np.intp), 0, mount).mount, enough
        self.smoother = Incremental()
        self._reckoning = Reckoning(drift)
        self._reckoned: list[Array] = []
        self._points: list[Array] = []  # of every keyframe, in the frame of the sensor
        self._reach: list[float] = []  # of every scan, m from the vehicle
        self._matches: list[Matches] = []
        self._closures: Factor | None = None  # in the smoother
        self._kept: Mask = np.zeros(0, dtype=bool)  # of the accepted matches that were judged

    def __len__(self) -> int:
        return len(self._reckoned)

    def update(self, pose: npt.ArrayLike, points: npt.ArrayLike) -> Array:
        """Take the next keyframe.

        Parameters
        ----------
        pose : (3,) as reckoned: x, y, m, and yaw, rad.
        points : (n, 2) of its scan, x ahead and y to the side to which yaw turns, in the frame of the sensor, m; none
            where n is 0.

        Returns
        -------
        array (3,), its estimate.

        Raises
        ------
        GraphError
            Wrong shapes, numbers that are not finite.
        """
        new = np.array(points, dtype=float).reshape(-1, 2) if np.size(points) == 0 else np.array(points, dtype=float)
        scan = Scans(new, np.zeros(len(new), dtype=np.intp), 1, self.mount)
        reckoned = np.array(pose, dtype=float)
        factors = self._reckoning.add(reckoned[None])
        k = len(self)
        if k:
            step = SE2.between(self._reckoned[-1][None], reckoned[None])
            start = Values({x: (SE2, SE2.compose(self.smoother[x[k - 1]][None], step), [k])})
        else:
            factors.append(Prior(x[0], reckoned, Isotropic(1e-4)))
            start = Values({x: (SE2, reckoned[None]), d: (R(2), np.zeros((0, 2))), m: (R(2), np.zeros((1, 2)))})
        self.smoother.update(factors, start)
        self._reckoned.append(reckoned)
        self._points.append(new)
        self._reach.append(float(np.hypot(*scan.points.T).max(initial=0.0)))
        newest = k - SUBMAP_HALF
        if newest >= SUBMAP_HALF and (newest - SUBMAP_HALF) % SUBMAP_STEP == 0:
            self._close(newest)
        return np.asarray(self.smoother[x[k]])

    def judge(self) -> None:
        """Judge all accepted matches that have come; by itself that is done whenever enough have."""
        if (matches := self.matches) is None or not matches.accepted.any():
            return
        # steps have drifts besides, so relative poses alone are closures
        trusted = [f for f in self.smoother.graph.factors if [keys.kind for keys in f.keys] != ["x", "x"]]
        closures, _, self._kept = chosen(FactorGraph(trusted), self.smoother.values, matches)
        before, self._closures = self._closures, closures
        if closures is not None:
            self.smoother.update(closures)
        if before is not None:
            self.smoother.remove(before)  # after the new ones, which hold the map

    @property
    def poses(self) -> Array:
        """(n, 3) the estimate of the keyframes."""
        return self.smoother[x[np.arange(len(self))]]

    @property
    def reckoned(self) -> Array:
        return np.array(self._reckoned).reshape(-1, 3)

    @property
    def values(self) -> Values:
        """The estimate of poses x, drifts d and their mean m."""
        return self.smoother.values

    @property
    def graph(self) -> FactorGraph:
        """All measurements in the estimate, with the closures that are kept."""
        return self.smoother.graph

    @property
    def scans(self) -> Scans:
        """The points of all keyframes."""
        return self._scans(np.arange(len(self)))

    @property
    def matches(self) -> Matches | None:
        """All candidates so far, matched when the later of the two was new; None before the first."""
        if not self._matches:
            return None
        columns = (np.concatenate([getattr(part, column.name) for part in self._matches]) for column in fields(Matches))
        matches = Matches(*columns)
        matches.kept[np.flatnonzero(matches.accepted)[: len(self._kept)]] = self._kept
        return matches

    def __repr__(self) -> str:
        kept = int(self._kept.sum())
        closures = f"{kept} closures, {len(self._kept) - kept} rejected"
        return f"OnlineClosing({len(self)} keyframes, {closures}, {self._waiting} waiting)"

    @property
    def _waiting(self) -> int:
        """Accepted matches that are not tested yet."""
        return sum(int(part.accepted.sum()) for part in self._matches) - len(self._kept)

    def _scans(self, keyframes: Index) -> Scans:
        """The points of some keyframes, numbered as all are."""
        points = [self._points[k] for k in keyframes.tolist()]
        number = np.repeat(keyframes, [len(p) for p in points])
        return Scans(np.concatenate([np.zeros((0, 2)), *points]), number, len(self), self.mount)

    def _close(self, newest: int) -> None:
        """Match the submap around a keyframe with the older ones, and test when enough matches are accepted."""
        poses = self.poses
        scans, middle = self._near(poses, newest)
        if not len(middle) or middle[-1] != newest:
            return
        a, b = pairs(poses, scans, middle)
        i = middle[a[middle[b] == newest]]
        if not len(i):
            return
        self._matches.append(self._matched(poses, scans, i, newest))
        if self._waiting > self.enough * len(self._kept):
            self.judge()

    def _near(self, poses: Array, newest: int) -> tuple[Scans, Index]:
        """The scans whose submaps may overlap with one, and the middles of these, the one itself last."""
        around = np.arange(-SUBMAP_HALF, SUBMAP_HALF + 1)
        middle = np.arange(SUBMAP_HALF, newest + 1, SUBMAP_STEP)
        members, at = middle[:, None] + around, poses[:, :2]
        reach = (np.array(self._reach)[members] + np.linalg.norm(at[members] - at[middle, None], axis=2)).max(axis=1)
        distance = np.linalg.norm(at[middle] - at[newest], axis=1)
        near = middle[distance <= reach + reach[-1] + 2 * FOOTPRINT_CELL]
        scans = self._scans(np.unique(near[:, None] + around))
        return scans, np.intersect1d(near, centers(scans))

    def _matched(self, poses: Array, scans: Scans, i: Index, newest: int) -> Matches:
        """The submap around a keyframe, matched with those around older ones (n,)."""
        C = self.smoother.marginals().joint(x[np.append(i, newest)], frame="body").matrix
        C = C.reshape(len(i) + 1, 3, len(i) + 1, 3).transpose(0, 2, 1, 3)
        j, k = np.full(len(i), newest), np.arange(len(i))
        motion = SE2.between(poses[i], poses[j])
        relative = of_motions(SE2, motion, C[k, k], C[k, -1], C[[-1] * len(i), -1])
        return Matches.around(poses, scans, i, j, half_widths(relative))
