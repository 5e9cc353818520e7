"""The start that solves the graph as it grows: drifting odometry, sonar missions, and all that it must leave."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import XYH, ZPR, Bearing, BearingRange, Between, Diagonal, Factor, Isotropic, Landmark, Prior, Tukey
from models import SE2, SE3, LieGroup, R, euler
from models.algebra import wrap
from models.errors import OptionError
from models.sensors import levelled, zpr
from nls import FactorGraph, LevenbergMarquardt, Values, initialize, kinds
from nls.starts import STARTS, incremental
from tests.nls.graphs import pose_graph

x, l, o = kinds("x", "l", "o")


def rounds(sensor: type[Factor] = Landmark, rows: int = 1) -> tuple[FactorGraph, Values]:
    """Four rounds past 24 landmarks with a heading that drifts by two turns: graph and true values.

    Numbers have gaps, and the rows of the stack are not in their order when ``rows`` is -1.
    """
    n, rng = 240, np.random.default_rng(0)
    a = np.arange(n) * 8 * np.pi / n
    number = 3 * np.arange(n) + 5
    X = np.column_stack([20 * np.cos(a), 20 * np.sin(a), wrap(a + np.pi / 2)])
    L = np.column_stack([24 * np.cos(np.arange(24) * np.pi / 12), 24 * np.sin(np.arange(24) * np.pi / 12)])
    pose = np.repeat(np.arange(n), 2)
    point = (np.round(a[pose] * 12 / np.pi).astype(int) + np.tile([0, 1], n)) % 24
    truth = Values({x: (SE2, X[::rows], number[::rows]), l: (R(2), L, 100 - np.arange(24))})
    steps = SE2.between(X[:-1], X[1:]) + [0, 0, 0.05] + rng.normal(size=(n - 1, 3)) * [0.02, 0.02, 0.002]
    d = SE2.act(SE2.inverse(X[pose]), L[point]) + rng.normal(size=(2 * n, 2)) * 0.02
    seen: Factor = Landmark(x[number[pose]], l[100 - point], d, Isotropic(0.02))
    if sensor is BearingRange:
        z = np.column_stack([np.arctan2(d[:, 1], d[:, 0]), np.linalg.norm(d, axis=1)])
        seen = BearingRange(*seen.keys, z, Diagonal([0.005, 0.02]))
    walked = Between(x[number[:-1]], x[number[1:]], steps, Diagonal([0.02, 0.02, 0.01]))
    return FactorGraph([walked, seen]), truth


def forgotten(values: Values) -> Values:
    """Only the first pose is known."""
    first = {k: np.tile(s.X[0], (len(s), 1)) for k, s in values.stacks.items() if s.manifold is not R(2)}
    return values.replaced(first | {"l": np.full_like(values.stack("l").X, 7.0)})


@pytest.mark.parametrize(("sensor", "rows"), [(Landmark, -1), (BearingRange, 1)])
def test_drift_that_no_solve_at_the_end_undoes(sensor: type[Factor], rows: int) -> None:
    graph, truth = rounds(sensor, rows=rows)
    blind = forgotten(truth)
    best = graph.optimize(truth).chi2_final
    dead = STARTS["odometry"](graph, blind)
    assert graph.optimize(dead).chi2_final > 10 * best
    start = incremental(graph, blind)  # twenty stages
    assert graph.chi2(start) < 1.1 * best
    if sensor is Landmark:
        np.testing.assert_array_equal(start[x], incremental(graph, blind, stage_size=12)[x])
        assert graph.chi2(incremental(graph, blind, stage_size=50)) < 2 * best  # the heading drifts by 2.5 rad in one
        assert graph.chi2(incremental(graph, blind, stage_size=len(truth))) > 10 * best
    result = graph.optimize(start)
    assert result.converged
    assert result.iterations <= 5
    assert result.chi2_final == pytest.approx(best, rel=1e-6)
    assert blind[x].tolist() == forgotten(truth)[x].tolist()
    assert [s.numbers.tolist() for s in start.stacks.values()] == [s.numbers.tolist() for s in truth.stacks.values()]


def test_auto_tries_it_only_where_landmarks_are_far_off() -> None:
    graph, truth = rounds()
    _, name, chi2 = initialize(graph, forgotten(truth))
    assert (name, set(chi2)) == ("incremental", {"file", "chordal", "incremental"})
    assert chi2["incremental"] == min(chi2.values())
    _, name, chi2 = initialize(graph, truth)
    assert (name, "incremental" in chi2) == ("file", False)
    tight = Between(x[[5, 725 - 3]], x[[722, 8]], [[900.0, 0, 0], [0, 900, 0]], Isotropic(1e-6))
    chi2 = initialize(FactorGraph([graph.factors[0], tight]), forgotten(truth))[2]  # no landmarks
    assert min(chi2.values()) > 1e6
    assert "incremental" not in chi2


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_pose_graphs_without_points(group: LieGroup) -> None:
    sample = pose_graph(group, n=12, numbers=(40, 2, 31, 4, 55, 6, 7, 28, 9, 10, 11, 12))
    best = sample.graph.optimize(sample.values).chi2_final
    for stage_size, limit in ((1, 6), (4, 6), (99, 1.01)):  # a loop that fits well enough does not pull
        start = incremental(sample.graph, sample.values, stage_size)
        assert sample.graph.optimize(start).chi2_final == pytest.approx(best, rel=1e-6)
        assert sample.graph.chi2(start) < limit * best


def test_what_is_fixed_stays() -> None:
    graph, truth = rounds()
    off = truth.replaced({"l": truth.stack("l").X + 0.3})
    held = x[[5, 365, 722]]
    graph.fix(held)
    graph.fix(l[[100, 90]])
    start = incremental(graph, off)
    np.testing.assert_array_equal(start[held], off[held])
    np.testing.assert_array_equal(start[l[[100, 90]]], off[l[[100, 90]]])
    assert np.abs(start[x[362]] - off[x[362]]).max() > 1e-6
    best = graph.optimize(truth.replaced({"l": start.stack("l").X})).chi2_final
    assert graph.optimize(start).chi2_final == pytest.approx(best, rel=1e-5)


def test_other_variables_are_known_from_the_beginning() -> None:
    """The place of the sensor is a pose and no step of the vehicle; a function sees all poses, and waits for them."""
    graph, truth = rounds()
    mount = np.array([0.2, -0.1, 0.05])
    keys, n = graph.factors[1].keys, len(graph.factors[1])
    X, L = truth[keys[0]], truth[keys[1]]
    seen = SE2.act(SE2.inverse(SE2.compose(X, mount[None])), L)

    def middle(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return (last - first)[:, :2] - (truth[x[[365, 722]]] - truth[x[5]])[:, :2]

    wait = Factor.from_function(middle, [x[[5, 5]], x[[365, 722]]], 2, Isotropic(100.0))
    priors = [Prior(x[5], truth[x[5]], Isotropic(0.01)), Prior(o[999], mount, Isotropic(0.01))]
    sighted = Landmark(*keys, seen, Isotropic(0.02), offset=o[np.full(n, 999)])
    graph = FactorGraph([graph.factors[0], sighted, wait, *priors])
    values = truth.copy()
    values.add(o, SE2, mount + 0.01, [999])
    start = incremental(graph, forgotten(values).replaced({"o": values.stack("o").X}))
    assert np.abs(start[o[999]] - mount).max() < 0.009  # it began 0.01 away
    best = graph.optimize(values)
    assert graph.chi2(start) < 1.5 * best.chi2_final
    result = graph.optimize(start)
    assert result.chi2_final == pytest.approx(best.chi2_final, rel=1e-6)
    assert result.values[o[999]] == pytest.approx(mount, abs=0.005)


def test_too_little_for_a_stage_is_dead_reckoned() -> None:
    """A point and the place of its sensor, seen once; a bearing is no place at all: more unknowns than measurements."""
    step = Between(x[0], x[1], [1.0, 0.0, 0.5], Isotropic(0.1))
    seen = Landmark(x[0], l[0], [1.0, 2.0], Isotropic(0.1), offset=o[0])
    values = Values({x: (SE2, SE2.identity(2)), l: (R(2), [0.0, 0.0]), o: (SE2, [0.5, 0.0, 0.0])})
    start = incremental(FactorGraph([seen, step]), values)
    assert (start[x[1]].tolist(), start[l[0]].tolist()) == ([1.0, 0.0, 0.5], [1.5, 2.0])
    assert start[o[0]].tolist() == [0.5, 0.0, 0.0]
    prior = Prior(x[0], [5.0, 6.0, 0.0], Isotropic(0.1))
    start = incremental(FactorGraph([prior, step, Bearing(x[0], l[0], 0.3, Isotropic(0.01))]), values)
    assert start[x] == pytest.approx(np.array([[5.0, 6.0, 0.0], [6.0, 6.0, 0.5]]), abs=1e-6)
    assert start[l[0]].tolist() == [0.0, 0.0]


def test_nothing_to_take_in_stages() -> None:
    values = Values({l: (R(2), [[1.0, 2.0], [3.0, 4.0]])})
    graph = FactorGraph([Prior(l[0], [5.0, 5.0], Isotropic(1))])
    assert incremental(graph, values) is values
    with pytest.raises(OptionError, match="stage_size"):
        incremental(graph, values, stage_size=0)


same = np.testing.assert_allclose


def floor(**options: object) -> sim.Mission:
    return sim.hauv_floor(np.random.default_rng(1), legs=4, **options)  # type: ignore[arg-type]


def blind(mission: sim.Mission) -> Values:
    """Only the first pose is known."""
    first = np.tile(mission.start[x[0]], (mission.poses, 1))
    return mission.start.replaced({"x": first, "l": np.full((mission.landmarks, 3), 99.0)})


@pytest.fixture(scope="module")
def grown() -> tuple[sim.Mission, Values]:
    """A floor, and its start from the first pose."""
    mission = floor()
    return mission, incremental(mission.graph, blind(mission))


def test_a_mission_from_its_first_pose(grown: tuple[sim.Mission, Values]) -> None:
    """Less than noise is left for the whole: the optimum is that from the truth, in fewer steps than from reckoning."""
    hull = sim.hauv_hull(np.random.default_rng(0))
    for mission, start in (grown, (hull, incremental(hull.graph, blind(hull)))):
        dead = STARTS["odometry"](mission.graph, blind(mission))
        assert mission.graph.chi2(dead) > 50 * mission.rows
        assert mission.graph.chi2(start) < mission.rows
        assert mission.ate(start) < 0.4 * mission.ate(dead)
    mission, start = grown
    dead = STARTS["odometry"](mission.graph, blind(mission))
    found, other, true = (mission.graph.optimize(v, LevenbergMarquardt()) for v in (start, dead, mission.truth))
    assert found.converged
    assert found.iterations < other.iterations
    assert found.chi2_final < (1 + 1e-3) * other.chi2_final
    assert found.chi2_final == pytest.approx(true.chi2_final, rel=1e-5)
    same(SE3.local(true.values[x], found.values[x]), 0.0, atol=2e-3)


@pytest.mark.parametrize("elevation", ["hinge", "free"])
def test_a_landmark_of_one_view(elevation: str) -> None:
    """The hinge lets it be placed, at elevation 0; without, two numbers are no place, and it keeps its own."""
    mission = floor(elevation=elevation)

    def once(factor: Factor) -> Factor:
        """All measurements but the later ones of landmark 7."""
        if len(factor.keys) < 2 or factor.keys[1].kind != "l":
            return factor
        pose, mine = factor.keys[0].numbers, factor.keys[1].numbers == 7
        return factor[~mine | (pose == pose[mine].min())]

    graph = FactorGraph([once(factor) for factor in mission.graph.factors])
    start = incremental(graph, blind(mission))
    assert (start[l[7]] == 99.0).all() == (elevation == "free")
    seen = [k for k in range(mission.landmarks) if k != 7 or elevation == "hinge"]
    assert np.linalg.norm(start[l[seen]] - mission.truth[l[seen]], axis=1).max() < 2.0
    assert elevation == "free" or graph.chi2(start) < mission.rows


def test_under_a_kernel_no_start_is_passed_over() -> None:
    """Tukey's kernel lets go of good measurements from both starts: chi2 without it asks for a third."""
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=20)
    _, _, tried = initialize(mission.graph, mission.start)
    _, robust, under = initialize(mission.graph.robust(Tukey(4.7)), mission.start)
    assert {"file"} < tried.keys() <= under.keys()
    assert robust == min(under, key=under.__getitem__) != "file"


def test_two_kinds_of_odometry_that_take_turns() -> None:
    """Exact steps in the horizontal on odd legs, in space on even ones: neither chain goes through."""
    k = np.arange(10.0)
    X = euler.to_se3(np.stack([0.02 * k, 0.01 * k, 0.3 * k, k, 0.5 * np.sin(k), 0.1 * k], axis=1))
    odd, even = np.arange(1, 9, 2), np.arange(0, 9, 2)
    noise = Isotropic(0.01)
    level = XYH(x[odd], x[odd + 1], levelled(X[odd], X[odd + 1])[0], noise)
    whole = Between(x[even], x[even + 1], SE3.between(X[even], X[even + 1]), noise)
    graph = FactorGraph([whole, level, ZPR(x[np.arange(10)], zpr(X)[0], noise)], [x[0]])
    start, name, chi2 = initialize(graph, Values({x: (SE3, np.tile(X[:1], (10, 1)))}))
    assert name == "incremental"
    assert chi2["odometry" if "odometry" in chi2 else "file"] > 1.0
    same(SE3.position(start[x]), SE3.position(X), atol=1e-6)
