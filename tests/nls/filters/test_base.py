"""A graph cut into steps, the record of a run, errors in units of the covariance; filters on public logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import sim
from factors import Between, Heading, Isotropic, Landmark, Prior
from factors.replaced import predicted
from models import SE2, R
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.filters import Smoother
from nls.filters.association import Nearest
from nls.filters.base import Step, Track, steps
from nls.filters.consistency import nees, nees_bounds, regular
from nls.filters.ekf import EKF
from nls.filters.fastslam import FastSLAM
from sim import LandmarkWorld
from sim.estimators import batch
from tests.sim.scenes import thinned

x, l, o = kinds("x", "l", "o")
ONE = Isotropic(0.1)


def small() -> tuple[FactorGraph, Values]:
    """Poses 2, 5, 9, given out of order; a closure, a heading, sightings in one batch, priors of two landmarks."""
    chart, first = Prior(l[[7, 3]], [[1, 1], [2, 2]], ONE), Prior(x[2], [0, 0, 0], ONE)
    seen = Landmark(x[[9, 5, 9, 2]], l[[7, 7, 4, 4]], [[1, 0], [2, 0], [3, 0], [4, 0]], ONE)
    steps_ = [Between(x[[9, 5]], x[[5, 2]], [[-1, 0, 0], [-2, 0, 0]], ONE), Between(x[2], x[9], [3, 0, 0], ONE)]
    graph = FactorGraph([chart, seen, *steps_, first, Heading(x[[5, 9]], [0.1, 0.2], ONE)])
    return graph, Values({l: (R(2), np.zeros((3, 2)), [7, 3, 4]), x: (SE2, SE2.identity(3), [9, 2, 5])})


def shown(step: Step) -> tuple[str, list[str], list[str]]:
    return repr(step.pose), [repr(f) for f in step.motion], [repr(f) for f in step.observations]


def test_every_measurement_is_at_the_step_of_its_latest_pose() -> None:
    cut = steps(*small())
    assert [shown(step) for step in cut] == [
        ("x2", [], ["Prior(l3)", "Landmark(x2, l4)", "Prior(x2)"]),  # nobody sees l3
        ("x5", ["Between(x5, x2)"], ["Prior(l7)", "Landmark(x5, l7)", "Heading(x5)"]),
        ("x9", ["Between(x9, x5)"], ["Landmark(x[9, 9], l[7, 4])", "Between(x2, x9)", "Heading(x9)"]),
    ]
    assert cut[2].observations[0].z.tolist() == [[1, 0], [3, 0]]
    assert cut[1].motion[0].z.tolist() == [[-2, 0, 0]]
    assert [float(f.z[0]) for f in (cut[1].observations[2], cut[2].observations[2])] == [0.1, 0.2]


def test_graphs_that_have_no_steps_are_refused_by_name() -> None:
    graph, values = small()
    graph.remove(graph.factors[2])
    graph.add(Between(x[2], x[5], [1, 0, 0], ONE))
    with pytest.raises(GraphError, match=r"x9 has no factor from x5, the pose before it"):
        steps(graph, values)
    graph, values = small()
    graph.fix(x[2])
    with pytest.raises(GraphError, match=r"x2 is fixed.*release"):
        steps(graph, values)
    graph.release(x[2])
    assert len(steps(graph, values)) == 3
    graph.add(Prior(o[0], [0, 0], ONE))
    values.add(o, R(2), [0, 0])
    with pytest.raises(GraphError, match=r"one kind of landmarks; this graph has kinds l, o"):
        steps(graph, values)
    with pytest.raises(GraphError, match=r"no variable of kind 'x'"):
        steps(FactorGraph(), Values({l: (R(2), [0, 0])}))
    graph, values = small()
    graph.add(Heading(x[3], 0.0, ONE))
    with pytest.raises(GraphError, match=r"x3 has no value"):
        steps(graph, values)


def test_a_track_measures_itself_against_the_truth() -> None:
    n = 4
    X = np.array([[0, 0, 3.1], [1, 0, 0], [2, 0, 0], [3, 0, 0.5]])
    P = np.tile(np.diag([0.04, 0.01, 0.0025]), (n, 1, 1))
    truth = Values({x: (SE2, X + np.array([[0, 0, -6.2], [0.2, 0, 0], [0, 0.3, 0], [0, 0, 0]]))})
    smoothed = Values({x: (SE2, X + np.array([[1, 0, 0]]))})
    track = Track("test", x[0:n], SE2, X, P, smoothed, l[[]], np.zeros((0, 2, 2)), np.zeros(n))
    turned = 2 * np.pi - 6.2  # over +-pi, not 6.2
    assert track.nees(truth).round(9).tolist() == pytest.approx([turned**2 / 0.0025, 1.0, 9.0, 0.0])
    assert track.ate(truth).rmse == pytest.approx(np.sqrt((0.04 + 0.09) / 4))
    distances = [1.0, 0.8, np.hypot(1, 0.3), 1.0]
    assert track.ate(truth, smoothed=True).rmse == pytest.approx(np.sqrt(np.mean(np.square(distances))))
    assert track.ate(truth, "rigid", smoothed=True).rmse < 0.3


def test_errors_along_axes_that_are_correlated() -> None:
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 3, 3)) * [1e-4, 1.0, 1e3]  # scales that differ by 1e7 are not singular
    P = A.mT @ A
    e = rng.normal(size=(6, 3)) * [1e-4, 1.0, 1e3]
    expected = [e[k] @ np.linalg.solve(P[k], e[k]) for k in range(6)]
    assert nees(x[0:6], R(3), np.zeros((6, 3)), P, e) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("P", [np.zeros((2, 2)), np.diag([1.0, 0.0]), np.ones((2, 2)), np.diag([1.0, np.nan])])
def test_a_singular_covariance_has_no_nees(P: np.ndarray) -> None:
    both = np.stack([np.eye(2), P])
    with pytest.raises(UnderconstrainedError, match=r"NEES of x8: its covariance is singular"):
        nees(x[[4, 8]], R(2), np.zeros((2, 2)), both, np.ones((2, 2)))
    assert regular(both).tolist() == [True, False]


def test_bounds_are_those_of_chi_squared() -> None:
    assert nees_bounds(3, 50) == pytest.approx(chi2.ppf([0.025, 0.975], 150) / 50)
    assert nees_bounds(2, 1, 0.8) == pytest.approx(chi2.ppf([0.1, 0.9], 2))
    assert [chi2_gate(d, 0.99) for d in (1, 2, 7)] == pytest.approx(chi2.ppf(0.99, [1, 2, 7]))
    for bad in (0.0, 1.0, True, "0.9", np.nan):
        with pytest.raises(OptionError, match="probability"):
            chi2_gate(2, bad)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="dim"):
        chi2_gate(0, 0.9)


def test_kinds_the_graph_does_not_use_are_left_alone() -> None:
    world = thinned(sim.subsea(np.random.default_rng(2), laps=1))
    values = Values({o: (R(3), [1, 2, 3]), **{k: (s.manifold, s.X, s.numbers) for k, s in world.start.stacks.items()}})
    graph = FactorGraph([world.first, world.odometry, world.sightings[world.sightings.keys[0].numbers > 3]])
    track = EKF().run(graph, values)
    assert (list(track.values.stacks), len(track.landmarks)) == (["x", "l"], 6)


def test_a_run_goes_by_the_numbers_of_the_poses_not_their_order() -> None:
    world = thinned(sim.subsea(np.random.default_rng(2), laps=1))
    track = EKF().run(world.graph, world.start)
    stack = world.start.stack("x")
    order = np.random.default_rng(0).permutation(len(stack))
    shuffled = Values({x: (SE2, stack.X[order], 3 * stack.numbers[order] - 7), l: (R(2), world.start[l])})
    first, odometry, seen = world.first, world.odometry, world.sightings
    order = np.argsort(-seen.keys[0].numbers, kind="stable")
    seen = seen[order]
    i, j = (k.numbers * 3 - 7 for k in odometry.keys)
    changed = [type(seen)(x[3 * seen.keys[0].numbers - 7], seen.keys[1], seen.z, seen.noise)]
    changed += [Between(x[i], x[j], odometry.z, odometry.noise), Prior(x[-7], first.z, first.noise)]
    other = EKF().run(FactorGraph(changed), shuffled)
    assert np.allclose(other.X, track.X, atol=1e-9)
    assert np.allclose(other.P, track.P, atol=1e-9)
    assert other.x.numbers.tolist() == list(range(-7, 3 * 31 - 7, 3))


def test_without_noise_every_estimate_is_the_truth() -> None:
    """Measurements as the truth predicts them, no gain or linearization can then be in the way."""
    world = thinned(sim.subsea(np.random.default_rng(1), laps=1, known_start=True))
    exact = FactorGraph([predicted(factor, factor.keys, world.truth) for factor in world.graph.factors])
    for method in (EKF(), EKF(iterations=3), Smoother(), Smoother(10, landmarks="stay"), Smoother(3)):
        track = method.run(exact, world.truth)
        assert track.ate(world.truth).rmse < 1e-9
        keys, L, P = method.landmarks
        np.testing.assert_allclose(L, world.truth[keys], atol=1e-9)
        assert np.linalg.eigvalsh(P[~np.isnan(P[:, 0, 0])]).min() > 0  # nan: it left


def test_without_landmarks_there_are_none() -> None:
    steps_of_odometry = Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.5], ONE)
    graph = FactorGraph([Prior(x[0], [0, 0, 0], ONE), steps_of_odometry])
    for method in (EKF(), FastSLAM(particles=5, rng=np.random.default_rng(0)), Smoother(), Smoother(2)):
        method.run(graph, Values({x: (SE2, SE2.identity(3))}))
        keys, L, P = method.landmarks
        assert (len(keys), len(L), len(P)) == (0, 0, 0), method.method


@pytest.fixture
def evidence(script: Callable[[str], Any]) -> Any:
    return script("landmark_logs")


def landmark_error(world: LandmarkWorld, track: Track) -> float:
    """Rms over the landmarks, m."""
    off = track.values[track.landmarks] - world.truth[track.landmarks]
    return float(np.sqrt(np.square(off).sum(axis=1).mean()))


def test_a_robot_among_landmarks(data: Path, evidence: ModuleType) -> None:
    """100 s from the true start, nothing aligned: 0.55 m by the commands alone, 0.16 m by EKF, 0.12 m by the graph."""
    world = evidence.mrclam(evidence.read_mrclam(data / "mrclam6", 3), "robot 3", 100.0)
    assert (world.poses, world.landmarks) == (195, 8)
    ekf, graph = EKF().run(world.graph, world.start), batch(world)
    errors = [world.ate(world.start), ekf.ate(world.truth).rmse, graph.ate(world.truth).rmse]
    print(f"ATE {errors}, landmarks {landmark_error(world, ekf):.3f} and {landmark_error(world, graph):.3f} m")
    assert 0.4 < errors[0] < 0.7
    assert errors[1] < 0.2
    assert errors[2] < 0.15
    assert landmark_error(world, graph) < 0.15 < landmark_error(world, ekf) < 0.4


def test_trees_without_names(data: Path, evidence: ModuleType) -> None:
    """150 s of a truck in a park, against the GPS of the beginning and the end, after a rigid alignment."""
    park = evidence.victoria_park(evidence.read_victoria_park(data / "victoria-park"), 160.0)
    ekf = EKF(associate=Nearest(0.99))
    track = ekf.run(park.graph, park.start)
    graph, start = park.named(ekf.associations, track.X)
    result = graph.optimize(start)
    assert result.converged
    errors = [park.gps_error(X).rmse for X in (park.start[x], track.X, result.values[x])]
    print(f"{len(park.t)} poses, {len(track.landmarks)} trees, rmse from GPS {errors}")
    assert len(park.t) == 685
    assert 80 < len(track.landmarks) < 130
    assert errors[0] > 1.4
    assert max(errors[1:]) < 1.1
    again = park.again(result.values)
    assert (again == ekf.associations).mean() > 0.97  # the map agrees with what the filter thought on the way
