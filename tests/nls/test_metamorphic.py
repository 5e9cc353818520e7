"""The same problem told in another way has the same optimum: order, names, batches, directions, world frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Factor, Information, Prior
from models import LieGroup
from nls import FactorGraph, GaussNewton, Result, Stop, Values
from tests.nls.graphs import GROUPS, Sample, distance, pose_graph, x

TIGHT = GaussNewton(Stop(update_tol=1e-11, chi2_rtol=0.0, gradient_tol=0.0))


@pytest.fixture(params=GROUPS, ids=str)
def group(request: pytest.FixtureRequest) -> LieGroup:
    return request.param  # type: ignore[no-any-return]


@pytest.fixture(params=[True, False], ids=["prior", "gauge"])
def sample(request: pytest.FixtureRequest, group: LieGroup) -> Sample:
    return pose_graph(group, n=10, seed=11, anchored=request.param)


def solved(graph: FactorGraph, values: Values) -> Result:
    result = graph.optimize(values, TIGHT)
    assert result.converged, result.reason
    assert result.chi2_final > 0.1
    return result


def whiteners(factor: Factor, group: LieGroup) -> npt.NDArray[np.float64]:
    """W'W of every measurement of a batch."""
    W = factor.bind(*(group for _ in factor.keys)).W
    W = W if W.ndim == 3 else W[..., None] * np.eye(group.dim)
    return np.array(np.broadcast_to(W.mT @ W, (len(factor), group.dim, group.dim)))


def one_by_one(sample: Sample, group: LieGroup) -> list[Factor]:
    """Every measurement as a factor of its own."""
    out: list[Factor] = []
    for f in sample.graph.factors:
        Omega, model = whiteners(f, group), f.bind(*(group for _ in f.keys))
        for k in range(len(f)):
            keys = [keys[[k]] for keys in f.keys]
            noise = Information(Omega[k])
            out.append(Between(*keys, model.z[k], noise) if len(keys) == 2 else Prior(keys[0], model.z[k], noise))
    return out


def same(group: LieGroup, one: Result, other: Result, poses: npt.NDArray[np.float64] | None = None) -> None:
    assert other.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
    assert distance(group, one.values[x], other.values[x] if poses is None else poses) < 1e-8


def test_shuffled_and_split_factors(sample: Sample, group: LieGroup) -> None:
    factors = one_by_one(sample, group)
    np.random.default_rng(0).shuffle(factors)  # type: ignore[arg-type]
    assert len(factors) == len(sample.graph) > len(sample.graph.factors)
    same(group, solved(sample.graph, sample.values), solved(FactorGraph(factors), sample.values))


def test_shuffled_rows_of_a_batch(sample: Sample, group: LieGroup) -> None:
    rng, graph = np.random.default_rng(1), FactorGraph()
    for f in sample.graph.factors:
        order = rng.permutation(len(f))
        Omega, z = whiteners(f, group)[order], f.bind(*(group for _ in f.keys)).z[order]
        keys = [k[order] for k in f.keys]
        graph.add(Between(*keys, z, Information(Omega)) if len(keys) == 2 else Prior(keys[0], z, Information(Omega)))
    same(group, solved(sample.graph, sample.values), solved(graph, sample.values))


def test_renumbered_variables(sample: Sample, group: LieGroup) -> None:
    """Numbers and places in the stack change; what belongs together does not."""
    rng = np.random.default_rng(2)
    name, place = 100 + 7 * rng.permutation(10), rng.permutation(10)
    name[0] = 3  # the lowest number stays with the pose that is held
    X = sample.values[x]
    graph = FactorGraph()
    for f in one_by_one(sample, group):
        keys = [x[name[k.numbers]] for k in f.keys]
        graph.add(Between(*keys, f.z, f.noise) if len(keys) == 2 else Prior(keys[0], f.z, f.noise))
    values = Values({x: (group, X[place], name[place])})
    one, other = solved(sample.graph, sample.values), solved(graph, values)
    same(group, one, other, other.values[x[name]])


