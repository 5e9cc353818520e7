"""Poor starts compared by what they lead to: ranges alone, and where nothing is to be compared."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import nls
import sim
from factors import Between, Cauchy, Factor, Isotropic, Prior, Range
from factors.base import Model
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, GaussNewton, Stop, Values, initialize, kinds
from nls.missions.folder.table import csv_text
from nls.optimizers import Result, Status
from nls.starts import STARTS
from tests.nls.graphs import between, forgotten, pose_graph
from tests.nls.missions.folder.mission_files import folder

x, l = kinds("x", "l")


def ranges_alone(seed: int) -> tuple[sim.LandmarkWorld, FactorGraph]:
    """Subsea without its bearings: the range of every sighting, with its own sigma. The first pose is known."""
    world = sim.subsea(np.random.default_rng(seed), 1, known_start=True)
    ranges = Range(*world.sightings.keys, world.sightings.z[:, 1:], Isotropic(0.2))
    return world, FactorGraph([*world.graph.factors[:2], ranges])


@pytest.mark.parametrize("seed", [0, 2])
def test_ranges_alone_end_at_the_best_optimum(seed: int) -> None:
    world, graph = ranges_alone(seed)
    start, name, chi2 = initialize(graph, world.start if seed % 4 else forgotten(world.start, 7.0))
    assert chi2[name] == graph.chi2(start)
    result = graph.optimize(start)
    assert result.converged
    assert result.chi2_final == pytest.approx(graph.optimize(world.truth).chi2_final, rel=1e-5)
    assert world.ate(result.values) < 1.0


def test_the_lowest_start_is_not_the_one_that_ends_lowest() -> None:
    world, graph = ranges_alone(1)
    relaxed = graph.optimize(STARTS["chordal"](graph, world.start))
    assert (relaxed.converged, relaxed.chi2_final > 3000, world.ate(relaxed.values) > 10) == (True, True, True)
    start, name, chi2 = initialize(graph, world.start)
    assert chi2["chordal"] == pytest.approx(29633, abs=1)
    assert chi2["chordal"] < chi2["file"]
    assert chi2["chordal + 20 steps"] == pytest.approx(relaxed.chi2_final, rel=1e-2)
    assert name == "file + 20 steps"
    assert chi2[name] == min(chi2.values()) < 375  # of the incremental start
    assert chi2["odometry"] == pytest.approx(chi2["chordal"], rel=1e-9)  # no loop closures: one chain, compared once
    assert sum(name in chi2 for name in ("odometry + 20 steps", "chordal + 20 steps")) == 1
    assert "incremental" not in chi2
    assert world.ate(graph.optimize(start).values) < 0.5


def test_an_optimization_goes_on_with_the_linearization_of_its_chordal_start(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = pose_graph(SE2, anchored=False, start=1.0)
    graph = sample.graph
    start, name, chi2 = initialize(graph, sample.values)
    moved = start.copy()
    moved[x[3]] = moved[x[3]] + 0.1
    assert graph.optimize(moved).chi2_initial == graph.chi2(moved) > chi2["chordal"]  # not the one of the start
    start, name, chi2 = initialize(graph, sample.values)
    linearize, once = Mock(wraps=Model.linearize), GaussNewton(Stop(max_iterations=1))
    monkeypatch.setattr(Model, "linearize", lambda *X: linearize(*X))
    assert (name, graph.optimize(start, once).chi2_initial) == ("chordal", chi2["chordal"])
    assert linearize.call_count == len(graph.factors)  # where the step led
    assert graph.optimize(start, once).chi2_initial == chi2["chordal"]
    assert linearize.call_count == 3 * len(graph.factors)


def test_the_incremental_start_is_tried_where_no_other_leads_to_an_optimum() -> None:
    world, graph = ranges_alone(1)
    start, name, chi2 = initialize(graph, forgotten(world.start, 7.0))
    assert chi2["chordal"] < 100 * 3 * len(graph)  # not poor enough to try it at once
    assert name.startswith("incremental")
    assert {"file", "chordal", "incremental", "chordal + 20 steps", "file + 20 steps"} <= chi2.keys()
    assert chi2[name] == min(chi2.values()) == graph.chi2(start)


def refuse(*_: object) -> Result:
    raise AssertionError("a step was taken")


def test_a_good_start_costs_no_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    world, graph = ranges_alone(3)
    monkeypatch.setattr(FactorGraph, "optimize", refuse)
    _, name, chi2 = initialize(graph, world.start)
    assert (name, chi2.keys()) == ("chordal", {"file", "chordal"})
    assert 4 < chi2["chordal"] / 164 < 10
    _, name, chi2 = initialize(graph, world.truth)
    assert (name, chi2.keys()) == ("file", {"file", "chordal"})


def test_a_pose_graph_costs_no_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    """However poor: chordal relaxation has used all there is. With a prior there is more."""
    sample = pose_graph(SE2, n=30, seed=7, start=0.5)
    overconfident: list[Factor] = [Between(*f.keys, f.z, Isotropic(1e-4)) for f in between(sample)]
    prior = Prior(x[0], sample.values[x[0]] + 1.0, Isotropic(0.1))
    graph = FactorGraph(overconfident)
    monkeypatch.setattr(FactorGraph, "optimize", refuse)
    assert min(initialize(graph, sample.values)[2].values()) > 10 * 3 * len(graph)
    with pytest.raises(AssertionError, match="a step was taken"):
        initialize(FactorGraph([*overconfident, prior]), sample.values)


def test_an_interrupt_ends_the_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    world, graph = ranges_alone(1)
    interrupt = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("nls.optimizers.problem.Problem.solve", interrupt)
    assert graph.optimize(world.truth).status is Status.INTERRUPTED  # by itself it keeps its best point
    with pytest.raises(KeyboardInterrupt):
        initialize(graph, world.start)


def test_a_start_from_which_no_step_can_be_taken_stays_a_start() -> None:
    """A function of the user's exists at the starts alone, to rounding; it is differentiated with larger steps."""
    world, graph = ranges_alone(1)
    places = [STARTS[name](graph, world.start)[x[5]] for name in ("file", "chordal")]

    def strict(pose: Array) -> Array:
        if not any(np.allclose(pose, place, rtol=0, atol=1e-12) for place in places):
            raise ValueError("not here")
        return np.zeros((len(pose), 1))

    graph.add(Factor.from_function(strict, x[5], 1))
    with pytest.warns(nls.GraphWarning, match="initial guess 'incremental' was left out"):
        _, name, chi2 = initialize(graph, world.start)
    assert name in ("chordal", "odometry")  # the same poses
    assert chi2.keys() == {"file", "chordal", "odometry"}


