"""Functions written for one measurement: the error says that a function gets stacks."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from factors import Factor
from models import SE2, R
from models.algebra import Array
from models.errors import EvaluationError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused

x, l = kinds("x", "l")
VALUES = Values({x: (SE2, np.ones((2, 3))), l: (R(2), np.ones((2, 2)))})
HINT = r"Your function gets stacks \(n, size\), one row per measurement, here \(2, 3\), \(2, 2\)"


def unpacks(X: Array, L: Array) -> Array:
    px, py, _ = X
    return np.array([px, py]) - L


def decides(X: Array, L: Array) -> Array:
    return X[:, :2] - L if X[0] > 0 else L


@for_all(
    case=[
        (lambda X, L: [X[2] - L[0], X[1] - L[1]], "raised IndexError: .*"),
        (lambda X, L: [math.cos(X[0]), L[0]], "raised TypeError: .*"),
        (unpacks, "raised ValueError: not enough values to unpack.*"),
        (decides, "raised ValueError: The truth value of an array.*"),
        (lambda X, L: np.hypot(X[:, 0] - L[:, 0], X[:, 1] - L[:, 1]), r"returned shape \(2,\), expected \(2, 2\)\. "),
        (lambda X, L: X - X, r"returned shape \(2, 3\), expected \(2, 2\)\. "),
    ]
)
def test_a_function_for_one_measurement(case: tuple[Callable[[Array, Array], Array], str]) -> None:
    residual, named = case
    factor = Factor.from_function(residual, [x[0:2], l[0:2]], 2)
    for evaluate in (linearized, error):
        caught = refused(lambda evaluate=evaluate: evaluate(factor, VALUES), EvaluationError, named + HINT)
        assert caught.keys == (x[0:2], l[0:2])


def test_other_mistakes_of_a_function_are_named_alone() -> None:
    factor = Factor.from_function(lambda X: 1 / len(X[:, :0].T), x[0:2], 1)
    refused(lambda: error(factor, VALUES), EvaluationError, "raised ZeroDivisionError: [a-z ]*$")
