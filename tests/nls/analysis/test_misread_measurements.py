"""Single measurements read otherwise: named, and no wrong closure by chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nls.analysis.misread_measurements import misread_measurements
from tests.nls.misreadings import PUBLIC, doubted, misread_one, optimum, public, world, wrong_closure


@pytest.mark.parametrize(
    ("name", "k", "reading"),
    [
        ("sphere", 0, "exchanged"),
        ("sphere", 1, "transposed"),
        ("sphere", 1, "y flipped"),
        ("sphere", 1, "z flipped"),
        ("subsea", 1, "exchanged"),
        ("subsea", 2, "mirrored"),
        ("lines", 2, "mirrored"),
    ],
)
@pytest.mark.parametrize("seed", range(4))
def test_a_measurement_is_named(name: str, k: int, reading: str, seed: int) -> None:
    """Where it is a suspect: in every case but where the reading changes next to nothing."""
    graph, start = world(name, seed)
    i = int(np.random.default_rng(seed).integers(2, len(graph.factors[k]) - 2))
    wrong = misread_one(graph, start, k, i, reading)
    pattern, doubts = doubted(wrong, optimum(wrong, start))
    place = (len(wrong.factors) - 1, 0)
    meant = misread_measurements(pattern, doubts.values, doubts.places)
    assert all(misread.place == place for misread in meant)
    if place in doubts.places:
        assert reading in {misread.reading for misread in meant}
        assert all(misread.t < 30 < 100 <= misread.standing for misread in meant)


@pytest.mark.parametrize("name", ["ring", "manhattan", "sphere"])
@pytest.mark.parametrize("seed", range(8))
def test_a_wrong_closure_fits_under_no_reading(name: str, seed: int) -> None:
    graph, start = world(name, seed)
    wrong = wrong_closure(graph, np.random.default_rng(seed))
    pattern, doubts = doubted(wrong, optimum(wrong, start))
    assert misread_measurements(pattern, doubts.values, doubts.places) == ()


@pytest.mark.parametrize("name", ["sphere", "subsea"])
def test_nothing_is_doubted(name: str) -> None:
    graph, start = world(name, 0)
    pattern, doubts = doubted(graph, optimum(graph, start))
    assert misread_measurements(pattern, doubts.values, doubts.places) == ()


@pytest.mark.parametrize("name", PUBLIC)
def test_doubtful_measurements_of_public_graphs(name: str, data: Path) -> None:
    graph, values = public(data / name)
    pattern, doubts = doubted(graph, values)
    assert misread_measurements(pattern, doubts.values, doubts.places) == ()
