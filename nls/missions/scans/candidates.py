"""Which submaps may show the same place, and how far around the present estimate a match of them is searched.

Pairs whose footprints overlap are matched, within three sigmas of their relative pose.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.missions.scans.scans import Scans, in_world

__all__ = ["centers", "half_widths", "pairs"]

HALF = 4  # keyframes on either side of the middle of a submap
STEP = 4  # keyframes from middle to middle
POINTS = 60  # least points of a submap
CELL = 5.0  # m, side of the cells in which footprints are compared
OVERLAP = 0.25  # least share of the smaller footprint
APART = 20  # keyframes between submaps at least: nearer ones see the same and close no loop
SPREAD = 8  # keyframes of the track from which one partner is taken
PARTNERS = 8  # of one submap at most
SIGMAS = 3.0  # of the relative pose
LIMITS = ((3.0, 20.0), (np.radians(3.0), np.radians(10.0)))  # least and largest half width: m, rad


def centers(scans: Scans) -> Index:
    """Middle keyframes (n,) of the submaps that have points enough."""
    k = np.arange(HALF, len(scans) - HALF, STEP)
    count = scans.starts[k + HALF + 1] - scans.starts[k - HALF]
    return k[count >= POINTS]


def pairs(poses: Array, scans: Scans, middle: Index) -> tuple[Index, Index]:
    """Earlier and later submap (n,) of each pair to be matched, as rows of `middle`.

    A submap is paired with those at least `APART` keyframes before it whose footprint overlaps with its own. Of every
    `SPREAD` keyframes the one of largest overlap is taken, `PARTNERS` at most.
    """
    if len(middle) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    cells = _footprints(poses, scans, middle)
    shared = sp.coo_array(sp.triu(cells @ cells.T, k=1))
    size = cells.sum(axis=1)
    i, j, overlap = shared.row, shared.col, shared.data / np.minimum(size[shared.row], size[shared.col])
    good = (overlap >= OVERLAP) & (middle[j] - middle[i] >= APART)
    i, j, overlap = i[good], j[good], overlap[good]
    order = np.lexsort((-overlap, middle[i] // SPREAD, j))
    i, j, overlap = i[order], j[order], overlap[order]
    first = np.unique(np.column_stack([j, middle[i] // SPREAD]), axis=0, return_index=True)[1]
    i, j, overlap = i[first], j[first], overlap[first]
    order = np.lexsort((-overlap, j))
    i, j = i[order], j[order]
    rank = np.arange(len(j)) - np.searchsorted(j, j)
    return i[rank < PARTNERS].astype(np.intp), j[rank < PARTNERS].astype(np.intp)


def _footprints(poses: Array, scans: Scans, middle: Index) -> sp.csr_array:
    """(submaps, cells) 1 where a submap has a point in a cell of the world."""
    cell = np.unique(np.floor(in_world(poses, scans) / CELL).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    by_scan = sp.csr_array((np.ones(len(cell)), (scans.keyframe, cell)), shape=(len(scans), int(cell.max()) + 1))
    around = middle[:, None] + np.arange(-HALF, HALF + 1)
    rows = np.repeat(np.arange(len(middle)), around.shape[1])
    members = sp.csr_array((np.ones(around.size), (rows, around.ravel())), shape=(len(middle), len(scans)))
    cells = (members @ by_scan).tocsr()
    cells.data[:] = 1.0
    return cells


def half_widths(relative: Array) -> Array:
    """Half widths (n, 2), m and rad, of the search for poses, by their covariances (n, 3, 3) from their partners."""
    variance = np.column_stack([np.linalg.eigvalsh(relative[:, :2, :2])[:, -1], relative[:, 2, 2]])
    sigma = np.sqrt(np.maximum(variance, 0.0))  # below 0 by rounding, where both poses are as good as one
    return np.column_stack([np.clip(SIGMAS * sigma[:, k], *LIMITS[k]) for k in range(2)])
