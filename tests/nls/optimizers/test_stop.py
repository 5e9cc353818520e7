"""Every stop rule by its inequality, on both sides of it; and that a threshold which is given is the one that stops."""

from __future__ import annotations

import json
import math
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls
from factors import Between, Factor, Information, Isotropic, Prior
from models import SE2, SE3, R
from nls import Dogleg, FactorGraph, GaussNewton, Iteration, LevenbergMarquardt, Optimizer, Status, Stop, Values
from nls.cli import main
from nls.optimizers import OPTIMIZERS, automatic, stop
from nls.optimizers.step import Thresholds
from tests.nls.graphs import circle, p, pose_graph, scalar

ALL = pytest.mark.parametrize("name", OPTIMIZERS)


# ---- one rule at a time: the verdict where its inequality holds, none where one part of it does not


def looked(**changes: Any) -> Any:
    """A step to which no rule applies: chi2 fell from 100 to 50; dx is shorter than before, and short."""
    watch: dict[str, Any] = {
        "history": [Iteration(0, 100.0), Iteration(1, 50.0, 0.1)],
        "lowest": 50.0,
        "since_best": 0,
        "level_steps": 0,
        "began": perf_counter(),
        "stop": Stop(),
        "limit": 100,
        "reason": "small",
        "scaled": lambda system: np.ones(2),
    }
    system: dict[str, Any] = {"chi2": 50.0, "column_norms": np.ones(2), "column": lambda index: ("p0", "xy"[index])}
    step: dict[str, Any] = {
        "old": Iteration(0, 100.0, 1.0),
        "tol": Thresholds(),
        "chi2": 50.0,
        "fall": 50.0,
        "update": 0.1,
        "largest": "0.1 m (x of p0)",
        "promised": 60.0,
        "undamped": None,
        "words": "to chi2 51",
        "slope": 0.5,
        "rounds": lambda change: change <= 1e-12,
    }
    step |= {"still": False, "missed": False, "near": True, "ending": False, "agreed": True, "short": True}
    step |= {"shorter": True, "longer": False, "invisible": False, "leaves": False}
    assert set(changes) <= {*watch, *system, *step}
    for group in (watch, system, step):
        group |= {key: value for key, value in changes.items() if key in group}
    step_count = watch["history"][-1].number
    watched = SimpleNamespace(**watch, step_count=step_count)
    return SimpleNamespace(watch=watched, system=SimpleNamespace(**system), **step)


def swings(n: int) -> list[Iteration]:
    return [Iteration(k, 50.0 + k % 2) for k in range(n + 1)]


OFF = Thresholds(0.0, 0.0, 0.0)
RULES: dict[stop.Rule, tuple[Status, dict[str, Any], list[dict[str, Any]]]] = {
    stop.unknown_lost: (Status.DIVERGED, {"column_norms": np.array([1.0, 0.0])}, [{"scaled": lambda s: np.zeros(2)}]),
    stop.zero: (Status.CONVERGED, {"slope": 0.0}, [{"slope": 1e-300}, {"short": False}]),
    stop.scaled_gradient: (
        Status.CONVERGED,
        {"slope": 1e-10},
        [{"slope": 1.1e-10}, {"short": False}, {"tol": Thresholds(1.0, 1.0, 0.0)}],
    ),
    stop.chi2_unbounded: (Status.DIVERGED, {"chi2": 1e14}, [{"chi2": 0.9e14}]),
    stop.promise_missed: (Status.STALLED, {"still": True, "missed": True}, [{"still": False}, {"missed": False}]),
    stop.update_norm: (Status.CONVERGED, {"still": True}, [{"still": False}, {"near": False}]),
    stop.relative_decrease: (
        Status.CONVERGED,
        {"ending": True, "fall": 1e-5},
        [{"ending": False}, {"shorter": False}, {"agreed": False}, {"tol": OFF}],
    ),
    stop.noise_floor: (
        Status.CONVERGED,
        {"longer": True, "invisible": True},
        [{"longer": False}, {"invisible": False}, {"short": False}, {"undamped": object()}],
    ),
    stop.plateau: (Status.DIVERGED, {"level_steps": 6}, [{"level_steps": 5}]),
    stop.cycle: (
        Status.CYCLING,
        {"since_best": 10, "history": swings(20), "chi2": 50.0},
        [{"since_best": 9}, {"chi2": 50.5}, {"invisible": True}],
    ),
    stop.up_and_down: (
        Status.CYCLING,
        {"since_best": 100, "history": swings(100)},
        [{"since_best": 39}, {"history": swings(99)}, {"history": [Iteration(k, 50.0 + k) for k in range(101)]}],
    ),
    stop.iteration_limit: (Status.MAX_ITERATIONS, {"history": swings(100)}, [{"history": swings(99)}]),
    stop.time_limit: (Status.MAX_TIME, {"stop": Stop(max_seconds=0.0)}, [{"stop": Stop(max_seconds=1e6)}]),
    stop.level_refused: (
        Status.DIVERGED,
        {"fall": 1e-13, "leaves": True},
        [{"fall": -1e-3}, {"fall": -math.inf}, {"leaves": False}],
    ),
    stop.promise_small: (
        Status.CONVERGED,
        {"promised": 4e-5},
        [{"promised": 6e-5}, {"agreed": False}, {"tol": OFF}],
    ),
    stop.promise_invisible: (Status.CONVERGED, {"invisible": True}, [{"invisible": False}, {"agreed": False}]),
    stop.no_rise: (Status.DIVERGED, {"fall": 0.0}, [{"fall": -1e-3}]),
    stop.stationary: (Status.CONVERGED, {"slope": 1e-6}, [{"slope": 1.1e-6}]),
    stop.every_step_refused: (Status.STALLED, {}, []),
    stop.pulled: (
        Status.STALLED,
        {"slope": 1.0},
        [{"slope": 0.7}, {"slope": 3e-3, "chi2": 1e8}],
    ),
    automatic.chi2_rises: (
        Status.DIVERGED,
        {"chi2": 1e6, "old": Iteration(1, 1e6, 1.0)},
        [{"chi2": 0.9e6}, {"old": Iteration(1, 0.9e6, 1.0)}, {"rounds": lambda change: True}],
    ),
    automatic.no_new_best: (Status.CYCLING, {"since_best": 10}, [{"since_best": 9}, {"invisible": True}]),
}


