"""When a choice of closures is doubtful, when all are kept, and what one group more or less does to a choice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import BearingRange, Between, Diagonal, Prior
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from nls import FactorGraph, Values, kinds
from nls.analysis import unverified_groups
from nls.cli.outliers import record
from nls.io.report import Source
from nls.robust import DoubtKind, Robustified, preselection, verdict
from nls.robust.accepted_closures import witnesses
from nls.robust.loop_graph import loop_graph
from nls.robust.preselection import exchanged
from nls.robust.truncated_least_squares import Truncated
from nls.robust.verdict import difference, doubts

x, l = kinds("x", "l")
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)


def wrong(n: int, count: int, seed: int) -> Between:
    """Closures between poses drawn at random, each somewhere else."""
    rng = np.random.default_rng(seed)
    i, j = rng.integers(0, n // 2, count), rng.integers(n // 2 + 5, n, count)
    return Between(x[i], x[j], rng.normal(size=(count, 3)) * [3.0, 3.0, 1.0], SIGMAS)


@pytest.fixture(scope="module")
def laps() -> sim.World:
    """Two laps of 60 poses, the second of which is tied to the first."""
    return sim.ring(np.random.default_rng(0), laps=2, per_lap=60)


@pytest.mark.parametrize(
    ("share", "times", "expected"),
    [
        (0.5, 1.0, []),
        (3.0, 1.0, [DoubtKind.FEW_KEPT, DoubtKind.SIGMAS]),
        (3.0, 2.0, [DoubtKind.FEW_KEPT]),  # a map with less noise than stated shows that sigmas are not too small
    ],
)
def test_more_than_half_wrong_is_doubtful(
    laps: sim.World, share: float, times: float, expected: list[DoubtKind]
) -> None:
    loops = len(laps.graph.factors[1])
    wider = [
        Between(*factor.keys, factor.z, Diagonal(times / factor.noise.sqrt_information(1, ("x", "y", "yaw"))[0]))
        for factor in (*laps.graph.factors, wrong(120, int(share * loops), 1))
    ]
    found = nls.gnc(FactorGraph(wider), laps.truth)
    assert found.weights[1].all()
    assert not found.weights[2].any()
    assert [doubt.kind for doubt in found.doubts] == expected
    quiet = np.sqrt(found.result.chi2_final / found.result.dof) < verdict.QUIET
    assert quiet == (times == 2.0)
    if expected:
        assert str(found.doubts[0]) == f"{loops} of {4 * loops} tested measurements were kept, less than half"
        assert "doubtful: " in str(found)


def test_a_start_of_zeros_is_named_and_initialize_is_one(laps: sim.World) -> None:
    zeros = Values({x: (SE2, np.zeros((120, 3)))})
    seen = BearingRange(x[[0, 40]], l[0], [[0.1, 5.0], [-0.4, 4.0]], Diagonal(bearing=0.5, range=5.0))
    graph, more = laps.graph, FactorGraph([*laps.graph.factors, seen])
    found = nls.gnc(graph, zeros, preselect=False)
    assert [doubt.kind for doubt in found.doubts] == [DoubtKind.FEW_KEPT, DoubtKind.NO_START]
    assert str(found.doubts[1]).startswith("all 120 poses begin at one place: get an initial guess, nls.initialize(")
    for preselect in (True, False):
        with pytest.raises(nls.SingularGeometryError, match=r"another initial guess: nls\.initialize\(graph, values\)"):
            nls.gnc(more, zeros | Values({l: (R(2), [0, 0])}), preselect=preselect)
    start, *_ = nls.initialize(graph, zeros)
    assert nls.gnc(graph, start, preselect=False).doubts == ()
    assert nls.gnc(FactorGraph([graph.factors[0]]), zeros, doubted=[graph.factors[0]]).doubts == ()


def test_half_is_meant_less_what_chance_rejects_and_noise_explains_chi2(laps: sim.World) -> None:
    """Of 100 right ones chance rejects 1 at 99 %, at most 4, and at 99.9 % at most 1; of 2,000 20, at most 33."""
    result = laps.graph.optimize(laps.start)
    for kept, of, probability in ((96, 200, 0.99), (98, 200, 0.999), (1966, 4000, 0.99)):
        assert [doubt.kind for doubt in doubts(result, kept, of, probability)] == [DoubtKind.FEW_KEPT]
        assert doubts(result, kept + 1, of, probability) == []
    for ratio, doubtful in ((1.9, False), (2.1, True)):
        found = doubts(replace(result, chi2_final=ratio * result.dof), 1, 1, 0.99)
        assert [doubt.kind for doubt in found] == [DoubtKind.UNEXPLAINED] * doubtful


def test_closures_that_span_little_of_the_track_are_near_dead_reckoning() -> None:
    steps, k = np.arange(99), np.arange(0, 60, 2)
    values = Values({x: (SE2, np.c_[np.arange(100.0), np.zeros((100, 2))])})
    odometry = Between(x[steps], x[steps + 1], [1.0, 0.0, 0.0], Diagonal(x=0.01, y=0.01, yaw=0.001))
    short = Between(x[k[:10]], x[k[:10] + 2], [2.0, 0.0, 0.0], SIGMAS)
    far = Between(x[[1, 2, 3]], x[[96, 97, 98]], [[0.0, 9.0, 0.0], [0.0, -9.0, 0.0], [5.0, 20.0, 0.0]], SIGMAS)
    found = nls.gnc(FactorGraph([odometry, short, far]), values)
    assert found.weights[1].all()
    assert not found.weights[2].any()
    (doubt,) = (doubt for doubt in found.doubts if doubt.kind is DoubtKind.DEAD_RECKONING)
    assert (doubt.count, doubt.total) == (20, 98)


def test_closures_alone_that_are_noisier_than_all_others_are_doubtful() -> None:
    """Sigmas six times too large, which 13 wrong closures across a ring fit: each half a meter short and more."""
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=100)
    wide = Diagonal(x=0.3, y=0.3, yaw=0.06)
    right = [Between(*factor.keys, factor.z, wide) for factor in world.graph.factors]
    truth, i = world.truth[x], np.arange(0, 50, 4)
    z = SE2.between(truth[i], truth[i + 50])
    z[:, 1] -= np.linspace(0.5, 1.0, len(i))
    z[:, 2] += 0.12 * (-1.0) ** np.arange(len(i))  # no two agree
    for factors, kinds_of in ((right, []), ([*right, Between(x[i], x[i + 50], z, wide)], [DoubtKind.ALONE])):
        found = nls.gnc(FactorGraph(factors), world.truth)
        assert found.result.chi2_final < 0.5 * found.result.dof
        assert [doubt.kind for doubt in found.doubts] == kinds_of
    (doubt,), kept = found.doubts, int(found.weights[2].sum())
    assert (doubt.count, doubt.total) == (kept, kept + len(right[1]))
    without = FactorGraph(right).optimize(found.result.values)
    spent = (found.result.chi2_final - without.chi2_final) / (found.result.dof - without.dof)
    assert doubt.number**2 == pytest.approx(spent / (without.chi2_final / without.dof), rel=0.3)
    assert doubt.number > 2.5


def noisy(step: Array, sigmas: Array, rng: np.random.Generator) -> Array:
    """Steps with noise of some sigmas."""
    return SE2.compose(step, SE2.exp(sigmas * rng.normal(size=step.shape)))


def halls(seed: int, off: float) -> tuple[FactorGraph, Values]:
    """Three laps of four halls that seven closures hold, each alone, the last one ``off`` meters; and six wrong ones.

    Noise is half of the stated one.
    """
    rng, n = np.random.default_rng(seed), 300
    step = np.tile([1.0, 0.0, 0.0], (n - 1, 1))
    step[24::25, 2] = np.pi / 2
    truth, k = sim.chain(SE2, np.zeros(3), step), np.arange(n - 1)
    loose, tight = np.array([0.1, 0.05, 0.02]), np.array([0.1, 0.1, 0.02])
    odometry = Between(x[k], x[k + 1], noisy(step, loose / 2, rng), Diagonal(loose))
    i = np.arange(0, 210, 30)
    z = noisy(SE2.between(truth[i], truth[i + 100]), tight / 2, rng)
    z[-1] = SE2.compose(z[-1], [0.0, off, 0.0])
    a = rng.integers(0, 120, 6)
    far = Between(x[a], x[a + rng.integers(40, 170, 6)], np.zeros((6, 3)), Diagonal(tight))
    return FactorGraph([odometry, Between(x[i], x[i + 100], z, Diagonal(tight)), far]), Values({x: (SE2, truth)})


@pytest.mark.parametrize("seed", [2, 3])
def test_a_choice_is_not_in_doubt_because_it_could_give_up_closures_that_fit(seed: int) -> None:
    graph, values = halls(seed, 0.0)
    found = nls.gnc(graph, values)
    assert [int(w.sum()) for w in found.weights] == [299, 7, 0]
    assert found.doubts == ()
    without = graph.only([np.ones(299, bool), np.arange(7) < 4, np.zeros(6, bool)]).optimize(found.result.values)
    assert difference(loop_graph(graph, values), found.result.values, without.values).fraction > verdict.AWAY


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_closures_that_fit_badly_and_that_few_others_check_are_weak(seed: int) -> None:
    """Two meters off: what the others leave open, and not by chance."""
    graph, values = halls(seed, 2.0)
    found = nls.gnc(graph, values)
    assert [int(w.sum()) for w in found.weights] == [299, 7, 0]
    (doubt,) = (doubt for doubt in found.doubts if doubt.kind is DoubtKind.WEAK)
    assert (doubt.number > 0.005, doubt.total) == (True, 7)
    assert f"the map is {doubt.meters:.3g} m ({100 * doubt.fraction:.2g} % of its extent)" in str(doubt)
    if doubt.count == 1:
        without = graph.only([np.ones(299, bool), np.arange(7) < 6, np.zeros(6, bool)]).optimize(found.result.values)
        apart = difference(loop_graph(graph, values), found.result.values, without.values)
        assert (doubt.fraction, doubt.meters, doubt.radians) == pytest.approx(tuple(apart), rel=1e-3)
        excess = found.result.chi2_final - without.chi2_final
        assert doubt.sigmas**2 == pytest.approx(excess / (without.chi2_final / without.dof), rel=0.3)


@pytest.mark.parametrize("seed", [2, 11])
def test_right_maps_are_not_doubted_because_odometry_alone_fits_by_chance(seed: int) -> None:
    """All closures agree; what the map without them says of its noise rests on few numbers, 3 and 30."""
    world = sim.manhattan(np.random.default_rng(seed), n_poses=200)
    found = nls.gnc(world.graph, world.start)
    assert (found.doubts, len(found.rejected) < 2) == ((), True)


@pytest.mark.parametrize(("meters", "kept"), [(0.0, True), (6.0, False)])
def test_a_closure_far_off_an_uncertain_map_is_taken_back_where_it_fits(meters: float, kept: bool) -> None:
    rng, k = np.random.default_rng(1), np.arange(39)
    step = np.tile([1.0, 0.0, 0.0], (39, 1))
    truth = sim.chain(SE2, np.zeros(3), step)
    odometry = Between(x[k], x[k + 1], noisy(step, np.full(3, 0.02), rng), Diagonal([0.02, 0.02, 0.02]))
    z = SE2.compose(SE2.between(truth[:1], truth[-1:]), [0.0, meters, meters])
    graph = FactorGraph([odometry, Between(x[[0]], x[[39]], z, Diagonal([0.01, 0.01, 0.01]))])
    problem = Truncated(graph, [np.zeros(39, bool), np.ones(1, bool)], [11.3, 11.3])
    rejected = problem.optimum(Values({x: (SE2, truth)}), [np.ones(39, bool), np.zeros(1, bool)])
    assert rejected.s[1][0] > 20**2
    choice = problem.taken_back(rejected)
    assert (choice.inliers[1].all(), choice.cost < rejected.cost) == (kept, kept)
    marginals = nls.Marginals(rejected.graph, rejected.values)
    bound = problem.least_distances(rejected)[1]
    assert (0 < bound <= marginals.gate(graph.factors[1]).d2).all()


def test_a_choice_has_the_closure_that_graduation_loses() -> None:
    """The only one of the last place, 59 m away, among too many wrong ones to exchange each."""
    rng, k, i, j = np.random.default_rng(2), np.arange(59), np.r_[:4, 0], np.r_[10:14, 59]
    truth = sim.chain(SE2, np.zeros(3), np.tile([1.0, 0.0, 0.0], (59, 1)))
    loose, tight = np.full(3, 0.02), np.full(3, 0.003)
    odometry = Between(x[k], x[k + 1], noisy(SE2.between(truth[:-1], truth[1:]), loose, rng), Diagonal(loose))
    right = Between(x[i], x[j], noisy(SE2.between(truth[i], truth[j]), tight, rng), Diagonal(tight))
    w = rng.integers(0, 30, 65)
    far = Between(x[w], x[w + rng.integers(20, 30, 65)], rng.normal(size=(65, 3)) * [50, 50, 1], Diagonal(tight))
    graph, values = FactorGraph([odometry, right, far]), Values({x: (SE2, truth)})
    problem = Truncated(graph, [np.full(len(f), f is not odometry) for f in graph.factors], [11.3] * 3)
    preselected = preselection.Preselection(problem, loop_graph(graph, values), "tls", 0.99)
    kept, choice = preselected.kept(), preselected.choice
    assert [mask.tolist() for mask in (kept.inliers[1], choice.inliers[1])] == [[True] * 5, [True] * 4 + [False]]
    assert nls.gnc(graph, values).weights[1].all()


def test_closures_that_only_make_a_choice_dearer_are_not_taken_back() -> None:
    """Either fits the uncertain map; both at once, five sigmas apart, cost more than to reject both."""
    step, two = (
        Between(x[0], x[1], [0.0], Diagonal([10.0])),
        Between(x[0], x[[1, 1]], [[24.0], [24.5]], Diagonal([0.1])),
    )
    problem = Truncated(FactorGraph([step, two]), [np.zeros(1, bool), np.ones(2, bool)], [6.6, 6.6])
    rejected = problem.optimum(Values({x: (R(1), np.zeros((2, 1)))}), [np.ones(1, bool), np.zeros(2, bool)])
    both = problem.settled(problem.optimum(rejected.values, [np.ones(1, bool), np.ones(2, bool)]).values)
    assert (both.inliers[1].all(), both.cost > rejected.cost) == (True, True)
    assert (nls.Marginals(rejected.graph, rejected.values).gate(two).d2 <= 6.6).all()
    assert problem.taken_back(rejected) is rejected


def test_noise_of_a_group_that_repeats_itself_is_no_doubt() -> None:
    """Twenty closures agree: the distance of the map without them is chi2 of 57 numbers, by noise alone."""
    k, i, all_ = np.arange(59), np.arange(20), np.ones(20, bool)
    steps, group = (Between(x[a], x[a + n], np.tile([n, 0, 0], (len(a), 1)), SIGMAS) for a, n in ((k, 1), (i, 40)))
    graph, values = FactorGraph([steps, group]), Values({x: (SE2, np.c_[np.arange(60.0), np.zeros((60, 2))])})
    problem, loops = Truncated(graph, [np.zeros(59, bool), all_], [11.3, 11.3]), loop_graph(graph, values)
    judged, choice = list(witnesses(loops, values, all_)), problem.settled(values)
    evidence = verdict.Evidence(problem, loops, choice, [choice], True, 1.0, judged, 0.0)
    none, usual, rare = (verdict._odds(evidence, all_, all_, 57 + n * 114**0.5, 1_000_000) for n in (-1, 1, 4))
    assert 0 < none == usual < 0.005 < 1 < rare


def test_the_chance_of_a_rejected_closure_does_not_depend_on_the_unit_of_the_sigmas(laps: sim.World) -> None:
    """Stated ones five times and ten times too large: sigma0 makes up for that."""
    z, found = SE2.compose(SE2.between(laps.truth[x][5:6], laps.truth[x][65:66]), [1.6, 1.6, 0.0]), []
    for times in (5.0, 10.0):
        wide = Diagonal(x=0.05 * times, y=0.05 * times, yaw=0.01 * times)
        factors = [Between(*factor.keys, factor.z, wide) for factor in laps.graph.factors]
        found.append(nls.gnc(FactorGraph([*factors, Between(x[[5]], x[[65]], z, wide)]), laps.truth))
    assert found[0].sigma0 == pytest.approx(2 * found[1].sigma0)
    assert [r.chance for r in found[0].rejected] == pytest.approx([r.chance for r in found[1].rejected], rel=1e-3)
    assert 0.01 < found[0].rejected[0].chance < 0.1


@pytest.mark.parametrize("space", [SE2, SE3])
def test_the_shift_of_a_map_is_its_change_of_shape(space: LieGroup) -> None:
    rng = np.random.default_rng(2)
    X = space.exp(rng.normal(size=(30, space.dim)))
    k = np.arange(29)
    graph = FactorGraph([Between(x[k], x[k + 1], space.between(X[:-1], X[1:]), Diagonal(np.ones(space.dim)))])
    graph.add(Between(x[0], x[29], space.between(X[0], X[29]), Diagonal(np.ones(space.dim))))
    values = Values({x: (space, X)})
    track = loop_graph(graph, values)
    moved = Values({x: (space, space.compose(space.exp(rng.normal(size=(1, space.dim))), X))})
    assert difference(track, values, moved)[:2] == pytest.approx((0, 0), abs=1e-12)
    p = space.position(X)
    other = X.copy()
    other[:, : p.shape[1]] += 0.3 * rng.normal(size=p.shape)
    expected = nls.metrics.ate(other, X, "rigid").rmse / np.ptp(p, axis=0).max()
    apart = difference(track, values, Values({x: (space, other)}))
    assert (apart.fraction, apart.meters) == pytest.approx((expected, expected * np.ptp(p, axis=0).max()), rel=1e-6)
    turn = np.zeros((30, space.dim))
    turn[1:, -1] = 0.2 * (-1.0) ** np.arange(29)
    turned = difference(track, values, Values({x: (space, space.retract(X, turn))}))
    assert turned == pytest.approx((0, 0, 0.2 * np.sqrt(29 / 30)), abs=1e-9)


@pytest.mark.parametrize("name", ["kitti_00.g2o", "CSAIL.g2o", "FR079_P_toro.graph", "input_INTEL.g2o"])
def test_no_more_right_closures_of_public_graphs_are_lost_than_chance_takes(data: Path, name: str) -> None:
    graph, values, _ = nls.load(data / "pose-graphs-2d" / name)
    found = nls.gnc(graph, values)
    assert len(found.rejected) <= 0.01 * found.doubted
    assert found.doubts == ()
    best = graph.optimize(nls.initialize(graph, values)[0])
    assert found.result.chi2_final == pytest.approx(best.chi2_final, rel=0.01)


def test_neighbors_less_noisy_than_stated_do_not_condemn_a_long_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Odometry as noisy as stated over 600 steps, closures a third as noisy: what kitti_00 is like."""
    rng, n = np.random.default_rng(5), 600
    step = np.tile([1.0, 0.0, 2 * np.pi / 300], (n - 1, 1))
    truth, k = sim.chain(SE2, np.zeros(3), step), np.arange(n - 1)
    noise, i = np.array([0.05, 0.05, 0.005]), np.arange(280, 300)
    odometry = Between(x[k], x[k + 1], noisy(step, noise, rng), Diagonal(noise))
    z = noisy(SE2.between(truth[i], truth[i + 300]), noise / 3, rng)
    graph, values = FactorGraph([odometry, Between(x[i], x[i + 300], z, Diagonal(noise))]), Values({x: (SE2, truth)})
    assert not nls.gnc(graph, values).rejected
    monkeypatch.setattr(preselection.Preselection, "_explained", lambda self: None)  # growth alone keeps them too
    assert not nls.gnc(graph, values).rejected
    spoiled = nls.gnc(FactorGraph([*graph.factors, wrong(n, 10, 3)]), values)
    assert spoiled.weights[1].all()
    assert not spoiled.weights[2].any()


