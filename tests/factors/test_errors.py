"""What a factor says when something does not fit, and what `check_jacobians` says of a wrong derivative."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Noise, Prior, SqrtInformation, check_jacobians
from factors.base import Jacobians
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, GraphWarning, JacobianError, NoiseModelError, OptionError
from models.sensors import point_in_frame
from nls import FactorGraph, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused

x, l, q = kinds("x", "l", "q")
PLANE = Values(
    {x: (SE2, [[0, 0, 0.3], [1, 2, -0.5], [2, 1, 0.1]]), l: (R(2), [[1.0, 2.0], [3.0, 4.0]]), q: (SE3, SE3.identity(2))}
)
UNIT = Isotropic()


class Measured(Factor):
    """A factor whose prediction and Jacobians are given."""

    slots = (SE2,)

    def __init__(self, keys: Keys, h: Array, H: Jacobians = None, noise: Noise = UNIT) -> None:
        super().__init__([keys], np.zeros(2), noise)
        self.h, self.H = h, H

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(2)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return self.h, self.H


@for_all(
    case=[
        (lambda: Between(x[0], 1, [0, 0, 0], UNIT), r"Between: .*got 1"),
        (lambda: Prior("x0", [0, 0, 0], UNIT), r"Prior: .*got 'x0'"),
        (lambda: Prior(x, [0, 0, 0], UNIT), r"Prior: .*got x"),
        (lambda: Prior(x[0], ["a", 0, 0], UNIT), r"Prior: z is not an array of numbers"),
        (lambda: Prior(x[0], [0, 0, 0], 0.1), r"Prior: .*got 0.1"),
        (lambda: Between(x[0:3], x[3:5], [0, 0, 0], UNIT), r"Between: .*\[3, 2\]; expected 1 or 3"),
        (lambda: Between(x[1], x[1], [0, 0, 0], UNIT), r"Between: measurement 0 connects x1"),
        (lambda: Between(x[2], x[0:5], [0, 0, 0], UNIT), r"measurement 2 connects x2"),
        (lambda: Factor.from_function(np.add, [x[0], 5], 3), r"got 5"),
    ]
)
def test_factors_that_cannot_be_made(case: tuple[Callable[[], Factor], str]) -> None:
    caught = refused(case[0], GraphError, case[1])
    assert str(caught).startswith(f"{caught.factor}: ")
    assert len(Between(x[1], l[1], [0, 0], UNIT)) == 1, "the same number of another kind"
    refused(lambda: Between(x[0], x[1], [0, 0, 0], UNIT, convention="g20"), OptionError, "g20.*log, g2o, graphslam, gt")


@for_all(
    case=[
        (Prior(x[0], [0, 0, 0], UNIT, ("x", "depth")), r"\('x', 'z'\) of SE2, .*\('x', 'y', 'yaw'\)"),
        (Prior(x[0], [0, 0, 0], UNIT, ()), r"\(\) of SE2"),
        (Prior(x[0], [0, 0, 0], UNIT, ("theta", "yaw")), r"\('yaw', 'yaw'\) of SE2"),
        (Prior(x[7], [0, 0, 0], UNIT), "x7 has no value"),
    ]
)
def test_factors_that_do_not_fit_their_variables(case: tuple[Factor, str]) -> None:
    refused(lambda: PLANE.gather(case[0]), GraphError, case[1])


def test_a_missing_noise_is_named_with_its_cure() -> None:
    ends: tuple[Any, ...] = (x[0], x[1])
    for args, options, kind, named in (
        ((*ends, [1, 0, 0]), {}, GraphError, "its noise is missing; give .* noise=Isotropic"),
        ((), {"z": [1, 0, 0], "j": x[1], "i": x[0]}, GraphError, "its noise is missing"),
        ((*ends, UNIT), {}, GraphError, r"its z is missing; Isotropic\(1\) stands in its place"),
        (ends, {}, TypeError, "'z' and 'noise'"),
        ((*ends, [1, 0, 0]), {"nois": UNIT}, TypeError, "'nois'"),
    ):
        refused(lambda args=args, options=options: Between(*args, **options), kind, named)


def test_noise_that_does_not_fit_names_the_measurement() -> None:
    prior = Prior(x[0:3], np.zeros((3, 3)), Isotropic([0.1, 0.1, 1e-320]))
    caught = refused(lambda: PLANE.gather(prior), NoiseModelError, r"Prior\(x2\): the noise of measurement 2 is beyond")
    assert caught.index == 2
    assert isinstance(caught.__cause__, NoiseModelError)


def linearize(factor: Factor) -> tuple[tuple[Array, ...], Array]:
    return linearized(factor, PLANE)


def test_shapes_of_prediction_and_jacobians() -> None:
    J, two = np.ones((1, 2, 3)), np.zeros((2, 2))
    for factor, named in (
        (Measured(x[0], np.zeros((1, 3))), r"Measured\(x0\): .*\(1, 3\), expected \(1, 2\)"),
        (Measured(x[0], np.zeros((1, 2)), ()), r"Measured\(x0\): 0 Jacobians, expected 1"),
        (Measured(x[0], np.zeros((1, 2)), (J, J)), r"Measured\(x0\): 2 Jacobians, expected 1"),
        *(
            (Measured(x[0:2], two, (np.ones(shape),)), r"slot 0 has shape .*, expected \(2, 2, 3\)")
            for shape in ((2, 3, 2), (3, 2, 3), (2, 2, 2), (2,), (1, 2, 2, 3))
        ),
    ):
        refused(lambda factor=factor: linearize(factor), EvaluationError, named)
    for shape in ((2, 3), (1, 2, 3), (2, 2, 3)):  # one may serve the batch
        (A,), _ = linearize(Measured(x[0:2], two, (np.ones(shape),)))
        np.testing.assert_array_equal(A, np.ones((2, 2, 3)))


@for_all(bad=[np.nan, np.inf, -np.inf])
def test_residuals_and_jacobians_must_be_finite(bad: float) -> None:
    factor = Measured(x[[1, 2]], np.array([[0.0, 0.0], [0.0, bad]]), (np.ones((2, 3)),))
    for evaluate in (linearized, error):
        named = r"Measured\(x2\): its residual is not finite"
        caught = refused(lambda evaluate=evaluate: evaluate(factor, PLANE), EvaluationError, named)
        assert (caught.factor, caught.keys, caught.where) == ("Measured", (x[2],), "residual")
    H = np.ones((2, 2, 3))
    H[1, 0, 2] = bad
    factor = Measured(x[[1, 2]], np.zeros((2, 2)), (H,))
    refused(lambda: linearize(factor), EvaluationError, r"Measured\(x2\): .*Jacobian .* x2 is not finite")


def test_extreme_residuals() -> None:
    """Infinities that cancel are found; a residual is named where its square is no number, and finite below."""
    for h, named in (([[np.inf, -np.inf]], "not finite"), ([[-1e308] * 2], r"Measured\(x0\): .*1e\+308 sigmas")):
        factor = Measured(x[0], np.array(h), (np.ones((2, 3)),))
        refused(lambda factor=factor: linearize(factor), EvaluationError, named)
    _, b = linearize(Measured(x[0], np.full((1, 2), -1e149), (np.ones((2, 3)),)))
    np.testing.assert_array_equal(b, [[1e149, 1e149]])


def raising(*X: Array) -> Array:
    raise KeyError("lost")


@for_all(
    case=[
        (raising, None, KeyError, r"raising\(l\[0, 1\]\): .*KeyError: 'lost'"),
        (lambda L: L, raising, KeyError, r"KeyError: 'lost'"),
        (lambda L: "abc", None, ValueError, r"ValueError: could not convert string"),
        (lambda L: L, lambda L: 5.0, TypeError, r"TypeError: .*not iterable"),
        (lambda: 0, None, TypeError, r"TypeError: .*takes 0 positional arguments"),
        (lambda L: L[:, 0], None, None, r"\(2,\), expected \(2, 2\)"),
        (lambda L: L[:, :1], None, None, r"\(2, 1\), expected \(2, 2\)"),
        (lambda L: None, None, None, r"\(\), expected \(2, 2\)"),
        (lambda L: L / 0 * np.nan, None, None, r"\(l0\): its residual is not finite"),
        (lambda L: L, lambda L: [np.ones((2, 3, 2))], None, r"slot 0 has shape \(2, 3, 2\), expected \(2, 2, 2\)"),
        (lambda L: L, lambda L: [np.eye(2)] * 2, None, r"2 Jacobians, expected 1"),
        (lambda L: L, lambda L: [np.full((2, 2), np.nan)], None, r"Jacobian .* l0 is not finite"),
    ]
)
def test_functions_that_raise_or_return_something_else(
    case: tuple[Callable, Callable | None, type | None, str],
) -> None:
    residual, jacobians, cause, named = case
    factor = Factor.from_function(residual, l[0:2], 2, jacobians=jacobians)
    with np.errstate(all="ignore"):
        caught = refused(lambda: linearize(factor), EvaluationError, named)
    if cause:
        assert isinstance(caught.__cause__, cause)
        assert caught.keys == (l[0:2],)


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
        caught = refused(lambda evaluate=evaluate: evaluate(factor, PLANE), EvaluationError, named + HINT)
        assert caught.keys == (x[0:2], l[0:2])


def test_other_mistakes_of_a_function_are_named_alone() -> None:
    factor = Factor.from_function(lambda X: 1 / len(X[:, :0].T), x[0:2], 1)
    refused(lambda: error(factor, PLANE), EvaluationError, "raised ZeroDivisionError: [a-z ]*$")


class Own(Factor):
    """Somebody's first factor: z = X, in the space and with the prediction that a test gives it."""

    slots = (None,)

    def __init__(self, space: object, predict: Callable[[Array], object], n: int = 1) -> None:
        super().__init__([x[0:n]], np.zeros((n, 3)), UNIT)
        self._space, self._predict = space, predict

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return self._space

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return self._predict(X[0])


