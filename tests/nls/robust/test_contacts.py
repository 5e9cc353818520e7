"""Doubted contacts: which agree along dead reckoning, the estimate without the others, and landmarks that leave."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import nls
import sim
from factors import Between, Isotropic, Position, Range, RangeAzimuth
from factors.noise import Noise, SqrtInformation
from models import SE2, SE3, R
from models.algebra import Array
from models.errors import UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.robust.contacts import TRIED, agreement, along, misfit
from nls.robust.landmarks import landmarks_of
from nls.starts.parts import put_back

x, l = kinds("x", "l")
RNG = np.random.default_rng


def floor(seed: int, outliers: float = 0.0) -> sim.Mission:
    """A small mission over the sea floor."""
    return sim.hauv_floor(RNG(seed), legs=2, per_leg=12, outliers=outliers)


def measured(mission: sim.Mission, z: Array, noise: Noise) -> RangeAzimuth:
    """The contacts of a mission with other numbers."""
    pose, target = mission.contacts.keys[:2]
    return RangeAzimuth(pose, target, z, noise, mission.offset)


def poses_of(mission: sim.Mission) -> tuple[FactorGraph, Values]:
    """The trusted measurements of a mission, and dead reckoning."""
    stack = mission.start.stack("x")
    return FactorGraph(mission.graph.factors[:4]), Values({x: (SE3, stack.X, stack.numbers)})


@pytest.mark.parametrize(
    ("make", "ways"), [(sim.hauv_floor, {"legs": 2, "per_leg": 12}), (sim.hauv_hull, {"levels": 2, "per_level": 13})]
)
def test_contacts_that_agree_are_the_right_ones(make: Callable[..., sim.Mission], ways: dict[str, int]) -> None:
    mission = make(RNG(2), outliers=0.2, **ways)
    track = along(*poses_of(mission), "x")
    sets = agreement(mission.contacts, mission.start, track, mission.sonar.aperture / 2)
    assert sets.kept[mission.wrong].mean() < 0.1
    assert sets.kept[~mission.wrong].mean() > 0.93
    off = np.linalg.norm(sets.points - mission.truth[l][sets.rows], axis=1)
    assert np.median(off) < 0.2
    assert np.quantile(off, 0.9) < 0.6
    rows = mission.start.stack("l").index(mission.contacts.keys[1])
    counts = np.bincount(rows[sets.kept], minlength=mission.landmarks)
    assert (counts[sets.rows] == sets.size).all()
    assert (sets.size >= 2).all()
    assert (np.delete(counts, sets.rows) == 0).all()


def test_blocks_of_contacts_are_judged_as_all_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = floor(3, 0.1)
    track = along(*poses_of(mission), "x")
    one = agreement(mission.contacts, mission.start, track, 0.12)
    monkeypatch.setattr("nls.robust.contacts.PAIRS_AT_ONCE", 40 * TRIED)
    many = agreement(mission.contacts, mission.start, track, 0.12)
    np.testing.assert_array_equal(one.kept, many.kept)
    np.testing.assert_allclose(one.points, many.points, atol=1e-12)


def test_the_estimate_without_false_contacts_is_as_good_as_if_there_were_none() -> None:
    mission = floor(1, 0.2)
    found = nls.gnc(mission.graph, mission.start, doubted=[mission.contacts])
    out = found.weights[4] == 0
    np.testing.assert_array_equal(found.weights[5] == 0, out)  # nobody saw that these landmarks were in view
    assert out[mission.wrong].mean() > 0.98
    assert out[~mission.wrong].mean() < 0.08
    clean = floor(1)
    error = clean.ate(clean.graph.optimize(clean.start).values)
    assert mission.ate(found.result.values) < 1.5 * error < mission.ate(mission.start)
    assert not found.doubts
    assert found.result.chi2_final < 1.1 * found.result.dof
    kept = len(mission.contacts) - out.sum()
    assert found.expected_by_chance == pytest.approx(kept * 0.01 / 0.99)
    assert len(found.rejected) + sum(each.measurements for each in found.left) == out.sum()


def test_a_landmark_whose_contacts_contradict_leaves_with_its_hinges() -> None:
    mission = floor(1)
    z = np.array(mission.contacts.z)
    rows = [np.flatnonzero(mission.contacts.keys[1].numbers == number) for number in (3, 7)]
    for k, at in enumerate(np.concatenate(rows)):  # no two say the same
        z[at] = [1.2 + 4.6 * ((0.37 * k) % 1), 0.2 * (-1) ** k]
    contacts = measured(mission, z, mission.contacts.noise)
    factors = list(mission.graph.factors)
    factors[4] = contacts
    found = nls.gnc(FactorGraph(factors), mission.start, doubted=[contacts])
    left = {each.variable: each.measurements for each in found.left}
    assert {"l3", "l7"} <= set(left)
    assert (left["l3"], left["l7"]) == tuple(map(len, rows))
    for factor, weights in zip(factors[4:6], found.weights[4:6], strict=True):
        assert not weights[np.isin(factor.keys[1].numbers, [3, 7])].any()
    assert l[3] not in found.result.values
    assert l[4] in found.result.values
    assert not {"l3)", "l7)"} & {each.factor.split(", ")[1] for each in found.rejected}
    assert "removed with them: too few of" in "\n".join(found.report())


def test_contacts_are_refused_where_dead_reckoning_is_broken() -> None:
    mission = floor(1)
    with pytest.raises(UnderconstrainedError, match="free"):
        nls.gnc(FactorGraph(mission.graph.factors[1:]), mission.start, doubted=[mission.contacts])


def test_dives_that_share_landmarks_alone_have_sets_of_their_own() -> None:
    step = Between(x[[0, 1, 3, 4]], x[[1, 2, 4, 5]], SE3.identity(4), Isotropic(0.01))
    values = Values({x: (SE3, SE3.identity(6))})
    track = along(FactorGraph([step]), values, "x")
    assert track.part.tolist() == [0, 0, 0, 1, 1, 1]
    z = np.array([[5.0, 0.0], [5.0, 0.0], [2.0, 0.1], [3.0, 0.0], [3.0, 0.0], [3.0, 0.0]])
    contacts = RangeAzimuth(x[np.arange(6)], l[0], z, SqrtInformation(np.diag([100.0, 200.0])))
    values.add(nls.Kind("l"), R(3), np.zeros((1, 3)))
    sets = agreement(contacts, values, track, 0.12)
    assert sets.kept.tolist() == [True, True, False, True, True, True]
    assert (sets.rows.tolist(), sets.size.tolist()) == ([0], [3])
    assert np.linalg.norm(sets.points[0]) == pytest.approx(3.0)


def test_ranges_and_fixes_are_doubted_and_a_beacon_leaves() -> None:
    rng, n = RNG(0), 40
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    T = np.column_stack([10 * np.cos(turn), 10 * np.sin(turn), turn + np.pi / 2])
    odometry = Between(x[np.arange(n - 1)], x[np.arange(1, n)], SE2.between(T[:-1], T[1:]), Isotropic(0.02))
    places = np.array([[3.0, 3.0], [-4.0, 5.0], [15.0, -2.0]])
    i = np.concatenate([np.arange(0, n, 2), np.arange(1, n, 3), [3, 4, 5, 6]])
    k = np.repeat([0, 1, 2], [20, 13, 4])
    z = np.linalg.norm(T[i, :2] - places[k], axis=1) + 0.05 * rng.normal(size=len(i))
    z[[3, 8, 25]] += 4.0
    z[-4:] = [10.0, 3.0, 14.0, 1.0]
    heard = Range(x[i], l[k], z, Isotropic(0.05))
    fixes = Position(x[[0, 10, 20, 30]], T[[0, 10, 20, 30], :2] + [[0, 0], [0, 0], [6, 0], [0, 0]], Isotropic(0.1))
    values = Values({x: (SE2, T), l: (R(2), places + 0.3)})
    found = nls.gnc(FactorGraph([odometry, heard, fixes]), values, doubted=[heard, fixes])
    wrong = {heard.describe(row) for row in (3, 8, 25)} | {"Position(x20)"}
    assert {each.factor for each in found.rejected} == wrong
    assert [(each.variable, each.measurements) for each in found.left] == [("l2", 4)]
    np.testing.assert_allclose(found.result.values[l[[0, 1]]], places[:2], atol=0.1)
    assert found.weights[2].tolist() == [1, 1, 0, 1]


def test_a_landmark_that_lost_nothing_stays_however_little_is_known() -> None:
    heard = Range(x[[0, 1, 0, 0]], l[[0, 0, 1, 2]], [5.0, 4.0, 2.0, 1.0], Isotropic(0.1))
    values = Values({x: (SE2, [[0, 0, 0], [3, 0, 0]]), l: (R(2), [[3, 4], [0, 2], [1, 0]])})
    graph = FactorGraph([heard], [l[2]])
    landmarks = landmarks_of(graph, values, [np.ones(4, dtype=bool)])
    (kept,) = landmarks.kept([np.array([True, False, True, False])], values)
    assert kept.tolist() == [False, False, True, False]
    assert landmarks.gone([kept])["l"].tolist() == [True, False, True]
    present = landmarks.present([kept], values)
    assert present.stack("l").numbers.tolist() == [1]
    moved = present.copy()
    moved[l[1]] = [7.0, 7.0]
    np.testing.assert_array_equal(put_back(values, moved)[l], [[3, 4], [7, 7], [1, 0]])
    (every,) = landmarks.kept([np.ones(4, dtype=bool)], values, lost=False)
    assert every.tolist() == [True, True, False, True]  # l2 is held


def test_contacts_are_wrong_where_one_is_too_far_and_not_where_all_sigmas_are_small() -> None:
    mission = floor(4)
    plain = mission.graph.optimize(mission.start)
    assert not misfit(plain, [mission.contacts])
    for spoiled in (sim.false_contacts(mission, 0.002, RNG(5)), sim.exchange_contacts(mission, 0.05, RNG(5))):
        assert misfit(spoiled.graph.optimize(spoiled.start), [spoiled.contacts])
    factors = list(mission.graph.factors)
    noise = SqrtInformation(2 * np.diag(1 / np.array([0.01, np.radians(0.25)])))
    factors[4] = measured(mission, mission.contacts.z, noise)
    small = FactorGraph(factors).optimize(mission.start)
    assert small.chi2_final > 2 * small.dof
    assert not misfit(small, [factors[4]])