def test_where_noise_explains_all_closures_none_is_grown(monkeypatch: pytest.MonkeyPatch) -> None:
    world = sim.sphere(np.random.default_rng(0), rings=8, per_ring=16)
    monkeypatch.setattr(preselection, "grown", None)
    assert not nls.gnc(world.graph, world.start).rejected


def test_a_wrong_group_is_exchanged_for_the_right_closures_it_keeps_out(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = np.arange(19)
    odometry = Between(x[steps], x[steps + 1], np.ones((19, 1)), Diagonal([1.0]))
    right = Between(x[[0, 4, 9]], x[[15, 16, 18]], [[15.0], [12.0], [9.0]], Diagonal([0.1]))
    lone = Between(x[1], x[17], [4.0], Diagonal([0.1]))  # 16 is right
    graph, values = FactorGraph([odometry, right, lone]), Values({x: (R(1), np.arange(20.0)[:, None])})
    loops = loop_graph(graph, values)
    doubted = [np.full(len(factor), k > 0) for k, factor in enumerate(graph.factors)]
    problem = Truncated(graph, doubted, [6.6, 6.6, 6.6])
    start = problem.optimum(problem.settled(values).values, [np.ones(19, bool), np.zeros(3, bool), np.ones(1, bool)])
    assert start.cost > 3 * 6.6 - 1e-9
    choice, others = exchanged(problem, loops, start)
    assert [mask.all() for mask in choice.inliers] == [True, True, False]
    assert choice.cost == pytest.approx(6.6, rel=1e-6)
    assert all(other.cost >= choice.cost * (1 - 1e-3) for other in others)
    offset = Prior(x[[0, 0]], [[-100.0], [100.0]], Diagonal([1.0]))  # adds the same to every cost
    dear = Truncated(FactorGraph([*graph.factors, offset]), [*doubted, np.zeros(2, bool)], [6.6] * 4)
    best = dear.settled(choice.result.values)
    assert exchanged(dear, loop_graph(dear.graph, values), best)[0] is best
    monkeypatch.setattr(preselection, "MANY_CLOSURES", 3)  # where more are there, each is checked by others
    assert exchanged(problem, loops, start) == (start, [])


def test_groups_that_nothing_checks_are_doubtful_unless_there_is_one_or_wrong_ones_came_singly() -> None:
    """Two loops one behind the other, of loose odometry: each closes by a group of its own."""
    rng, n = np.random.default_rng(4), 80
    turn = SE2.exp([[1.0, 0.0, 2 * np.pi / 40]])
    loose, tight = Diagonal(x=0.5, y=0.5, yaw=0.3), Diagonal(x=0.02, y=0.02, yaw=0.01)
    odometry = Between(x[0 : n - 1], x[1:n], np.repeat(turn, n - 1, axis=0), loose)

    def group(begin: int) -> Between:
        i = begin + np.arange(4)
        return Between(x[i], x[i + 36], SE2.exp(rng.normal(0, 0.01, (4, 3))), tight)

    one, two = [odometry, group(0)], [odometry, group(0), group(40)]
    far = Between(x[[20, 24]], x[[60, 75]], [[30.0, 0, 0], [0, 30.0, 0]], tight)
    start = Values({x: (SE2, np.zeros((n, 3)))})
    kinds_of = [[doubt.kind for doubt in nls.gnc(FactorGraph(f), start).doubts] for f in (one, two, [*two, far])]
    assert DoubtKind.UNCHECKED not in kinds_of[0]
    assert DoubtKind.UNCHECKED in kinds_of[1]
    assert DoubtKind.UNCHECKED not in kinds_of[2]


def test_the_choice_its_report_and_its_record_have_the_group_that_nothing_verifies(laps: sim.World) -> None:
    """Two single closures rejected, ten wrong ones that agree accepted: these are numbered as in the given graph."""
    k = np.arange(10)
    alone = Between(x[[3]], x[[33]], np.zeros((1, 3)), SIGMAS)
    mixed = Between(x[np.r_[7, k]], x[np.r_[90, k + 50]], np.zeros((11, 3)), SIGMAS)
    masks = [np.zeros(1, dtype=bool), np.ones(119, dtype=bool), np.arange(11) > 0]
    graph = FactorGraph([alone, laps.graph.factors[0], mixed]).only(masks)
    weights = [mask.astype(float) for mask in masks]
    carried = Robustified(graph.optimize(laps.start), graph, weights, (), 12, 1.0, 0.99)
    (group,) = carried.unverified
    (same,) = unverified_groups(carried.graph, carried.result.values)
    assert same.closures == tuple((1, k) for k in range(10))
    assert group.closures == tuple((2, k) for k in range(1, 11))
    assert group.names == same.names
    assert carried.unverified is carried.unverified
    numbers = f"(redundancy 0.00); without them the map moves {group.meters:.3g} m ({group.sigmas:.2g} sigmas)"
    agree = "Between(x0, x50) and 9 more closures join the same stretches"
    assert f"{agree}, but nothing else checks them {numbers}" in carried.report()
    (entry,) = record(carried, [Source("a.g2o", np.zeros(len(w), np.intp)) for w in carried.weights])["unverified"]
    assert entry["factors"] == [f"Between(x{k}, x{k + 50})" for k in range(10)]
    for name in ("redundancy", "meters", "rms", "sigmas"):
        assert entry[name] == getattr(group, name)


def test_a_choice_of_right_closures_has_none(laps: sim.World) -> None:
    choice = nls.gnc(laps.graph, laps.truth)
    assert choice.unverified == ()
    assert record(choice, ())["unverified"] == []
    assert not any("nothing else checks" in line for line in choice.report())
