"""What every optimization promises, and whether noise explains its chi2: one rule for plain and robust results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2 as distribution

import nls
from factors import DCS, Between, Cauchy, GemanMcClure, Huber, Isotropic, Prior, Robust, Tukey, Welsch
from factors.robust import Kernel
from models import R
from models.advice import listed
from nls import FactorGraph, GaussNewton, GraphError, Stop
from nls.optimizers.result import Fit, fit, shares
from tests.nls.graphs import circle, p, pose_graph, scalar, x


def result(chi2: float, dof: int, robust: bool = False) -> nls.Result:
    return nls.Result(nls.Values({}), nls.Status.CONVERGED, "", [], chi2, chi2, dof, "", "", {}, robust=robust)


@pytest.mark.parametrize("dof", [1, 3, 7, 60, 500, 40_000])
def test_the_bounds_are_the_quantile_and_twice_the_expectation(dof: int) -> None:
    quantile = distribution.ppf(0.975, dof)
    assert fit(0.9999 * quantile, dof) is Fit.PLAUSIBLE
    assert fit(1.0001 * quantile, dof) is (Fit.HIGH if quantile < 2 * dof else Fit.IMPLAUSIBLE)
    for robust in (False, True):
        assert fit(1.0001 * max(quantile, 2 * dof), dof, robust) is Fit.IMPLAUSIBLE
    assert fit(0.9999 * max(quantile, 2 * dof), dof, robust=True) is Fit.PLAUSIBLE


def test_without_degrees_of_freedom_chi2_is_rounding() -> None:
    for dof in (0, -10):
        assert fit(1e-9, dof) is Fit.PLAUSIBLE
        assert fit(7.0, dof) is Fit.IMPLAUSIBLE


@pytest.mark.parametrize("robust", [False, True])
def test_every_ratio_above_two_is_in_doubt_and_another_start_is_for_the_largest(robust: bool) -> None:
    for ratio in (2.5, 73.0, 85.0, 116.0):
        doubted = result(60 * ratio, 60, robust)
        assert doubted.doubt == f"chi2 is {ratio:.3g} times its expectation: {Fit.IMPLAUSIBLE.value}"
        assert doubted.doubt in str(doubted)
        words = "; ".join(listed(doubted.advice, shell=True))
        assert "cauchy" not in words
        assert "nls explain" in words
        assert ("--init" in words) == (ratio > 100)
    assert result(70.0, 60, robust).doubt == ""


@pytest.mark.parametrize("kernel", [Cauchy(1), Huber(1), Tukey(4.685), Welsch(2.985), GemanMcClure(1), DCS(1)])
def test_noise_alone_makes_no_kernel_ignore_more_than_one_in_a_hundred(kernel: Kernel) -> None:
    """Far ones are ignored, of whatever kernel; limits are no measurements, and a quarter is not too much."""
    rng, n = np.random.default_rng(0), 20_000
    for dim in (1, 3, 6):
        z = rng.normal(size=(n, dim))
        z[:100] = 1000.0
        values = nls.Values({x: (R(dim), np.zeros((1, dim)))})
        factor = Prior(x[np.zeros(n, dtype=int)], z, Robust(Isotropic(1.0), kernel))
        (share,) = shares([factor], values)
        assert 100 <= share.ignored <= 100 + 0.01 * n
        assert share.numbers == dim * share.ignored
        assert share.chi2 == pytest.approx(dim * (n - share.ignored), rel=0.1)


def test_a_table_of_which_more_than_a_quarter_is_ignored_is_implausible() -> None:
    for wrong, verdict in ((0, Fit.PLAUSIBLE), (2, Fit.PLAUSIBLE), (3, Fit.IMPLAUSIBLE)):
        good = Prior(x[np.zeros(50, dtype=int)], np.zeros((50, 1)), Robust(Isotropic(1.0), Cauchy(1.0)))
        z = np.where(np.arange(8)[:, None] < wrong, 99.0, 0.0)
        other = Prior(x[np.zeros(8, dtype=int)], z, Robust(Isotropic(1.0), Cauchy(1.0)))
        values = nls.Values({x: (R(1), [0.0])})
        names = shares([good, other], values, ["good.csv", "other.csv"])
        assert [(share.name, share.ignored, share.total) for share in names] == [
            ("good.csv", 0, 50),
            ("other.csv", wrong, 8),
        ]
        judged = replace(result(0.0, 57, robust=True), shares=names)
        assert (judged.fit, bool(judged.doubt)) == (verdict, verdict is Fit.IMPLAUSIBLE)
        assert judged.believed == (0.0, 57 - wrong)
        assert ("other.csv" in judged.doubt) == (wrong > 2)
    unchecked = replace(result(0.0, 2, robust=True), shares=(names[1]._replace(total=99),))
    assert unchecked.doubt == "nothing checks the measurements the kernel keeps"


def test_closures_that_a_kernel_silences_are_not_hidden_among_odometry() -> None:
    """Five closures of 99 edges; from odometry a bounded kernel ignores all of them."""
    n = 95
    i = np.r_[np.arange(n - 1), [0, 1, 2, 3, 4]]
    j = np.r_[np.arange(1, n), [94, 93, 92, 91, 90]]
    z = np.r_[np.ones(n - 1), np.full(5, 3.0)][:, None]
    graph = nls.FactorGraph([Between(x[i], x[j], z, Isotropic(0.1))]).robust(Tukey(4.685))
    robust = graph.optimize(nls.Values({x: (R(1), np.arange(n, dtype=float)[:, None])}))
    assert robust.chi2_final < robust.dof * 8
    assert [(share.name, share.ignored, share.total) for share in robust.shares] == [
        ("Between of odometry", 0, 94),
        ("Between closures", 5, 5),
    ]
    assert robust.fit is Fit.IMPLAUSIBLE
    assert "the kernel ignored 5 of 5 Between closures (100 %)" in str(robust)


def test_a_start_that_is_kept_can_be_changed_without_harm() -> None:
    graph, start = scalar(lambda X: X - 1.0, 3.0, lambda X: -np.ones((1, 1, 1)))
    result = graph.optimize(start)
    start[p[0]] = [99.0]
    assert result.values[p[0]].tolist() == [3.0]


def test_history_timings_and_table() -> None:
    sample = pose_graph(R(2))
    result = sample.graph.optimize(sample.values)
    assert [it.number for it in result.history] == list(range(result.iterations + 1))
    assert np.isnan(result.history[0].update)
    assert result.history[0].chi2 == result.chi2_initial
    assert {"build", "analyze", "linearize", "retract"} <= set(result.timings)
    assert all(seconds >= 0 for seconds in result.timings.values())
    text = str(result)
    assert f"CONVERGED: {result.reason}" in text
    assert f"{result.dof} degrees of freedom" in text
    assert len(text.splitlines()) == 1 + len(result.history) + 2


def test_an_optimizer_is_not_changed_by_a_run() -> None:
    graph, start = circle()
    optimizer = GaussNewton()
    first, second = graph.optimize(start, optimizer), graph.optimize(start, optimizer)
    assert first.values[p[0]].tobytes() == second.values[p[0]].tobytes()
    with pytest.raises(AttributeError):
        optimizer.stop = Stop()  # type: ignore[misc]


def test_nothing_left_to_move() -> None:
    sample = pose_graph(R(2))
    sample.graph.fix(x[0:8])
    result = sample.graph.optimize(sample.values)
    assert result.converged
    assert np.array_equal(result.values[x], sample.values[x])
    with pytest.raises(GraphError):
        FactorGraph().optimize(sample.values)
