"""Wrong loop closures and contacts: as many as asked for, really wrong, the right ones untouched."""

from __future__ import annotations

from math import radians

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import Between
from models import SE2, SE3
from models.errors import OptionError
from nls import FactorGraph, kinds
from tests.combinations import for_all


@pytest.fixture(scope="module", params=["ring", "sphere"])
def world(request: pytest.FixtureRequest) -> sim.World:
    rng = np.random.default_rng(4)
    return sim.ring(rng, laps=3, per_lap=60) if request.param == "ring" else sim.sphere(rng, rings=8, per_ring=15)


def errors(world: sim.World) -> npt.NDArray[np.float64]:
    """Whitened error at the truth of every measurement, (m,)."""
    norms = []
    for factor in world.graph.factors:
        model, X = world.truth.gather(factor)
        norms.append(np.linalg.norm(model.error(*X), axis=1))
    return np.concatenate(norms)


@for_all(grouped=[False, True], fraction=[0.1, 1.0, 2.0])
def test_the_mask_names_the_wrong_ones(world: sim.World, fraction: float, grouped: bool) -> None:
    spoiled, wrong = sim.outliers(world, fraction, np.random.default_rng(1), grouped)
    assert wrong.dtype == bool
    assert wrong.shape == (len(spoiled.graph),)
    assert wrong.sum() == round(fraction * world.closures)
    assert errors(spoiled)[wrong].min() > 10.0
    np.testing.assert_allclose(errors(spoiled)[~wrong], errors(world), atol=1e-9)
    assert f"{wrong.sum()} wrong loop closures" in spoiled.description
    assert spoiled.closures == world.closures + wrong.sum()
    assert spoiled.rows == len(spoiled.graph) * (3 if spoiled.name == "ring" else 6)


def test_the_given_world_is_left_alone(world: sim.World) -> None:
    before = [f.z.copy() for f in world.graph.factors]
    same, wrong = sim.outliers(world, 0.0, np.random.default_rng(1))
    assert same is world
    assert wrong.tolist() == [False] * len(world.graph)
    spoiled, _ = sim.outliers(world, 0.5, np.random.default_rng(1))
    assert len(before) == len(world.graph.factors) == 2
    assert all(np.array_equal(z, f.z) for z, f in zip(before, world.graph.factors, strict=True))
    assert spoiled.truth is world.truth
    assert spoiled.graph.factors[0] is world.graph.factors[0]


@for_all(grouped=[False, True])
def test_a_seed_gives_the_same_bits(world: sim.World, grouped: bool) -> None:
    z = [sim.outliers(world, 0.5, np.random.default_rng(s), grouped)[0].graph.factors[1].z for s in (1, 1, 2)]
    assert z[0].tobytes() == z[1].tobytes() != z[2].tobytes()


def test_a_group_agrees_with_itself(world: sim.World) -> None:
    """All five claim one and the same displacement G = x_i z x_j^-1 of one part of the path against another."""
    spoiled, wrong = sim.outliers(world, 0.4, np.random.default_rng(1), grouped=True)
    closures = spoiled.graph.factors[1]
    group = world.truth.stack("x").manifold
    assert isinstance(closures, Between)
    assert group in (SE2, SE3)
    late = wrong[-len(closures) :]
    i, j = (k[late] for k in closures.keys)
    G = group.compose(group.compose(world.truth[i], closures.z[late]), group.inverse(world.truth[j]))
    whole = len(G) // 5 * 5
    G = G[:whole].reshape(-1, 5, group.size)
    np.testing.assert_allclose(group.local(G[:, :1], G), 0.0, atol=1e-8)
    for k in (i, j):
        assert (np.diff(k.numbers[:whole].reshape(-1, 5), axis=1) == 1).all()