def test_spaces_and_slots_that_are_none() -> None:
    for space in (3, None, "R(3)", R):
        refused(lambda space=space: PLANE.gather(Own(space, lambda X: (X, None))), GraphError, "^Own: its `space`")

    class Forgetful(Own):
        """A factor that does not say what its variable is."""

        slots = ()

    forgetful = Forgetful(R(3), lambda X: (X, None))
    refused(lambda: PLANE.gather(forgetful), GraphError, "Forgetful.*: .* 0 spaces, it has 1")


@for_all(
    case=[
        (lambda X: X, r"Own\(x0\): its `predict` returned an array of shape \(1, 3\)"),
        (lambda X: (X,), "expected two things"),
        (lambda X: None, r"`predict` returned None; .*\(1, 3\)"),
        (lambda X: (X.tolist(), None), r"`predict` returned \(\[\["),
        (lambda X: (X, np.eye(3)[None]), "Jacobians are a ndarray"),
        (lambda X: (X, (1.0,)), r"slot 0 has shape \(\), expected \(1, 3, 3\)"),
    ]
)
def test_predictions_that_are_none(case: tuple[Callable[[Array], object], str]) -> None:
    caught = refused(lambda: linearize(Own(R(3), case[0])), EvaluationError, case[1])
    assert (caught.factor, [repr(key) for key in caught.keys]) == ("Own", ["x0"])


