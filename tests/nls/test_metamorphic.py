"""A problem told in another way has the same optimum: order, names, batches, directions, world frame."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Factor, Information, Prior
from models import SE2, SE3, SO3, LieGroup, R
from nls import FactorGraph, GaussNewton, Result, Stop, Values
from tests.nls.graphs import Sample, distance, pose_graph, x, y

TIGHT = GaussNewton(Stop(update_tol=1e-11))
SAMPLES = ((R(2), True), (SE2, True), (SE2, False), (SO3, False), (SE3, True))  # with a prior, or held by the gauge
Poses = npt.NDArray[np.float64]


@cache
def solved(group: LieGroup, anchored: bool) -> tuple[Sample, Result]:
    sample = pose_graph(group, n=10, seed=11, anchored=anchored)
    return sample, optimum(sample.graph, sample.values)


def optimum(graph: FactorGraph, values: Values) -> Result:
    result = graph.optimize(values, TIGHT)
    assert result.converged, result.reason
    assert result.chi2_final > 0.1
    return result


def whiteners(factor: Factor, group: LieGroup) -> Poses:
    """W'W of every measurement of a batch."""
    W = factor.bind(*(group for _ in factor.keys)).W
    W = W if W.ndim == 3 else W[..., None] * np.eye(group.dim)
    return np.array(np.broadcast_to(W.mT @ W, (len(factor), group.dim, group.dim)))


def made(keys: list[object], z: Poses, Omega: Poses) -> Factor:
    return (Between if len(keys) == 2 else Prior)(*keys, z, Information(Omega))  # type: ignore[arg-type]


def reordered(f: Factor, order: npt.NDArray[np.int64], group: LieGroup) -> Factor:
    z = f.bind(*(group for _ in f.keys)).z
    return made([keys[order] for keys in f.keys], z[order], whiteners(f, group)[order])


def one_by_one(sample: Sample, group: LieGroup) -> list[Factor]:
    """Every measurement as a factor of its own."""
    return [reordered(f, np.array([k]), group) for f in sample.graph.factors for k in range(len(f))]


def shuffled_and_split(sample: Sample, group: LieGroup) -> FactorGraph:
    factors = one_by_one(sample, group)
    np.random.default_rng(0).shuffle(factors)  # type: ignore[arg-type]
    assert len(factors) == len(sample.graph) > len(sample.graph.factors)
    return FactorGraph(factors)


def rows_shuffled(sample: Sample, group: LieGroup) -> FactorGraph:
    rng = np.random.default_rng(1)
    return FactorGraph([reordered(f, rng.permutation(len(f)), group) for f in sample.graph.factors])


def edges_reversed(sample: Sample, group: LieGroup) -> FactorGraph:
    """j seen from i becomes i seen from j: z^-1, the information carried over by the adjoint of z; chi2 is equal."""
    graph = FactorGraph()
    for f in sample.graph.factors:
        if isinstance(f, Between):
            z = f.bind(group, group).z
            back = np.linalg.inv(group.adjoint(z))
            Omega = back.mT @ whiteners(f, group) @ back
            graph.add(Between(f.keys[1], f.keys[0], group.inverse(z), Information((Omega + Omega.mT) / 2)))
        else:
            graph.add(f)
    return graph


@pytest.mark.parametrize(("group", "anchored"), SAMPLES, ids=str)
def test_factors_told_in_another_way(group: LieGroup, anchored: bool) -> None:
    sample, one = solved(group, anchored)
    for retold in (shuffled_and_split, rows_shuffled, edges_reversed):
        graph = retold(sample, group)
        assert graph.chi2(sample.values) == pytest.approx(sample.graph.chi2(sample.values), rel=1e-10)
        other = optimum(graph, sample.values)
        assert other.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
        assert distance(group, one.values[x], other.values[x]) < 1e-8


@pytest.mark.parametrize(("group", "anchored"), SAMPLES, ids=str)
def test_variables_told_in_another_way(group: LieGroup, anchored: bool) -> None:
    """Other numbers and places in the stack; a second kind for poses of odd number; the world frame moved."""
    sample, one = solved(group, anchored)
    rng, X, n = np.random.default_rng(2), sample.values[x], np.arange(10)
    name, place = 100 + 7 * rng.permutation(10), rng.permutation(10)
    name[0] = 3  # the lowest number stays with the pose that is held
    renumbered, two_kinds, moved = FactorGraph(), FactorGraph(), FactorGraph()
    T = group.exp(np.linspace(2.0, -1.0, group.dim))
    for f in one_by_one(sample, group):
        numbers = [int(keys.numbers[0]) for keys in f.keys]
        Omega = whiteners(f, group)
        renumbered.add(made([x[name[k]] for k in numbers], f.z, Omega))
        two_kinds.add(made([(y if k % 2 else x)[k] for k in numbers], f.z, Omega))
        moved.add(made([x[k] for k in numbers], f.z if len(numbers) == 2 else group.compose(T, f.z), Omega))
    start = Values({x: (group, group.compose(T, X))})
    assert moved.chi2(start) == pytest.approx(sample.graph.chi2(sample.values), rel=1e-10)
    results = (
        optimum(renumbered, Values({x: (group, X[place], name[place])})),
        optimum(two_kinds, Values({x: (group, X[::2], n[::2]), y: (group, X[1::2], n[1::2])})),
        optimum(moved, start),
    )
    halves = np.stack([results[1].values[x], results[1].values[y]], axis=1).reshape(X.shape)
    back = group.compose(group.inverse(T), results[2].values[x])
    for other, poses in zip(results, (results[0].values[x[name]], halves, back), strict=True):
        assert other.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
        assert distance(group, one.values[x], poses) < 1e-8
