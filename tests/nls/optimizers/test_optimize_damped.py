"""What holds for every optimizer: each status is reached, nothing gets worse, nothing of the caller's is touched."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nls
from factors import Between, Factor, Huber, Isotropic, Prior
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.errors import OptionError, UnderconstrainedError
from nls import FactorGraph, GaussNewton, Iteration, LevenbergMarquardt, Status, Stop, Values
from nls.optimizers import OPTIMIZERS
from tests.nls.graphs import GROUPS, SAMPLES, Sample, circle, distance, never_worse, p, pose_graph, scalar, walk, x

ALL = pytest.mark.parametrize("name", OPTIMIZERS)
DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])
NEVER = Stop(update_tol=0.0, chi2_rtol=0.0, gradient_tol=0.0)


# ---- the same optimum as Gauss-Newton


@DAMPED
@pytest.mark.parametrize("sample", SAMPLES)
def test_the_optimum_of_gauss_newton(name: str, sample: str) -> None:
    tight = Stop(update_tol=1e-9, chi2_rtol=1e-12)
    made = SAMPLES[sample]()
    expected = made.graph.optimize(made.values, OPTIMIZERS["gauss-newton"](tight))
    result = made.graph.optimize(made.values, OPTIMIZERS[name](tight))
    assert result.converged
    assert expected.converged
    assert (result.method, result.underconstrained, result.dof) == (name, (), expected.dof)
    assert result.chi2_final == pytest.approx(expected.chi2_final, rel=1e-9)
    for kind in {key.kind for key in made.values}:
        stack = expected.values.stack(kind)
        assert np.abs(stack.manifold.local(stack.X, result.values.stack(kind).X)).max() < 1e-5
    never_worse(made.graph, made.values, result)


@DAMPED
@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_noise_free_measurements_are_met(name: str, group: LieGroup) -> None:
    X = walk(group, 6, np.random.default_rng(1))
    graph = FactorGraph(
        [
            Between(x[0:5], x[1:6], group.between(X[:-1], X[1:]), Isotropic(0.1)),
            Between(x[0], x[5], group.between(X[:1], X[5:]), Isotropic(0.1)),
        ]
    )
    start = group.retract(X, 0.2 * np.random.default_rng(2).normal(size=(6, group.dim)))
    start[0] = X[0]
    result = graph.optimize(Values({x: (group, start)}), OPTIMIZERS[name]())
    assert result.converged
    assert distance(group, X, result.values[x]) < 1e-6


# ---- every status


@ALL
def test_converged_by_each_rule(name: str) -> None:
    graph, start = circle()
    optimizer = OPTIMIZERS[name]
    by_update = graph.optimize(start, optimizer(Stop(1e-3, 0.0, 0.0)))
    by_fall = graph.optimize(start, optimizer(Stop(0.0, 1e-2, 0.0)))
    by_gradient = graph.optimize(start, optimizer(Stop(0.0, 0.0, 1e-5)))
    for result, rule in (
        (by_update, "max|dx| "),
        (by_fall, "relative decrease of chi2"),
        (by_gradient, "scaled gradient"),
    ):
        assert (result.status, result.reason.startswith(rule)) == (Status.CONVERGED, True), result.reason
        assert result.values[p[0]] == pytest.approx([2.8059, 4.1378], abs=0.05)
        never_worse(graph, start, result)
    again = graph.optimize(by_gradient.values, optimizer(Stop(0.0, 0.0, 1e-5)))
    assert (again.status, again.iterations) == (Status.CONVERGED, 0)


@ALL
@pytest.mark.parametrize("limit", [0, 1, 2])
def test_the_iteration_limit(name: str, limit: int) -> None:
    graph, start = circle()
    result = graph.optimize(start, OPTIMIZERS[name](Stop(max_iterations=limit)))
    assert (result.status, result.iterations) == (Status.MAX_ITERATIONS, limit)
    assert result.reason == f"after {limit} iterations"
    never_worse(graph, start, result)


@ALL
def test_the_time_limit(name: str) -> None:
    graph, start = circle()
    result = graph.optimize(start, OPTIMIZERS[name](Stop(max_seconds=0.0)))
    assert (result.status, result.iterations <= 1) == (Status.MAX_TIME, True)
    never_worse(graph, start, result)


@DAMPED
def test_the_time_limit_while_steps_are_refused(name: str) -> None:
    def slow(X: Array) -> Array:
        time.sleep(0.005)
        return np.where(X == 1.0, 1.0, 9.0)

    graph, start = scalar(slow, 1.0, lambda X: np.ones((1, 1, 1)))
    began = time.perf_counter()
    result = graph.optimize(start, OPTIMIZERS[name](Stop(max_seconds=0.02)))
    assert (result.status, result.iterations) == (Status.MAX_TIME, 0)
    assert time.perf_counter() - began < 5


@ALL
def test_stopped_by_the_callback(name: str) -> None:
    graph, start = circle()
    seen: list[Iteration] = []

    def callback(iteration: Iteration) -> bool:
        seen.append(iteration)
        return iteration.number == 2

    result = graph.optimize(start, OPTIMIZERS[name](NEVER, callback))
    assert (result.status, result.iterations, len(seen)) == (Status.STOPPED, 2, 2)
    assert [it.chi2 for it in seen] == [it.chi2 for it in result.history[1:]]
    never_worse(graph, start, result)


@ALL
def test_interrupted_in_a_residual(name: str) -> None:
    calls = []

    def residual(X: Array) -> Array:
        calls.append(1)
        if len(calls) > 12:
            raise KeyboardInterrupt
        return np.array(X**2 - 2.0)

    graph, start = scalar(residual, 3000.0)
    result = graph.optimize(start, OPTIMIZERS[name]())
    assert (result.status, result.converged) == (Status.INTERRUPTED, False)
    assert 1 <= result.iterations < 5
    assert result.chi2_final < result.chi2_initial
    assert result.chi2_final == min(it.chi2 for it in result.history)
    assert np.array_equal(start[p], [[3000.0]])


@ALL
def test_cycling(name: str) -> None:
    """Newton's cycle 0, 1, 0, 1 is one of undamped steps; the others come to the local minimum instead."""
    graph, start = scalar(lambda X: X**3 - 2 * X + 2, 0.0, lambda X: (3 * X**2 - 2)[..., None])
    result = graph.optimize(start, OPTIMIZERS[name]())
    never_worse(graph, start, result)
    if name == "gauss-newton":
        assert result.status is Status.CYCLING
    else:  # a minimum with f = 0.91, f' = 0: a single residual without slope, found within the rounding of chi2
        assert result.values[p[0]][0] == pytest.approx(np.sqrt(2 / 3), abs=1e-4)
        assert result.status in (Status.CONVERGED, Status.STALLED)