def test_what_cannot_be_spoiled_is_refused(world: sim.World) -> None:
    for fraction in (-0.1, float("nan"), float("inf")):
        with pytest.raises(OptionError, match="at least 0"):
            sim.outliers(world, fraction, np.random.default_rng(1))
    with pytest.raises(OptionError, match="without loop closures"):
        sim.outliers(sim.ring(np.random.default_rng(0), 1, 20), 0.1, np.random.default_rng(1))
    vague = sim.sphere(np.random.default_rng(0), rings=2, per_ring=4, sigma_t=100.0, sigma_r=1.0)
    with pytest.raises(OptionError, match="too few pairs are far from the truth"):
        sim.outliers(vague, 1.0, np.random.default_rng(1))
    with pytest.raises(OptionError, match="a generator such as"):
        sim.outliers(vague, 1.0, 3)  # type: ignore[arg-type]


x, l = kinds("x", "l")
SPOIL = {"exchange": sim.exchange_contacts, "false": sim.false_contacts}


@pytest.fixture(scope="module", params=["floor", "hull"])
def mission(request: pytest.FixtureRequest) -> sim.Mission:
    rng = np.random.default_rng(4)
    return sim.hauv_floor(rng, legs=2) if request.param == "floor" else sim.hauv_hull(rng, levels=2)


def contact_errors(mission: sim.Mission) -> np.ndarray:
    """Whitened error at the truth of every contact, (m,)."""
    model, X = mission.truth.gather(mission.contacts)
    return np.linalg.norm(model.error(*X), axis=1)


@for_all(name=SPOIL, fraction=[0.02, 0.3])
def test_the_mask_names_the_wrong_contacts(mission: sim.Mission, name: str, fraction: float) -> None:
    spoiled = SPOIL[name](mission, fraction, np.random.default_rng(1))
    m = len(mission.contacts)
    asked = round(fraction * m) if name == "false" else 2 * round(fraction * m / 2)
    assert spoiled.wrong.shape == (m,)
    assert spoiled.wrong.sum() == asked
    moved = (spoiled.contacts.z - mission.contacts.z) / [0.01, radians(0.25)]
    assert np.linalg.norm(moved[spoiled.wrong], axis=1).min() >= 10.0
    assert contact_errors(spoiled)[spoiled.wrong].min() > 5.0
    np.testing.assert_array_equal(contact_errors(spoiled)[~spoiled.wrong], contact_errors(mission)[~spoiled.wrong])
    np.testing.assert_array_equal(spoiled.contacts.z[~spoiled.wrong], mission.contacts.z[~spoiled.wrong])
    assert f"{asked} contacts are" in spoiled.description
    assert abs(spoiled.sensed.chi2(spoiled.truth) - spoiled.rows) < 4 * np.sqrt(2 * spoiled.rows)
    assert spoiled.rows == mission.rows - 2 * asked


def test_false_contacts_are_anywhere_in_the_image(mission: sim.Mission) -> None:
    spoiled = sim.false_contacts(mission, 1.0, np.random.default_rng(1))
    r, azimuth = spoiled.contacts.z.T
    assert spoiled.wrong.all()
    for u in ((r - 1) / 5, azimuth / radians(28.8) + 0.5):  # evenly from 0 to 1
        assert 0 < u.min() < 0.02
        assert 0.98 < u.max() < 1
        assert abs(u.mean() - 0.5) < 4 / np.sqrt(12 * len(u))


def test_exchanged_contacts_are_neighbors_of_one_image(mission: sim.Mission) -> None:
    spoiled = sim.exchange_contacts(mission, 0.2, np.random.default_rng(1))
    pose, z, scale = mission.contacts.keys[0].numbers, mission.contacts.z, np.array([0.01, radians(0.25)])
    chosen = np.flatnonzero(spoiled.wrong)
    for a in chosen:
        (b,) = np.flatnonzero((z == spoiled.contacts.z[a]).all(axis=1))  # whose contact it is
        assert pose[a] == pose[b]
        np.testing.assert_array_equal(spoiled.contacts.z[b], z[a])
        away = np.linalg.norm((z - z[a]) / scale, axis=1)
        others = (pose == pose[a]) & (np.arange(len(z)) != a)
        assert away[b] == away[others].min() >= 10


