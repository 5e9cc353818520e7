"""Tracks: which sightings are taken for one target. A track is named by the lowest number of its sightings.

A partition of n sightings is an array (n,) of such names, so that every sighting alone is ``np.arange(n)``.

Tracks of which pairs of sightings fit are merged where nothing else contradicts; what is doubtful stays apart. Two
tracks that share a ping are two targets. A track b that fits several landmarks a is joined with the nearest only where
the others fit that one, too. Then they may be one target in pieces. Otherwise the choice waits for the measurements of
a later round. In the end a track that nothing needs is none.
"""

import numpy as np

from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_tail
from nls.sparse.elimination import connected


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


def linked(c: Index, d: Index, d2: Array, lag: Index, n: int, gate: float) -> Index:
    """Tracks (n,) of sightings linked with those of following pings.

    Parameters
    ----------
    c, d, d2 : (k,) a sighting, one of a later ping, and how far this is from the arc of the first.
    lag : (k,) how many pings lie between them: every lag is judged by itself.
    n : number of sightings.
    gate : bound on d2.

    Examples
    --------
    Sighting 1 fits 3 and, as well, 4; 0 fits 2 alone:

    >>> c, d = np.array([0, 1, 1]), np.array([2, 3, 4])
    >>> linked(c, d, np.array([0.5, 1.0, 1.2]), np.ones(3, dtype=int), n=5, gate=9.0)
    array([0, 1, 0, 3, 4])
    """
    inside = d2 < gate
    c, d, d2, lag = c[inside], d[inside], d2[inside], lag[inside]
    clear = _clear(c, lag, d2) & _clear(d, lag, d2)
    return joined(np.arange(n), c[clear], d[clear])


def _clear(sighting: Index, lag: Index, d2: Array) -> Mask:
    """Which pairs (k,) are the best of their sighting and lag, by more than 4 of d2: no other is as good."""
    order = np.lexsort((d2, lag, sighting))
    same = (np.diff(sighting[order]) == 0) & (np.diff(lag[order]) == 0)
    rival = np.append(np.where(same, d2[order][1:], np.inf), np.inf)[: len(order)]
    clear = np.zeros(len(order), dtype=bool)
    clear[order] = np.append(True, ~same)[: len(order)] & (rival > d2[order] + 4.0)
    return clear


def merged(tracks: Index, ping: Index, b: Index, a: Index, d2: Array, gate: float) -> Index:
    """Tracks (n,), joined where sightings of them fit, until no other two do.

    Parameters
    ----------
    tracks : (n,), the number of the track of each sighting.
    ping : (n,) of the sightings.
    b, a, d2 : (k,) the track of a sighting, another track, and how far the sighting is from that one's target. Any
        sighting names its track.
    gate : bound on d2.

    Examples
    --------
    Track 0 was seen in pings 1 and 2, sighting 2 in ping 3 fits it:

    >>> merged(np.array([0, 0, 2]), np.array([1, 2, 3]), np.array([2]), np.array([0]), np.array([0.5]), 9.0)
    array([0, 0, 0])
    """
    while True:
        before = tracks
        tracks = _merged_once(before, ping, before[b], before[a], d2, gate)
        if np.array_equal(tracks, before):
            return tracks


def merged_both_ways(tracks: Index, ping: Index, c: Index, d: Index, d2: Array, gate: float) -> Index:
    """As `merged`, where sighting c (k,) fits the target of sighting d (k,), and d fits that of c."""
    return merged(tracks, ping, np.concatenate([c, d]), np.concatenate([d, c]), np.concatenate([d2, d2]), gate)


def continued(tracks: Index, pieces: Index, ping: Index, stretch: Index) -> Index:
    """Tracks (n,) of single stretches, joined where a piece goes on from one stretch to the next.

    Parameters
    ----------
    tracks, pieces : (n,) tracks of stretches, and those of sightings that were linked.
    ping, stretch : (n,) of the sightings.

    Examples
    --------
    Sightings 0 to 3 were linked, and 4 is alone:

    >>> continued(np.array([0, 0, 2, 2, 4]), np.zeros(5, dtype=int), np.arange(5), np.array([0, 0, 1, 1, 1]))
    array([0, 0, 0, 0, 4])
    """
    several = np.flatnonzero(sizes(tracks) > 1)
    order = several[np.lexsort((ping[several], pieces[several]))]
    c, d = order[:-1], order[1:]
    on = (pieces[c] == pieces[d]) & (stretch[c] != stretch[d])
    c, d = c[on], d[on]
    return merged_both_ways(tracks, ping, c, d, np.zeros(len(c)), np.inf)