def test_no_jacobian_means_the_identity_and_has_to_be_square() -> None:
    half = Measured(x[0], np.zeros((1, 2)), (None,))
    refused(lambda: linearize(half), EvaluationError, "None for slot 0 .* 2 x 3")


def test_a_factor_that_is_printed_shows_its_numbers() -> None:
    """Messages name the variables alone; print and notebooks show the measurement and its noise as well."""
    step = Between(x[0], x[1], [1.0, 0.0, 0.5], Diagonal([0.1, 0.1, 0.02]))
    assert str(step) == f"{step!r}: z = [1. , 0. , 0.5], {step.noise!r}"
    many = Between(x[:50], x[1:51], np.ones((50, 3)), Diagonal([0.1, 0.1, 0.02]))
    assert len(str(many)) < 200
    assert "..." in str(many)
    printed: list[str] = []

    class Printer:
        text = staticmethod(printed.append)

    step._repr_pretty_(Printer(), False)
    assert printed == [str(step)]


def scan(L: Array) -> Array:
    """A square, curved, not symmetric function of a point."""
    a, b = L[:, 0], L[:, 1]
    return np.stack([a * b, np.sin(a) + 3 * b], axis=1)


def scan_jacobian(L: Array) -> Array:
    a, b = L[:, 0], L[:, 1]
    return np.stack([np.stack([b, a], axis=-1), np.stack([np.cos(a), np.full_like(a, 3.0)], axis=-1)], axis=1)


