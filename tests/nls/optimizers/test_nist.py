"""Nonlinear regressions with certified parameters: solved within 1,000 evaluations, and nothing else called solved."""

from __future__ import annotations

import numpy as np
import pytest

from models.errors import UnderconstrainedError
from nls import Stop
from nls.optimizers import OPTIMIZERS
from tests.nls.optimizers.nist import REGRESSIONS

DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])
TIGHT = {
    "default": Stop(max_iterations=1000),
    "update": Stop(1e-12, 0.0, 0.0, 1000),
    "fall": Stop(0.0, 1e-12, 0.0, 1000),
    "gradient": Stop(0.0, 0.0, 1e-10, 1000),
    "none": Stop(0.0, 0.0, 0.0, 1000),
}
TURN = ("update", "fall", "gradient", "none")
# chi2 of second minima: the gradient is zero there, and all curvature positive. Rounding decides which is met.
SECOND = {"MGH09": 4.23675e-4, "Thurber": 13787.061}
# From far away by default, from nearby with one threshold alone or none.
CASES = [case for k, q in enumerate(REGRESSIONS) for case in ((q, 0, "default"), (q, 1, TURN[k % 4]))]


@DAMPED
def test_solved_from_both_starts(name: str) -> None:
    for problem, start, stop in CASES:
        problem.evaluations = 0
        result = problem.graph.optimize(problem.values(start), OPTIMIZERS[name](TIGHT[stop]))
        case = (problem.name, start, stop, result.reason)
        assert problem.evaluations <= 1000, case
        assert result.converged, case
        assert problem.digits(result.values) > {"default": 2.5, "fall": 5.5}.get(stop, 6.0), case


def test_gauss_newton_knows_where_it_has_arrived() -> None:
    arrivals = 0
    for problem, start, stop in CASES:
        try:
            result = problem.graph.optimize(problem.values(start), OPTIMIZERS["gauss-newton"](TIGHT[stop]))
        except UnderconstrainedError:  # the far starts are nearly singular for some
            assert start == 0
            continue
        arrived = problem.digits(result.values) > (2.5 if stop == "default" else 6)
        other = result.chi2_final == pytest.approx(SECOND.get(problem.name, np.nan), rel=1e-4)
        assert result.converged == (arrived or other), (problem.name, start, stop)
        arrivals += result.converged
    assert arrivals >= 6
