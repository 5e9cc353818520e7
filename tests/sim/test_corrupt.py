"""Wrong loop closures: as many as asked for, really wrong, the right ones untouched."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import Between
from models import SE2, SE3
from models.errors import OptionError
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
