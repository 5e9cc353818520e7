"""Single measurements read otherwise: named, and no wrong closure by chance."""

from __future__ import annotations

import numpy as np
import pytest

from nls import FactorGraph, Values
from nls.analysis.misread import MisreadMeasurement, misread_measurements
from tests.combinations import for_all
from tests.nls.misreadings import clean, doubted, misread_one, optimum, wrong_closure


def misread(graph: FactorGraph, start: Values) -> tuple[list[tuple[int, int]], tuple[MisreadMeasurement, ...]]:
    """Places of the suspects, and which of these fit under another reading."""
    pattern, doubts = doubted(graph, optimum(graph, start))
    return doubts.places, misread_measurements(pattern, doubts.values, doubts.places)


@pytest.mark.parametrize(
    ("name", "k", "reading"),
    [
        ("sphere", 0, "exchanged"),
        ("sphere", 1, "transposed"),
        ("sphere", 1, "z flipped"),
        ("subsea", 1, "exchanged"),
        ("subsea", 2, "mirrored"),
        ("lines", 2, "mirrored"),
    ],
)
def test_a_measurement_is_named(name: str, k: int, reading: str) -> None:
    """Wherever it is a suspect: where the reading changes next to nothing it is none."""
    suspected = 0
    for seed in range(2):
        graph, start, _ = clean(name, seed)
        i = int(np.random.default_rng(seed).integers(2, len(graph.factors[k]) - 2))
        wrong = misread_one(graph, start, k, i, reading)
        place = (len(wrong.factors) - 1, 0)
        places, meant = misread(wrong, start)
        assert all(one.place == place and one.t < 30 < 100 <= one.standing for one in meant)
        assert (reading in {one.reading for one in meant}) == (place in places)
        suspected += place in places
    assert suspected


@for_all(name=["ring", "manhattan", "sphere"], seed=range(3))
def test_a_wrong_closure_fits_under_no_reading(name: str, seed: int) -> None:
    graph, start, _ = clean(name, seed)
    assert misread(wrong_closure(graph, np.random.default_rng(seed)), start)[1] == ()
