"""Central differences against exact derivatives: sizes from 1e-12 to 1e12, offsets, borders of domains."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from factors import Factor, Isotropic, Range, check_jacobians
from factors.differences import EPS
from models import LINE, SE2, SE3, Manifold, Measured, R
from models.algebra import Array
from models.errors import EvaluationError, GraphWarning, JacobianError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import linearized, refused

(p,) = kinds("p")
Function = Callable[[Array], Array]

# f and f' of u = x / s, where s has the size of x: each changes by about itself over s
FUNCTIONS: dict[str, tuple[Function, Function]] = {
    "cube": (lambda u: u**3, lambda u: 3 * u**2),
    "power": (lambda u: np.abs(u) ** -1.5, lambda u: -1.5 * np.abs(u) ** -2.5 * np.sign(u)),
    "exponential": (np.exp, np.exp),
    "rational": (lambda u: u / (5 + u), lambda u: 5 / (5 + u) ** 2),
    "sine": (lambda u: np.sin(3 * u), lambda u: 3 * np.cos(3 * u)),
    "logarithm": (lambda u: np.log(np.abs(u)), lambda u: 1 / u),
    "line": (lambda u: 2 * u - 1, lambda u: np.full_like(u, 2.0)),
}


@given(
    name=st.sampled_from(sorted(FUNCTIONS)),
    decade=st.integers(-12, 12),
    u=st.floats(0.3, 3.0).flatmap(lambda u: st.sampled_from([u, -u])),
    offset=st.sampled_from([0.0, 1.0, 1e6]),
)
def test_check_refuses_the_wrong_and_never_the_exact(name: str, decade: int, u: float, offset: float) -> None:
    f, df = FUNCTIONS[name]
    s = 10.0**decade
    values = Values({p: (R(2), [u * s, 0.7])})

    def residual(X: Array) -> Array:
        return np.stack([offset + f(X[:, 0] / s), np.cos(X[:, 1]) * f(X[:, 0] / s)], axis=1)

    def jacobians(X: Array, wrong: float = 1.0) -> list[Array]:
        v, c = X[:, 0] / s, np.cos(X[:, 1])
        zero = np.zeros_like(v)
        J = [[df(v) / s, zero], [wrong * c * df(v) / s, -np.sin(X[:, 1]) * f(v)]]
        return [np.array(J).transpose(2, 0, 1)]

    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        check_jacobians(Factor.from_function(residual, p[0], 2, jacobians=jacobians), values)
        for wrong in (1.01, 0.99, -1.0, 2.0, 0.0):
            mistaken = Factor.from_function(residual, p[0], 2, jacobians=lambda X, w=wrong: jacobians(X, w))
            if not doubts:
                with pytest.raises(JacobianError, match=r"row 1, component x of p0: analytic .* difference .* \+- "):
                    check_jacobians(mistaken, values)
    assert all(issubclass(doubt.category, GraphWarning) for doubt in doubts)
    if offset < 1e6:
        assert not doubts


# f and f' of u = length * (x - origin), bounded or not: of no size that x knows of
SHAPES: dict[str, tuple[Function, Function]] = {
    "sine": (np.sin, np.cos),
    "cosine": (np.cos, lambda u: -np.sin(u)),
    "peaks": (lambda u: np.tan(1.2 * np.sin(u)), lambda u: 1.2 * np.cos(u) / np.cos(1.2 * np.sin(u)) ** 2),
    "steps": (lambda u: np.tanh(3 * np.sin(u)), lambda u: 3 * np.cos(u) / np.cosh(3 * np.sin(u)) ** 2),
    "tangent": (np.tan, lambda u: np.cos(u) ** -2),
    "exponential": (np.exp, np.exp),
    "polynomial": (lambda u: u**3 - 2 * u, lambda u: 3 * u**2 - 2),
}
PERIODIC = ("sine", "cosine", "peaks", "steps")


def outcome(residual: Function, jacobian: Function, x: object, factors: object) -> str:
    """How `check_jacobians` takes a Jacobian with its columns times these factors: refused, doubted or passed."""
    X = np.atleast_2d(np.asarray(x, dtype=float))
    factor = Factor.from_function(
        residual, p[0], residual(X).shape[1], jacobians=lambda X: [jacobian(X) * np.array(factors)]
    )
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        try:
            check_jacobians(factor, Values({p: (R(X.shape[1]), X)}))
        except JacobianError:
            return "refused"
    assert all(issubclass(doubt.category, GraphWarning) for doubt in doubts)
    return "doubted" if doubts else "passed"


def verdict(residual: Function, jacobian: Function, x: object) -> str:
    """The exact Jacobian is not refused; a wrong one is, or doubted."""
    X = np.atleast_2d(np.asarray(x, dtype=float))
    n = X.shape[1]
    for k in range(n):
        for wrong in (1.01, 0.0, -1.0):
            factors = [wrong if d == k else 1.0 for d in range(n)]
            assert outcome(residual, jacobian, X, factors) != "passed", (k, wrong)
    right = outcome(residual, jacobian, X, np.ones(n))
    assert right != "refused"
    return right


@given(
    name=st.sampled_from(sorted(SHAPES)),
    decade=st.floats(-12, 12),
    digits=st.floats(3, 15),
    whole=st.booleans(),
    negative=st.booleans(),
    absolute=st.booleans(),
    phases=st.lists(st.floats(0.1, 1.2), min_size=1, max_size=3),
)
def test_a_function_as_fine_as_rounding_resolves(
    name: str, decade: float, digits: float, whole: bool, negative: bool, absolute: bool, phases: list[float]
) -> None:
    """Rounding of x is 1e-3 to 1e-15 of the length over which f changes, so x may be 1e12 periods from 0."""
    x = (-1 if negative else 1) * 10.0**decade
    length = 10.0**-digits / (EPS * abs(x))
    if whole:  # round numbers of periods, so that round steps fall on them
        length = 2 * np.pi * (float(f"{length:.2g}") if length < 100 else round(length, -1))
    origin = 0.0 if absolute and name in PERIODIC else x
    f, df = SHAPES[name]

    def residual(X: Array) -> Array:
        return np.asarray(f(length * (X - origin) + phases))

    def jacobian(X: Array) -> Array:
        return np.asarray(length * df(length * (X - origin) + phases))[..., None]

    X = np.array([[x]])
    exact = jacobian(X)[0, :, 0]
    assume(np.abs(exact).max() > 0.01 * length)
    right = verdict(residual, jacobian, x)
    assert right == "passed" or digits < 7
    try:
        (A,), _ = linearize(Factor.from_function(residual, p[0], len(phases)), R(1), [x])
    except EvaluationError as error:
        assert (digits < 7, error.where) == (True, "Jacobian with respect to p0")  # noqa: PT017
        return
    assert np.abs(A[0, :, 0] - exact).max() < (1e-7 + 100 * 10.0**-digits) * np.abs(exact).max() or right == "doubted"


@for_all(large=[1e4, 1e8, 1e10, 1e12, 1e14])
def test_a_column_lost_in_the_rounding_of_another_is_doubted(large: float) -> None:
    def residual(X: Array) -> Array:
        return large * X[:, :1] + X[:, 1:] * [1.0, 2.0]

    def jacobian(X: Array) -> Array:
        return np.stack([large + 0 * X, [1.0, 2.0] + 0 * X], axis=-1)

    assert verdict(residual, jacobian, [1.0, 1.0]) == ("passed" if large < 1e12 else "doubted")


def test_check_warns_where_no_step_can_be_trusted() -> None:
    """Functions that change within the rounding of their variable."""
    fine: list[Function] = [
        lambda X: np.sin(1e20 * X),
        lambda X: np.sin(1e20 * X + np.arange(3.0)),
        lambda X: np.sin(1e7 * X**5),
    ]
    for f in fine:
        J = np.ones((1, f(np.ones((1, 1))).shape[1], 1))
        for wrong in (0.0, 1.0):
            assert outcome(f, lambda X, J=J: J, 1e3, [wrong]) == "doubted"  # type: ignore[misc]


def linearize(factor: Factor, manifold: Manifold, X: object) -> tuple[tuple[Array, ...], Array]:
    return linearized(factor, Values({p: (manifold, X)}))


@for_all(distance=[1e-3, 1e-6, 1e-9])
def test_a_step_stays_in_the_domain(distance: float) -> None:
    def residual(X: Array) -> Array:
        return np.sqrt(X - 1) + np.log(X - 1)  # NaN, with a warning of NumPy, below 1

    (A,), _ = linearize(Factor.from_function(residual, p[0], 1), R(1), [1 + distance])
    d = (1 + distance) - 1
    assert A[0, 0, 0] == pytest.approx(0.5 / np.sqrt(d) + 1 / d, rel=10 * EPS / distance + 1e-9)


def test_a_step_avoids_values_at_which_the_function_raises() -> None:
    def residual(X: Array) -> Array:
        if (X < 0).any():
            raise ValueError("below 0")
        return np.sqrt(X)

    (A,), _ = linearize(Factor.from_function(residual, p[0], 1), R(1), [1e-8])
    assert A[0, 0, 0] == pytest.approx(0.5e4, rel=1e-9)
    factor = Factor.from_function(residual, p[0], 1)
    refused(lambda: linearize(factor, R(1), [0.0]), EvaluationError, "ValueError: below 0")


def test_no_step_is_in_the_domain() -> None:
    def residual(X: Array) -> Array:
        return np.stack([X[:, 0], np.sqrt(-np.abs(X[:, 1]))], axis=1)

    factor = Factor.from_function(residual, p[0], 2)
    for start in ([[1.0, 0.0]], [[0.0, 0.0]]):
        named = r"\(p0\): .* component y of p0: .* not beside it"
        refused(lambda start=start: linearize(factor, R(2), start), EvaluationError, named)


@for_all(
    element=[
        (SE2, [5e5, 4e6, 3.1]),
        (SE2, [0.0, 0.0, 0.0]),
        (SE3, [0.0, 0.0, 1e-9, 0.0, 0.0, 0.0, 1.0]),
        (SE3, [4e5, 0.0, 20.0, 0.5, 0.5, 0.5, 0.5]),
        (LINE, [-3.14, 2e-3]),
        (Measured("yaw", "range"), [3.14, 1e4]),
    ]
)
def test_elements_near_and_far_from_the_origin(element: tuple[Manifold, list[float]]) -> None:
    """The residual is the tangent step from there, so that its derivative is the identity."""
    manifold, X = element
    here = np.array([X])
    factor = Factor.from_function(lambda Y: manifold.local(here, Y), p[0], manifold.dim)
    (A,), _ = linearize(factor, manifold, here)
    far = np.abs(manifold.position(here)).max(initial=1.0)
    assert np.abs(A[0] - np.eye(manifold.dim)).max() < 1e-10 + 100 * EPS * far


def test_columns_of_poses_take_five_evaluations_or_little_more() -> None:
    rng = np.random.default_rng(0)
    points, calls = rng.uniform(-50, 50, size=(200, 2)), []

    def residual(X: Array) -> Array:
        calls.append(len(X))
        return Range(p[0], p[1], [1.0], Isotropic()).predict((SE2, R(2)), X, points)[0]

    linearize(Factor.from_function(residual, p[0:200], 1), SE2, rng.uniform(-50, 50, size=(200, 3)))
    assert len(calls) <= 1 + 5 + 5 + 2 * 5 + 5  # where one pose of 200 needs another step, the batch takes it


def test_check_says_where_it_cannot_tell() -> None:
    """1e13 + x: a change of x by 1 is lost but for three digits; a mistake of a tenth of a percent does not show."""

    def factor(slope: float) -> Factor:
        return Factor.from_function(
            lambda X: 1e13 + np.sin(X), p[0], 1, jacobians=lambda X: [slope * np.cos(X)[:, None]]
        )

    values = Values({p: (R(1), [0.3])})
    with pytest.warns(GraphWarning, match=r"p0\): component x of p0: the central difference is uncertain by"):
        check_jacobians(factor(1.0), values)
    with pytest.raises(JacobianError, match=r"analytic -0\.95.* difference 0\.95"):
        check_jacobians(factor(-1.0), values)
