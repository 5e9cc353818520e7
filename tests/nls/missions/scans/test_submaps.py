"""Submaps: points of neighbors in one frame, at the ends too; and which of them may show the same place."""

from __future__ import annotations

import numpy as np

from models import SE2
from models.errors import OptionError
from nls.missions.scans import Scans, submap
from nls.missions.scans.scans import centers, in_world, pairs
from tests.factors.evaluated import refused, same
from tests.nls.missions.scans.rooms import drive, laps

RNG = np.random.default_rng(0)
POSES = RNG.normal(0, 5, (9, 3))
LANDMARKS = RNG.uniform(-20, 20, (9, 6, 2))
SCANS = Scans(
    np.concatenate([SE2.act(SE2.inverse(POSES[[k]]), LANDMARKS[k]) for k in range(9)]), np.repeat(np.arange(9), 6), 9
)


def test_points_of_the_neighbors_in_the_frame_of_the_middle() -> None:
    for center, half, members in (
        (4, 2, range(2, 7)),
        (4, 0, [4]),
        (4, (3, 0), range(1, 5)),
        (4, (0, 9), range(4, 9)),
        (0, 2, range(3)),
        (8, 2, range(6, 9)),
    ):
        points = submap(POSES, SCANS, center, half)  # type: ignore[arg-type]
        same(SE2.act(POSES[[center]], points), np.concatenate([LANDMARKS[k] for k in members]), atol=1e-9)


def test_keyframes_without_points() -> None:
    scans = Scans([[5.0, 0.0]], [3], 9)
    assert len(submap(POSES, scans, 6, 2)) == 0
    same(SE2.act(POSES[[5]], submap(POSES, scans, 5, 2)), SE2.act(POSES[[3]], [[5.0, 0.0]]), atol=1e-12)


def test_what_does_not_fit() -> None:
    for center in (-1, 9):
        refused(lambda c=center: submap(POSES, SCANS, c, 2), OptionError, "center.*0 to 8")
    for half in (-1, (2, -3)):
        refused(lambda h=half: submap(POSES, SCANS, 4, h), OptionError, "half")


def test_pairs_by_brute_force() -> None:
    """Of every eight keyframes the submap of largest overlap, the eight best of them, twenty keyframes before."""
    truth = laps(3)
    scans = drive(truth).scans
    middle, points = centers(scans), in_world(truth, scans)
    near = {k: points[np.abs(scans.keyframe - k) <= 4] for k in middle.tolist()}
    feet = {k: {tuple(cell) for cell in np.floor(p / 5.0).astype(int).tolist()} for k, p in near.items()}

    def share(i: int, j: int) -> float:
        return len(feet[i] & feet[j]) / min(len(feet[i]), len(feet[j]))

    a, b = pairs(truth, scans, middle)
    assert len(a) > 50
    for j in middle.tolist():
        best: dict[int, float] = {}
        for i in middle[middle <= j - 20].tolist():
            if share(i, j) >= 0.25:
                best[i // 8] = max(best.get(i // 8, 0.0), share(i, j))
        chosen = middle[a[middle[b] == j]].tolist()
        assert len({i // 8 for i in chosen}) == len(chosen), "one of each piece"
        assert sorted(share(i, j) for i in chosen) == sorted(best.values())[-8:]


def test_centers_have_their_neighbors_and_sixty_points() -> None:
    few = Scans(np.ones((60, 2)), np.repeat([20, 40], [30, 30]), 60)
    assert len(centers(few)) == 0
    alone = Scans(np.ones((60, 2)), np.full(60, 20), 60)
    assert centers(alone).tolist() == [16, 20, 24]
    assert len(centers(Scans(np.ones((99, 2)), np.zeros(99, dtype=int), 5))) == 0, "shorter than a submap"