def test_two_kinds_instead_of_one(sample: Sample, group: LieGroup) -> None:
    """The poses of odd number are given another kind."""
    from tests.nls.graphs import y

    def renamed(keys: object) -> object:
        number = int(keys.numbers[0])  # type: ignore[attr-defined]
        return y[number] if number % 2 else x[number]

    graph = FactorGraph()
    for f in one_by_one(sample, group):
        keys = [renamed(k) for k in f.keys]
        graph.add(Between(*keys, f.z, f.noise) if len(keys) == 2 else Prior(keys[0], f.z, f.noise))  # type: ignore[arg-type]
    X, n = sample.values[x], np.arange(10)
    values = Values({x: (group, X[::2], n[::2]), y: (group, X[1::2], n[1::2])})
    one, other = solved(sample.graph, sample.values), solved(graph, values)
    poses = np.array(X)
    poses[::2], poses[1::2] = other.values[x], other.values[y]
    same(group, one, other, poses)


def test_reversed_edges(sample: Sample, group: LieGroup) -> None:
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
    assert graph.chi2(sample.values) == pytest.approx(sample.graph.chi2(sample.values), rel=1e-10)
    same(group, solved(sample.graph, sample.values), solved(graph, sample.values))


def test_the_world_frame_moved(sample: Sample, group: LieGroup) -> None:
    """T X_i for all i: the same chi2, and the optimum moved with it."""
    T = group.exp(np.linspace(2.0, -1.0, group.dim))
    graph = FactorGraph()
    for f in sample.graph.factors:
        graph.add(Prior(f.keys[0], group.compose(T, f.z), f.noise) if isinstance(f, Prior) else f)
    values = Values({x: (group, group.compose(T, sample.values[x]))})
    assert graph.chi2(values) == pytest.approx(sample.graph.chi2(sample.values), rel=1e-10)
    one, other = solved(sample.graph, sample.values), solved(graph, values)
    same(group, one, other, group.compose(group.inverse(T), other.values[x]))


@pytest.mark.parametrize("convention", ["log", "g2o", "graphslam"])
def test_conventions_agree_to_first_order(group: LieGroup, convention: str) -> None:
    """Measured almost without error, every convention with its own information finds the same poses."""
    sample = pose_graph(group, n=8, seed=3)
    half = np.array([2.0 if c in ("roll", "pitch", "yaw") and group.point_dim == 3 else 1.0 for c in group.components])
    if convention == "log":
        half[:] = 1.0
    graph = FactorGraph()
    for f in sample.graph.factors:
        X = [sample.truth[keys] for keys in f.keys]
        h = group.between(*X) if len(X) == 2 else X[0]
        z = group.retract(h, 1e-4 * np.random.default_rng(len(f)).normal(size=(len(f), group.dim)))
        Omega = whiteners(f, group) * half[:, None] * half
        make = Between if len(X) == 2 else Prior
        graph.add(make(*f.keys, z, Information(Omega), convention=convention))
        f._z, f._model = z, None
    one, other = (g.optimize(sample.truth, TIGHT) for g in (sample.graph, graph))
    assert one.chi2_final > 1e-6
    assert other.chi2_final == pytest.approx(one.chi2_final, rel=2e-3)
    assert distance(group, one.values[x], other.values[x]) < 1e-6


def test_a_measurement_twice_is_one_of_twice_the_information(group: LieGroup) -> None:
    sample = pose_graph(group, n=6, seed=4)
    twice, double = FactorGraph(sample.graph.factors), FactorGraph(sample.graph.factors[1:])
    first = sample.graph.factors[0]
    twice.add(Between(*first.keys, first.z, first.noise))
    double.add(Between(*first.keys, first.z, Information(2 * whiteners(first, group))))
    same(group, solved(twice, sample.values), solved(double, sample.values))
