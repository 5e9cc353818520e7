"""Diagonal blocks of an inverse from a Cholesky factor, and the supernodes they are computed with."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse as sp

import sim
from factors import Between, Isotropic, Prior
from models import SE2, R
from models.algebra import Array
from models.errors import ResourceLimitError
from nls import FactorGraph, LinearSystem, Values
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.lu import SuperLU
from nls.sparse import takahashi
from nls.sparse.pattern import Pattern
from tests.nls.graphs import SAMPLES, mixed, pose_graph, x
from tests.nls.solving import DECOMPOSITIONS, factorized, near

every_factorization = pytest.mark.parametrize("kind", DECOMPOSITIONS)


def diagonal_blocks(state: Factorization, memory_limit: float) -> Array:
    """The blocks of all variables, one after the other."""
    every = np.arange(len(state.hessian.dims))
    return state.inverse_blocks(every, every, memory_limit)


def agrees(state: Factorization, system: LinearSystem, memory_limit: float = 4e9) -> None:
    """Every block against the dense inverse, relative to the largest number of the block; exactly symmetric."""
    found, dims = diagonal_blocks(state, memory_limit), state.hessian.dims
    inverse = np.linalg.inv((system.A.T @ system.A).toarray())
    assert len(found) == int((dims**2).sum())
    for flat, end, d in zip(np.split(found, np.cumsum(dims**2)[:-1]), np.cumsum(dims), dims, strict=True):
        block = flat.reshape(d, d)
        near(block, inverse[end - d : end, end - d : end], 1e-10)
        assert np.array_equal(block, block.T)


def dense_world(seed: int) -> LinearSystem:
    """A city with many loops: fronts of every size."""
    world = sim.manhattan(np.random.default_rng(seed), n_poses=120)
    world.graph.fix(x[0])
    return world.graph.linearize(world.truth)


@every_factorization
def test_quadratic_forms_of_many_matrices(kind: type[Decomposition]) -> None:
    """More than go the way together; one is zero, and one begins in every variable."""
    system, rng = dense_world(2), np.random.default_rng(0)
    U = rng.normal(size=(system.pattern.n, 3 * 150)) * (rng.random((system.pattern.n, 3 * 150)) < 0.02)
    U[:, 3:6], U[:, 6] = 0.0, 1.0
    H, blocks = (system.A.T @ system.A).toarray(), U.reshape(-1, 150, 3).transpose(1, 0, 2)
    found = factorized(kind, system).quadratic_forms(sp.csc_array(U), 3)
    near(found, blocks.mT @ np.linalg.solve(H, blocks), 1e-10)


@every_factorization
def test_every_graph_against_the_dense_inverse(kind: type[Decomposition]) -> None:
    for name in ("R(1)", "SO3", "SE3 odd ids", "two poses", "mixed", "mixed, some fixed"):
        sample = SAMPLES[name]()
        system = sample.graph.linearize(sample.values)
        agrees(factorized(kind, system), system)


@pytest.mark.parametrize("step", [0.0, 60e-6, 1e9], ids=["nothing merged", "as it is", "all in one"])
@every_factorization
def test_merging_changes_nothing(kind: type[Decomposition], step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(takahashi, "STEP", step)
    if step == 0.0:
        monkeypatch.setattr(takahashi, "GATHER", 0.0)
    for system in (dense_world(1), mixed(3).graph.linearize(mixed(3).values)):
        agrees(factorized(kind, system), system)


@every_factorization
def test_a_long_loop(kind: type[Decomposition]) -> None:
    """Variances on a ring of resistances, by hand: 1/s = 1/k + 1/(n - k) between places k apart."""
    n = 600
    graph = FactorGraph([Between(x[np.arange(n)], x[(np.arange(n) + 1) % n], np.zeros((n, 1)), Isotropic(1.0))])
    graph.fix(x[0])
    system = graph.linearize(Values({x: (R(1), np.zeros((n, 1)))}))
    state = factorized(kind, system)
    k = np.arange(1, n)
    np.testing.assert_allclose(diagonal_blocks(state, 4e9), k * (n - k) / n, rtol=1e-9)


@every_factorization
def test_numbers_that_happen_to_be_zero(kind: type[Decomposition]) -> None:
    """At heading 0 and unit steps whole parts of A'A vanish; the structure has them all the same."""
    X = np.zeros((30, 3))
    X[:, 0] = np.arange(30)
    graph = FactorGraph([Prior(x[0], X[0], Isotropic(0.1))])
    graph.add(Between(x[0:29], x[1:30], np.tile([1.0, 0, 0], (29, 1)), Isotropic(0.1)))
    graph.add(Between(x[[0, 3, 9]], x[[20, 17, 28]], SE2.between(X[[0, 3, 9]], X[[20, 17, 28]]), Isotropic(0.1)))
    system = graph.linearize(Values({x: (SE2, X)}))
    agrees(factorized(kind, system), system)


def test_fronts_needed_at_one_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two leaves of a star, never together; of a chain a front and its parent's."""
    tall = np.full(3, 200, dtype=np.intp)
    star = takahashi.Supernodes(tall, np.array([2, 2]), np.array([0, 1]))
    assert (len(star), star.numbers) == (3, 200**2 + 400**2)
    monkeypatch.setattr(takahashi, "STEP", 0.0)
    monkeypatch.setattr(takahashi, "GATHER", 0.0)
    chain = takahashi.Supernodes(tall, np.array([1, 2]), np.array([0, 1]))
    assert (len(chain), chain.numbers) == (3, 2 * 400**2)


def test_what_would_not_fit_is_refused() -> None:
    sample = pose_graph(SE2)
    state = factorized(SuperLU, sample.graph.linearize(sample.values))
    with pytest.raises(ResourceLimitError, match=r"the marginal covariances of 8 variables need .* GB") as caught:
        diagonal_blocks(state, 1000.0)
    assert caught.value.needed > caught.value.limit == 1000.0
    diagonal_blocks(state, caught.value.needed)


@every_factorization
def test_nothing_free_has_no_blocks(kind: type[Decomposition]) -> None:
    sample = pose_graph(SE2)
    held = np.ones(8, dtype=bool)
    state = factorized(kind, LinearSystem.at(Pattern(sample.graph.factors, sample.values, held), sample.values))
    assert diagonal_blocks(state, 4e9).shape == (0,)
