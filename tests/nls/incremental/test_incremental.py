"""`nls.Incremental`: after every update its chi2 is within its gap of the batch optimum, and its gap within `tol`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import factors as f
import nls
import sim
from factors import Between, DriftingStep, Factor, GemanMcClure, Huber, Isotropic, Position, Prior, Range, Shifted
from factors.base import Model
from factors.function import FunctionFactor
from factors.keys import Keys
from models import SE2, SE3, LieGroup, R
from models.algebra import Array, Index
from models.errors import GraphError, OptionError
from nls import FactorGraph, Incremental, Values, kinds
from nls.incremental.steps import steps
from nls.linear import cholesky, updatable
from tests.factors.samples import Sample, full_noise, situation
from tests.factors.test_conformity import SAMPLES

x, l, c = kinds("x", "l", "c")
STEP = Isotropic(0.1)


def first(values: Values) -> Values:
    """The first pose of some values."""
    stack = values.stack("x")
    return Values({x: (stack.manifold, stack.X[:1], stack.numbers[:1])})


def grown(factors: Sequence[Factor], start: Values, smoother: Incremental | None = None) -> Incremental:
    """A smoother, given step after step."""
    smoother = smoother or Incremental()
    for step in steps(factors):
        smoother.update(step.factors, first(start))
    return smoother


def is_optimal(smoother: Incremental) -> None:
    """chi2 is above its minimum by no more than the gap, and the gap is within the tolerance."""
    best = smoother.graph.optimize(smoother.values).chi2_final
    above, allowed = smoother.chi2 - best, smoother.tol * max(smoother.chi2, 1.0)
    assert smoother.gap <= allowed
    bound = allowed if any(f.kernel for f in smoother.graph.factors) else smoother.gap
    assert -1e-9 * max(best, 1.0) <= above <= bound + 1e-9 * max(best, 1.0)
    np.testing.assert_allclose(smoother.chi2, smoother.graph.chi2(smoother.values), rtol=1e-9, atol=1e-9)


def same(smoother: Incremental, result: nls.Result, tolerance: float) -> None:
    """Every variable is where a batch solution has it."""
    for kind, stack in result.values.stacks.items():
        keys = Keys(kind, stack.numbers)
        np.testing.assert_allclose(stack.manifold.local(stack.X, smoother[keys]), 0, atol=tolerance)


@pytest.mark.parametrize("group", [SE2, SE3])
def test_a_loop_is_at_its_optimum_after_every_step(group: type) -> None:
    rng = np.random.default_rng(0)
    world = sim.ring(rng, laps=2, per_lap=25) if group is SE2 else sim.sphere(rng, rings=5, per_ring=12)
    smoother = Incremental()
    for k, step in enumerate(steps(world.graph.factors)):
        smoother.update(step.factors, first(world.start) if k == 0 else None)
        if k % 5 == 0:
            is_optimal(smoother)
    is_optimal(smoother)
    assert not smoother.waiting
    assert len(smoother.graph) == len(world.graph)


class Doubled(Between):
    """The last component counts twice."""

    def innovation(self, model: Model, X: tuple[Array, ...], jacobians: bool = True) -> tuple[Array, tuple[Array, ...]]:
        e, J = super().innovation(model, X, jacobians)
        twice = np.append(np.ones(model.space.dim - 1), 2.0)
        return e * twice, tuple([J_k * twice[:, None] for J_k in J])


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_a_subclass_is_linearized_by_its_own_innovation(group: LieGroup) -> None:
    rng, d = np.random.default_rng(0), group.dim
    truth = group.exp(np.zeros((1, d)))
    smoother = Incremental()
    smoother.update(Prior(x[0], truth[0], STEP), Values({x: (group, truth)}))
    for k in range(1, 12):
        truth = np.concatenate([truth, group.compose(truth[-1:], group.exp(np.append(np.eye(d)[0, :-1], 0.5)[None]))])
        off = group.exp(rng.normal(0, 0.1, (2, d)))
        z = group.compose(group.between(truth[[k - 1, max(k - 3, 0)]], truth[[k, k]]), off)
        step, match = Between(x[k - 1], x[k], z[0], STEP, "g2o"), Doubled(x[max(k - 3, 0)], x[k], z[1], STEP, "g2o")
        smoother.update([step, match] if k > 3 else step)
        is_optimal(smoother)


def test_a_range_alone_waits_for_the_third() -> None:
    beacon = np.array([3.0, 4.0])
    poses = np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0.5], [2, 3, 1.0]])
    smoother = Incremental(1e-9)
    smoother.update(Prior(x[0], poses[0], STEP), Values({x: (SE2, poses[:1]), l: (R(2), np.zeros((0, 2)))}))
    waiting = []
    for k in range(4):
        z = np.linalg.norm(beacon - poses[k, :2])
        walk = [] if k == 0 else [Between(x[k - 1], x[k], SE2.between(poses[k - 1 : k], poses[k : k + 1]), STEP)]
        smoother.update([*walk, Range(x[k], l[7], z, Isotropic(0.01))])
        waiting.append([repr(keys) for keys in smoother.waiting])
    assert waiting == [["l7"], ["l7"], [], []]
    np.testing.assert_allclose(smoother[l[7]], beacon, atol=1e-6)
    assert len(smoother.graph) == 8


def test_sonar_contacts_online_end_at_the_batch_map() -> None:
    world = sim.hauv_floor(np.random.default_rng(0), legs=2, per_leg=6)
    smoother, waited = Incremental(1e-6), 0
    for k, step in enumerate(steps(world.graph.factors)):
        smoother.update(step.factors, first(world.start) if k == 0 else None)
        waited += len(smoother.waiting)
    result = world.graph.optimize(nls.initialize(world.graph, world.start)[0])
    assert waited
    assert not smoother.waiting
    same(smoother, result, 1e-3)


def test_a_position_without_a_heading_waits_for_another() -> None:
    smoother = Incremental(1e-9)
    smoother.update([Between(x[k], x[k + 1], [1.0, 0, 0], STEP) for k in range(4)], Values({x: (SE2, [[0.0, 0, 0]])}))
    smoother.update(Position(x[1], [1.0, 1.0], STEP))
    assert len(smoother.graph) == 4
    assert [repr(factor) for factor in smoother.pending] == ["Position(x1)"]
    np.testing.assert_allclose(smoother[x[4]], [4, 0, 0], atol=1e-9)
    smoother.update(Position(x[4], [1.0, 4.0], STEP))
    assert len(smoother.graph) == 6
    same(smoother, smoother.graph.optimize(smoother.values), 1e-4)
    np.testing.assert_allclose(smoother[x[4]], [1, 4, np.pi / 2], atol=0.01)


@pytest.mark.parametrize("sample", SAMPLES, ids=str)
def test_every_factor_in_random_order_ends_at_the_batch_solution(sample: Sample) -> None:
    n, rng = 3, np.random.default_rng(5)
    X, z = situation(sample, "truth", n, 0)
    factor = sample.factor(z, full_noise(n, sample.dim, 1))
    priors = [Prior(keys, Y, Isotropic(0.3)) for keys, Y in zip(factor.keys, X, strict=True)]
    graph = FactorGraph([factor, *priors])
    moved = [m.retract(Y, 0.01 * rng.normal(size=(n, m.dim))) for m, Y in zip(sample.manifolds, X, strict=True)]
    start = sample.values(tuple(moved))
    pieces = [p for f in graph.factors for p in ([f] if isinstance(f, FunctionFactor) else f)]
    smoother = Incremental(1e-13)
    for k in rng.permutation(len(pieces)).tolist():
        smoother.update(pieces[k], start)
    assert not smoother.waiting
    result = graph.optimize(smoother.values, nls.GaussNewton(nls.Stop(update_tol=1e-12, max_iterations=200)))
    same(smoother, result, 1e-6)


@given(st.integers(0, 10**6))
def test_random_graphs_removals_kernels_and_rebuilds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = sim.ring(rng, laps=2, per_lap=int(rng.integers(6, 12)))
    kernel = [None, Huber(1.0)][int(rng.integers(2))]
    smoother, removable = Incremental(), []
    for k, step in enumerate(steps(world.graph.factors)):
        new = [f if kernel is None else f.robust(kernel) for f in step.factors]
        smoother.update(new, first(world.start) if k == 0 else None)
        removable += [f for f in new if (abs(f.keys[0].numbers - f.keys[1].numbers) != 1).all()]
        if removable and rng.random() < 0.2:
            smoother.remove(removable.pop(int(rng.integers(len(removable)))))
        if rng.random() < 0.2:
            smoother._system.renew()
    is_optimal(smoother)


def test_without_room_for_new_variables_it_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    world = sim.ring(np.random.default_rng(2), laps=1, per_lap=20)
    monkeypatch.setattr(updatable, "RESERVE", 7)
    is_optimal(grown(world.graph.factors, world.start))


def test_without_suitesparse_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(updatable, "cholmod", lambda: None)
    monkeypatch.setattr(cholesky, "cholmod", lambda: None)
    world = sim.ring(np.random.default_rng(2), laps=2, per_lap=20)
    odometry, closures = world.graph.factors
    smoother = grown([odometry[:-1]], world.start)
    smoother.update(last := odometry[-1:])
    smoother.update(closures[(closures.keys[0].numbers != 39) & (closures.keys[1].numbers != 39)])
    is_optimal(smoother)
    assert "SuperLU" in smoother.linear_solver
    smoother.remove(last)
    assert x[39] not in smoother
    is_optimal(smoother)


def test_a_redescending_kernel_from_the_first_measurement_on() -> None:
    world = sim.ring(np.random.default_rng(4), laps=2, per_lap=20)
    wrong = Between(x[[2, 5]], x[[30, 22]], [[9.0, 0, 1], [0, 9, 2]], Isotropic(0.05)).robust(GemanMcClure(2.0))
    smoother = grown([*world.graph.factors, wrong], world.start)
    is_optimal(smoother)
    assert (wrong.weights(smoother.values) < 0.1).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        *(({"tol": tol}, "tol") for tol in (0, 1, -1e-3, "1e-3", None)),
        *(({"lag": lag}, "lag") for lag in (0, 2.0)),
        ({"landmarks": "go"}, "landmarks"),
        ({"decide_every": 0}, r"decide_every.*at least 1"),
        ({"decide_every": 10, "lag": 5}, "None with a lag"),
    ],
)
def test_options_are_refused_by_name(options: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Incremental(**options)


def test_unknown_variables_are_refused() -> None:
    smoother = Incremental()
    with pytest.raises(GraphError, match="x0 is not in the estimate"):
        smoother[x[0]]
    smoother.update([], Values({x: (SE2, [[0.0, 0, 0]])}))
    with pytest.raises(GraphError, match="x is in SE2, its initial values are in SE3"):
        smoother.update([], Values({x: (SE3, SE3.identity())}))


# ---- batches that grow: what measurements have of their own stays theirs


NOISE = Isotropic(0.1)
OFFSETS = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.3], [0.5, 0.0, -1.0]])
Z = np.array([[1.0, 0.1, 0.3], [0.9, 0.0, 0.1], [1.1, -0.1, 0.0]])

MADE: dict[str, Callable[[Index], Factor]] = {
    "numbers": lambda k: DriftingStep(x[k], x[k + 1], c[0], Z[k], NOISE, k + 1.0),
    "pairs": lambda k: f.BetweenSensors(x[k], x[k + 1], Z[k], NOISE, (OFFSETS[k], OFFSETS[k - 1])),
    "within": lambda k: Shifted(Position(x[k + 1], Z[k, :2], NOISE, offset=OFFSETS[k, :2]), np.eye(2), c[0]),
}


def start(n: int) -> Values:
    return Values({x: (SE2, 0.1 * np.random.default_rng(0).normal(size=(n, 3))), c: (R(2), np.zeros((1, 2)))})


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("sizes", [(1, 1, 1), (2, 1), (1, 2)])
def test_what_is_of_one_measurement_stays_with_it(name: str, sizes: tuple[int, ...]) -> None:
    """However many arrive at once, the optimum is that of all in one graph."""
    held = [Prior(x[np.arange(4)], start(4)[x], Isotropic(1.0)), Prior(c[0], [0.1, 0.2], Isotropic(0.5))]
    smoother = Incremental(tol=1e-9)
    smoother.update(held, start(4))
    parts = [MADE[name](k) for k in np.split(np.arange(3), np.cumsum(sizes)[:-1])]
    for part in parts:
        smoother.update(part)
    whole = FactorGraph([*held, *parts]).optimize(start(4)).values
    for kind in (x, c):
        np.testing.assert_allclose(smoother.values[kind], whole[kind], atol=2e-3)


def test_rows_of_a_follow_the_values_after_measurements_left() -> None:
    """Whatever part of its memory a batch uses: steps are taken with the A of where the variables are."""
    smoother, k = Incremental(), np.arange(40)
    smoother.update([Between(x[k], x[k + 1], [1.0, 0.0, 0.1], NOISE), Prior(x[0], [0, 0, 0], NOISE)], start(1))
    batch = smoother._system.batches[0]
    batch.drop(k < 35)
    A, At = batch.A(200)
    batch.variables[0].X[...] += [0.0, 1.0, 0.5]
    batch.linearize()
    expected = np.concatenate(batch.blocks(), axis=2).sum(axis=2).reshape(-1)
    assert np.abs(expected).max() > 1
    for rows in (A, At.T):
        np.testing.assert_allclose(rows.sum(axis=1), expected, atol=1e-12)
