"""Landmarks whose sightings were exchanged are named with the sightings; no false contact, no other mistake."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import Sighting
from factors.keys import Keys
from factors.replaced import replaced
from models.algebra import Mask
from nls import FactorGraph, Values
from nls.analysis.leave_one_out import checks
from nls.analysis.swapped_landmarks import Exchanged, SwappedLandmarks, exchanged_contacts, swapped_landmarks
from tests.nls.misreadings import clean, judged, optimum

When = Callable[[npt.NDArray[np.int64]], npt.NDArray[np.bool_]]


def swapped(graph: FactorGraph, a: int, b: int, when: When) -> FactorGraph:
    """The graph with landmarks a and b exchanged at some poses, by their number."""
    factors = list(graph.factors)
    for k, factor in enumerate(factors):
        if isinstance(factor, Sighting):
            pose, target, *others = factor.keys
            other = np.where(target.numbers == a, b, np.where(target.numbers == b, a, target.numbers))
            numbers = np.where(when(pose.numbers), other, target.numbers)
            factors[k] = replaced(factor, [pose, Keys(target.kind, numbers), *others])
    return FactorGraph(factors, graph.fixed)


def named(graph: FactorGraph, start: Values) -> tuple[SwappedLandmarks, ...]:
    values = optimum(graph, start)
    checked = judged(graph, values)
    return swapped_landmarks(graph, values, None if checked is None else checks(checked, len(graph.factors)))


def seen_by(graph: FactorGraph, a: int, b: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Poses and landmarks of the sightings of two."""
    (factor,) = (f for f in graph.factors if isinstance(f, Sighting) and not f.limit_only)
    of = np.isin(factor.keys[1].numbers, [a, b])
    return factor.keys[0].numbers[of], factor.keys[1].numbers[of]


@pytest.mark.parametrize(("name", "a", "b"), [("subsea", 3, 4), ("lines", 7, 9)])
def test_exchanged_from_some_time_on(name: str, a: int, b: int) -> None:
    graph, start, right = clean(name, 0)
    middle = len(start.stack("x")) // 2
    (swap,) = named(swapped(graph, a, b, lambda pose: pose > middle), start)
    assert (swap.first, swap.second) == (Keys("l", a), Keys("l", b))
    assert swap.chi2 == pytest.approx(graph.chi2(right), rel=1e-3)
    poses, _ = seen_by(graph, a, b)
    late = int((poses > middle).sum())
    assert len(swap.places) in (late, len(poses) - late)  # which half is called exchanged is a matter of names


def test_exchanged_in_one_image() -> None:
    graph, start, _ = clean("lines", 0)
    poses, landmarks = seen_by(graph, 1, 4)
    image = np.intersect1d(poses[landmarks == 1], poses[landmarks == 4])[0]
    (swap,) = named(swapped(graph, 1, 4, lambda pose: pose == image), start)
    assert (swap.first, swap.second) == (Keys("l", 1), Keys("l", 4))
    assert len(swap.places) == 2


def test_wholly_exchanged_where_they_are_known() -> None:
    """Without knowledge of where they are, exchanged names are no mistake."""
    graph, start, _ = clean("headings", 0)
    (swap,) = named(swapped(graph, 0, 1, lambda pose: pose >= 0), start)
    assert (swap.first, swap.second) == (Keys("l", 0), Keys("l", 1))
    assert len(swap.places) == len(seen_by(graph, 0, 1)[0])
    graph, start, _ = clean("subsea", 0)
    assert named(swapped(graph, 0, 1, lambda pose: pose >= 0), start) == ()


def test_contacts_of_a_sonar_in_space() -> None:
    """Two pairs in two images, whose hinges go with them."""
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=4)
    spoiled = sim.exchange_contacts(mission, 0.008, np.random.default_rng(1))
    swaps = named(spoiled.graph, spoiled.start)
    target = mission.contacts.keys[1].numbers[spoiled.wrong]
    assert {int(key.numbers[0]) for swap in swaps for key in (swap.first, swap.second)} == set(target.tolist())
    assert all(len(swap.places) == 4 for swap in swaps)


def test_a_false_sighting_is_no_exchange() -> None:
    graph, start, _ = clean("subsea", 0)
    first, odometry, seen = graph.factors
    z = np.array(seen.z)
    z[len(z) // 2] += [1.0, 5.0]
    assert named(FactorGraph([first, odometry, replaced(seen, z=z)]), start) == ()


RNG = np.random.default_rng


def exchanged(mission: sim.Mission, rejected: Mask, values: Values | None = None) -> tuple[Exchanged, ...]:
    """Pairs whose contacts were exchanged, of those that were rejected; at the truth unless there are values."""
    masks = [rejected if f is mission.contacts else np.zeros(len(f), dtype=bool) for f in mission.graph.factors]
    return exchanged_contacts(mission.graph, values or mission.truth, masks)


def test_exchanged_pairs_are_named_with_their_contacts() -> None:
    right = sim.hauv_floor(RNG(1), legs=2, per_leg=12)
    mission = sim.exchange_contacts(right, 0.05, RNG(2))
    pairs = exchanged(mission, mission.wrong)
    rows = [index for pair in pairs for _, index in pair.places]
    assert mission.wrong[rows].all()
    assert len(set(rows)) > 0.9 * mission.wrong.sum()
    assert [len(pair.places) for pair in pairs] == sorted((len(pair.places) for pair in pairs), reverse=True)
    for pair in pairs:
        numbers = mission.contacts.keys[1].numbers[[index for _, index in pair.places]]
        assert set(numbers.tolist()) == {int(pair.first.numbers[0]), int(pair.second.numbers[0])}
        assert pair.standing > 100 * len(pair.places)
        assert pair.chi2 < 9.3 * len(pair.places)
    own = right.contacts.chi2(mission.truth)[sorted(set(rows))]
    np.testing.assert_allclose(sum(pair.chi2 for pair in pairs), own.sum(), rtol=0.1)


def test_false_contacts_are_no_exchange() -> None:
    mission = sim.hauv_floor(RNG(1), legs=2, per_leg=12, outliers=0.1)
    assert exchanged(mission, mission.wrong) == exchanged(mission, mission.wrong & False) == ()


def test_landmarks_that_left_are_passed_over() -> None:
    mission = sim.hauv_floor(RNG(1), legs=2, per_leg=12, wrong_associations=0.05)
    pairs = exchanged(mission, mission.wrong)
    gone = int(pairs[0].first.numbers[0])
    stack = mission.truth.stack("l")
    values = Values.of([mission.truth.stack("x"), stack.only(stack.numbers != gone)])
    fewer = exchanged(mission, mission.wrong, values)
    assert 0 < len(fewer) < len(pairs)
    assert all(gone not in (pair.first.numbers[0], pair.second.numbers[0]) for pair in fewer)
