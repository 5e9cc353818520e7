"""Covariances for the files of a mission: at an optimum; elsewhere a note says why there are none."""

from __future__ import annotations

import numpy as np

from factors import Between, Isotropic, Range
from factors.keys import kinds
from models import SE2
from nls.graph import FactorGraph
from nls.io.report import LoadReport
from nls.linear import QR
from nls.missions.solution import Solution
from nls.values import Values

x = kinds("x")[0]
STEP = Between(x[0], x[1], [[2.0, 0.0, 0.1]], Isotropic(0.1))
START = Values({x: (SE2, [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0]])})


GRAPH = FactorGraph([STEP])
REPORT = LoadReport("m", "mission", "2-D", "log")


def test_at_an_optimum_with_solver_and_gauge() -> None:
    result = GRAPH.optimize(START)
    for gauge, sentence in (("first", "x0 fixed"), ("free", "free")):
        marginals, note = Solution(GRAPH, START, result, REPORT, QR(), gauge).covariances
        assert note == ""
        assert marginals.gauge.startswith(sentence)
        np.testing.assert_array_equal(marginals.values[x], result.values[x])


def test_why_there_are_none_at_an_optimum() -> None:
    free = FactorGraph([Range(x[0], x[1], [2.0], Isotropic(0.1))])
    marginals, note = Solution(free, START, GRAPH.optimize(START), REPORT).covariances
    assert marginals is None
    assert note.startswith("the files have no sigmas: 1 unknown is not measured: x1: yaw")
