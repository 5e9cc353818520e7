"""Contacts of two landmarks that were exchanged in one image: named, and nothing else is."""

from __future__ import annotations

import numpy as np

import sim
from models.algebra import Mask
from nls.analysis.swapped_landmarks import exchanged_contacts

RNG = np.random.default_rng


def rejected(mission: sim.Mission, mask: Mask) -> list[Mask]:
    """Per factor what was rejected, of the contacts this."""
    return [mask if f is mission.contacts else np.zeros(len(f), dtype=bool) for f in mission.graph.factors]


def test_exchanged_pairs_are_named_with_their_contacts() -> None:
    right = sim.hauv_floor(RNG(1), legs=2, per_leg=12)
    mission = sim.exchange_contacts(right, 0.05, RNG(2))
    pairs = exchanged_contacts(mission.graph, mission.truth, rejected(mission, mission.wrong))
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
    assert exchanged_contacts(mission.graph, mission.truth, rejected(mission, mission.wrong)) == ()
    none = np.zeros(len(mission.contacts), dtype=bool)
    assert exchanged_contacts(mission.graph, mission.truth, rejected(mission, none)) == ()


def test_landmarks_that_left_are_passed_over() -> None:
    mission = sim.hauv_floor(RNG(1), legs=2, per_leg=12, wrong_associations=0.05)
    pairs = exchanged_contacts(mission.graph, mission.truth, rejected(mission, mission.wrong))
    gone = int(pairs[0].first.numbers[0])
    stack = mission.truth.stack("l")
    kept = stack.numbers != gone
    values = type(mission.truth)(
        {
            "x": (mission.truth.stack("x").manifold, mission.truth.stack("x").X),
            "l": (stack.manifold, stack.X[kept], stack.numbers[kept]),
        }
    )
    fewer = exchanged_contacts(mission.graph, values, rejected(mission, mission.wrong))
    assert 0 < len(fewer) < len(pairs)
    assert all(gone not in (pair.first.numbers[0], pair.second.numbers[0]) for pair in fewer)
