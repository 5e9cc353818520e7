"""Partitions of sightings against sets of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from models.algebra import Index
from nls.missions.contacts.tracks import (
    joined,
    largest,
    once_per_ping,
    parted,
    renamed,
    several,
    share_a_ping,
    single,
    sizes,
)

Partition = set[frozenset[int]]


def groups_of(tracks: Index) -> Partition:
    return {frozenset(np.flatnonzero(tracks == name).tolist()) for name in tracks}


@st.composite
def scenes(draw: st.DrawFn) -> dict[str, Any]:
    """Tracks of a few sightings, their pings, and choices of them."""
    n = draw(st.integers(1, 12))

    def whole(largest: int, size: int = n) -> Index:
        return np.array(draw(st.lists(st.integers(0, largest), min_size=size, max_size=size)), dtype=np.intp)

    k = draw(st.integers(0, 6))
    tracks, mask = renamed(whole(4)), whole(1) > 0
    return {
        "n": n,
        "tracks": tracks,
        "ping": whole(3),
        "mask": mask,
        "a": tracks[whole(n - 1, k)],
        "b": whole(n - 1, k),
    }


@given(scenes())
def test_a_track_is_named_by_its_first_sighting(scene: dict[str, Any]) -> None:
    n, tracks, ping, mask = (scene[name] for name in ("n", "tracks", "ping", "mask"))
    a, b = scene["a"], tracks[scene["b"]]
    results = [
        joined(tracks, a, b),
        single(tracks, mask),
        once_per_ping(tracks, ping),
        parted(tracks, renamed(ping), mask),
    ]
    for result in results:
        assert all(name == min(np.flatnonzero(result == name)) for name in result)
        assert sizes(result).tolist() == [np.count_nonzero(result == name) for name in result]
        assert len(result) == n


@given(scenes())
def test_joined_tracks_are_what_hangs_together(scene: dict[str, Any]) -> None:
    tracks, a, b = scene["tracks"], scene["a"], scene["tracks"][scene["b"]]
    groups = groups_of(tracks)
    for one, other in zip(a.tolist(), b.tolist(), strict=True):
        both = [group for group in groups if one in group or other in group]
        groups = {group for group in groups if group not in both} | {frozenset().union(*both)}
    assert groups_of(joined(tracks, a, b)) == groups


@given(scenes())
def test_sightings_leave_their_tracks_alone_or_by_piece(scene: dict[str, Any]) -> None:
    tracks, ping, mask = scene["tracks"], scene["ping"], scene["mask"]
    gone = frozenset(np.flatnonzero(mask).tolist())
    stay = {group - gone for group in groups_of(tracks)} - {frozenset()}
    assert groups_of(single(tracks, mask)) == stay | {frozenset([k]) for k in gone}
    assert np.array_equal(single(tracks, np.flatnonzero(mask)), single(tracks, mask))
    pieces = {frozenset(k for k in gone if ping[k] == number) for number in ping} - {frozenset()}
    assert groups_of(parted(tracks, renamed(ping), mask)) == stay | pieces


@given(scenes())
def test_of_the_sightings_in_one_ping_the_first_stays(scene: dict[str, Any]) -> None:
    tracks, ping = scene["tracks"], scene["ping"]
    pairs = list(zip(tracks.tolist(), ping.tolist(), strict=True))
    again = [pair in pairs[:k] for k, pair in enumerate(pairs)]
    assert np.array_equal(once_per_ping(tracks, ping), single(tracks, np.array(again)))


@given(scenes())
def test_tracks_that_share_a_ping(scene: dict[str, Any]) -> None:
    tracks, ping, a, b = scene["tracks"], scene["ping"], scene["a"], scene["tracks"][scene["b"]]
    common = [bool(set(ping[tracks == one]) & set(ping[tracks == other])) for one, other in zip(a, b, strict=True)]
    assert share_a_ping(tracks, ping, a, b).tolist() == common


def test_the_worst_sighting_of_a_track() -> None:
    tracks, d2 = np.array([0, 1, 0, 1, 4]), np.array([3.0, 1.0, 2.0, 5.0, 0.0])
    assert np.flatnonzero(largest(tracks, d2)).tolist() == [0, 3, 4]
    assert not largest(tracks[:0], d2[:0]).any()


@given(scenes())
def test_tracks_of_several_pieces(scene: dict[str, Any]) -> None:
    tracks, ping = scene["tracks"], scene["ping"]
    assert several(tracks, renamed(ping)).tolist() == [len(set(ping[tracks == track])) > 1 for track in tracks]
