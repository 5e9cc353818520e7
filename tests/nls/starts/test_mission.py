"""The start that solves the graph as it grows, on sonar missions: steps in the horizontal, contacts on their arcs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import XYH, ZPR, Between, Cauchy, Factor, Isotropic, Tukey
from factors.robust import Kernel
from models import SE3, euler
from models.sensors import levelled, zpr
from nls import FactorGraph, Keys, LevenbergMarquardt, Values, initialize, kinds
from nls.starts import STARTS, incremental
from nls.starts.incremental import _Growth

x, l = kinds("x", "l")
same = np.testing.assert_allclose


def floor(seed: int = 1, **options: object) -> sim.Mission:
    return sim.hauv_floor(np.random.default_rng(seed), legs=8, **options)  # type: ignore[arg-type]


def hull(seed: int = 0) -> sim.Mission:
    return sim.hauv_hull(np.random.default_rng(seed))


def blind(mission: sim.Mission) -> Values:
    """Only the first pose is known."""
    first = np.tile(mission.start[x[0]], (mission.poses, 1))
    return mission.start.replaced({"x": first, "l": np.full((mission.landmarks, 3), 99.0)})


@pytest.mark.parametrize("make", [floor, hull], ids=lambda make: make.__name__)
def test_a_mission_from_its_first_pose(make: Callable[[], sim.Mission]) -> None:
    """Less than noise is left for the whole: the same optimum, in fewer steps than from dead reckoning."""
    mission = make()
    start, dead = incremental(mission.graph, blind(mission)), STARTS["odometry"](mission.graph, blind(mission))
    assert mission.graph.chi2(dead) > 50 * mission.rows
    assert mission.graph.chi2(start) < mission.rows
    assert mission.ate(start) < 0.4 * mission.ate(dead)
    found, other = (mission.graph.optimize(each, LevenbergMarquardt()) for each in (start, dead))
    assert found.converged
    assert make is hull or found.iterations < other.iterations  # where the elevation is weak the last steps wander
    assert found.chi2_final < (1 + 1e-3) * other.chi2_final  # a hull has landmarks that hardly anything raises or sinks


def test_the_optimum_of_a_floor_is_the_one_from_the_truth() -> None:
    mission = floor()
    found, true = (
        mission.graph.optimize(each, LevenbergMarquardt())
        for each in (incremental(mission.graph, mission.start), mission.truth)
    )
    assert found.chi2_final == pytest.approx(true.chi2_final, rel=1e-5)
    same(SE3.local(true.values[x], found.values[x]), 0.0, atol=2e-3)


def test_auto_takes_it_where_dead_reckoning_is_poor() -> None:
    mission = floor()
    _, name, chi2 = initialize(mission.graph, mission.start)
    assert (name, set(chi2)) == ("incremental", {"file", "incremental"})
    assert chi2["file"] > 100 * mission.rows > 100 * chi2["incremental"]
    _, name, chi2 = initialize(mission.graph, mission.truth)
    assert (name, set(chi2)) == ("file", {"file"})


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, bool]]:
    """Stages that were optimized, and whether everything was."""
    seen: list[tuple[int, bool]] = []
    optimized = _Growth.optimized

    def spied(self: _Growth, values: Values, stage: int, everything: bool) -> tuple[Values, float]:
        seen.append((stage, everything))
        return optimized(self, values, stage, everything)

    monkeypatch.setattr(_Growth, "optimized", spied)
    return seen


def test_older_poses_are_held_where_they_fit(solved: list[tuple[int, bool]]) -> None:
    """So that the cost is linear: 511 poses are eleven stages of 50, and none needs all before it."""
    mission = floor()
    assert mission.poses == 511
    incremental(mission.graph, mission.start, stage_size=50)
    assert solved == [(0, True), *((stage, False) for stage in range(1, 11))]


def test_false_contacts_do_not_call_for_everything_at_every_stage(solved: list[tuple[int, bool]]) -> None:
    """What they leave when everything was optimized is what a stage is judged by."""
    mission = floor(outliers=0.05)
    start = incremental(mission.graph, mission.start)
    assert mission.graph.chi2(start) > 10 * mission.rows
    assert sum(everything for _, everything in solved) <= 3


def test_what_is_fixed_stays() -> None:
    mission = floor()
    held, point = x[[20, 120, 400]], l[[3, 50]]
    given = mission.start.copy()
    for key in (held, point):
        given[key] = mission.truth[key]
        mission.graph.fix(key)
    start = incremental(mission.graph, given)
    for key in (held, point):
        np.testing.assert_array_equal(start[key], given[key])
    assert mission.graph.chi2(start) < mission.rows
    assert mission.ate(start) < mission.ate(given)


def test_the_order_of_measurements_and_variables_is_nothing() -> None:
    mission, rng = floor(), np.random.default_rng(5)

    def shuffled(factor: Factor) -> Factor:
        return factor[rng.permutation(len(factor))]

    mixed = FactorGraph([shuffled(factor) for factor in mission.graph.factors[::-1]])
    rows = {kind: rng.permutation(len(stack)) for kind, stack in mission.start.stacks.items()}
    values = Values({k: (s.manifold, s.X[rows[k]], s.numbers[rows[k]]) for k, s in mission.start.stacks.items()})
    start, other = incremental(mission.graph, mission.start), incremental(mixed, values)
    for kind, stack in start.stacks.items():
        same(stack.manifold.local(stack.X, other[Keys(kind, stack.numbers)]), 0.0, atol=5e-3)


@pytest.mark.parametrize("elevation", ["hinge", "free"])
def test_a_landmark_of_one_view(elevation: str) -> None:
    """The hinge lets it be placed, at elevation 0; without, two numbers are no place, and it keeps its own."""
    mission = floor(elevation=elevation)
    others = [f if not _sees(f) else f[_first_of(f, 7)] for f in mission.graph.factors]
    graph = FactorGraph(others)
    given = mission.start.replaced({"l": np.full((mission.landmarks, 3), 99.0)})
    start = incremental(graph, given)
    assert (start[l[7]] == 99.0).all() == (elevation == "free")
    rest = [k for k in range(mission.landmarks) if k != 7]
    assert np.linalg.norm(start[l[rest]] - mission.truth[l[rest]], axis=1).max() < 2.0
    if elevation == "hinge":
        assert graph.chi2(start) < mission.rows
        assert np.linalg.norm(start[l[7]] - mission.truth[l[7]]) < 2.0


def _sees(factor: Factor) -> bool:
    return len(factor.keys) == 2 and factor.keys[1].kind == "l"


def _first_of(factor: Factor, number: int) -> npt.NDArray[np.bool_]:
    """All measurements but the later ones of a landmark."""
    pose, point = (keys.numbers for keys in factor.keys)
    mine = point == number
    return np.asarray(~mine | (pose == pose[mine].min()))


@pytest.mark.parametrize("kernel", [Cauchy(1.0), Tukey(4.7)], ids=repr)
def test_under_a_kernel_no_start_is_passed_over(kernel: Kernel) -> None:
    """Tukey's kernel lets go of good measurements from both starts: chi2 without it asks for a third."""
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=20)
    _, _, tried = initialize(mission.graph, mission.start)
    _, robust, under = initialize(mission.graph.robust(kernel), mission.start)
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