@for_all(
    case=[
        (lambda J: -J, "; likely: the sign is flipped; the ratio is -1 for all entries$"),
        (lambda J: -2 * J, r"; likely: the sign .* and .* factor 2 too many .*; the ratio is -2 for all entries$"),
        (lambda J: 3.1 * J, "; likely: a constant factor; the ratio is 3.1 for all entries$"),
        (lambda J: J * [1.0, 0.0], r"; likely, in column\(s\) \[1\]: a derivative is left out; the ratio is 0 "),
        (lambda J: J.mT, "; likely: it is transposed"),
        (lambda J: np.deg2rad(J), "; likely: it is in degrees"),
        (lambda J: np.rad2deg(J), "; likely: degrees"),
        (lambda J: J / 2, r"; likely: a factor 2 is missing"),
        (lambda J: 2 * J, r"; likely: there is a factor 2"),
        (lambda J: J * [1.0, -1.0], r"; likely, in column\(s\) \[1\]: the sign"),
        (lambda J: J * [1.0, 2.0], r"; likely, in column\(s\) \[1\]: there is a factor 2"),
        (lambda J: J + 0.1, r"central difference [-0-9.e]+ \+- [0-9]e-[01][0-9]$"),
    ]
)
def test_check_jacobians_names_the_likely_cause(case: tuple[Callable[[Array], Array], str]) -> None:
    mistake, cause = case
    right = Factor.from_function(scan, l[0:2], 2, jacobians=lambda L: [scan_jacobian(L)])
    assert check_jacobians(right, PLANE) < 1e-8
    wrong = Factor.from_function(scan, l[0:2], 2, Isotropic(0.5), lambda L: [mistake(scan_jacobian(L))])
    caught = refused(lambda: check_jacobians(wrong, PLANE), JacobianError, cause)
    slot, n, row, column = caught.entry
    assert slot == 0
    assert caught.numeric == pytest.approx(2 * scan_jacobian(PLANE[l])[n, row, column], rel=1e-6)
    assert caught.analytic == pytest.approx(2 * mistake(scan_jacobian(PLANE[l]))[n, row, column], rel=1e-9)
    assert f"row {row}, component {'xy'[column]} of l{n}: analytic" in str(caught)


def test_check_jacobians_finds_one_wrong_entry_in_a_batch() -> None:
    def jacobians(L: Array) -> list[Array]:
        J = scan_jacobian(L)
        J[1, 0, 1] += 1e-4
        return [J]

    factor = Factor.from_function(scan, l[0:2], 2, jacobians=jacobians)
    with pytest.raises(JacobianError, match=r"row 0, component y of l1") as caught:
        check_jacobians(factor, PLANE)
    assert caught.value.entry == (0, 1, 0, 1)
    column = np.abs(scan_jacobian(PLANE[l])[1, :, 1]).max()
    assert check_jacobians(factor, PLANE, rtol=1e-3) == pytest.approx(1e-4 / column, rel=1e-4)


@for_all(group=[SE2, SE3])
def test_check_jacobians_names_the_order_of_columns(group: LieGroup) -> None:
    (p,), d = kinds("p"), group.point_dim
    values = Values({p: (group, group.exp(0.3 * np.random.default_rng(0).normal(size=(2, group.dim))))})

    def jacobians(X: Array, shift: int = 0) -> list[Array]:
        J = np.zeros((len(X), d, group.dim))
        J[:, :, :d] = group.world_axes(X)[:, :d, :d]
        return [np.roll(J, shift, axis=2)]

    assert check_jacobians(Factor.from_function(group.position, p[0:2], d, jacobians=jacobians), values) < 1e-8
    first = Factor.from_function(group.position, p[0:2], d, jacobians=lambda X: jacobians(X, group.dim - d))
    with pytest.raises(JacobianError, match=r"its columns are in another order \(translation comes first\)"):
        check_jacobians(first, values)