@ALL
def test_diverged_along_a_plateau(name: str) -> None:
    graph, start = scalar(lambda X: np.concatenate([np.exp(-X), np.ones_like(X)], axis=1), 0.5, dim=2)
    result = graph.optimize(start, OPTIMIZERS[name]())
    assert result.status is Status.DIVERGED
    assert "chi2 levels off at 1 while the steps do not get shorter" in result.reason
    never_worse(graph, start, result)


# ---- Ctrl-C on the command line


@ALL
def test_a_real_interrupt_writes_the_best_point(name: str, tmp_path: Path) -> None:
    """The command is sent SIGINT while it iterates towards thresholds it can never reach."""
    sample = pose_graph(SE2, n=8, seed=4, anchored=False, start=0.3)
    source, target = tmp_path / "in.g2o", tmp_path / "out.g2o"
    nls.save(source, sample.graph, sample.values)
    limits = ["--max-iterations", "1000000000", "--update-tol", "0"]
    code = (
        "import sys, time, signal, os\n"
        "import nls.optimizers.watch as w\n"
        "from nls.cli import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a job in the background inherits none
        "old = w.Watch.step\n"
        "def step(self, *a, **k):\n"
        "    old(self, *a, **k)\n"
        "    if len(self.history) == 3:\n"
        "        os.kill(os.getpid(), signal.SIGINT); time.sleep(1)\n"
        "w.Watch.step = step\n"
        f"sys.exit(main({['solve', str(source), '-o', str(target), '--method', name, '--init', 'file', *limits]!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done.stderr
    assert "interrupted" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    graph, values, _ = nls.load(target)
    start_graph, start, _ = nls.load(source)
    assert graph.chi2(values) < start_graph.chi2(start)


# ---- never worse, nothing touched


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    noise=st.sampled_from([0.0, 0.3, 3.0]),
    group=st.sampled_from([R(2), SE2, SE3]),
    name=st.sampled_from(list(OPTIMIZERS)),
    kernel=st.sampled_from([None, Huber(1.0)]),
)
def test_never_worse(seed: int, noise: float, group: LieGroup, name: str, kernel: Huber | None) -> None:
    sample: Sample = pose_graph(group, seed=seed, start=noise)
    graph = sample.graph if kernel is None else sample.graph.robust(kernel)
    before = sample.values[x].copy()
    result = graph.optimize(sample.values, OPTIMIZERS[name]())
    never_worse(graph, sample.values, result)
    assert np.array_equal(sample.values[x], before)
    if name != "gauss-newton":
        falls = np.diff([it.chi2 for it in result.history])
        assert (falls < 0).all()  # damped methods take no step that rises


# ---- what is free


def loose(prior: bool = False) -> tuple[FactorGraph, Values]:
    """Four poses that only know of each other, in a loop that does not close."""
    sample = pose_graph(SE2, n=8, seed=3, anchored=prior)
    return sample.graph, sample.values


