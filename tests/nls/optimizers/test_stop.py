"""The threshold that is given is the one that stops; the default goes on, damped, where Gauss-Newton fails."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls
from factors import Between, Cauchy, Huber, Information, Isotropic, Noise, Robust
from models import SE2, SE3
from nls import (
    Dogleg,
    FactorGraph,
    GaussNewton,
    Iteration,
    LevenbergMarquardt,
    Optimizer,
    Status,
    Stop,
    Values,
    gauss_newton_step,
)
from nls.cli import main
from nls.linear import LU, PCG, LinearSolver
from nls.optimizers import OPTIMIZERS, Automatic, stop
from tests.nls.graphs import circle, p, pose_graph, scalar, x

ALL = pytest.mark.parametrize("name", OPTIMIZERS)


# ---- thresholds in force


def test_a_threshold_that_is_given_is_the_only_one_in_force() -> None:
    for chi2, dof, least in ((400.0, 100, 100.0), (25.0, 100, 25.0), (400.0, -3, 1.0)):  # sigmas too small; a few dof
        assert Stop().sigmas(chi2, dof) == Stop(max_iterations=3).sigmas(chi2, dof) == pytest.approx(1e-3 * least**0.5)
        assert Stop(update_sigmas=0.1).sigmas(chi2, dof) == pytest.approx(0.1 * least**0.5)
        assert Stop(chi2_rtol=1e-2).sigmas(chi2, dof) == pytest.approx(0.1 * chi2**0.5)
        assert Stop(update_tol=1e-3).sigmas(chi2, dof) == Stop(update_sigmas=0.0).sigmas(chi2, dof) == 0.0


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
def test_the_update_in_sigmas(name: str) -> None:
    sample = pose_graph(SE2, n=40, seed=2, start=0.1)
    for stop_at in (Stop(), Stop(update_sigmas=1e-5), Stop(chi2_rtol=1e-3)):
        result = sample.graph.optimize(sample.values, OPTIMIZERS[name](stop_at))
        *_, before, last = result.history
        most = stop_at.sigmas(before.chi2, result.dof)
        assert (result.converged, result.rule, last.sigmas <= most) == (True, "update_sigmas", True), result.reason
        assert before.sigmas > most or before.sigmas**2 > most * (result.history[-3].sigmas - before.sigmas)
        system = sample.graph.linearize(result.values)
        assert np.linalg.norm(system.times(gauss_newton_step(system))) < most  # 8 sigmas, 1e-5 of it
    graph, start = circle()  # a threshold out of reach ends where chi2 has no digits left
    for out_of_reach in (Stop(update_tol=1e-300), Stop(chi2_rtol=1e-300), Stop(update_sigmas=1e-300)):
        result = graph.optimize(start, OPTIMIZERS[name](out_of_reach))
        assert (result.converged, result.rule in ("rounding", "refused_small")) == (True, True), result.reason
        assert "noise floor of 16 digits" in result.reason
        assert result.history[-1].update < 1e-6


LEFT: dict[str, tuple[Noise | None, LinearSolver]] = {
    "gaussian": (None, LU()),
    "huber": (Robust(Isotropic(0.05), Huber(1.0)), LU()),
    "cauchy": (Robust(Isotropic(0.05), Cauchy(1.0)), LU()),
    "inexact": (None, PCG()),
}


@pytest.mark.parametrize("case", LEFT)
@pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg", None])
def test_what_is_left_of_chi2_is_below_the_threshold(name: str | None, case: str) -> None:
    """Also under kernels, which converge linearly, and where a linear solver stops early."""
    noise, solver = LEFT[case]
    sample = pose_graph(SE2, n=40, seed=4, start=0.1)
    graph = FactorGraph(sample.graph.factors)
    if noise:  # closures that are ten sigmas off
        i, j = [0, 5, 9], [30, 21, 39]
        z = SE2.between(sample.truth[x][i], sample.truth[x][j]) + np.array([0.5, -0.5, 0.2])
        graph.add(Between(x[i], x[j], z, noise))
    optimizer = OPTIMIZERS[name]() if name else None
    result = graph.optimize(sample.values, optimizer, solver)
    lowest = graph.optimize(result.values, LevenbergMarquardt(Stop(1e-9, max_iterations=500))).chi2_final
    assert (result.converged, result.rule in ("update_sigmas", "refused_small")) == (True, True), result.reason
    assert 0 <= result.chi2_final - lowest + 1e-9 <= 2 * Stop().sigmas(lowest, result.dof) ** 2


@ALL
@pytest.mark.parametrize("at", [1e4, 1e6])
@pytest.mark.parametrize("off", [1e-4, 0.0])
def test_a_start_that_is_far_off_makes_no_fit_exact(name: str, at: float, off: float) -> None:
    """chi2 falls by 30 digits, and what is left is still far; the control, without `off`, fits."""
    graph, start = scalar(lambda X: 1e3 * np.concatenate([X**2 - 9, X**3 - 27 - off], axis=1), at, dim=2)
    result = graph.optimize(start, OPTIMIZERS[name](Stop(max_iterations=500)))
    assert result.converged or (at == 1e6 and name != "gauss-newton")  # there lambda never lets go
    assert not result.converged or result.values[p[0]][0] == pytest.approx(3.0 + 27 / 765 * off, abs=1e-7)
    assert (result.rule == "exact_fit") == (off == 0.0 and result.converged)


@ALL
def test_an_exact_fit_is_named(name: str) -> None:
    """As many measurements as unknowns, fewer, or without noise: A dx is as long as b to the end."""
    for residual, dim in ((lambda X: X**3 - 8.0, 1), (lambda X: np.concatenate([X**3 - 8.0, X - 2.0], axis=1), 2)):
        graph, start = scalar(residual, 5.0, dim=dim)
        result = graph.optimize(start, OPTIMIZERS[name]())
        assert (result.converged, result.dof) == (True, dim - 1)
        assert dim == 2 or result.rule in ("exact_fit", "rounding", "refused_small")
        assert result.values[p[0]][0] == pytest.approx(2.0, abs=1e-8)


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


@pytest.mark.parametrize(
    ("options", "rules"),
    [
        (["--update-sigmas", "1e-4"], ("update_sigmas",)),
        (["--update-tol", "1e-12"], ("update_norm", "rounding")),
        (["--chi2-rtol", "1e-2"], ("update_sigmas",)),
        (["--update-tol", "1e-30", "--chi2-rtol", "1e-6"], ("update_sigmas",)),
    ],
)
def test_the_command_line_gives_thresholds(options: list[str], rules: tuple[str, ...], tmp_path: Path) -> None:
    sample = pose_graph(SE2, n=30, seed=3, anchored=False, start=0.1)
    file, report = tmp_path / "in.g2o", tmp_path / "report.json"
    nls.save(file, sample.graph, sample.values)
    words = ["--init", "file", "--method", "gauss-newton", "--json", str(report), *options]
    assert main(["solve", str(file), *words]) == 0
    assert json.loads(report.read_text())["rule"] in rules


# ---- the optimizer of those who name none


D, C = Status.DIVERGED, Status.CYCLING
# Residual, derivative, start, minimum, and how undamped steps end: named, and by default.
FAILING: dict[str, tuple[Any, Any, float, float, Status | None, Status]] = {
    "grows": (lambda X: X / (1 + X**2) ** 0.375, (lambda X: (1 + 0.25 * X**2) / (1 + X**2) ** 1.375), 5.0, 0.0, D, C),
    "swings": (lambda X: np.sign(X) * np.abs(X) ** 0.5, lambda X: 0.5 * np.abs(X) ** -0.5, 0.7, 0.0, C, C),
    "wall": (lambda X: np.log(np.where(X > 0, X, np.nan)) + 3.0, lambda X: 1 / X, 1.0, np.exp(-3.0), D, D),
    "singular": (np.arctan, lambda X: 1 / (1 + X**2), 2.0, 0.0, None, C),
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
    enough = graph.optimize(start, Automatic(callback=lambda record: numbers.append(record.number)))
    assert enough.converged
    assert numbers == list(range(1, enough.iterations + 1))
    for limit in range(0, min(enough.iterations, 15), 2):
        result = graph.optimize(start, Automatic(Stop(max_iterations=limit)))
        assert not result.converged
        assert result.iterations <= limit
        assert result.chi2_final <= result.chi2_initial


def test_who_names_a_method_gets_it() -> None:
    graph, start = failing("grows")
    for optimizer in (GaussNewton(), LevenbergMarquardt(), Dogleg()):
        result = graph.optimize(start, optimizer)
        assert (result.method, result.attempts) == (optimizer.name, ())


SLOW = {"creeps": -1.0, "swings": 1.0}  # sign s of 1 + s 0.485 p^2: an undamped step leaves 0.97 of p, turned or not


def slow(case: str) -> tuple[FactorGraph, Values]:
    s = 0.485 * SLOW[case]
    return scalar(lambda X: np.concatenate([X, 1 + s * X**2], axis=1), 0.9, dim=2)


@pytest.mark.parametrize("case", SLOW)
def test_the_default_goes_on_where_gauss_newton_is_slow_and_no_limit_is_given(case: str) -> None:
    graph, start = slow(case)
    named = graph.optimize(start, GaussNewton())
    assert (named.status, named.iterations) == (Status.MAX_ITERATIONS, 100)
    result = graph.optimize(start)
    assert (result.status, result.method) == (Status.CONVERGED, "gauss-newton, then dogleg")
    assert result.chi2_final == pytest.approx(1.0, rel=1e-5)
    (attempt,) = result.attempts
    if case == "swings":  # each step undoes the one before it
        assert (attempt.status, attempt.iterations) == (Status.CYCLING, 6)
        assert "sigmas undo each other" in attempt.reason
        assert result.iterations < 20
        return
    assert attempt == ("gauss-newton", Status.MAX_ITERATIONS, "after 100 iterations", 100)
    assert "gauss-newton ended as MAX_ITERATIONS after 100 iterations; dogleg continued" in str(result)
    for limit in (100, 101):
        limited = graph.optimize(start, Automatic(Stop(max_iterations=limit)))
        assert (limited.status, limited.iterations, limited.attempts) == (Status.MAX_ITERATIONS, limit, ())
    halted = graph.optimize(start, Automatic(callback=lambda record: record.number == 100))
    assert (halted.iterations, halted.attempts) == (100, ())


def test_the_damped_default_is_as_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, start = slow("creeps")
    monkeypatch.setattr(graph.factors[0], "damped", True)
    assert graph.optimize(start, LevenbergMarquardt()).iterations == 100
    result = graph.optimize(start)
    assert (result.method, result.converged) == ("levenberg-marquardt", True)
    assert 100 < result.iterations < 1000


def test_a_refused_step_along_a_plateau_is_no_arrival() -> None:
    watch = SimpleNamespace(level_steps=6, history=[Iteration(7, 50.0, 0.1)])
    watch.stop = Stop()
    step: Any = SimpleNamespace(watch=watch, sigmas=4e-3, tolerance=7e-3, agreed=True, invisible=True)
    for watch.level_steps, status in ((6, Status.DIVERGED), (5, Status.CONVERGED)):
        verdict: Any = stop.refused_small(step)
        assert verdict.status is status
