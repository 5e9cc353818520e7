"""Clean graphs: nothing read otherwise, no landmarks exchanged, no clock or calibration off, no outsized number."""

from __future__ import annotations

from pathlib import Path

import pytest

from nls import FactorGraph, Values
from nls.analysis.calibrations import calibrations
from nls.analysis.clock import clock_offsets
from nls.analysis.leave_one_out import checks
from nls.analysis.linearization import Checked, Linearization
from nls.analysis.misread import misread_kinds, misread_measurements
from nls.analysis.scales import outsized
from nls.analysis.suspects import suspects
from nls.analysis.swapped_landmarks import swapped_landmarks
from tests.nls.misreadings import PUBLIC, WORLDS, clean, held, public


def alarms(graph: FactorGraph, values: Values) -> tuple[object, ...]:
    """All that the analyses say of a graph at its optimum."""
    pattern, count = held(graph, values), len(graph.factors)
    checked = Checked(Linearization(pattern, values))
    landmarks = swapped_landmarks(graph, values, checks(checked, count))
    offsets = clock_offsets(checked, values, count)
    doubts = suspects(graph, pattern, values, checked)  # takes out the measurements it doubts
    measurements = misread_measurements(pattern, doubts.values, doubts.places)
    return (
        *landmarks,
        *offsets,
        *measurements,
        *misread_kinds(graph, values),
        *calibrations(graph, values),
        *outsized(pattern),
    )


@pytest.mark.parametrize("name", WORLDS)
def test_worlds(name: str) -> None:
    for seed in range(2):
        graph, _, values = clean(name, seed)
        assert alarms(graph, values) == (), seed


@pytest.mark.parametrize("name", PUBLIC)
def test_public_graphs(name: str, data: Path) -> None:
    assert alarms(*public(data / name)) == ()