@DAMPED
def test_damped_methods_converge_on_a_singular_graph_and_say_what_is_free(name: str) -> None:
    graph, start = loose()
    held = graph.optimize(start)
    result = graph.optimize(start, OPTIMIZERS[name](), gauge="none")
    assert result.converged
    assert result.chi2_final == pytest.approx(held.chi2_final, rel=1e-6)
    assert len(result.underconstrained) == 3
    assert all("x" in direction for direction in result.underconstrained)
    assert "free, left where the start had them" in str(result)
    assert held.underconstrained == ()


def test_what_is_free_is_said_without_a_step() -> None:
    X = walk(SE2, 4, np.random.default_rng(0))
    i, j = np.array([0, 1, 2, 0]), np.array([1, 2, 3, 3])
    graph = FactorGraph([Between(x[i], x[j], SE2.between(X[i], X[j]), Isotropic(0.1))])
    result = graph.optimize(Values({x: (SE2, X)}), LevenbergMarquardt(Stop(gradient_tol=1.0)), gauge="none")
    assert (result.converged, result.iterations, len(result.underconstrained)) == (True, 0, 3)


def test_gauss_newton_refuses_a_singular_graph() -> None:
    graph, start = loose()
    with pytest.raises(UnderconstrainedError) as caught:
        graph.optimize(start, GaussNewton(), gauge="none")
    assert caught.value.nullity == 3
    assert graph.chi2(caught.value.values) == graph.chi2(start)


def test_levenberg_marquardt_says_that_nothing_is_free() -> None:
    graph, start = loose(prior=True)
    result = graph.optimize(start, LevenbergMarquardt(), gauge="none")
    assert (result.converged, result.underconstrained) == (True, ())


@ALL
def test_fewer_measurements_than_unknowns(name: str) -> None:
    graph = FactorGraph([Prior(p[0], [1.0, 0.0], Isotropic(0.1), components=["x"])])
    with pytest.raises(UnderconstrainedError, match="p0: y"):
        graph.optimize(Values({p: (R(2), [[0.0, 0.0]])}), OPTIMIZERS[name]())


@ALL
def test_nothing_reacts_at_all(name: str) -> None:
    graph, start = scalar(lambda X: np.full_like(X, 2.0), 1.0, lambda X: np.zeros((1, 1, 1)))
    with pytest.raises(UnderconstrainedError, match="p0"):
        graph.optimize(start, OPTIMIZERS[name]())


def test_a_free_scale() -> None:
    """Ratios of distances alone: the scale is free, as in a reconstruction from one camera; the shape is found."""
    truth = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    i, j = np.array([0, 0, 0, 1, 1, 2]), np.array([1, 2, 3, 2, 3, 3])
    size = np.linalg.norm(truth[j] - truth[i], axis=1)

    def ratios(X0: Array, X1: Array, X2: Array, X3: Array) -> Array:
        X = np.stack([X0, X1, X2, X3], axis=1)
        d = np.linalg.norm(X[:, j] - X[:, i], axis=2)
        return np.log(d / d[:, :1]) - np.log(size / size[0]) + 0.01 * np.array([0, 1, -1, 1, 2, -1])

    graph = FactorGraph([Factor.from_function(ratios, [p[k] for k in range(4)], 6)])
    off = np.array([[0.1, 0.2], [-0.2, 0.1], [0.3, -0.1], [0.0, -0.3]])
    start = Values({p: (R(2), truth + off)})
    with pytest.raises(UnderconstrainedError, match="leave 4 directions free"):
        graph.optimize(start)
    graph.add(Prior(p[0], truth[0], Isotropic(0.1)))
    graph.add(Prior(p[1], truth[1], Isotropic(0.1), components=["y"]))
    graph.add(Prior(p[1], truth[1], Isotropic(0.2), components=["y"]))  # once more: dof 0, and still no scale
    result = graph.optimize(start, LevenbergMarquardt())
    assert result.converged
    assert len(result.underconstrained) == 1
    assert all(f"p{k}" in result.underconstrained[0] for k in (1, 2, 3))


# ---- options


@pytest.mark.parametrize("damping", [0, -1.0, np.nan, np.inf, 1e17])
def test_damping_that_is_none(damping: float) -> None:
    with pytest.raises(OptionError, match="damping"):
        LevenbergMarquardt(damping=damping)


def test_after_an_exception_the_values_are_untouched() -> None:
    graph, start = circle()

    def callback(iteration: Iteration) -> bool:
        raise RuntimeError("a fault of the caller")

    before = start[p].copy()
    for optimizer in OPTIMIZERS.values():
        with pytest.raises(RuntimeError, match="a fault of the caller"):
            graph.optimize(start, optimizer(callback=callback))
        assert np.array_equal(start[p], before)