@for_all(fraction=[0.1, 0.8])
def test_lost_contacts(mission: sim.Mission, fraction: float) -> None:
    fewer = sim.drop_contacts(mission, fraction, np.random.default_rng(1))
    m, kept = len(mission.contacts), len(fewer.contacts)
    assert kept <= m - round(fraction * m)
    which, counts = np.unique(fewer.contacts.keys[1].numbers, return_counts=True)
    assert counts.min() >= 3
    np.testing.assert_array_equal(which, fewer.truth.stack("l").numbers)  # the others left, numbers stay
    np.testing.assert_array_equal(fewer.truth[l], mission.truth[l[which]])
    before = {
        (i, k): z for i, k, z in zip(*(n.numbers for n in mission.contacts.keys), mission.contacts.z, strict=True)
    }
    for i, k, z in zip(*(n.numbers for n in fewer.contacts.keys), fewer.contacts.z, strict=True):
        np.testing.assert_array_equal(before[i, k], z)
    assert fewer.wrong.shape == (kept,)
    assert fraction < 0.5 or fewer.graph.optimize(fewer.start).converged


@for_all(times=[2.0, 20.0])
def test_poor_odometry_says_so(mission: sim.Mission, times: float) -> None:
    missions = [sim.poor_odometry(mission, 0.3, np.random.default_rng(s), times) for s in range(20)]
    n, chi2 = len(mission.odometry), 0.0
    good = np.array([100.0, 100.0, 1 / radians(0.25)])
    for poor in missions:
        W = poor.odometry.noise.sqrt_information(n, ("x", "y", "yaw"))
        worse = W[:, 0] < 90.0
        assert worse.sum() == round(0.3 * n)
        np.testing.assert_allclose(W[worse], np.tile(good / times, (worse.sum(), 1)))
        np.testing.assert_allclose(W[~worse], np.tile(good, (n - worse.sum(), 1)))
        np.testing.assert_array_equal(poor.odometry.z[~worse], mission.odometry.z[~worse])
        assert not poor.wrong.any()
        assert poor.rows == mission.rows
        chi2 += FactorGraph([poor.odometry[worse]]).chi2(mission.truth)  # of the poor steps alone
    dof = 20 * 3 * round(0.3 * n)
    assert abs(chi2 - dof) < 4 * np.sqrt(2 * dof)
    assert np.mean([poor.ate(poor.start) for poor in missions]) > (2 if times > 10 else 1) * mission.ate(mission.start)


@for_all(name=[*SPOIL, "drop"])
def test_nothing_asked_for_nothing_changed(mission: sim.Mission, name: str) -> None:
    spoil = {**SPOIL, "drop": sim.drop_contacts}[name]
    assert spoil(mission, 0.0, np.random.default_rng(1)) is mission
    for fraction in (-0.1, 1.5, float("nan")):
        with pytest.raises(OptionError, match="expected a number from 0 to 1"):
            spoil(mission, fraction, np.random.default_rng(1))
    with pytest.raises(OptionError, match="a generator such as"):
        spoil(mission, 0.1, 3)


def test_wrong_ones_are_not_made_wrong_twice(mission: sim.Mission) -> None:
    twice = sim.false_contacts(
        sim.false_contacts(mission, 0.4, np.random.default_rng(1)), 0.4, np.random.default_rng(2)
    )
    assert twice.wrong.sum() == 2 * round(0.4 * len(mission.contacts))
    with pytest.raises(OptionError, match="contacts 0 are right"):
        sim.false_contacts(sim.false_contacts(mission, 1.0, np.random.default_rng(1)), 0.5, np.random.default_rng(2))
    with pytest.raises(OptionError, match="no landmark keeps 3 contacts"):
        sim.drop_contacts(mission, 1.0, np.random.default_rng(1))
