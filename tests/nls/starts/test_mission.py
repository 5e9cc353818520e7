"""The start that solves the graph as it grows, on sonar missions: steps in the horizontal, contacts on their arcs."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import XYH, ZPR, Between, Factor, Isotropic, Tukey
from models import SE3, euler
from models.sensors import levelled, zpr
from nls import FactorGraph, Keys, LevenbergMarquardt, Values, initialize, kinds
from nls.starts import STARTS, incremental
from nls.starts.incremental import _Growth

x, l = kinds("x", "l")
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


def test_auto_takes_it_where_dead_reckoning_is_poor(grown: tuple[sim.Mission, Values]) -> None:
    mission, _ = grown
    _, name, chi2 = initialize(mission.graph, blind(mission))
    assert (name, set(chi2)) == ("incremental", {"file", "incremental"})
    assert chi2["file"] > 100 * mission.rows > 100 * chi2["incremental"]
    assert initialize(mission.graph, mission.truth)[1:] == ("file", {"file": mission.graph.chi2(mission.truth)})


def test_older_poses_are_held_where_they_fit(
    grown: tuple[sim.Mission, Values], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the cost is linear; what false contacts leave when everything was optimized judges the next stages."""
    solved: list[tuple[int, bool]] = []
    optimized = _Growth.optimized

    def noted(self: _Growth, values: Values, stage: int, everything: bool) -> tuple[Values, float]:
        solved.append((stage, everything))
        return optimized(self, values, stage, everything)

    monkeypatch.setattr(_Growth, "optimized", noted)
    mission, _ = grown
    assert mission.poses == 247
    incremental(mission.graph, mission.start, stage_size=50)
    assert solved == [(0, True), *((stage, False) for stage in range(1, 5))]
    solved.clear()
    mission = floor(outliers=0.05)
    assert mission.graph.chi2(incremental(mission.graph, mission.start)) > 10 * mission.rows
    assert sum(everything for _, everything in solved) <= 3


def test_what_is_fixed_stays_and_order_is_nothing(grown: tuple[sim.Mission, Values]) -> None:
    mission, start = grown
    rng = np.random.default_rng(5)
    mixed = FactorGraph([factor[rng.permutation(len(factor))] for factor in mission.graph.factors[::-1]])
    rows = {kind: rng.permutation(len(stack)) for kind, stack in mission.start.stacks.items()}
    values = Values({k: (s.manifold, s.X[rows[k]], s.numbers[rows[k]]) for k, s in mission.start.stacks.items()})
    other = incremental(mixed, values)
    for kind, stack in start.stacks.items():
        same(stack.manifold.local(stack.X, other[Keys(kind, stack.numbers)]), 0.0, atol=2e-2)
    for key in (held := x[[20, 120, 200]], point := l[[3, 50]]):
        values[key] = mission.truth[key]
        mixed.fix(key)
    start = incremental(mixed, values)
    for key in (held, point):
        np.testing.assert_array_equal(start[key], values[key])
    assert mixed.chi2(start) < 2 * mission.rows
    every = x[np.arange(mission.poses)]
    off = [np.linalg.norm(SE3.position(v[every]) - SE3.position(mission.truth[every]), axis=1) for v in (start, values)]
    assert off[0].mean() < off[1].mean()


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
    graph = FactorGraph(
        [
            Between(x[even], x[even + 1], SE3.between(X[even], X[even + 1]), Isotropic(0.01)),
            XYH(x[odd], x[odd + 1], levelled(X[odd], X[odd + 1])[0], Isotropic(0.01)),
            ZPR(x[np.arange(10)], zpr(X)[0], Isotropic(0.01)),
        ]
    )
    graph.fix(x[0])
    start, name, chi2 = initialize(graph, Values({x: (SE3, np.tile(X[:1], (10, 1)))}))
    assert name == "incremental"
    assert chi2["odometry" if "odometry" in chi2 else "file"] > 1.0
    same(SE3.position(start[x]), SE3.position(X), atol=1e-6)
