"""Wrong loop closures: the kernels, what neighbors and groups tell, and that exactly the wrong ones are rejected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal, Factor, GemanMcClure, Information, Isotropic, Range
from models import SE2, SE3, LieGroup, R
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError
from nls import FactorGraph, Values, kinds
from nls.posegraph import closures
from nls.robust import Robustified
from nls.robust.accepted_closures import FITS, WIDER_GATE, misfits, path_covariances, witnesses
from nls.robust.contacts import along
from nls.robust.kernels import GemanMcClureSquares, TruncatedSquares
from nls.robust.loop_graph import Neighbors, Odometry, loop_graph, neighbors
from nls.robust.truncated_least_squares import lowest

(x,) = kinds("x")
RNG = np.random.default_rng
S = np.array([1e-4, 0.3, 0.9, 1.1, 4.0, 17.0, 400.0])


@pytest.fixture(scope="module")
def city() -> sim.World:
    return sim.manhattan(RNG(3), n_poses=300)


def wrong_closures(world: sim.World, count: int, rng: np.random.Generator, group: int = 1) -> Between:
    """Closures with the measurement of a true one between two other poses, in groups that agree with one another."""
    masks = closures(world.graph.pattern(world.truth))
    factor, true = next((f, np.flatnonzero(m)) for f, m in zip(world.graph.factors, masks, strict=True) if m.any())
    truth = world.truth[x]
    manifold, n = world.truth.stack("x").manifold, len(truth)
    assert isinstance(manifold, LieGroup)
    i, j = rng.integers(0, n - group, (2, 20 * count))
    i, j = (each[np.abs(i - j) > 4 * group][: count // group] for each in (i, j))
    z = factor.bind(manifold, manifold).z[rng.choice(true, len(i))]
    i, j, first = np.repeat(i, group), np.repeat(j, group), np.repeat(np.arange(len(i)), group)
    step = np.tile(np.arange(group), len(i) // group)
    back = manifold.compose(manifold.inverse(truth[i + step]), truth[i])
    ahead = manifold.compose(manifold.inverse(truth[j]), truth[j + step])
    z = manifold.compose(manifold.compose(back, z[first]), ahead)
    sigmas = Diagonal(**{name: 0.05 if name in "xyz" else 0.01 for name in manifold.components})
    return Between(x[i + step], x[j + step], z, sigmas, convention=factor.convention)


def loose(factor: Factor, times: float) -> Between:
    """Measurements with sigmas so many times larger."""
    W = factor.bind(SE2, SE2).W / times
    W = W if W.ndim == 3 else W[:, :, None] * np.eye(3)
    information = np.broadcast_to(W.mT @ W, (len(factor), 3, 3))
    return Between(*factor.keys, factor.z, Information(information), convention=factor.convention)


def names(factor: Between) -> set[str]:
    return {factor.describe(k) for k in range(len(factor))}


def test_graduated_kernels_slope_as_they_weigh_and_end_where_they_should() -> None:
    for kind in (TruncatedSquares, GemanMcClureSquares):
        for mu in (1e-3, 0.2, 1.0, 7.0, 1e3):
            kernel, h = kind(1.7), 1e-6 * S
            kernel.mu = mu
            slope = (kernel.rho(S + h) - kernel.rho(S - h)) / (2 * h)
            np.testing.assert_allclose(slope, kernel.weight(S), rtol=1e-5, atol=1e-5)
            assert (np.diff(kernel.rho(S)) >= 0).all()
            assert (kernel.weight(S) >= 0).all()
            assert (kernel.weight(S) <= 1).all()
    truncated, squares = TruncatedSquares(2.0), GemanMcClureSquares(2.0)
    truncated.begin(400.0)
    squares.begin(400.0)
    assert (truncated.mu, squares.mu) == (4 / (2 * 400 - 4), 2 * 400 / 4)
    assert (truncated.weight(S) > 0).all()
    assert (squares.weight(S) > 0.4).all()
    for kernel in (truncated, squares):
        while not kernel.done:
            kernel.bend()
    np.testing.assert_allclose(truncated.rho(S), np.minimum(S, 4.0), atol=2e-2)
    np.testing.assert_array_equal(truncated.weight(S[S != 4.0]), S[S != 4.0] < 4.0)
    np.testing.assert_array_equal(squares.rho(S), GemanMcClure(2.0).rho(S))
    np.testing.assert_array_equal(squares.weight(S), GemanMcClure(2.0).weight(S))


@pytest.mark.parametrize("space", [SE2, SE3])
def test_covariances_along_paths_are_those_of_the_chain(space: LieGroup) -> None:
    rng, n = RNG(1), 9
    step = space.exp(0.3 * rng.normal(size=(n - 1, space.dim)))
    noise = Isotropic(0.02)
    a = np.arange(n - 1)
    a, b = np.where(a % 3 == 1, a + 1, a), np.where(a % 3 == 1, a, a + 1)  # some are measured backward
    step[a > b] = space.inverse(step[a > b])
    graph = FactorGraph([Between(x[a], x[b], step, noise)])
    values = nls.starts.chain(graph, Values({x: (space, space.identity(n))}))
    pose_graph = loop_graph(graph, values)
    assert pose_graph.poses.odometry.all()
    T, i, j = values[x], np.array([0, 7, 3, 5]), np.array([8, 2, 4, 0])
    Z, C = Odometry(pose_graph.edges, T).between(i, j)
    np.testing.assert_allclose(Z, space.compose(space.inverse(T[i]), T[j]), atol=1e-12)
    np.testing.assert_allclose(path_covariances(pose_graph.edges, T, i, j, 1.0), C, atol=1e-12)
    for k, (first, last) in enumerate(zip(i, j, strict=True)):  # by the graph itself, that pose held
        held = FactorGraph(graph.factors)
        held.fix(x[int(first)])
        expected = nls.Marginals(held, values).covariance(x[int(last)], frame="body")
        np.testing.assert_allclose(C[k], expected, rtol=1e-6, atol=1e-10)
    renumbered = FactorGraph([Between(x[3 * a], x[3 * b], step, noise)])  # neither dense nor in the order of the stack
    track = along(renumbered, Values({x: (space, T[::-1], 3 * np.arange(n)[::-1])}), "x")
    assert (track.part == 0).all()
    for found, one in zip(track.odometry.between(i, j), (Z, C), strict=True):
        np.testing.assert_allclose(found, one, atol=1e-12)


def test_the_lowest_optimum_is_that_of_the_better_start() -> None:
    world = sim.ring(RNG(0), laps=3, per_lap=30)
    turned = world.truth.replaced({"x": SE2.retract(world.truth[x], RNG(1).normal(size=(90, 3)) * [0, 0, 2.5])})
    right = world.graph.optimize(world.truth).chi2_final
    assert world.graph.optimize(turned).chi2_final > 10 * right
    for values in (turned, world.truth):
        assert lowest(world.graph, values).chi2_final == pytest.approx(right, rel=1e-3)


def test_neighbors_support_each_other_and_tell_the_noise(city: sim.World) -> None:
    loops, group = wrong_closures(city, 12, RNG(0)), wrong_closures(city, 10, RNG(1), group=10)
    graph = FactorGraph([*city.graph.factors, loops, group])
    pose_graph = loop_graph(graph, city.truth)
    T = nls.starts.chain(graph, city.truth)[x]
    true = len(pose_graph.closures) - 22
    for factor in (1.0, 0.1):
        scaled = [replace(each, C=each.C / factor**2) for each in (pose_graph.closures, pose_graph.odometry)]
        found = neighbors(*scaled, T)
        assert (found.support[:true] > 0).mean() > 0.9
        assert (found.support[true : true + 12] > 0).sum() <= 2
        assert (found.support[-10:] >= 5).all()
        assert len(set(found.cluster[-10:])) == 1
        assert 0.8 < neighbors(scaled[0][:true], scaled[1], T).sigma0 / factor < 1.25
        assert 0.5 < found.sigma0 / factor < 1.25  # the group agrees too well, without noise


def test_a_group_is_judged_by_what_chi2_falls_by_without_it() -> None:
    rng, a = RNG(2), np.arange(30)
    odometry = Between(x[a], x[a + 1], rng.normal(size=(30, 2)), Isotropic(0.5))
    noise = Isotropic([0.1, 0.2, 0.3, 0.2, 0.1])
    loops = Between(x[[0, 3, 5, 20, 21]], x[[11, 14, 29, 9, 8]], rng.normal(size=(5, 2)), noise)
    graph, values = FactorGraph([odometry, loops]), Values({x: (R(2), np.zeros((31, 2)))})
    result = graph.optimize(values)
    track, groups = loop_graph(graph, values), np.array([7, 7, 2, 4, 4])
    track.__dict__["neighbors"] = Neighbors(np.zeros(5, dtype=np.intp), groups, 1.0)
    for group in (7, 2, 4):
        kept = FactorGraph([odometry, loops[groups != group]])
        fall = result.chi2_final - kept.optimize(values).chi2_final
        gate = WIDER_GATE * chi2_gate(2 * int((groups == group).sum()), FITS)
        for above, found in ((1.001, False), (0.999, True)):  # linear: the statistic is exactly that fall
            scaled = replace(result, chi2_final=above * fall / gate * result.dof)  # what the noise is taken from
            wrong = misfits(witnesses(track, result.values, np.ones(5, dtype=bool)), scaled, track)
            assert (wrong[groups == group].all(), wrong[groups == group].any()) == (found, found)


def judged(world: sim.World, wrong: Between, found: Robustified) -> None:
    """All wrong closures were rejected, and few others; the map is that of the clean graph."""
    clean = world.graph.optimize(world.truth).values
    assert names(wrong) <= {each.factor for each in found.rejected}
    assert len(found.rejected) <= len(wrong) + 0.05 * found.doubted
    assert nls.metrics.ate(found.result.values[x], clean[x], "rigid").rmse < 0.05
    assert found.result.converged


@pytest.mark.parametrize(("loss", "count", "group"), [("tls", 60, 10), ("gm", 100, 1)])
def test_exactly_the_wrong_closures_are_rejected(city: sim.World, loss: str, count: int, group: int) -> None:
    wrong = wrong_closures(city, count, RNG(4), group)
    graph = FactorGraph([*city.graph.factors, wrong])
    found = nls.gnc(graph, city.truth, loss)
    judged(city, wrong, found)
    assert found.weights[-1].tolist() == [0.0] * len(wrong)
    assert [each.sigmas for each in found.rejected] == sorted((each.sigmas for each in found.rejected), reverse=True)
    assert sum(int((1 - w).sum()) for w in found.weights) == len(found.rejected) == len(graph) - len(found.graph)
    assert 0.5 < found.strain < 2
    assert found.strain * found.local == pytest.approx(np.sqrt(found.result.chi2_final / found.result.dof))
    spoiled, clean = graph.optimize(nls.initialize(graph, city.truth)[0]).values, city.graph.optimize(city.truth).values
    assert nls.metrics.ate(spoiled[x], clean[x], "rigid").rmse > 1


def test_in_space() -> None:
    world = sim.sphere(RNG(0), rings=6, per_ring=15)
    wrong = wrong_closures(world, 20, RNG(5), 10)
    judged(world, wrong, nls.gnc(FactorGraph([*world.graph.factors, wrong]), world.truth))


def test_sigmas_a_hundred_times_too_large_and_another_frame_start_and_order_change_nothing() -> None:
    small = sim.manhattan(RNG(3), n_poses=250)
    wrong = wrong_closures(small, 40, RNG(4), 10)
    graph = FactorGraph([loose(factor, 100.0) for factor in (*small.graph.factors, wrong)])
    found = nls.gnc(graph, small.truth)
    judged(small, wrong, found)
    assert 0.005 < found.local < 0.02
    assert found.sigma0 < 0.05
    moved = Values({x: (SE2, SE2.compose(np.array([[30.0, -7.0, 2.5]]), nls.starts.chain(graph, small.truth)[x]))})
    other = nls.gnc(FactorGraph(graph.factors[::-1]), moved)
    assert {r.factor for r in other.rejected} == {r.factor for r in found.rejected}
    assert other.result.chi2_final == pytest.approx(found.result.chi2_final, rel=1e-6)


def test_without_wrong_ones_nothing_is_lost(city: sim.World) -> None:
    found = nls.gnc(city.graph, city.truth)
    assert len(found.rejected) <= 0.03 * found.doubted
    assert "tested measurements rejected" in str(found)


def test_named_factors_are_doubted_from_the_values_given() -> None:
    l = nls.Kind("l")
    places = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [2, -2, 0]])
    point = np.array([1.0, 2.5])
    z = np.linalg.norm(places[:, :2] - point, axis=1) + np.array([0.01, -0.02, 0.01, 3.0, 0.0])
    heard = Range(x[np.arange(5)], l[0], z, Isotropic(0.05))
    graph = FactorGraph([heard])
    graph.fix(x[np.arange(5)])
    values = Values({x: (SE2, places), l: (R(2), [[2.0, 2.0]])})
    found = nls.gnc(graph, values, doubted=[heard])
    assert [each.factor for each in found.rejected] == ["Range(x3, l0)"]
    assert np.isnan(found.strain)
    np.testing.assert_allclose(found.result.values[l[0]], point, atol=0.05)
    with pytest.raises(GraphError, match="not in this graph"):
        nls.gnc(graph, values, doubted=[heard[:2]])


def test_plain_graduation_from_odometry_finds_single_ones(city: sim.World) -> None:
    wrong = wrong_closures(city, 20, RNG(6))
    graph = FactorGraph([*city.graph.factors, wrong])
    found = nls.gnc(graph, nls.initialize(graph, city.truth, "odometry")[0], preselect=False)
    assert names(wrong) <= {each.factor for each in found.rejected}


def test_what_cannot_be_judged_is_refused_by_name(city: sim.World) -> None:
    chain = Between(x[[0, 1, 3]], x[[1, 2, 4]], [1.0, 0.0, 0.0], Isotropic(0.1))
    loop = Between(x[[0, 2]], x[[4, 0]], [0.0, 0.0, 0.0], Isotropic(0.1))
    values = Values({x: (SE2, SE2.identity(5))})
    with pytest.raises(GraphError, match="no odometry connects x2 to x3: the graph has 2 sessions"):
        nls.gnc(FactorGraph([chain, loop]), values)
    with pytest.raises(GraphError, match="no loop closures"):
        nls.gnc(FactorGraph([chain]), values)
    with pytest.raises(OptionError, match="loss"):
        nls.gnc(city.graph, city.truth, "huber")
    for probability in (0.0, 1.0, np.nan, "0.9"):
        with pytest.raises(OptionError, match="probability"):
            nls.gnc(city.graph, city.truth, probability=probability)  # type: ignore[arg-type]