def test_a_warning_of_the_graph_is_left_to_its_optimization() -> None:
    world, graph = ranges_alone(1)
    values = Values({x: (SE2, world.start[x]), l: (R(2), np.concatenate([world.start[l], [[1.0, 2.0]]]))})
    _, name, _ = initialize(graph, values)  # warnings are errors here
    assert name == "file + 20 steps"
    with pytest.warns(nls.GraphWarning, match="l6: no measurement touches it"):
        graph.optimize(values)


@pytest.mark.filterwarnings("ignore:initial guess 'chordal' was left out")
def test_a_start_that_lies_on_a_bad_fix_is_left_whatever_the_size(tmp_path: Path) -> None:
    """No sensor measures the motion, and one of 1500 fixes is 44 m off: under a kernel its own start ends on it."""
    rng, t, bad = np.random.default_rng(0), np.arange(1500.0), 700
    p = np.column_stack([40 * np.sin(t / 150), 30 * np.cos(t / 110), 10 + 3 * np.sin(t / 70)])
    fixes = p + rng.normal(0, [1.0, 1.0, 0.1], p.shape)
    fixes[bad, 0] += 44.0
    names = ["time_s", *(f"{axis}_m" for axis in "xyz"), *(f"sigma_{axis}_m" for axis in "xyz")]
    table = csv_text(names, t, fixes, np.tile([1.0, 1.0, 0.1], (len(t), 1))).decode()
    folder(tmp_path, {"motion": "sigma_walk_m_sqrt_s\n0.3\n", "fixes": table})
    graph, values, _ = nls.load(tmp_path)
    robust = graph.robust(Cauchy(1.0))
    start, name, chi2 = initialize(robust, values)
    assert name == "odometry + 20 steps"
    assert chi2["file + 20 steps"] < 10 * robust.pattern(values).measured_rows
    ends = [robust.optimize(values), robust.optimize(start)]
    away = [np.linalg.norm(end.values[x][bad, :2] - p[bad, :2]) for end in ends]
    assert away[1] < 3.0 < 40.0 < away[0]
    assert ends[1].chi2_final < ends[0].chi2_final


def test_starts_under_a_kernel_are_not_compared_where_it_believes_all() -> None:
    """One comparison, of the lowest start, where nothing is ignored; of relative poses alone none."""
    world = sim.subsea(np.random.default_rng(1), 1, known_start=True)
    _, _, chi2 = initialize(world.graph.robust(Cauchy(3.0)), world.truth)
    assert sum(name.endswith("steps") for name in chi2) == 1
    city = sim.manhattan(np.random.default_rng(0), n_poses=100)
    _, _, chi2 = initialize(city.graph.robust(Cauchy(1.0)), city.start)
    assert not any(name.endswith("steps") for name in chi2)
