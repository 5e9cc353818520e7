"""The points a sensor measured, keyframe by keyframe; submaps of neighboring keyframes, and which show the same place.

Pairs of submaps whose footprints overlap are matched, within three sigmas of their relative pose.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from models import SE2
from models.algebra import Array, Index
from models.errors import GraphError, OptionError
from models.finite import finite, numbers
from models.options import check_whole

SUBMAP_HALF = 4  # keyframes on either side of the middle of a submap
SUBMAP_STEP = 4  # keyframes from middle to middle
PARTNER_SPACING = 8  # keyframes of the track from which one partner of a submap is taken
MOST_PARTNERS = 8  # of one submap
FOOTPRINT_CELL = 5.0  # m, side of the cells in which footprints are compared


class Scans:
    """Points in the plane by keyframe: of an imaging sonar, a laser, any sensor that measures points.

    Parameters
    ----------
    points : (n, 2) x ahead and y to the side to which yaw turns, in the frame of the sensor, m.
    keyframe : (n,) number of the keyframe of each point, from 0.
    count : keyframes; those without points are allowed.
    mount : (3,) pose of the sensor on the vehicle, x, y, m, and yaw, rad.

    Attributes
    ----------
    points : (n, 2) in the frame of the vehicle, by keyframe.
    keyframe : (n,) ascending.
    starts : (count + 1,) the points of keyframe k are those from ``starts[k]`` to ``starts[k + 1]``.

    Raises
    ------
    GraphError
        Wrong shapes, numbers that are not finite, a keyframe outside 0 to count - 1.

    Examples
    --------
    >>> scans = Scans([[5.0, 0.0], [6.0, 1.0], [7.0, 0.0]], keyframe=[2, 0, 2], count=4, mount=[0.5, 0.0, 0.0])
    >>> scans
    Scans(3 points in 2 of 4 keyframes)
    >>> scans[2]
    array([[5.5, 0. ],
           [7.5, 0. ]])
    """

    def __init__(
        self, points: npt.ArrayLike, keyframe: npt.ArrayLike, count: int, mount: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        check_whole("count", count, 0)
        p, k, T = numbers("Scans", "points", points), np.asarray(keyframe), finite("Scans", "mount", mount)
        if p.ndim != 2 or p.shape[1:] != (2,) or k.shape != p.shape[:1] or T.shape != (3,):
            raise GraphError(
                f"Scans: points {p.shape}, keyframe {k.shape}, mount {T.shape}; expected (n, 2), (n,) and (3,)"
            )
        if bad := np.flatnonzero(~np.isfinite(p).all(axis=1)).tolist():
            raise GraphError(f"Scans: point {bad[0]} is {p[bad[0]].tolist()}; expected finite numbers, m")
        if len(k) and k.dtype.kind not in "iu":
            raise GraphError(f"Scans: keyframes of type {k.dtype}; expected whole numbers from 0 to {count - 1}")
        if len(k) and (k.min() < 0 or k.max() >= count):
            raise GraphError(f"Scans: keyframes {k.min()} to {k.max()}; expected whole numbers from 0 to {count - 1}")
        order = np.argsort(k, kind="stable")
        self.keyframe: Index = k[order].astype(np.intp)
        self.points: Array = SE2.act(np.broadcast_to(T, (len(p), 3)), p[order]) if len(p) else p
        self.starts: Index = np.searchsorted(self.keyframe, np.arange(count + 1))
        self.mount = T

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, k: int) -> Array:
        if not 0 <= k < len(self):
            raise IndexError(f"keyframe {k}; expected 0 to {len(self) - 1}")
        return self.points[self.starts[k] : self.starts[k + 1]]

    def __repr__(self) -> str:
        return f"Scans({len(self.points)} points in {int(self.with_points.sum())} of {len(self)} keyframes)"

    @property
    def with_points(self) -> npt.NDArray[np.bool_]:
        """(count,) whether a keyframe has points."""
        return np.diff(self.starts) > 0

    def at(self, mount: npt.ArrayLike) -> Scans:
        """The points of a sensor that is mounted elsewhere, (3,)."""
        return Scans(self._in_sensor, self.keyframe, len(self), mount)

    def mirrored(self) -> Scans:
        """The points with azimuths of the other sign."""
        return Scans(self._in_sensor * [1.0, -1.0], self.keyframe, len(self), self.mount)

    @property
    def _in_sensor(self) -> Array:
        back = SE2.inverse(self.mount[None])
        return SE2.act(np.broadcast_to(back, (len(self.points), 3)), self.points) if len(self.points) else self.points


def in_world(poses: Array, scans: Scans) -> Array:
    """All points (n, 2) in the world, seen from poses (count, 3)."""
    return SE2.act(poses[scans.keyframe], scans.points)


def submap(poses: Array, scans: Scans, center: int, half: int | tuple[int, int]) -> Array:
    """Points (n, 2) of the keyframes around one of them, in the frame of that one, m.

    Parameters
    ----------
    poses : (count, 3) of the keyframes, SE2.
    scans : their points.
    center : number of the keyframe in whose frame the points are.
    half : keyframes on either side of it; or how many before and after it, -1 after it for none and not its own.
        Those beyond the ends are left out.

    Raises
    ------
    OptionError
        No such keyframe; no keyframe at all.

    Examples
    --------
    >>> import numpy as np
    >>> scans = Scans([[5.0, 0.0], [4.0, 0.0]], keyframe=[0, 1], count=2)
    >>> submap(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), scans, center=1, half=1)
    array([[3., 0.],
           [4., 0.]])
    """
    before, after = (half, half) if isinstance(half, int) else half
    if not 0 <= center < len(scans):
        raise OptionError("center", center, f"a keyframe, 0 to {len(scans) - 1}")
    if before + after < 0:
        raise OptionError("half", half, "at least one keyframe")
    first, last = max(0, center - before), min(len(scans), center + after + 1)
    rows = slice(scans.starts[first], scans.starts[last])
    T = SE2.between(np.broadcast_to(poses[center], (last - first, 3)), poses[first:last])
    return np.asarray(SE2.act(T[scans.keyframe[rows] - first], scans.points[rows]))


def centers(scans: Scans) -> Index:
    """Middle keyframes (n,) of the submaps that have points enough."""
    k = np.arange(SUBMAP_HALF, len(scans) - SUBMAP_HALF, SUBMAP_STEP)
    count = scans.starts[k + SUBMAP_HALF + 1] - scans.starts[k - SUBMAP_HALF]
    return k[count >= 60]  # points enough


def pairs(poses: Array, scans: Scans, middle: Index) -> tuple[Index, Index]:
    """Earlier and later submap (n,) of each pair to be matched, as rows of `middle`.

    A submap is paired with those at least 20 keyframes before it whose footprint shares a quarter of the smaller one:
    nearer ones see the same and close no loop. Of every 8 keyframes the one of largest overlap is taken, 8 at most.
    """
    if len(middle) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    cells = _footprints(poses, scans, middle)
    shared = sp.coo_array(sp.triu(cells @ cells.T, k=1))
    size = cells.sum(axis=1)
    i, j, overlap = shared.row, shared.col, shared.data / np.minimum(size[shared.row], size[shared.col])
    good = (overlap >= 0.25) & (middle[j] - middle[i] >= 20)
    i, j, overlap = i[good], j[good], overlap[good]
    order = np.lexsort((-overlap, middle[i] // PARTNER_SPACING, j))
    i, j, overlap = i[order], j[order], overlap[order]
    first = np.unique(np.column_stack([j, middle[i] // PARTNER_SPACING]), axis=0, return_index=True)[1]
    i, j, overlap = i[first], j[first], overlap[first]
    order = np.lexsort((-overlap, j))
    i, j = i[order], j[order]
    rank = np.arange(len(j)) - np.searchsorted(j, j)
    return i[rank < MOST_PARTNERS].astype(np.intp), j[rank < MOST_PARTNERS].astype(np.intp)


def _footprints(poses: Array, scans: Scans, middle: Index) -> sp.csr_array:
    """(submaps, cells) 1 where a submap has a point in a cell of the world."""
    square = np.floor(in_world(poses, scans) / FOOTPRINT_CELL).astype(np.int64)
    cell = np.unique(square, axis=0, return_inverse=True)[1].ravel()
    by_scan = sp.csr_array((np.ones(len(cell)), (scans.keyframe, cell)), shape=(len(scans), int(cell.max()) + 1))
    around = middle[:, None] + np.arange(-SUBMAP_HALF, SUBMAP_HALF + 1)
    rows = np.repeat(np.arange(len(middle)), around.shape[1])
    members = sp.csr_array((np.ones(around.size), (rows, around.ravel())), shape=(len(middle), len(scans)))
    cells = (members @ by_scan).tocsr()
    cells.data[:] = 1.0
    return cells


def half_widths(relative: Array) -> Array:
    """Half widths (n, 2), m and rad, of the search for poses, by their covariances (n, 3, 3) from their partners."""
    variance = np.column_stack([np.linalg.eigvalsh(relative[:, :2, :2])[:, -1], relative[:, 2, 2]])
    sigma = np.sqrt(np.maximum(variance, 0.0))  # below 0 by rounding, where both poses are as good as one
    limits = (3.0, 20.0), (np.radians(3.0), np.radians(10.0))  # least and largest half width: m, rad
    return np.column_stack([np.clip(3.0 * sigma[:, k], *limits[k]) for k in range(2)])
