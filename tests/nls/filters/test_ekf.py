"""The EKF against the batch solution where both are exact; its options, and what it refuses by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import factors as f
import sim
from factors import BearingRange, Between, Diagonal, Factor, Heading, Isotropic, Landmark, Position, Prior, Range
from factors.keys import Keys
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, LeadlineError, OptionError, UnderconstrainedError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.association import Nearest
from nls.filters.base import Step, Track, steps
from nls.filters.ekf import EKF
from nls.filters.map_state import MapState
from tests.combinations import for_all
from tests.nls.graphs import walk
from tests.sim.scenes import thinned

x, l, o = kinds("x", "l", "o")


def scene(group: LieGroup, sigma: float, seed: int) -> tuple[FactorGraph, Values]:
    """A walk there and back twice past four landmarks, measured with a sigma so small that all is linear."""
    rng = np.random.default_rng(seed)
    X = np.concatenate([walk(group, 6, rng), walk(group, 6, rng)])
    n, d = len(X), group.point_dim
    L = rng.normal(size=(4, d)) * 3
    noise = Diagonal(sigma * rng.uniform(0.5, 2.0, size=group.dim))
    steps_ = group.retract(group.between(X[:-1], X[1:]), sigma * rng.normal(size=(n - 1, group.dim)))
    i, k = np.divmod(np.arange(4 * n), 4)
    kept = rng.uniform(size=4 * n) < 0.6
    i, k = i[kept], k[kept]
    z = group.act(group.inverse(X[i]), L[k]) + sigma * rng.normal(size=(len(i), d))
    first = Prior(x[0], group.retract(X[:1], sigma * rng.normal(size=(1, group.dim))), Isotropic(sigma))
    seen = Landmark(x[i], l[k], z, Diagonal(sigma * rng.uniform(0.5, 2.0, size=d)))
    fix = Position(x[[n // 2]], group.position(X[[n // 2]]) + sigma, Isotropic(3 * sigma))
    graph = FactorGraph([first, Between(x[0 : n - 1], x[1:n], steps_, noise), seen, fix])
    return graph, Values({x: (group, X), l: (R(d), L + 0.1)})


def agrees(track: Track, graph: FactorGraph, start: Values, rtol: float, relative: float) -> None:
    """Mean (in sigmas) and covariance of last pose and landmarks are those of the batch."""
    best = graph.optimize(start).values
    marginals = Marginals(graph, best)
    last = track.x[[len(track.x) - 1]]
    P = marginals.covariance(last, frame="body")[0]
    sigma = np.sqrt(np.diag(P))
    away = track.manifold.local(best[last], track.X[-1:])[0]
    assert np.abs(away / sigma).max() < relative
    assert np.abs(track.P[-1] - P).max() < rtol * np.abs(P).max()
    P_l = marginals.covariance(track.landmarks)
    assert np.abs(track.P_landmarks - P_l).max() < rtol * np.abs(P_l).max()
    away_l = track.values[track.landmarks] - best[track.landmarks]
    assert (np.abs(away_l) / np.sqrt(np.diagonal(P_l, axis1=1, axis2=2))).max() < relative


def test_it_is_the_batch_solution_of_a_linear_problem() -> None:
    rng, n = np.random.default_rng(7), 9
    walk = Between(x[0 : n - 1], x[1:n], rng.normal(size=(n - 1, 2)), Diagonal([0.3, 0.1]))
    seen = Between(x[[3, 5, 5, 8, 8]], l[[4, 4, 2, 2, 4]], rng.normal(size=(5, 2)), Isotropic(0.2))
    charted = Prior(l[[4, 2]], [[3.0, 3.0], [-1.0, 0.0]], Diagonal([[5.0, 2.0], [1.0, 1.0]]))
    again = Prior(l[2], [-2.0, 1.0], Isotropic(3.0))  # of the same landmark
    part = Prior(x[[4]], [[9.0, 0.0]], Isotropic(0.7), components=("y",))
    graph = FactorGraph([Prior(x[0], [1.0, 2.0], Isotropic(0.5)), walk, charted, seen, part, again])
    values = Values({x: (R(2), np.zeros((n, 2))), l: (R(2), np.zeros((2, 2)), [2, 4])})
    for options in ({}, {"first_estimates": True}, {"landmarks": "independent"}):
        track = EKF(**options).run(graph, values)  # type: ignore[arg-type]
        agrees(track, graph, values, rtol=1e-10, relative=1e-9)
        assert sorted(track.landmarks.numbers.tolist()) == [2, 4]


@for_all(group=[SE2, SE3], first_estimates=[False, True])
def test_it_is_the_batch_solution_where_noise_is_small(group: LieGroup, first_estimates: bool) -> None:
    """Landmarks are added with their correlations: 1e-6 of noise leaves 1e-4 of nonlinearity at most."""
    for seed in (0, 1):
        graph, start = scene(group, 1e-6, seed)
        track = EKF(first_estimates=first_estimates).run(graph, start)
        agrees(track, graph, start, rtol=2e-4, relative=2e-4)


def test_bearings_and_lines_and_wheels_too() -> None:
    world = sim.lines(np.random.default_rng(0), laps=1, noise_scale=1e-4)
    track = EKF().run(world.graph, world.start)
    agrees(track, world.graph, world.start, rtol=3e-3, relative=1e-2)
    world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True, azimuth="absolute", noise_scale=1e-4)
    agrees(EKF().run(world.graph, world.start), world.graph, world.start, rtol=3e-3, relative=1e-2)


def test_a_landmark_seen_twice_from_where_it_is_seen_first() -> None:
    X = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.3]])
    walk = Between(x[0], x[1], SE2.between(X[0], X[1]), Isotropic(1e-5))
    seen = Landmark(x[[1, 1, 0]], l[[5, 5, 6]], [[2.0, 1.0], [2.0, 1.00001], [1.0, 1.0]], Isotropic(1e-5))
    z = [[np.arctan2(1, 2), 5**0.5], [np.pi - 0.3 - np.pi / 2, 1.0]]
    ranged = BearingRange(x[[1, 1]], l[[5, 6]], z, Isotropic(2e-5))
    graph = FactorGraph([Prior(x[0], X[0], Isotropic(1e-5)), walk, seen, ranged])
    values = Values({x: (SE2, X), l: (R(2), np.zeros((2, 2)), [5, 6])})
    agrees(EKF().run(graph, values), graph, values, rtol=1e-3, relative=1e-3)


def test_one_step_at_a_time_is_the_run() -> None:
    graph, start = scene(SE2, 0.05, 3)
    track, ekf = EKF().run(graph, start), EKF()
    cut = steps(graph, start)
    ekf.start(cut[0], start)
    for step, X, P in zip(cut[1:], track.X[1:], track.P[1:], strict=True):
        ekf.step(step)
        assert np.array_equal(ekf.pose[0], X)
        assert np.array_equal(ekf.pose[1], P)
    assert np.array_equal(ekf.state.P, ekf.state.P.T)
    assert np.linalg.eigvalsh(ekf.state.P).min() > 0
    again = ekf.run(graph, start)  # a filter that was used starts anew
    assert np.array_equal(again.X, track.X)


def test_the_frame_of_the_world_does_not_matter() -> None:
    """Headings and bearings that cross +-pi somewhere else."""
    world = thinned(sim.subsea(np.random.default_rng(4), laps=1, known_start=True))
    plain = EKF().run(world.graph, world.start)
    for turn in (1.0, -2.0):
        T = np.array([[30.0, -20.0, turn]])
        first = Prior(x[0], SE2.compose(T, world.first.z), world.first.noise)
        graph = FactorGraph([first, *world.graph.factors[1:]])
        moved = EKF().run(graph, world.start)
        assert np.allclose(SE2.local(SE2.compose(T, plain.X), moved.X), 0, atol=1e-8)
        assert np.allclose(moved.P, plain.P, rtol=1e-6, atol=1e-12)


def sigma_of_common_heading(X: Array, L: Array, P: Array) -> float:
    """Least sigma, rad, of a rotation of everything together, wherever its center is: motions N, (N' P^-1 N)^-1."""
    shifts, turns = np.tile(np.eye(2), (len(L), 1)), np.stack([-L[:, 1], L[:, 0]], axis=1).reshape(-1, 1)
    N = np.concatenate([SE2.adjoint_inverse(X[None])[0], np.concatenate([shifts, turns], axis=1)])
    return float(np.sqrt(np.linalg.inv(N.T @ np.linalg.solve(P, N))[2, 2]))


def test_first_estimates_learn_nothing_about_a_rotation_of_everything() -> None:
    """What is known of the heading of everything is the prior, 0.5 deg; relative measurements add nothing to it."""
    world = thinned(sim.subsea(np.random.default_rng(0)))
    best = world.graph.optimize(world.start).values
    joint = Marginals(world.graph, best).joint([x[60], l[0:6]], frame="body")
    batch = sigma_of_common_heading(best[x[60]], best[l], joint.matrix)
    assert np.radians(0.5) < batch < np.radians(0.52)
    sigma = {}
    for first_estimates in (False, True):
        ekf = EKF(first_estimates=first_estimates)
        ekf.run(world.graph, world.start)
        state = ekf.state
        sigma[first_estimates] = sigma_of_common_heading(state.first, state.L_first, state.P)
    assert sigma[True] == pytest.approx(batch, rel=5e-4)
    assert sigma[False] < 0.98 * batch


def test_numbers_that_are_not_finite_name_the_step() -> None:
    for variance, wrong in ((np.nan, "finite"), (-5.0, "positive")):
        state = MapState((SE2, R(2)), np.zeros(3), np.diag([variance, 1.0, 1.0]), False)
        with pytest.raises(EvaluationError, match=f"EKF at x17: the covariance of its innovations is not {wrong}"):
            state.update(np.eye(1, 3), np.arange(3), np.zeros(1), Keys("x", 17))


def test_all_that_is_known_of_the_first_pose_counts() -> None:
    """Several priors of it, two of them in one factor, before and after what is seen from it."""
    headings = Heading(x[[0, 0]], [3.1, -3.1], Isotropic([0.1, 0.2]))
    seen = Landmark(x[[0, 0]], l[[0, 1]], [[1.0, 0.0], [2.0, 0.0]], Isotropic(0.1))
    fixes = Position(x[[0, 0]], [[1.0, 2.0], [1.2, 2.0]], Isotropic(0.1))
    graph = FactorGraph([headings, seen, fixes, Prior(x[0], [0.9, 2.0, 3.1], Isotropic(1.0))])
    values = Values({x: (SE2, [0, 0, 3.0]), l: (R(2), np.zeros((2, 2)))})
    agrees(EKF().run(graph, values), graph, values, rtol=1e-6, relative=1e-6)


# ---- options, and what they make of it


ONE = Isotropic(0.1)
START = Prior(x[0], [0, 0, 0], ONE)
WITHOUT_DELAY: tuple[dict[str, Any], ...] = ({"first_estimates": True}, {"associate": Nearest()})
WALK = Between(x[[0, 1]], x[[1, 2]], [1, 0, 0], ONE)


def run(*factors: Factor, count: int = 2, **options: object) -> EKF:
    ekf = EKF(**options)  # type: ignore[arg-type]
    stacks = {x: (SE2, SE2.identity(3)), **({l: (R(2), np.ones((count, 2)))} if count else {})}
    ekf.run(FactorGraph(factors), Values(stacks))
    return ekf


def test_what_cannot_be_filtered_is_named() -> None:
    flat, thin = f.Information(np.diag([1.0, 0.0, 1.0])), f.Information(np.diag([1.0, 0.0]))
    free, wrong = UnderconstrainedError, GraphError
    cases: list[tuple[list[Factor], type[LeadlineError], str]] = [
        ([WALK], wrong, r"x0: .*Prior"),
        ([Heading(x[0], 0.0, ONE), WALK], free, r"x0: .*Heading"),
        ([START, Between(x[[0, 1]], x[[1, 2]], [1, 0, 0], flat)], free, r"x1: .*Between"),
        ([START, WALK, Range(x[[1, 2]], l[[1, 1]], [2.0, 2.0], ONE)], wrong, r"Range\(x1, l1\) .*Prior of l1"),
        ([START, WALK, BearingRange(x[1], l[0], [0.1, 2.0], thin)], free, r"l0: .*BearingRange"),
        ([START, WALK, Between(x[0], x[2], [2, 0, 0], ONE)], wrong, r"EKF at x2: Between\(x0, x2\) needs x0"),
        ([START, WALK, Landmark(x[1], l[0], [1, 0], ONE).robust(f.Huber(1.0))], wrong, r"Landmark.*robust"),
        ([START, WALK, Between(l[0], l[1], [1, 0], ONE)], wrong, r"Between\(l0, l1\)"),
        ([START, WALK, Prior(l[0], [[1.0, 0.0]], ONE, components=("x",))], free, r"l0: .*Prior"),
    ]
    for factors, error, named in cases:
        with pytest.raises(error, match=named):
            run(*factors)


def test_motions_that_look_back_are_refused() -> None:
    """Two factors that together have more to say than where the next pose is."""
    values = Values({x: (R(1), np.zeros((2, 1)))})
    start, twice = Prior(x[0], [1.0], ONE), Factor.from_function(lambda a, b: b - 2 * a, [x[0], x[1]], dim=1)
    track = EKF().run(FactorGraph([start, twice]), values)
    assert (track.X[1, 0], track.P[1, 0, 0]) == (pytest.approx(2.0), pytest.approx(4 * 0.01 + 1))
    with pytest.raises(GraphError, match=r"together also constrain x0, which is past"):
        EKF().run(FactorGraph([start, twice, Between(x[0], x[1], [1.0], ONE)]), values)


def test_a_range_is_fine_once_its_landmark_is_known() -> None:
    known = Landmark(x[1], l[1], [1.0, 0.5], ONE)
    seen = Range(x[[1, 2]], l[[1, 1]], [1.1, 0.5], ONE)
    with_ranges = run(START, WALK, seen, known)  # the order of the factors does not matter
    without = run(START, WALK, known)
    assert with_ranges.state.numbers.tolist() == [1]
    assert with_ranges.landmarks[2][0, 0, 0] < without.landmarks[2][0, 0, 0]


def test_charted_landmarks_need_a_chart() -> None:
    seen = Landmark(x[[1, 2]], l[[0, 1]], [[1.0, 0.0], [2.0, 1.0]], ONE)
    chart = Prior(l[[0, 1]], [[2.0, 0.0], [4.0, 1.0]], Isotropic(4.0))
    with pytest.raises(GraphError, match=r"l1 is observed and has no Prior, which landmarks='independent' needs"):
        run(START, WALK, seen, chart[0], landmarks="independent")
    charted, plain = (run(START, WALK, seen, chart, landmarks=name) for name in ("independent", "correlated"))
    assert np.array_equal(charted.state.P, plain.state.P)


def test_steps_out_of_order_are_refused() -> None:
    ekf = EKF()
    with pytest.raises(GraphError, match="no step has been taken"):
        _ = ekf.pose
    ekf.start(Step(x[0], [], [START]), Values({x: (SE2, SE2.identity(3))}))
    with pytest.raises(GraphError, match=r"EKF is at x0; Between\(x1, x2\) does not begin there"):
        ekf.step(Step(x[2], [WALK[1]]))
    with pytest.raises(GraphError, match=r"x1 has no motion from x0"):
        ekf.step(Step(x[1]))
    with pytest.raises(GraphError, match=r"landmarks are of kind l, not o"):
        ekf.step(Step(x[1], [WALK[0]], [Landmark(x[1], o[0], [1, 0], ONE)]))


def test_options_that_are_none_are_refused_and_reports_name_the_variant() -> None:
    cases: list[tuple[str, dict[str, Any]]] = [
        ("landmarks", {"landmarks": "fixed"}),
        ("first_estimates", {"first_estimates": 1}),
        ("associate", {"associate": "jcbb"}),
        *(("gate: .* between 0 and 1", {"gate": gate}) for gate in (0.0, 1.0, 1.5, "0.9", True)),
        ("gates of its own", {"gate": 0.99, "associate": Nearest(0.99)}),
        *(("iterations: .* at least 1; 1 with first_estimates", {"iterations": count}) for count in (0, 2.0, True)),
        ("iterations: .* at least 1; 1 with first_estimates", {"iterations": 2, "first_estimates": True}),
        *(("landmarks: .*with first_estimates or ass", {"landmarks": "delayed", **other}) for other in WITHOUT_DELAY),
    ]
    for match, options in cases:
        with pytest.raises(OptionError, match=match):
            EKF(**options)
    for sigma in (0.0, float("nan"), [1.0, 2.0, 3.0]):
        with pytest.raises(OptionError, match="prior_sigma"):
            run(START, WALK, Landmark(x[1], l[0], [1, 0], ONE), prior_sigma=sigma)
    assert EKF().method == "EKF"
    assert EKF("first-sight", first_estimates=True).method == "EKF (first-sight, first estimates)"
    assert EKF("delayed", gate=0.999, iterations=3).method == "EKF (delayed, 3 iterations, gate 0.999)"


@for_all(first_estimates=[False, True])
def test_one_landmark_under_the_name_of_another(first_estimates: bool) -> None:
    world = sim.subsea(np.random.default_rng(3), laps=1, known_start=True)
    others, seen = world.graph.factors[:2], world.sightings
    numbers = seen.keys[1].numbers.copy()
    at = int(np.flatnonzero((seen.keys[0].numbers > 80) & (numbers == 0))[0])
    numbers[at] = 5  # both have been seen before
    wrong = FactorGraph([*others, BearingRange(seen.keys[0], Keys("l", numbers), seen.z, seen.noise)])
    without = FactorGraph([*others, seen[np.arange(len(seen)) != at]])
    gated = EKF(first_estimates=first_estimates, gate=0.999999)
    found = gated.run(wrong, world.start)
    expected = EKF(first_estimates=first_estimates).run(without, world.start)
    assert gated.left_out == 1
    np.testing.assert_allclose(found.X, expected.X, atol=1e-9)
    np.testing.assert_allclose(found.P, expected.P, rtol=1e-6, atol=1e-15)
    if not first_estimates:
        assert EKF().run(wrong, world.start).ate(world.truth).largest > 3 * found.ate(world.truth).largest


def test_as_many_are_left_out_as_the_gate_says() -> None:
    left, all_of_them = 0, 0
    for seed in range(2):
        world = sim.subsea(np.random.default_rng(seed), laps=1, known_start=True)
        filter = EKF(gate=0.9)
        filter.run(world.graph, world.start)
        left += filter.left_out
        all_of_them += len(world.sightings) - len(world.truth[l])
    assert left / all_of_them == pytest.approx(0.1, abs=0.05)
    again = filter.left_out
    filter.run(world.graph, world.start)
    assert filter.left_out == again  # counted anew


def test_an_update_ends_at_the_optimum_of_its_step() -> None:
    """Landmarks charted to 4 m, 20 m away, and a bearing of 0.2 deg: one linearization is many sigma off."""
    rng = np.random.default_rng(4)
    L = np.array([[20.0, 5.0], [-3.0, 18.0], [5.0, -20.0]])
    chart = L + 4.0 * rng.normal(size=L.shape)
    seen = np.stack([np.arctan2(L[:, 1], L[:, 0]), np.hypot(*L.T)], axis=1)
    first = Prior(x[0], [0.5, -0.4, 0.001], Diagonal([1.0, 1.0, 1e-3]))  # hardly turned: no matter by which chart
    ranged = BearingRange(x[0], l[0:3], seen, Diagonal(bearing=np.radians(0.2), range=0.2))
    graph = FactorGraph([first, ranged, Prior(l[0:3], chart, Isotropic(4.0))])
    values = Values({x: (SE2, np.zeros((1, 3))), l: (R(2), chart)})
    best = graph.optimize(values).values
    marginals = Marginals(graph, best)
    P, P_l = marginals.covariance(x[0], frame="body"), marginals.covariance(l[0:3])
    sigma, sigma_l = np.sqrt(np.diag(P)), np.sqrt(np.diagonal(P_l, axis1=1, axis2=2))
    off = {}
    for iterations in (1, 10):
        track = EKF("independent", iterations=iterations).run(graph, values)
        away = track.values[l[0:3]] - best[l[0:3]]
        off[iterations] = max(np.abs(away / sigma_l).max(), np.abs((track.X[0] - best[x[0]]) / sigma).max())
    assert off[1] > 1.0
    assert off[10] < 5e-3
    np.testing.assert_allclose(track.P[0], P, atol=2e-3 * np.abs(P).max())
    np.testing.assert_allclose(track.P_landmarks, P_l, rtol=2e-3, atol=2e-3 * np.abs(P_l).max())


def test_what_the_variants_say_of_the_last_pose() -> None:
    """Relative measurements leave the 2 m of the start; six landmarks of 4 m make (1/2^2 + 6/4^2)^-1/2 = 1.265 m."""
    for options, believed, low, high in (
        ({}, "correlated", 1.99, 2.02),
        ({}, "first-sight", 1.25, 1.30),
        ({"landmarks": "independent"}, "independent", 1.25, 1.30),
        ({"known_landmarks": 1, "azimuth": "absolute"}, "correlated", 0.100, 0.115),
    ):
        world = sim.subsea(np.random.default_rng(1), laps=1, **options)  # type: ignore[arg-type]
        track = EKF(believed).run(world.graph, world.start)  # type: ignore[arg-type]
        G = SE2.world_axes(track.X[-1:])[0]
        sigma = np.sqrt(np.diag(G @ track.P[-1] @ G.T))[:2]
        assert ((sigma > low) & (sigma < high)).all(), (believed, options, sigma)