def test_every_rule_is_here() -> None:
    asked = {*stop.BEFORE_A_STEP, *stop.AFTER_A_STEP, *stop.AT_THE_END, *stop.AFTER_A_REFUSAL, *stop.NO_STEP_LEFT}
    assert asked | {automatic.chi2_rises, automatic.no_new_best} == set(RULES)
    assert all(rule.__doc__ for rule in RULES)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_a_rule_and_its_inequality(rule: stop.Rule) -> None:
    status, holds, fails = RULES[rule]
    verdict = rule(looked(**holds))
    assert verdict is not None
    assert verdict.status is status
    assert verdict.reason
    for change in fails:
        assert rule(looked(**(holds | change))) is None, change


def test_a_long_step_that_chi2_cannot_show_is_a_plateau() -> None:
    assert stop.plateau(looked(invisible=True, short=False, leaves=True)) is not None
    assert stop.plateau(looked(invisible=True)) is None
    assert stop.zero(looked(chi2=0.0, short=False)) is not None
    for rule, holds in ((stop.promise_small, {"promised": 4e-5}), (stop.promise_invisible, {"invisible": True})):
        verdict = rule(looked(**holds, level_steps=6))  # type: ignore[arg-type]
        assert verdict is not None
        assert verdict.status is Status.DIVERGED


def test_converged_only_at_the_best_point_and_with_every_unknown() -> None:
    at_the_best = looked(still=True)
    verdict = stop.ask([stop.cycle, stop.update_norm], at_the_best)
    assert verdict == stop.Verdict(Status.CONVERGED, "max|dx| 0.1 m (x of p0), below 1e-06 (update_tol)", "update_norm")
    above = stop.ask([stop.update_norm], looked(still=True, lowest=49.0))
    assert above is not None
    assert (above.status, above.rule) == (Status.STALLED, "above_the_best")
    lost = stop.ask([stop.update_norm], looked(still=True, column_norms=np.array([0.0, 1.0])))
    assert lost is not None
    assert (lost.status, lost.rule) == (Status.DIVERGED, "unknown_lost")
    assert stop.ask([stop.cycle], at_the_best) is None


# ---- thresholds in force


def test_a_threshold_that_is_given_is_the_only_one_in_force() -> None:
    assert Stop().in_force == Stop(max_iterations=3).in_force == Thresholds(1e-6, 1e-6, 1e-10)
    assert Stop(update_tol=1e-3).in_force == Thresholds(1e-3, 0.0, 0.0)
    assert Stop(chi2_rtol=1e-3).in_force == Thresholds(0.0, 1e-3, 0.0)
    assert Stop(gradient_tol=1e-3, update_tol=0.0).in_force == Thresholds(0.0, 0.0, 1e-3)


