"""Which tracks are joined: rivals, pieces of one landmark, pings in common, and no matter in which order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.algebra import Index
from nls.missions.contacts.merging import continued, linked, merged, superfluous
from nls.missions.contacts.tracks import joined, renamed

GATE = 9.0
Fits = dict[tuple[int, int], float]


def joins(tracks: list[int], ping: list[int], fits: Fits) -> list[int]:
    """Tracks after `merged`; fits: of a track and the target of another, one sighting each."""
    b, a = np.array(list(fits), dtype=np.intp).reshape(-1, 2).T
    return merged(np.array(tracks), np.array(ping), b, a, np.array([*fits.values()]), GATE).tolist()


def mutual(fits: Fits) -> Fits:
    return fits | {(a, b): d2 for (b, a), d2 in fits.items()}


TRACKS, PING = [0, 0, 2, 2, 4, 4], [0, 1, 2, 3, 5, 6]  # three tracks of two


def test_two_tracks_are_joined_only_where_both_say_so() -> None:
    assert joins(TRACKS, PING, mutual({(0, 2): 1.0})) == [0, 0, 0, 0, 4, 4]
    assert joins(TRACKS, PING, {(0, 2): 1.0}) == TRACKS
    assert joins([0, 0, 2, 3], [0, 1, 2, 3], {(2, 0): 1.0}) == [0, 0, 0, 3]  # a sighting alone is no landmark
    assert joins([0, 1, 2], [0, 1, 2], {(1, 0): 1.0}) == [0, 1, 2]
    assert joins([0, 1, 2], [0, 1, 2], mutual({(1, 0): 1.0})) == [0, 0, 2]


@pytest.mark.parametrize(("d2", "together"), [(8.9, True), (9.1, False)])
def test_the_gate(d2: float, together: bool) -> None:
    assert (joins(TRACKS, PING, mutual({(0, 2): d2})) == [0, 0, 0, 0, 4, 4]) == together


def test_most_of_the_sightings_have_to_fit() -> None:
    tracks, ping = np.array([0, 0, 2, 2, 2, 2]), np.arange(6)
    b, a = np.array([2] * 4 + [0, 0]), np.array([0] * 4 + [2, 2])
    for d2, together in (([1, 1, 1, 12, 1, 1], True), ([1, 1, 12, 12, 1, 1], False), ([1, 1, 1, 99, 1, 1], False)):
        numbers = merged(tracks, ping, b, a, np.array(d2, dtype=float), GATE)
        assert (numbers == 0).all() == together, d2


def test_tracks_that_share_a_ping_are_two_targets() -> None:
    assert joins(TRACKS, [0, 1, 1, 3, 5, 6], mutual({(0, 2): 0.1})) == TRACKS


def test_a_rival_makes_a_track_wait() -> None:
    """Sighting 4 fits both; the others overlap in a ping and so are two."""
    tracks, ping = [0, 0, 2, 2, 4], [0, 1, 1, 3, 5]
    assert joins(tracks, ping, {(4, 0): 1.0, (4, 2): 1.0}) == tracks
    assert joins(tracks, ping, {(4, 0): 1.0, (4, 2): 8.9}) == tracks
    assert joins(tracks, ping, {(4, 0): 1.0, (4, 2): 9.1}) == [0, 0, 2, 2, 0]


def test_pieces_of_one_landmark_are_no_rivals() -> None:
    """4 fits 0 and 2 alike, and these fit one another: in the end all are one."""
    assert joins(TRACKS, PING, mutual({(4, 0): 1.0, (4, 2): 1.5, (0, 2): 1.2})) == [0] * 6


def test_a_rival_that_is_of_another_track_of_the_same_ping_is_none() -> None:
    """Sighting 4 fits landmarks 0 and 2; track 5, not yet joined, fits 2 best and was seen beside 4 or not."""
    tracks, fits = [0, 0, 2, 2, 4, 5, 5], {(4, 0): 0.5, (4, 2): 2.0, (5, 2): 0.2}
    assert joins(tracks, [0, 1, 0, 1, 3, 3, 6], fits) == [0, 0, 2, 2, 0, 5, 5]
    assert joins(tracks, [0, 1, 0, 1, 3, 4, 6], fits) == tracks
    assert joins(tracks, [0, 1, 0, 1, 3, 3, 6], fits | {(5, 2): 2.2}) == tracks  # 4 fits it better


@st.composite
def candidates(draw: st.DrawFn) -> tuple[Index, Index, Index, Index, Index, Index]:
    """Tracks without a ping twice, pings, pairs with different d2, and another order of the sightings."""
    n = draw(st.integers(2, 10))
    ping = np.array(draw(st.lists(st.integers(0, 5), min_size=n, max_size=n)))
    tracks = renamed(np.array(draw(st.lists(st.integers(0, 5), min_size=n, max_size=n))))
    pairs = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=20, unique=True))
    d, other = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    d2 = np.array(draw(st.permutations(range(len(pairs)))), dtype=float) * 0.7
    return tracks, ping, d, tracks[other], d2, np.array(draw(st.permutations(range(n))))


@given(candidates())
def test_the_order_of_sightings_and_pairs_does_not_matter(
    scene: tuple[Index, Index, Index, Index, Index, Index],
) -> None:
    tracks, ping, d, a, d2, order = scene
    result = merged(tracks, ping, tracks[d], a, d2, GATE)
    place = np.argsort(order)  # of each sighting among the permuted ones
    moved = renamed(tracks[order])
    first = moved[place]  # the name that the track of each sighting has there
    other = merged(moved, ping[order], first[d][::-1], first[a][::-1], d2[::-1], GATE)
    assert np.array_equal(other, renamed(result[order]))


@given(candidates())
def test_what_is_joined_fits_and_nothing_is_left_to_join(
    scene: tuple[Index, Index, Index, Index, Index, Index],
) -> None:
    tracks, ping, d, a, d2, _ = scene
    result = merged(tracks, ping, tracks[d], a, d2, GATE)
    inside = d2 < GATE
    hanging = joined(tracks, tracks[d][inside], a[inside])
    assert all(len(set(hanging[result == name])) == 1 for name in result)
    assert all(len(set(result[tracks == name])) == 1 for name in tracks)
    assert np.array_equal(merged(result, ping, result[d], result[a], d2, GATE), result)


def test_links_are_the_best_both_ways_and_clear() -> None:
    def links(pairs: dict[tuple[int, int], float], lag: list[int] | None = None) -> list[int]:
        c, d = np.array(list(pairs)).T
        lags = np.ones(len(c), dtype=int) if lag is None else np.array(lag)
        return linked(c, d, np.array([*pairs.values()]), lags, 5, GATE).tolist()

    assert links({(0, 2): 1.0, (1, 3): 8.9, (2, 4): 9.1}) == [0, 1, 0, 1, 4]
    assert links({(0, 2): 1.0, (0, 3): 4.9}) == [0, 1, 2, 3, 4]  # two of the later ping
    assert links({(0, 2): 1.0, (0, 3): 5.1}) == [0, 1, 0, 3, 4]
    assert links({(0, 2): 1.0, (1, 2): 4.9}) == [0, 1, 2, 3, 4]  # two of the earlier one
    assert links({(0, 2): 1.0, (0, 3): 5.1, (1, 3): 8.0}) == [0, 1, 0, 3, 4]  # 3 is nearer to 0
    assert links({(0, 2): 1.0, (0, 3): 1.5}, [1, 2]) == [0, 1, 0, 0, 4]  # every lag by itself
    assert links({(0, 2): 1.0, (2, 4): 1.0}, [1, 1]) == [0, 1, 0, 3, 0]
    assert links({(0, 2): 20.0, (0, 3): 8.0}) == [0, 1, 2, 0, 4]  # outside of the gate is no rival


def test_a_track_whose_sightings_all_fit_larger_ones_is_superfluous() -> None:
    """Tracks of three, two, three and four sightings: 3 may go to 0 and 5; and 8 is the largest."""
    tracks = np.array([0, 0, 0, 3, 3, 5, 5, 5, 8, 8, 8, 8])

    def needless(fits: Fits) -> set[int]:
        d, landmarks = np.array(list(fits), dtype=np.intp).reshape(-1, 2).T
        mask = superfluous(tracks, d, landmarks, np.array([*fits.values()], dtype=float), 2, 0.999)
        return {int(track) for track in tracks[mask]}

    assert needless({(3, 0): 1.0, (4, 5): 2.0}) == {3}
    assert needless({(3, 0): 1.0}) == set()  # one of two has no other
    assert needless({(3, 0): 9.1, (4, 5): 9.2}) == {3}  # together within 18.5, of four numbers
    assert needless({(3, 0): 9.3, (4, 5): 9.3}) == set()
    assert needless({(3, 0): 30.0, (3, 5): 1.0, (4, 5): 2.0}) == {3}
    back = {(k, 3): 0.1 for k in (0, 1, 2)}
    assert needless(back) == set()  # the landmark of two is no larger one
    assert needless({(3, 0): 1.0, (4, 5): 2.0} | back) == {3}
    assert needless({(k, 0): 1.0 for k in (5, 6, 7)} | {(k, 5): 1.0 for k in (0, 1, 2)}) == {
        5
    }  # of two alike the later
    # 0 itself goes to 8, and so nothing goes to 0 in this round
    assert needless({(3, 0): 1.0, (4, 0): 1.0} | {(k, 8): 1.0 for k in (0, 1, 2)}) == {0}
    assert needless({}) == set()


def test_tracks_go_on_in_the_next_stretch() -> None:
    ping, stretch = np.array([0, 1, 2, 3, 0, 3, 1]), np.array([0, 0, 1, 1, 0, 1, 0])

    def goes_on(tracks: list[int], pieces: list[int]) -> list[int]:
        return continued(np.array(tracks), np.array(pieces), ping, stretch).tolist()

    assert goes_on([0, 0, 2, 2, 4, 5, 6], [0, 0, 0, 0, 4, 5, 6]) == [0, 0, 0, 0, 4, 5, 6]
    assert goes_on([0, 0, 2, 2, 4, 5, 6], [0, 0, 2, 2, 4, 5, 6]) == [0, 0, 2, 2, 4, 5, 6]  # nothing was linked
    assert goes_on([0, 1, 2, 2, 4, 5, 6], [0, 0, 0, 0, 4, 5, 6]) == [0, 1, 2, 2, 4, 5, 6]  # what is alone stays so
    assert goes_on([0, 0, 2, 3, 4, 2, 4], [0, 0, 0, 3, 4, 4, 4]) == [0, 0, 2, 3, 4, 2, 4]  # two that share pings 0, 1
