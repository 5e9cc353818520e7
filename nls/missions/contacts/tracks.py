"""Tracks: which sightings are taken for one target. A track is named by the lowest number of its sightings.

A partition of n sightings is an array (n,) of such names, so that every sighting alone is ``np.arange(n)``.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Index, Mask
from nls.sparse.elimination import connected

__all__ = [
    "joined",
    "largest",
    "moved",
    "once_per_ping",
    "parted",
    "renamed",
    "several",
    "share_a_ping",
    "single",
    "sizes",
]


def renamed(groups: Index) -> Index:
    """The tracks (n,) of any numbers (n,) for groups.

    Examples
    --------
    >>> renamed(np.array([7, 3, 7, 9]))
    array([0, 1, 0, 3])
    """
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    return np.asarray(first[group], dtype=np.intp)


def joined(tracks: Index, a: Index, b: Index) -> Index:
    """Tracks a (k,) joined with tracks b (k,), and all that hangs together so.

    Examples
    --------
    >>> joined(np.arange(4), np.array([0, 3]), np.array([2, 2]))
    array([0, 1, 0, 0])
    """
    return renamed(connected(a, b, len(tracks))[tracks])


def single(tracks: Index, sightings: Index | Mask) -> Index:
    """Some sightings taken out of their tracks, each alone.

    Examples
    --------
    >>> single(np.array([0, 0, 0, 3]), np.array([0]))
    array([0, 1, 1, 3])
    """
    groups = tracks.copy()
    groups[sightings] = len(tracks) + np.arange(len(tracks))[sightings]
    return renamed(groups)


def moved(tracks: Index, joined: Index) -> Mask:
    """Which sightings (n,) are new in their joined tracks (n,): all that are not of the largest track there.

    Examples
    --------
    >>> moved(np.array([0, 1, 1, 1, 4]), np.array([0, 0, 0, 0, 4]))
    array([ True, False, False, False, False])
    """
    main = np.zeros(len(tracks), dtype=np.intp)
    largest_ones = np.flatnonzero(largest(joined, sizes(tracks)))
    main[joined[largest_ones]] = tracks[largest_ones]
    return np.asarray(tracks != main[joined])


def once_per_ping(tracks: Index, ping: Index) -> Index:
    """A target is seen once in a ping (n,): of several sightings of a track there the first stays.

    Examples
    --------
    >>> once_per_ping(np.array([0, 0, 0]), np.array([5, 6, 6]))
    array([0, 0, 2])
    """
    order = np.lexsort((np.arange(len(tracks)), ping, tracks))
    again = np.zeros(len(tracks), dtype=bool)
    again[order[1:]] = (tracks[order[1:]] == tracks[order[:-1]]) & (ping[order[1:]] == ping[order[:-1]])
    return single(tracks, again)


def parted(tracks: Index, pieces: Index, sightings: Mask) -> Index:
    """Some sightings (n,) taken out of their tracks, those of one piece (n,) together.

    Examples
    --------
    >>> parted(np.zeros(4, dtype=int), np.array([0, 0, 2, 2]), np.array([False, False, True, True]))
    array([0, 0, 2, 2])
    """
    return renamed(np.where(sightings, len(tracks) + pieces, tracks))


def sizes(tracks: Index) -> Index:
    """How many sightings (n,) the track of each sighting has.

    Examples
    --------
    >>> sizes(np.array([0, 0, 2]))
    array([2, 2, 1])
    """
    return np.bincount(tracks, minlength=len(tracks))[tracks]


def several(tracks: Index, pieces: Index) -> Mask:
    """Which sightings (n,) are of a track of several pieces (n,).

    Examples
    --------
    >>> several(np.array([0, 0, 2]), np.array([0, 1, 2]))
    array([ True,  True, False])
    """
    n = len(tracks)
    return np.asarray(np.bincount(np.unique(tracks * n + pieces) // n, minlength=n)[tracks] > 1)


def share_a_ping(tracks: Index, ping: Index, a: Index, b: Index) -> Mask:
    """Which pairs (k,) of tracks a and b were seen in one ping, and so are two targets.

    Examples
    --------
    >>> share_a_ping(np.array([0, 1, 0, 3]), np.array([5, 5, 6, 6]), np.array([0, 1]), np.array([1, 3]))
    array([ True, False])
    """
    from scipy.sparse import csr_array

    n, pings = len(tracks), int(ping.max(initial=0)) + 1
    sightings = csr_array((np.ones(n), (tracks, ping)), shape=(n, pings))
    return np.asarray(sightings[a].multiply(sightings[b]).sum(axis=1)).reshape(-1) > 0


def largest(groups: Index, numbers: Array | Index) -> Mask:
    """Which (n,) is the largest number (n,) of every group (n,), one of each.

    Examples
    --------
    >>> largest(np.array([0, 2, 0, 2]), np.array([1.0, 8.0, 2.0, 5.0]))
    array([False,  True,  True, False])
    """
    order = np.lexsort((numbers, groups))
    chosen = np.zeros(len(groups), dtype=bool)
    chosen[order] = np.diff(groups[order], append=-1) != 0
    return chosen