@ALL
def test_the_update_norm_alone(name: str) -> None:
    for group, update_tol in ((SE2, 1e-2), (SE3, 1e-4), (SE2, 1e-6), (SE3, 1e-12)):
        sample = pose_graph(group, n=40, seed=1, start=0.1)
        result = sample.graph.optimize(sample.values, OPTIMIZERS[name](Stop(update_tol=update_tol)))
        assert result.converged
        updates = [record.update for record in result.history[1:]]
        assert all(update >= update_tol for update in updates[:-1])
        if result.rule == "update_norm":
            assert updates[-1] < update_tol
            assert f"below {update_tol:g} (update_tol)" in str(result)
        else:
            assert update_tol <= 1e-6
            assert "noise floor of 16 digits" in str(result)
        assert f"max|dx| {updates[-1]:.1e} " in str(result)
        assert result.last_update.split(" (")[0].endswith((" m", " rad"))


@ALL
def test_the_relative_decrease_alone_and_the_gradient_alone(name: str) -> None:
    sample = pose_graph(SE2, n=40, seed=2, start=0.1)
    by_fall = sample.graph.optimize(sample.values, OPTIMIZERS[name](Stop(chi2_rtol=1e-3)))
    assert by_fall.converged
    assert by_fall.rule in ("relative_decrease", "promise_small")
    by_gradient = sample.graph.optimize(sample.values, OPTIMIZERS[name](Stop(gradient_tol=1e-7)))
    assert (by_gradient.converged, by_gradient.rule) == (True, "scaled_gradient")
    assert "below 1e-07 (gradient_tol)" in by_gradient.reason
    graph, start = circle()  # a threshold out of reach ends at the noise floor
    result = graph.optimize(start, OPTIMIZERS[name](Stop(update_tol=1e-300)))
    assert result.converged
    assert result.rule in ("noise_floor", "promise_invisible", "zero"), result.rule
    assert result.history[-1].update < 1e-6


@pytest.mark.parametrize("optimizer", [None, GaussNewton(), LevenbergMarquardt(), Dogleg()])
def test_rounding_of_large_measurements_is_no_rise_of_chi2(optimizer: Optimizer | None) -> None:
    """Angles of 90 rad, degrees taken for radians: errors of a perfect fit are 90 times the rounding of a radian."""
    x = nls.Kind("x")
    for k in range(0, 20, 4):
        z = [[1.0, 0.0, 90.0 + k]] * 2
        graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], z, Information(np.diag([100.0, 100.0, 400.0])))])
        start = nls.initialize(graph, Values({x: (SE2, np.zeros((3, 3)))}), "odometry")[0]
        result = graph.optimize(start, optimizer)
        assert result.converged, result.reason
        assert result.chi2_final < 1e-20


def test_the_command_line_gives_thresholds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sample = pose_graph(SE2, n=30, seed=3, anchored=False, start=0.1)
    file, report = tmp_path / "in.g2o", tmp_path / "report.json"
    nls.save(file, sample.graph, sample.values)

    def solved(*options: str) -> dict[str, Any]:
        arguments = ["solve", str(file), "--init", "file", "--method", "gauss-newton", "--json", str(report), *options]
        assert main(arguments) == 0
        return dict(json.loads(report.read_text()))

    default, by_update, by_fall = solved(), solved("--update-tol", "1e-12"), solved("--chi2-rtol", "1e-2")
    shown = capsys.readouterr().out
    assert by_update["rule"] in ("update_norm", "noise_floor")
    assert by_fall["rule"] == "relative_decrease"
    assert by_update["iterations"] > default["iterations"] >= by_fall["iterations"]
    assert "below 0.01 (chi2_rtol); last max|dx| " in shown
    assert default["attempts"] == []
    both = solved("--update-tol", "1e-30", "--chi2-rtol", "1e-6")
    assert both["rule"] == "relative_decrease"


# ---- the optimizer of those who name none


D, C = Status.DIVERGED, Status.CYCLING
FAILING: dict[
    str, tuple[Any, Any, float, float, Status | None, Status]
] = {  # residual, derivative, start, minimum, and how undamped steps end: named, and by default
    "grows": (lambda X: X / (1 + X**2) ** 0.375, (lambda X: (1 + 0.25 * X**2) / (1 + X**2) ** 1.375), 5.0, 0.0, D, C),
    "swings": (lambda X: np.sign(X) * np.abs(X) ** 0.5, lambda X: 0.5 * np.abs(X) ** -0.5, 0.7, 0.0, C, C),
    "wall": (lambda X: np.log(np.where(X > 0, X, np.nan)) + 3.0, lambda X: 1 / X, 1.0, np.exp(-3.0), D, D),
    "singular": (np.arctan, lambda X: 1 / (1 + X**2), 2.0, 0.0, None, D),
}