def _merged_once(tracks: Index, ping: Index, b: Index, a: Index, d2: Array, gate: float) -> Index:
    """Tracks (n,), each joined with one other at most."""
    b, a, cost = _fitting(tracks, ping, b, a, d2, gate)
    n = len(tracks)
    first = np.append(True, b[1:] != b[:-1])[: len(b)]
    best = np.maximum.accumulate(np.where(first, np.arange(len(b)), 0))  # the pair of least cost of the same b
    rival = ~first & ~np.isin(a[best] * n + a, np.append(b * n + a, a * n + b))
    owner, by_cost = np.full(n, -1), np.argsort(-cost, kind="stable")
    owner[a[by_cost]] = b[by_cost]  # the track that fits a best
    taken = rival & (owner[a] != b)
    rival[taken] = ~share_a_ping(tracks, ping, b[taken], owner[a[taken]])  # a is of that other track
    clear = first & (np.bincount(best, rival, len(b)) == 0)
    b, a = b[clear], a[clear]
    size = sizes(tracks)
    both = np.isin(a * n + b, b * n + a) | ((size[b] == 1) & (size[a] > 1))  # a sighting alone is no landmark
    return joined(tracks, b[both], a[both])


def _fitting(tracks: Index, ping: Index, b: Index, a: Index, d2: Array, gate: float) -> tuple[Index, Index, Array]:
    """Pairs of tracks b and a that may be one target, with the mean d2 of the sightings; by b, then by that."""
    n, other = len(tracks), a != b
    pairs, pair = np.unique(b[other] * n + a[other], return_inverse=True)
    d2, tested = d2[other], np.bincount(pair, minlength=len(pairs))
    cost = np.bincount(pair, np.minimum(d2, 4 * gate), len(pairs)) / tested
    fit = (np.bincount(pair, d2 < gate, len(pairs)) >= 0.7 * tested) & (cost < gate)  # most sightings of a track
    fit[fit] = ~share_a_ping(tracks, ping, pairs[fit] // n, pairs[fit] % n)
    pairs, cost = pairs[fit], cost[fit]
    order = np.lexsort((cost, pairs // n))
    return pairs[order] // n, pairs[order] % n, cost[order]


def superfluous(tracks: Index, d: Index, landmarks: Index, d2: Array, dim: int, probability: float) -> Mask:
    """Sightings (n,) of tracks that nothing needs: all sightings of such a one fit landmarks of larger tracks.

    Parameters
    ----------
    tracks : (n,).
    d, landmarks, d2 : (k,) a sighting, the track of a landmark that is free in its ping, and how far it is from that.
    dim : numbers of a sighting.
    probability : with which noise explains the sum of these d2 of a track that is none.

    Examples
    --------
    Of track 3 one sighting fits track 0, one track 5:

    >>> tracks = np.array([0, 0, 0, 3, 3, 5, 5, 5])
    >>> superfluous(tracks, np.array([3, 4]), np.array([0, 5]), np.array([1.0, 2.0]), 2, 0.999).nonzero()[0]
    array([3, 4])
    """
    n, size = len(tracks), np.bincount(tracks, minlength=len(tracks))
    other = size[tracks[d]]
    larger = (size[landmarks] > other) | ((size[landmarks] == other) & (landmarks < tracks[d]))

    def explained(stays: Mask) -> Mask:
        use = larger & stays[landmarks]
        least = np.full(n, np.inf)
        np.minimum.at(least, d[use], d2[use])
        total = np.asarray(np.bincount(tracks, least, n), dtype=np.float64)
        return (chi2_tail(total, dim * size) > 1 - probability) & (size > 1)

    return explained(~explained(np.ones(n, dtype=bool)))[tracks]
