"""Every stop rule alone: its verdict where its inequality holds, none where one part of it does not."""

from __future__ import annotations

import math
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nls import Iteration, Status, Stop
from nls.optimizers import automatic, stop

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
        "updates": [np.array([1.0, 0.0]), np.array([-1.1, 0.0]), np.array([1.0, 0.1])],
        "chi2_initial": 100.0,
        "dof": 10,
        "reason": "small",
        "scaled": lambda system: np.ones(2),
    }
    system: dict[str, Any] = {"chi2": 50.0, "column_norms": np.ones(2), "column": lambda index: ("p0", "xy"[index])}
    system |= {"scaled_gradient": 0.5, "times": lambda dx: 8.0 * dx}
    step: dict[str, Any] = {
        "old": Iteration(0, 100.0, 1.0, 30.0),
        "sigmas": 8.0,
        "sigmas_to_come": 0.0,
        "tolerance": 0.01,
        "chi2": 50.0,
        "fall": 50.0,
        "update": 0.1,
        "largest": "0.1 m (x of p0)",
        "promised": 60.0,
        "undamped": None,
        "words": "to chi2 51",
        "rounds": lambda change: change <= 1e-12,
    }
    step |= {"still": False, "near": True, "ending": False, "agreed": True, "short": True}
    step |= {"shorter": True, "longer": False, "invisible": False, "leaves": False}
    assert set(changes) <= {*watch, *system, *step}
    for group in (watch, system, step):
        group |= {key: value for key, value in changes.items() if key in group}
    step_count = watch["history"][-1].number
    watched = SimpleNamespace(**watch, step_count=step_count)
    return SimpleNamespace(watch=watched, system=SimpleNamespace(**system), **step)


def swings(n: int) -> list[Iteration]:
    return [Iteration(k, 50.0 + k % 2) for k in range(n + 1)]


RULES: dict[stop.Rule, tuple[Status, dict[str, Any], list[dict[str, Any]]]] = {
    stop.unknown_lost: (Status.DIVERGED, {"column_norms": np.array([1.0, 0.0])}, [{"scaled": lambda s: np.zeros(2)}]),
    stop.rounding: (
        Status.CONVERGED,
        {"invisible": True, "longer": True, "tolerance": 0.0},
        [{"invisible": False}, {"longer": False}, {"agreed": False}, {"sigmas_to_come": 1.0}],
    ),
    stop.exact_fit: (
        Status.CONVERGED,
        {"chi2": 9e-6, "chi2_initial": 1e19},
        [{"chi2_initial": 8e18}, {"chi2": 1.1e-5, "chi2_initial": 1e30}, {"short": False}],
    ),
    stop.chi2_unbounded: (Status.DIVERGED, {"chi2": 1e14}, [{"chi2": 0.9e14}]),
    stop.update_sigmas: (
        Status.CONVERGED,
        {"ending": True, "fall": 1e-5},
        [{"ending": False}, {"fall": -1e-9}, {"shorter": False}, {"agreed": False}],
    ),
    stop.promise_missed: (
        Status.STALLED,
        {"still": True, "promised": 60.0, "fall": 5.9},
        [{"still": False}, {"fall": 6.0}, {"invisible": True}, {"undamped": object()}],
    ),
    stop.update_norm: (
        Status.CONVERGED,
        {"still": True, "stop": Stop(update_tol=1.0)},
        [{"still": False}, {"near": False}],
    ),
    stop.plateau: (Status.DIVERGED, {"level_steps": 6}, [{"level_steps": 5}]),
    stop.cycle: (
        Status.CYCLING,
        {"since_best": 10, "history": swings(20), "chi2": 50.0},
        [{"since_best": 9}, {"chi2": 50.5}, {"invisible": True}],
    ),
    stop.iteration_limit: (Status.MAX_ITERATIONS, {"history": swings(100)}, [{"history": swings(99)}]),
    stop.time_limit: (Status.MAX_TIME, {"stop": Stop(max_seconds=0.0)}, [{"stop": Stop(max_seconds=1e6)}]),
    stop.level_refused: (
        Status.DIVERGED,
        {"fall": 1e-13, "leaves": True},
        [{"fall": -1e-3}, {"fall": -math.inf}, {"leaves": False}],
    ),
    stop.refused_small: (Status.CONVERGED, {"sigmas": 0.01}, [{"sigmas": 0.02}, {"agreed": False}]),
    stop.no_rise: (Status.DIVERGED, {"fall": 0.0}, [{"fall": -1e-3}]),
    stop.stationary: (Status.CONVERGED, {"scaled_gradient": 1e-6}, [{"scaled_gradient": 1.1e-6}]),
    stop.every_step_refused: (Status.STALLED, {}, []),
    stop.pulled: (
        Status.STALLED,
        {"scaled_gradient": 1.0},
        [{"scaled_gradient": 0.7}, {"tolerance": 3.0}],
    ),
    automatic.chi2_rises: (
        Status.DIVERGED,
        {"chi2": 1e6, "old": Iteration(1, 1e6, 1.0)},
        [{"chi2": 0.9e6}, {"old": Iteration(1, 0.9e6, 1.0)}, {"rounds": lambda change: True}],
    ),
    automatic.turns_back: (
        Status.CYCLING,
        {"old": Iteration(0, 100.0, 1.0, 9.0), "history": [Iteration(0, 50.0), Iteration(1, 50.0, 0.1)]},
        [
            {"history": [Iteration(0, 51.0), Iteration(1, 50.0, 0.1)]},
            {"old": Iteration(0, 100.0, 1.0, 11.0)},
            {"times": lambda dx: 12.0 * dx},
            {"updates": []},
            {"invisible": True},
        ],
    ),
    automatic.no_new_best: (Status.CYCLING, {"since_best": 10}, [{"since_best": 9}, {"invisible": True}]),
}


def test_every_rule_is_here() -> None:
    asked = {*stop.BEFORE_A_STEP, *stop.AFTER_A_STEP, *stop.AT_THE_END, *stop.AFTER_A_REFUSAL, *stop.NO_STEP_LEFT}
    assert asked | {automatic.chi2_rises, automatic.turns_back, automatic.no_new_best} == set(RULES)
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
