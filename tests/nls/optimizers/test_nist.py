"""Five nonlinear regressions of NIST/ITL StRD: solved within 1,000 evaluations, and nothing else called solved.

Source: National Institute of Standards and Technology, Statistical Reference Datasets, nonlinear regression; a work of
the United States government, in the public domain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from models.algebra import Array
from models.errors import UnderconstrainedError
from nls import Result, Stop, Values
from nls.optimizers import OPTIMIZERS
from tests.nls.optimizers.mgh import Problem, count, numbers, p


class Regression(NamedTuple):
    """y = model(b, t) with the certified b."""

    name: str
    model: Callable[[Array, Array], Array]
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    certified: tuple[float, ...]
    t: Array
    y: Array

    def digits(self, values: Values) -> float:
        """Right digits of the parameter that has the fewest; 11 are certified."""
        b = np.array(self.certified)
        return float(-np.log10((np.abs(values[p[0]] - b) / np.abs(b)).max() + 1e-12))


REGRESSIONS = (
    Regression(
        "BoxBOD",
        lambda b, t: b[0] * (1 - np.exp(-b[1] * t)),
        ((1.0, 1.0), (100.0, 0.75)),
        (213.80940889, 0.54723748542),
        numbers("1 2 3 5 7 10"),
        numbers("109 149 149 191 213 224"),
    ),
    Regression(
        "Thurber",
        lambda b, t: (b[0] + b[1] * t + b[2] * t**2 + b[3] * t**3) / (1 + b[4] * t + b[5] * t**2 + b[6] * t**3),
        ((1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03), (1300.0, 1500.0, 500.0, 75.0, 1.0, 0.4, 0.05)),
        (1288.13968, 1491.0792535, 583.23836877, 75.416644291, 0.96629502864, 0.39797285797, 0.049727297349),
        numbers(
            "-3.067 -2.981 -2.921 -2.912 -2.84 -2.797 -2.702 -2.699 -2.633 -2.481 -2.363 -2.322 -1.501 -1.46 "
            "-1.274 -1.212 -1.1 -1.046 -0.915 -0.714 -0.566 -0.545 -0.4 -0.309 -0.109 -0.103 0.01 0.119 0.377 "
            "0.79 0.963 1.006 1.115 1.572 1.841 2.047 2.2"
        ),
        numbers(
            "80.574 84.248 87.264 87.195 89.076 89.608 89.868 90.101 92.405 95.854 100.696 101.06 401.672 390.724 "
            "567.534 635.316 733.054 759.087 894.206 990.785 1090.109 1080.914 1122.643 1178.351 1260.531 "
            "1273.514 1288.339 1327.543 1353.863 1414.509 1425.208 1421.384 1442.962 1464.35 1468.705 1447.894 "
            "1457.628"
        ),
    ),
    Regression(
        "Eckerle4",
        lambda b, t: b[0] / b[1] * np.exp(-(((t - b[2]) / b[1]) ** 2) / 2),
        ((1.0, 10.0, 500.0), (1.5, 5.0, 450.0)),
        (1.5543827178, 4.0888321754, 451.54121844),
        numbers(
            "400 405 410 415 420 425 430 435 436.5 438 439.5 441 442.5 444 445.5 447 448.5 450 451.5 453 454.5 "
            "456 457.5 459 460.5 462 463.5 465 470 475 480 485 490 495 500"
        ),
        numbers(
            "0.0001575 0.0001699 0.000235 0.0003102 0.0004917 0.000871 0.0017418 0.00464 0.0065895 0.0097302 "
            "0.0149002 0.023731 0.0401683 0.0712559 0.1264458 0.2073413 0.2902366 0.3445623 0.3698049 0.3668534 "
            "0.3106727 0.2078154 0.1164354 0.0616764 0.03372 0.0194023 0.0117831 0.0074357 0.0022732 0.00088 "
            "0.0004579 0.0002345 0.0001586 0.0001143 7.1e-05"
        ),
    ),
    Regression(
        "Rat43",
        lambda b, t: b[0] / (1 + np.exp(b[1] - b[2] * t)) ** (1 / b[3]),
        ((100.0, 10.0, 1.0, 1.0), (700.0, 5.0, 0.75, 1.3)),
        (699.6415127, 5.2771253025, 0.75962938329, 1.2792483859),
        count(15),
        numbers("16.08 33.83 65.8 97.2 191.55 326.2 386.87 520.53 590.03 651.92 724.93 699.56 689.96 637.56 717.41"),
    ),
    Regression(
        "Lanczos1",
        lambda b, t: b[0] * np.exp(-b[1] * t) + b[2] * np.exp(-b[3] * t) + b[4] * np.exp(-b[5] * t),
        ((1.2, 0.3, 5.6, 5.5, 6.5, 7.6), (0.5, 0.7, 3.6, 4.2, 4.0, 6.3)),
        (0.095100000027, 1.0000000001, 0.86070000013, 3.0000000002, 1.5575999998, 5.0000000001),
        (count(24) - 1) / 20,
        numbers(
            "2.5134 2.044333373291 1.668404436564 1.366418021208 1.123232487372 0.9268897180037 0.7679338563728 "
            "0.6388775523106 0.5337835317402 0.4479363617347 0.377584788435 0.3197393199326 0.2720130773746 "
            "0.2324965529032 0.1996589546065 0.1722704126914 0.1493405660168 0.1300700206922 0.1138119324644 "
            "0.1000415587559 0.0883320908454 0.0783354401935 0.06976693743449 0.06239312536719"
        ),
    ),
)

DAMPED = pytest.mark.parametrize("name", ["levenberg-marquardt", "dogleg"])
TIGHT = {
    "default": Stop(max_iterations=1000),
    "update": Stop(1e-12, 0.0, 0.0, 1000),
    "fall": Stop(0.0, 1e-12, 0.0, 1000),
    "gradient": Stop(0.0, 0.0, 1e-10, 1000),
    "none": Stop(0.0, 0.0, 0.0, 1000),
}
TURN = ("update", "fall", "gradient", "none")
SECOND = 13787.061  # chi2 of another minimum of Thurber's: the gradient is zero there, and all curvature positive
# From far away by default, from nearby with one threshold alone or none.
CASES = [case for k, q in enumerate(REGRESSIONS) for case in ((q, 0, "default"), (q, 1, TURN[k % 4]))]


def solved(regression: Regression, start: int, stop: str, name: str) -> Result:
    """The result of an optimizer, within 1,000 evaluations. Complex numbers are of the Jacobian."""
    evaluations: list[bool] = []

    def residual(x: Array) -> Array:
        evaluations.append(not np.iscomplexobj(x))
        return regression.model(x, regression.t) - regression.y

    problem = Problem(regression.name, residual, regression.starts[start], ())
    result = problem.graph().optimize(problem.values(), OPTIMIZERS[name](TIGHT[stop]))
    assert sum(evaluations) <= 1000, (regression.name, start, stop)
    return result


@DAMPED
def test_solved_from_both_starts(name: str) -> None:
    for problem, start, stop in CASES:
        result = solved(problem, start, stop, name)
        case = (problem.name, start, stop, result.reason)
        assert result.converged, case
        assert problem.digits(result.values) > {"default": 2.5, "fall": 5.5}.get(stop, 6.0), case


def test_gauss_newton_knows_where_it_has_arrived() -> None:
    arrivals = 0
    for problem, start, stop in CASES:
        try:
            result = solved(problem, start, stop, "gauss-newton")
        except UnderconstrainedError:  # the far starts are nearly singular for some
            assert start == 0
            continue
        arrived = problem.digits(result.values) > (2.5 if stop == "default" else 6)
        other = problem.name == "Thurber" and result.chi2_final == pytest.approx(SECOND, rel=1e-4)
        assert result.converged == (arrived or other), (problem.name, start, stop)
        arrivals += result.converged
    assert arrivals >= 6
