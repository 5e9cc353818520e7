"""Candidates: submaps apart whose footprints overlap, the best of each piece of the track, not all of them."""

from __future__ import annotations

import numpy as np

from models import SE2
from nls.missions.scans import Scans
from nls.missions.scans.candidates import (
    APART,
    CELL,
    HALF,
    OVERLAP,
    PARTNERS,
    POINTS,
    SPREAD,
    STEP,
    centers,
    pairs,
)
from nls.missions.scans.scans import in_world
from tests.nls.missions.scans.rooms import drive, laps

TRUTH = laps(3)
ROOM = drive(TRUTH)


def footprint(k: int) -> set[tuple[int, ...]]:
    """Cells of the world with points of the submap around keyframe k."""
    member = np.abs(ROOM.scans.keyframe - k) <= HALF
    return {tuple(cell) for cell in np.floor(in_world(TRUTH, ROOM.scans)[member] / CELL).astype(int).tolist()}


def test_pairs_by_brute_force() -> None:
    """Of every piece of the track the earlier submap of largest overlap, the six best of them."""
    middle = centers(ROOM.scans)
    a, b = pairs(TRUTH, ROOM.scans, middle)
    feet = {int(k): footprint(int(k)) for k in middle}

    def share(i: int, j: int) -> float:
        return len(feet[i] & feet[j]) / min(len(feet[i]), len(feet[j]))

    assert len(a) > 50
    for j in middle.tolist():
        best: dict[int, float] = {}
        for i in middle[middle <= j - APART].tolist():
            if share(i, j) >= OVERLAP:
                best[i // SPREAD] = max(best.get(i // SPREAD, 0.0), share(i, j))
        chosen = middle[a[middle[b] == j]].tolist()
        assert len({i // SPREAD for i in chosen}) == len(chosen), "one of each piece"
        assert sorted(share(i, j) for i in chosen) == sorted(best.values())[-PARTNERS:]


def test_centers_have_their_neighbors_and_points_enough() -> None:
    middle = centers(ROOM.scans)
    assert middle[0] == HALF
    assert middle[-1] < len(TRUTH) - HALF
    assert (np.diff(middle) == STEP).all()
    few = Scans(np.ones((POINTS, 2)), np.repeat([20, 40], [POINTS // 2, POINTS // 2]), 60)
    assert len(centers(few)) == 0
    alone = Scans(np.ones((POINTS, 2)), np.full(POINTS, 20), 60)
    assert centers(alone).tolist() == [16, 20, 24]
    assert len(centers(Scans(np.ones((99, 2)), np.zeros(99, dtype=int), 5))) == 0, "shorter than a submap"


def test_a_straight_line_has_none() -> None:
    k = np.arange(120.0)
    line = np.column_stack([2 * k, 0 * k, 0 * k])
    side = np.column_stack([np.tile(np.linspace(0, 10, 11), 120), np.full(1320, 4.0)])
    scans = Scans(side, np.repeat(np.arange(120), 11), 120)
    middle = centers(scans)
    assert len(middle) > 20
    assert len(pairs(line, scans, middle)[0]) == 0


def test_where_the_world_lies_does_not_matter() -> None:
    """Cells are counted from the origin: a motion by whole cells leaves the pairs."""
    middle = centers(ROOM.scans)
    there = SE2.compose(np.broadcast_to([[40 * CELL, -8 * CELL, 0.0]], TRUTH.shape), TRUTH)
    for here, moved in zip(pairs(TRUTH, ROOM.scans, middle), pairs(there, ROOM.scans, middle), strict=True):
        assert np.array_equal(here, moved)
