"""Whether noise explains chi2: one rule for plain and robust results."""

from __future__ import annotations

import pytest
from scipy.stats import chi2 as distribution

import nls
from models.advice import listed
from nls.optimizers.fit import Fit, fit


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