def in_body_jacobians(X: Array, L: Array, transposed: bool) -> list[Array]:
    H_x, R_T = point_in_frame(SE3, X, L)[1]
    return [H_x, R_T.mT if transposed else R_T]


@for_all(noise=[Isotropic(0.1), Diagonal([0.1, 0.2, 0.5]), SqrtInformation(np.tri(3) + np.eye(3))])
def test_check_jacobians_names_a_transposed_rotation(noise: Noise) -> None:
    """Whatever the noise: whitened, a transposed rotation is no transposed matrix."""
    X = SE3.exp([[0.3, -0.2, 0.5, 0.4, -0.6, 0.8], [1.0, 0.0, 0.2, -0.3, 0.2, 0.5]])
    values = Values({x: (SE3, X), l: (R(3), [[3.0, 1.0, 0.5], [2.0, -1.0, 0.7]])})
    seen = lambda X, L: point_in_frame(SE3, X, L)[0]  # noqa: E731
    right, wrong = (
        Factor.from_function(seen, [x[0:2], l[0:2]], 3, noise, partial(in_body_jacobians, transposed=transposed))
        for transposed in (False, True)
    )
    assert check_jacobians(right, values) < 1e-6
    cause = "it is transposed" if isinstance(noise, Isotropic) else "a rotation in it is transposed"
    refused(lambda: check_jacobians(wrong, values), JacobianError, f"of l[01]: analytic .*; likely: {cause}$")


def test_check_jacobians_says_where_it_compares_nothing() -> None:
    factor = Factor.from_function(lambda X: X[:, :2], l[0], 2)
    with pytest.warns(GraphWarning, match="predict returns no Jacobians, so .* there is nothing to compare"):
        check_jacobians(factor, PLANE)


def test_slots_of_one_space_without_a_comma_are_refused() -> None:
    class Anchor(Prior):
        slots = R(2)  # type: ignore[assignment]

    refused(
        lambda: FactorGraph([Anchor(l[0], [0.0, 0.0], Isotropic(1))]).chi2(PLANE),
        GraphError,
        r"slots is one space, expected a tuple: slots = \(R\(2\),\)",
    )


def test_check_jacobians_of_a_graph_names_the_worst_factor() -> None:
    def scaled(by: float) -> Factor:
        def jacobians(X: Array) -> list[Array]:
            return [by * SE2.world_axes(X)]

        return Factor.from_function(np.array, x[0:3], 3, Isotropic(0.1), jacobians)

    right, slightly, badly = scaled(1.0), scaled(1.01), scaled(3.0)
    assert check_jacobians(FactorGraph([right, right]), PLANE) == max(check_jacobians(right, PLANE), 0.0) < 1e-6
    assert check_jacobians(FactorGraph([right, slightly]), PLANE, rtol=0.1) == check_jacobians(slightly, PLANE, 0.1) > 0
    assert check_jacobians(FactorGraph(), PLANE) == 0.0
    two, graph = FactorGraph([right, slightly]), FactorGraph([slightly, badly, right])
    one = refused(lambda: check_jacobians(two, PLANE), JacobianError, "^array.* 1.01 for all entries$")
    caught = refused(lambda: check_jacobians(graph, PLANE), JacobianError, "; the worst of 2 factors .*, of 3$")
    alone = refused(lambda: check_jacobians(badly, PLANE), JacobianError, "analytic")
    assert str(caught).startswith(str(alone))
    assert (one.deviation, caught.deviation) == (pytest.approx(0.0099, abs=1e-4), pytest.approx(2 / 3, abs=1e-4))
    refused(lambda: check_jacobians(PLANE, PLANE), GraphError, "expected a factor or a graph, got Values")