def failing(case: str) -> tuple[FactorGraph, Values]:
    residual, derivative, at, *_ = FAILING[case]
    return scalar(residual, at, lambda X: derivative(X)[..., None])


@pytest.mark.parametrize("case", FAILING)
def test_the_default_continues_damped_where_gauss_newton_fails(case: str) -> None:
    *_, minimum, named, status = FAILING[case]
    graph, start = failing(case)
    if named is None:
        with pytest.raises(nls.UnderconstrainedError):
            graph.optimize(start, GaussNewton())
    else:
        assert graph.optimize(start, GaussNewton()).status is named
    result = graph.optimize(start)
    assert (result.status, result.method) == (Status.CONVERGED, "gauss-newton, then dogleg")
    assert result.values[p[0]][0] == pytest.approx(minimum, abs=1e-6)
    (attempt,) = result.attempts
    assert (attempt.method, attempt.status) == ("gauss-newton", status)
    assert attempt.iterations < result.iterations
    assert [record.number for record in result.history] == list(range(result.iterations + 1))
    assert f"gauss-newton ended as {status.name} after {attempt.iterations} iterations: " in str(result)
    assert "dogleg continued from the lowest point" in str(result)


@pytest.mark.parametrize("case", ["grows", "swings", "wall"])  # a singular system is refused until a minimum is found
def test_callback_and_limits_are_those_of_both_methods(case: str) -> None:
    graph, start = failing(case)
    numbers: list[int] = []
    enough = graph.optimize(start, automatic.Automatic(callback=lambda record: numbers.append(record.number)))
    assert enough.converged
    assert numbers == list(range(1, enough.iterations + 1))
    for limit in range(0, min(enough.iterations, 15), 2):
        result = graph.optimize(start, automatic.Automatic(Stop(max_iterations=limit)))
        assert not result.converged
        assert result.iterations <= limit
        assert result.chi2_final <= result.chi2_initial


def test_who_names_a_method_gets_it_and_the_default_refuses_what_is_free() -> None:
    graph, start = failing("grows")
    for optimizer in (GaussNewton(), GaussNewton(reuse=True), LevenbergMarquardt(), Dogleg()):
        result = graph.optimize(start, optimizer)
        assert (result.method, result.attempts) == (optimizer.name, ())
    graph = FactorGraph([Prior(p[0], [1.0, 0.0], Isotropic(0.1), components=["x"])])
    with pytest.raises(nls.UnderconstrainedError, match="p0: y"):
        graph.optimize(Values({p: (R(2), [[0.0, 0.0]])}))


SLOW = {"creeps": -1.0, "swings": 1.0}  # sign s of 1 + s 0.485 p^2: an undamped step leaves 0.97 of p, turned or not


def slow(case: str) -> tuple[FactorGraph, Values]:
    s = 0.485 * SLOW[case]
    f = Factor.from_function(lambda X: np.concatenate([X, 1 + s * X**2], axis=1), p[0], dim=2)
    return FactorGraph([f]), Values({p: (R(1), [0.9])})


@pytest.mark.parametrize("case", SLOW)
def test_the_default_goes_on_where_gauss_newton_is_slow_and_no_limit_is_given(case: str) -> None:
    graph, start = slow(case)
    named = graph.optimize(start, GaussNewton())
    assert (named.status, named.iterations) == (Status.MAX_ITERATIONS, 100)
    result = graph.optimize(start)
    assert (result.status, result.method) == (Status.CONVERGED, "gauss-newton, then dogleg")
    assert result.chi2_final == pytest.approx(1.0, rel=1e-5)
    (attempt,) = result.attempts
    assert attempt == ("gauss-newton", Status.MAX_ITERATIONS, "after 100 iterations", 100)
    assert "gauss-newton ended as MAX_ITERATIONS after 100 iterations; dogleg continued" in str(result)
    for limit in (100, 101):
        limited = graph.optimize(start, automatic.Automatic(Stop(max_iterations=limit)))
        assert (limited.status, limited.iterations, limited.attempts) == (Status.MAX_ITERATIONS, limit, ())
    halted = graph.optimize(start, automatic.Automatic(callback=lambda record: record.number == 100))
    assert (halted.iterations, halted.attempts) == (100, ())


def test_the_damped_default_is_as_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, start = slow("creeps")
    monkeypatch.setattr(graph.factors[0], "damped", True)
    assert graph.optimize(start, LevenbergMarquardt()).iterations == 100
    result = graph.optimize(start)
    assert (result.method, result.converged) == ("levenberg-marquardt", True)
    assert 100 < result.iterations < 1000
