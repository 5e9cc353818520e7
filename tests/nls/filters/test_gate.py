"""A filter that believes only what can be: sightings of known landmarks within their gate."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import BearingRange
from factors.keys import Keys
from models.errors import OptionError
from nls import FactorGraph, kinds
from nls.filters.association import Nearest
from nls.filters.ekf import EKF
from tests.combinations import for_all

x, l = kinds("x", "l")


def sightings(graph: FactorGraph) -> int:
    """Which factor of the graph they are."""
    return next(k for k, factor in enumerate(graph.factors) if isinstance(factor, BearingRange))


def with_sightings(graph: FactorGraph, changed: BearingRange) -> FactorGraph:
    return FactorGraph([changed if isinstance(factor, BearingRange) else factor for factor in graph.factors])


@for_all(first_estimates=[False, True])
def test_one_landmark_under_the_name_of_another(first_estimates: bool) -> None:
    world = sim.subsea(np.random.default_rng(3), laps=1, known_start=True)
    seen = world.graph.factors[sightings(world.graph)]
    numbers = seen.keys[1].numbers.copy()
    at = int(np.flatnonzero((seen.keys[0].numbers > 80) & (numbers == 0))[0])
    numbers[at] = 5  # both have been seen before
    wrong = with_sightings(world.graph, BearingRange(seen.keys[0], Keys("l", numbers), seen.z, seen.noise))
    without = with_sightings(world.graph, seen[np.arange(len(seen)) != at])  # type: ignore[arg-type]
    gated = EKF(first_estimates=first_estimates, gate=0.999999)
    found = gated.run(wrong, world.start)
    expected = EKF(first_estimates=first_estimates).run(without, world.start)
    assert gated.left_out == 1
    np.testing.assert_allclose(found.X, expected.X, atol=1e-9)
    np.testing.assert_allclose(found.P, expected.P, rtol=1e-6, atol=1e-15)
    if not first_estimates:
        assert EKF().run(wrong, world.start).ate(world.truth).largest > 3 * found.ate(world.truth).largest


def test_as_many_are_left_out_as_the_gate_says() -> None:
    left, all_of_them = 0, 0
    for seed in range(2):
        world = sim.subsea(np.random.default_rng(seed), laps=1, known_start=True)
        filter = EKF(gate=0.9)
        filter.run(world.graph, world.start)
        left += filter.left_out
        all_of_them += len(world.graph.factors[sightings(world.graph)]) - len(world.truth[l])
    assert left / all_of_them == pytest.approx(0.1, abs=0.05)
    again = filter.left_out
    filter.run(world.graph, world.start)
    assert filter.left_out == again  # counted anew


def test_options() -> None:
    assert EKF(gate=0.99).method == "EKF (gate 0.99)"
    for gate in (0.0, 1.0, 1.5, "0.9", True):
        with pytest.raises(OptionError, match=r"gate: .* between 0 and 1"):
            EKF(gate=gate)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="gates of its own"):
        EKF(gate=0.99, associate=Nearest(0.99))
