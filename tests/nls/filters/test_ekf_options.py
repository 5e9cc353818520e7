"""Options of the EKF, what they make of it, and what it refuses by the name of the step and of the variable."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import (
    BearingRange,
    Between,
    Diagonal,
    Factor,
    Heading,
    Huber,
    Information,
    Isotropic,
    Landmark,
    Prior,
    Range,
)
from factors.keys import Keys
from models import SE2, R
from models.errors import GraphError, LeadlineError, OptionError, UnderconstrainedError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.association import Nearest
from nls.filters.base import Step
from nls.filters.ekf import EKF
from tests.combinations import for_all

x, l, o = kinds("x", "l", "o")
ONE = Isotropic(0.1)
START = Prior(x[0], [0, 0, 0], ONE)
WALK = Between(x[[0, 1]], x[[1, 2]], [1, 0, 0], ONE)


def run(*factors: Factor, count: int = 2, **options: object) -> EKF:
    ekf = EKF(**options)  # type: ignore[arg-type]
    stacks = {x: (SE2, SE2.identity(3)), **({l: (R(2), np.ones((count, 2)))} if count else {})}
    ekf.run(FactorGraph(factors), Values(stacks))
    return ekf


def test_what_cannot_be_filtered_is_named() -> None:
    flat, thin = Information(np.diag([1.0, 0.0, 1.0])), Information(np.diag([1.0, 0.0]))
    free, wrong = UnderconstrainedError, GraphError
    cases: list[tuple[list[Factor], type[LeadlineError], str]] = [
        ([WALK], wrong, r"x0: .*Prior"),
        ([Heading(x[0], 0.0, ONE), WALK], free, r"x0: .*Heading"),
        ([START, Between(x[[0, 1]], x[[1, 2]], [1, 0, 0], flat)], free, r"x1: .*Between"),
        ([START, WALK, Range(x[[1, 2]], l[[1, 1]], [2.0, 2.0], ONE)], wrong, r"Range\(x1, l1\) .*Prior of l1"),
        ([START, WALK, BearingRange(x[1], l[0], [0.1, 2.0], thin)], free, r"l0: .*BearingRange"),
        ([START, WALK, Between(x[0], x[2], [2, 0, 0], ONE)], wrong, r"EKF at x2: Between\(x0, x2\) needs x0"),
        ([START, WALK, Landmark(x[1], l[0], [1, 0], ONE).robust(Huber(1.0))], wrong, r"Landmark.*robust"),
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
    assert track.X[1, 0] == pytest.approx(2.0)
    assert track.P[1, 0, 0] == pytest.approx(4 * 0.01 + 1)
    with pytest.raises(GraphError, match=r"together say something of x0 as well, which is past"):
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
    with pytest.raises(GraphError, match=r"l1 is seen and has no Prior, which landmarks='independent' needs"):
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
    bad = {"landmarks": ["fixed"], "first_estimates": [1], "prior_sigma": [0.0, float("nan"), [1.0, 2.0, 3.0]]}
    bad["associate"] = ["jcbb"]
    for name, value in ((name, value) for name, values in bad.items() for value in values):
        with pytest.raises(OptionError, match=name):
            run(START, WALK, Landmark(x[1], l[0], [1, 0], ONE), **{name: value})
    assert EKF().method == "EKF"
    assert EKF("first-sight", first_estimates=True).method == "EKF (first-sight, first estimates)"


x, l = kinds("x", "l")


def sightings(graph: FactorGraph) -> int:
    """Which factor of the graph they are."""
    return next(k for k, factor in enumerate(graph.factors) if isinstance(factor, BearingRange))


def with_sightings(graph: FactorGraph, changed: BearingRange) -> FactorGraph:
    return FactorGraph([changed if isinstance(factor, BearingRange) else factor for factor in graph.factors])


@for_all(first_estimates=[False, True])
def test_one_landmark_under_the_name_of_another(first_estimates: bool) -> None:
    world = sim.subsea(np.random.default_rng(3), laps=1, known_start=True)
    seen = world.graph.factors[sightings(world.graph)]
    numbers = seen.keys[1].numbers.copy()
    at = int(np.flatnonzero((seen.keys[0].numbers > 80) & (numbers == 0))[0])
    numbers[at] = 5  # both have been seen before
    wrong = with_sightings(world.graph, BearingRange(seen.keys[0], Keys("l", numbers), seen.z, seen.noise))
    without = with_sightings(world.graph, seen[np.arange(len(seen)) != at])  # type: ignore[arg-type]
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
        all_of_them += len(world.graph.factors[sightings(world.graph)]) - len(world.truth[l])
    assert left / all_of_them == pytest.approx(0.1, abs=0.05)
    again = filter.left_out
    filter.run(world.graph, world.start)
    assert filter.left_out == again  # counted anew


def test_gates_that_are_none() -> None:
    assert EKF(gate=0.99).method == "EKF (gate 0.99)"
    for gate in (0.0, 1.0, 1.5, "0.9", True):
        with pytest.raises(OptionError, match=r"gate: .* between 0 and 1"):
            EKF(gate=gate)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="gates of its own"):
        EKF(gate=0.99, associate=Nearest(0.99))


def test_an_update_ends_at_the_optimum_of_its_step() -> None:
    """Landmarks charted to 4 m, 20 m away, and a bearing of 0.2 deg: one linearization is many sigma off."""
    rng = np.random.default_rng(4)
    L = np.array([[20.0, 5.0], [-3.0, 18.0], [5.0, -20.0]])
    chart = L + 4.0 * rng.normal(size=L.shape)
    seen = np.stack([np.arctan2(L[:, 1], L[:, 0]), np.hypot(*L.T)], axis=1)
    graph = FactorGraph(
        [
            Prior(x[0], [0.5, -0.4, 0.001], Diagonal([1.0, 1.0, 1e-3])),  # hardly turned: no matter by which chart
            BearingRange(x[0], l[0:3], seen, Diagonal(bearing=np.radians(0.2), range=0.2)),
            Prior(l[0:3], chart, Isotropic(4.0)),
        ]
    )
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


def test_iterations_that_are_none() -> None:
    assert EKF("independent", iterations=10).method == "EKF (independent, 10 iterations)"
    for given, first in ((0, False), (2.0, False), (True, False), (2, True)):
        with pytest.raises(OptionError, match=r"iterations: .* whole number of at least 1; 1 with first_estimates"):
            EKF(first_estimates=first, iterations=given)  # type: ignore[arg-type]


(x,) = kinds("x")


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
