"""Numeric Jacobians where |f| says nothing about its rounding: large inner numbers, small residuals, tiny variables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from factors import Between, Factor, Isotropic
from factors.conventions import innovation
from models import SE2, SE3, Manifold, R
from models.algebra import Array
from models.errors import EvaluationError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import linearized, refused
from tests.factors.test_differences import Function, outcome

p, q = kinds("p", "q")
VALUES = [0.0, 3e-16, 1.0, 1e6]
INNER = [1.0, 1e4, 1e8]
RESIDUALS = [0.0, 1e-12, 1e3]
BEACONS = np.array([[1, 0, 0.2], [-0.3, 0.9, 0.1], [0.2, -0.8, -0.5], [0.6, 0.6, 0.52]])
Problem = tuple[Manifold, Array, Function, Function]


def ranges(value: float, inner: float, residual: float) -> Problem:
    """To four beacons."""
    x, B = value * np.array([1, -0.7, 0.4]), inner * BEACONS
    z = np.linalg.norm(B - x, axis=1) + residual

    def toward(X: Array) -> Array:
        return B - X[:, None]

    return (
        R(3),
        x,
        lambda X: z - np.linalg.norm(toward(X), axis=2),
        lambda X: toward(X) / np.linalg.norm(toward(X), axis=2)[..., None],
    )


def wave(value: float, inner: float, residual: float) -> Problem:
    """Phases on a large constant: curved within 1, whatever the inner numbers are."""
    w, phase = np.array([1.0, 0.5, 2.0]), np.array([0.2, 0.7, 1.1])
    z = inner + np.sin(w * value + phase) + residual
    return (
        R(1),
        np.array([value]),
        lambda X: z - (inner + np.sin(w * X + phase)),
        lambda X: -(w * np.cos(w * X + phase))[..., None],
    )


def line(value: float, inner: float, residual: float) -> Problem:
    """A plain difference of large numbers: at some steps its rounding looks like a slope, by chance."""
    return (
        R(1),
        np.array([value]),
        lambda X: (inner - X) - (inner - value) + residual,
        lambda X: np.full((len(X), 1, 1), -1.0),
    )


def step(value: float, inner: float, residual: float) -> Problem:
    """A relative pose."""
    X = SE3.exp(np.array([[0, 0, 0, 0.2, 0.3, -0.5]]))[0]
    X[:3] = value * np.array([1, -0.7, 0.4])
    Y = SE3.retract(X[None], np.concatenate([inner * BEACONS[0], np.full(3, 0.2)]))
    z = SE3.between(X[None], Y)

    def function(X: Array) -> Array:
        return innovation(SE3, SE3.between(X, np.tile(Y, (len(X), 1))), z, "g2o", False)[0] + residual

    def jacobian(X: Array) -> Array:
        h, H = Between(p[0], p[1], z[0], Isotropic(1.0)).predict((SE3, SE3), X, Y)
        J = innovation(SE3, h, z, "g2o", True)[1]
        assert H is not None
        assert J is not None
        return -J @ np.asarray(H[0])

    return SE3, X, function, jacobian


PROBLEMS: dict[str, Callable[[float, float, float], Problem]] = {
    "line": line,
    "ranges": ranges,
    "wave": wave,
    "step SE3": step,
}


@for_all(name=sorted(PROBLEMS), value=VALUES, inner=INNER, residual=RESIDUALS)
def test_columns_where_the_rounding_of_f_is_not_that_of_its_value(
    name: str, value: float, inner: float, residual: float
) -> None:
    manifold, x, function, jacobian = PROBLEMS[name](value, inner, residual)
    exact = jacobian(x[None])[0]
    (A,), _ = linearized(Factor.from_function(function, p[0], len(exact)), Values({p: (manifold, x)}))
    size = np.abs(exact).max(axis=0)
    off = np.abs(A[0] - exact).max(axis=0) / np.where(size > 1e-9 * size.max(), size, 1e-2 * size.max())
    assert off.max() < 1e-4


def test_a_component_that_f_does_not_depend_on_is_0_in_spite_of_noise() -> None:
    """A range by way of the frame of the pose: turning it changes the rounding alone."""
    z = np.linalg.norm([3e5, 4e5])
    by_frame = Factor.from_function(
        lambda X: z - np.linalg.norm(SE2.act(SE2.inverse(X), [3e5, 4e5]), axis=1)[:, None], p[0], 1
    )
    (A,), _ = linearized(by_frame, Values({p: (SE2, [1e-15, 0.0, 0.7])}))
    assert A[0, 0] == pytest.approx([np.cos(0.7) * 0.6 + np.sin(0.7) * 0.8, 0.8 * np.cos(0.7) - 0.6 * np.sin(0.7), 0.0])
    assert A[0, 0, 2] == 0


FLAT: dict[str, Function] = {
    "cube": lambda u: u**3,
    "fourth": lambda u: u**4,
    "fifth": lambda u: u**5,
    "large": lambda u: 1e20 * u**9,
    "signed square": lambda u: u * np.abs(u),
    "even": lambda u: np.abs(u) ** 1.5,
    "rounded": lambda u: u - np.sin(u),
    "cosine": lambda u: 1 - np.cos(u),
}


@for_all(name=sorted(FLAT), origin=[0.0, 1.0, 1e6], added=[0.0, 5.0])
def test_a_derivative_that_vanishes_is_0(name: str, origin: float, added: float) -> None:
    """The slope falls with the step, so that the error of a difference is as large as the difference."""
    residual = lambda X: FLAT[name](X - origin) + added  # noqa: E731
    (A,), _ = linearized(Factor.from_function(residual, p[0], 1), Values({p: (R(1), [[origin]])}))
    assert abs(A[0, 0, 0]) < 1e-9
    for slope, found in ((0.0, "passed"), (1.0, "refused")):
        assert outcome(residual, lambda X, slope=slope: np.full((len(X), 1, 1), slope), origin, [1.0]) == found


def test_kinks_have_a_difference_and_plateaus_none() -> None:
    """Not noise: |x| and max(0, x) at 0, a limit 1e-5, 0.1 and 1e-12 away, inner numbers, a curve beside."""
    for function, x, slope in (
        (np.abs, 0.0, 0.0),
        (lambda X: np.abs(X) + X**2, 0.0, 0.0),
        (lambda X: X**5 + 1e-6 * np.maximum(X, 0), 0.0, 5e-7),
        (lambda X: np.maximum((1e2 + X) - 1e2, 0), 0.0, 0.5),
        (lambda X: np.maximum(X, 0), 0.0, 0.5),
        (lambda X: np.maximum(X - 1, 0), 1 - 1e-5, 0.0),
        (lambda X: np.maximum(X - 1, 0), 0.9, 0.0),
        (lambda X: np.maximum(X - 1, 0), 1 + 1e-12, 1.0),
    ):
        calls = []

        def counted(X: Array, function: Function = function, calls: list[Array] = calls) -> Array:
            calls.append(X)
            return function(X)

        (A,), _ = linearized(Factor.from_function(counted, p[0], 1), Values({p: (R(1), [x])}))
        assert A[0, 0, 0] == pytest.approx(slope, abs=1e-8), x
        assert len(calls) <= 1 + 8 * 5


@for_all(
    function=[
        lambda X: np.sign(X),
        lambda X: X != 0,
        lambda X: np.cbrt(X),
        lambda X: np.sqrt(np.abs(X)),
        lambda X: X + np.abs(X) ** 0.9,
        lambda X: np.abs(X) ** 0.99,
        lambda X: np.sqrt(np.abs(X)) + 1e9 * X**2,
        lambda X: np.abs(X) ** 0.9 + 1e9 * X**2,
        lambda X: 5 + np.sqrt(np.abs(X)),
        lambda X: (1e13 + X) - 1e13,
        lambda X: np.sin(1e20 * (X + 1)),
    ]
)
def test_too_few_digits_and_jumps_are_refused_by_name(function: Function) -> None:
    factor = Factor.from_function(function, p[[0, 1]], 1)
    named = r"\(p0\): no central difference in component x of p0: .* expected 0\.0004 of it; .* or give Jacobians"
    refused(lambda: linearized(factor, Values({p: (R(1), [[0.0], [0.0]])})), EvaluationError, named)
