"""What the EKF refuses, by the name of the step and of the variable, with what to do instead."""

from __future__ import annotations

import numpy as np
import pytest

from factors import (
    BearingRange,
    Between,
    Factor,
    Heading,
    Huber,
    Information,
    Isotropic,
    Landmark,
    Prior,
    Range,
)
from models import SE2, R
from models.errors import GraphError, LeadlineError, OptionError, UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.filters.base import Step
from nls.filters.ekf import EKF

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


def test_without_landmarks_it_is_dead_reckoning() -> None:
    ekf = run(START, WALK, count=0)
    keys, L, P = ekf.landmarks
    assert (len(keys), L.shape, P.shape) == (0, (0, 2), (0, 2, 2))
    assert np.allclose(ekf.pose[0], [2.0, 0.0, 0.0])
    assert np.sqrt(ekf.pose[1][0, 0]) == pytest.approx(0.1 * 3**0.5)


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
