"""What a factor says when something does not fit, and what `check_jacobians` says of a wrong derivative."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Noise, Prior, SqrtInformation, check_jacobians
from factors.base import Jacobians
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, R
from models.errors import EvaluationError, GraphError, JacobianError, NoiseModelError, OptionError
from nls import FactorGraph, Values, kinds

Array = npt.NDArray[np.float64]
x, l = kinds("x", "l")
PLANE = Values({x: (SE2, [[0, 0, 0.3], [1, 2, -0.5], [2, 1, 0.1]]), l: (R(2), [[1.0, 2.0], [3.0, 4.0]])})
UNIT = Isotropic()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Between(x[0], 1, [0, 0, 0], UNIT), r"Between: expected variables such as x\[0\] or x\[i\], got 1"),
        (lambda: Prior("x0", [0, 0, 0], UNIT), r"Prior: expected variables such as .*, got 'x0'"),
        (lambda: Prior(x, [0, 0, 0], UNIT), r"Prior: expected variables such as .*, got x"),
        (lambda: Prior(x[0], ["a", 0, 0], UNIT), r"Prior: z is not an array of numbers"),
        (lambda: Prior(x[0], [0, 0, 0], 0.1), r"Prior: expected a noise model such as Isotropic\(0.1\), got 0.1"),
        (lambda: Between(x[0:3], x[3:5], [0, 0, 0], UNIT), r"Between: its variables number \[3, 2\]; expected 1 or 3"),
        (lambda: Between(x[1], x[1], [0, 0, 0], UNIT), r"Between: measurement 0 joins x1 to itself"),
        (lambda: Between(x[[0, 1, 4]], x[[1, 2, 4]], [0, 0, 0], UNIT), r"measurement 2 joins x4 to itself"),
        (lambda: Between(x[2], x[0:5], [0, 0, 0], UNIT), r"measurement 2 joins x2 to itself"),
        (lambda: Factor.from_function(np.add, [x[0], x[0]], 3), r"measurement 0 joins x0 to itself"),
        (lambda: Factor.from_function(np.add, [x[0], 5], 3), r"expected variables such as .*, got 5"),
    ],
)
def test_factors_that_cannot_be_made(make: Callable[[], Factor], message: str) -> None:
    with pytest.raises(GraphError, match=message) as caught:
        make()
    assert str(caught.value).startswith(f"{caught.value.factor}: ")


def test_the_same_number_of_another_kind_is_another_variable() -> None:
    assert len(Between(x[1], l[1], [0, 0], UNIT)) == 1


def test_unknown_convention() -> None:
    with pytest.raises(
        OptionError, match="convention: 'g20' is not possible; expected one of log, g2o, graphslam, gts"
    ):
        Between(x[0], x[1], [0, 0, 0], UNIT, convention="g20")


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (Prior(x[0], [0, 0], UNIT), r"Prior\(x0\): SE2: elements have shape \(2,\), expected \(n, 3\)"),
        (Prior(x[0:3], np.zeros((2, 3)), UNIT), r"Prior\(x\[0, 1, 2\]\): 2 measurements for 3 sets of variables"),
        (Prior(x[0], [0, np.nan, 0], UNIT), r"Prior\(x0\): SE2: element 0 is .*: a number is not finite"),
        (
            Prior(x[0], [0, 0, 0], UNIT, ("x", "depth")),
            r"components \('x', 'z'\) of SE2, which has \('x', 'y', 'yaw'\)",
        ),
        (Prior(x[0], [0, 0, 0], UNIT, ()), r"components \(\) of SE2"),
        (Prior(x[0], [0, 0, 0], UNIT, ("theta", "yaw")), r"components \('yaw', 'yaw'\) of SE2"),
        (Between(x[0], l[1], [0, 0, 0], UNIT), r"Between\(x0, l1\) joins SE2 and R\(2\); both must be in the same"),
        (Prior(x[7], [0, 0, 0], UNIT), "x7 has no value"),
    ],
)
def test_factors_that_do_not_fit_their_variables(factor: Factor, message: str) -> None:
    with pytest.raises(GraphError, match=message):
        PLANE.gather(factor)


def test_a_quaternion_must_have_length_one() -> None:
    values = Values({x: (SE3, SE3.identity(2))})
    with pytest.raises(GraphError, match=r"Between\(x0, x1\): SE3: element 0 .*quaternion has length 0, expected 1"):
        values.gather(Between(x[0], x[1], np.zeros(7), UNIT))


def test_noise_that_does_not_fit_names_the_measurement() -> None:
    sigmas = np.full((3, 3), 0.1)
    sigmas[2, 2] = -1.0
    with pytest.raises(NoiseModelError, match=r"Prior\(x2\): sigma of yaw, measurement 2, is -1") as caught:
        PLANE.gather(Prior(x[0:3], np.zeros((3, 3)), Diagonal(sigmas)))
    assert (caught.value.index, caught.value.value) == (2, -1.0)
    assert isinstance(caught.value.__cause__, NoiseModelError)
    with pytest.raises(NoiseModelError, match=r"Prior\(x0\): Diagonal: 3 sigmas for a measurement of 1 components"):
        PLANE.gather(Prior(x[0], np.zeros(3), Diagonal([1.0, 1.0, 1.0]), ("yaw",)))


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


def linearize(factor: Factor) -> tuple[tuple[Array, ...], Array]:
    model, X = PLANE.gather(factor)
    return model.linearize(*X)


def test_a_slot_states_its_space() -> None:
    with pytest.raises(GraphError, match=r"Measured: l0 is in R\(2\), this factor needs SE2"):
        linearize(Measured(l[0], np.zeros((1, 2))))


def test_shape_of_the_prediction() -> None:
    with pytest.raises(EvaluationError, match=r"Measured\(x0\): the prediction has shape \(1, 3\), expected \(1, 2\)"):
        linearize(Measured(x[0], np.zeros((1, 3))))


@pytest.mark.parametrize("shape", [(2, 3, 2), (3, 2, 3), (2, 2, 2), (2,), (1, 2, 2, 3)], ids=str)
def test_shape_of_the_jacobians(shape: tuple[int, ...]) -> None:
    with pytest.raises(EvaluationError, match=r"Jacobian of slot 0 has shape .*, expected \(2, 2, 3\)"):
        linearize(Measured(x[0:2], np.zeros((2, 2)), (np.ones(shape),)))


@pytest.mark.parametrize("shape", [(2, 3), (1, 2, 3), (2, 2, 3)], ids=str)
def test_one_jacobian_may_serve_the_batch(shape: tuple[int, ...]) -> None:
    (A,), _ = linearize(Measured(x[0:2], np.zeros((2, 2)), (np.ones(shape),)))
    np.testing.assert_array_equal(A, np.ones((2, 2, 3)))


def test_number_of_the_jacobians() -> None:
    J = np.ones((1, 2, 3))
    for H in ((), (J, J)):
        with pytest.raises(EvaluationError, match=rf"Measured\(x0\): {len(H)} Jacobians, expected 1: one per slot"):
            linearize(Measured(x[0], np.zeros((1, 2)), H))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_residuals_and_jacobians_must_be_finite(bad: float) -> None:
    h = np.array([[0.0, 0.0], [0.0, bad]])
    with pytest.raises(
        EvaluationError, match=r"Measured\(x2\): its residual is not finite: .*check the values"
    ) as caught:
        linearize(Measured(x[[1, 2]], h, (np.ones((2, 3)),)))
    assert (caught.value.factor, caught.value.keys, caught.value.where) == ("Measured", (x[2],), "residual")
    model, X = PLANE.gather(Measured(x[[1, 2]], h))
    with pytest.raises(EvaluationError, match=r"Measured\(x2\): its residual is not finite"):
        model.error(*X)
    H = np.ones((2, 2, 3))
    H[1, 0, 2] = bad
    with pytest.raises(EvaluationError, match=r"Measured\(x2\): its Jacobian with respect to x2 is not finite"):
        linearize(Measured(x[[1, 2]], np.zeros((2, 2)), (H,)))


def test_not_finite_in_a_group_under_full_noise() -> None:
    """No warning of NumPy's comes first: infinity times zero, the wrap of infinity."""

    class Pose(Measured):
        """Its prediction is a pose of the plane."""

        def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
            return SE2

    factor = Pose(x[[0, 1]], np.array([[0, 0, 0.1], [0, np.inf, np.inf]]), noise=SqrtInformation(np.tri(3)))
    factor._z = np.zeros(3)
    with pytest.raises(EvaluationError, match=r"Pose\(x1\): its residual is not finite"):
        linearize(factor)


def test_infinities_that_cancel_are_found() -> None:
    h = np.array([[np.inf, -np.inf]])
    with pytest.raises(EvaluationError, match="residual is not finite"):
        linearize(Measured(x[0], h, (np.ones((2, 3)),)))


def test_huge_residuals_are_finite() -> None:
    _, b = linearize(Measured(x[0], np.full((1, 2), -1e149), (np.ones((2, 3)),)))
    np.testing.assert_array_equal(b, [[1e149, 1e149]])


def test_residuals_whose_square_is_not_a_number_are_named() -> None:
    with pytest.raises(EvaluationError, match=r"Measured\(x0\): its residual is 1e\+308 sigmas, too large for a chi2"):
        linearize(Measured(x[0], np.full((1, 2), -1e308), (np.ones((2, 3)),)))


def raising(*X: Array) -> Array:
    raise KeyError("lost")


@pytest.mark.parametrize(
    ("residual", "jacobians", "cause", "message"),
    [
        (raising, None, KeyError, r"raising\(l\[0, 1\]\): your function raised KeyError: 'lost'"),
        (lambda L: L, raising, KeyError, r"your function raised KeyError: 'lost'"),
        (lambda L: "abc", None, ValueError, r"your function raised ValueError: could not convert string"),
        (lambda L: L, lambda L: 5.0, TypeError, r"your function raised TypeError: .*not iterable"),
        (lambda: 0, None, TypeError, r"your function raised TypeError: .*takes 0 positional arguments"),
    ],
)
def test_exceptions_of_user_code_come_through_chained(
    residual: Callable[..., Array], jacobians: Callable[..., Array] | None, cause: type[Exception], message: str
) -> None:
    with pytest.raises(EvaluationError, match=message) as caught:
        linearize(Factor.from_function(residual, l[0:2], 2, jacobians=jacobians))
    assert isinstance(caught.value.__cause__, cause)
    assert caught.value.keys == (l[0:2],)


@pytest.mark.parametrize(
    ("residual", "jacobians", "message"),
    [
        (lambda L: L[:, 0], None, r"the prediction has shape \(2,\), expected \(2, 2\)"),
        (lambda L: L[:, :1], None, r"the prediction has shape \(2, 1\), expected \(2, 2\)"),
        (lambda L: None, None, r"the prediction has shape \(\), expected \(2, 2\)"),
        (lambda L: L / 0 * np.nan, None, r"\(l0\): its residual is not finite"),
        (
            lambda L: L,
            lambda L: [np.ones((2, 3, 2))],
            r"Jacobian of slot 0 has shape \(2, 3, 2\), expected \(2, 2, 2\)",
        ),
        (lambda L: L, lambda L: [np.eye(2)] * 2, r"2 Jacobians, expected 1: one per slot"),
        (lambda L: L, lambda L: [np.full((2, 2), np.nan)], r"its Jacobian with respect to l0 is not finite"),
    ],
)
def test_what_user_code_may_not_return(
    residual: Callable[..., Array], jacobians: Callable[..., list[Array]] | None, message: str
) -> None:
    with pytest.raises(EvaluationError, match=message), np.errstate(all="ignore"):
        linearize(Factor.from_function(residual, l[0:2], 2, jacobians=jacobians))


def scan(L: Array) -> Array:
    """A square, curved, not symmetric function of a point."""
    a, b = L[:, 0], L[:, 1]
    return np.stack([a * b, np.sin(a) + 3 * b], axis=1)


def scan_jacobian(L: Array) -> Array:
    a, b = L[:, 0], L[:, 1]
    return np.stack([np.stack([b, a], axis=-1), np.stack([np.cos(a), np.full_like(a, 3.0)], axis=-1)], axis=1)


def one_column(J: Array, factor: float) -> Array:
    return J * [1.0, factor]


@pytest.mark.parametrize(
    ("mistake", "cause"),
    [
        (lambda J: -J, "; likely: the sign is flipped"),
        (lambda J: J.mT, "; likely: it is transposed"),
        (lambda J: np.deg2rad(J), "; likely: it is in degrees, or radians are taken for degrees"),
        (lambda J: np.rad2deg(J), "; likely: degrees are taken for radians"),
        (lambda J: J / 2, r"; likely: a factor 2 is missing \(half angles\?\)"),
        (lambda J: 2 * J, r"; likely: there is a factor 2 too many \(half angles\?\)"),
        (lambda J: one_column(J, -1.0), r"; likely, in column\(s\) \[1\]: the sign is flipped"),
        (lambda J: one_column(J, 2.0), r"; likely, in column\(s\) \[1\]: there is a factor 2 too many"),
        (lambda J: J + 0.1, r"central difference [-0-9.e]+ \+- [0-9]e-[01][0-9]$"),
    ],
)
def test_check_jacobians_names_the_likely_cause(mistake: Callable[[Array], Array], cause: str) -> None:
    right = Factor.from_function(scan, l[0:2], 2, jacobians=lambda L: [scan_jacobian(L)])
    assert check_jacobians(right, PLANE) < 1e-8
    wrong = Factor.from_function(scan, l[0:2], 2, Isotropic(0.5), lambda L: [mistake(scan_jacobian(L))])
    with pytest.raises(JacobianError, match=r"^scan\(l[01]\): whitened Jacobian") as caught:
        check_jacobians(wrong, PLANE)
    error = caught.value
    caught.match(cause)
    slot, n, row, column = error.entry
    assert slot == 0
    L = PLANE[l]
    assert error.numeric == pytest.approx(2 * scan_jacobian(L)[n, row, column], rel=1e-6)
    assert error.analytic == pytest.approx(2 * mistake(scan_jacobian(L))[n, row, column], rel=1e-9)
    assert f"residual row {row}, component {'xy'[column]} of l{n}: analytic" in str(error)


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


class Half(Factor):
    """A factor that leaves out what it should not."""

    slots = (SE2,)

    def __init__(self) -> None:
        super().__init__([x[0]], [0.0], Isotropic(1.0))

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(1)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return X[0][:, :1], (None,)


def test_no_jacobian_means_the_identity_and_has_to_be_square() -> None:
    values = Values({x: (SE2, [0.0, 0.0, 0.0])})
    with pytest.raises(EvaluationError, match=r"None for slot 0 means the identity, but its Jacobian is 1 x 3"):
        FactorGraph([Half()]).linearize(values)


def test_slots_have_to_be_stated_for_every_variable() -> None:
    class Forgetful(Half):
        """It does not say what its variable is."""

        slots = ()

    with pytest.raises(GraphError, match=r"Forgetful: its `slots` state 0 spaces, it has 1 variables"):
        FactorGraph([Forgetful()]).chi2(Values({x: (SE2, [0.0, 0.0, 0.0])}))


class Own(Factor):
    """Somebody's first factor: z = X, in the space and with the prediction that a test gives it."""

    slots = (None,)

    def __init__(self, space: object, predict: Callable[[Array], object], n: int = 1) -> None:
        super().__init__([x[0:n]], np.zeros((n, 3)), UNIT)
        self._space, self._predict = space, predict

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return self._space  # type: ignore[return-value]

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return self._predict(X[0])  # type: ignore[return-value]


@pytest.mark.parametrize("space", [3, None, "R(3)", R])
def test_a_space_that_is_none(space: object) -> None:
    with pytest.raises(GraphError, match=r"^Own: its `space` returned .*; expected the space of one measurement, such"):
        PLANE.gather(Own(space, lambda X: (X, None)))


@pytest.mark.parametrize(
    ("predict", "message"),
    [
        (lambda X: X, r"Own\(x0\): its `predict` returned an array of shape \(1, 3\); expected two things"),
        (lambda X: (X,), r"expected two things, .* or None for central differences: return h, None"),
        (lambda X: None, r"`predict` returned None; expected two things, the prediction h, an array of shape \(1, 3\)"),
        (lambda X: (X.tolist(), None), r"`predict` returned \(\[\["),
        (lambda X: (X, np.eye(3)[None]), r"its Jacobians are a ndarray, expected a tuple of arrays, one per slot"),
        (lambda X: (X, (1.0,)), r"Jacobian of slot 0 has shape \(\), expected \(1, 3, 3\)"),
    ],
)
def test_predictions_that_are_none(predict: Callable[[Array], object], message: str) -> None:
    model, X = PLANE.gather(Own(R(3), predict))
    with pytest.raises(EvaluationError, match=message) as caught:
        model.linearize(*X)
    assert (caught.value.factor, [repr(key) for key in caught.value.keys]) == ("Own", ["x0"])


def test_a_factor_of_ones_own_that_is_right() -> None:
    values = Values({x: (R(3), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])})
    for H in (None, (np.eye(3),), [None]):
        model, X = values.gather(Own(R(3), lambda X, H=H: (X, H), 2))  # type: ignore[misc]
        (A,), _ = model.linearize(*X)
        np.testing.assert_allclose(A, np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-8)


@pytest.mark.parametrize(("group", "d"), [(SE2, 2), (SE3, 3)])
def test_check_jacobians_names_the_order_of_columns(group: LieGroup, d: int) -> None:
    (p,) = kinds("p")
    values = Values({p: (group, group.exp(0.3 * np.random.default_rng(0).normal(size=(2, group.dim))))})

    def jacobians(X: Array, shift: int = 0) -> list[Array]:
        J = np.zeros((len(X), d, group.dim))
        J[:, :, :d] = group.world_axes(X)[:, :d, :d]
        return [np.roll(J, shift, axis=2)]

    assert check_jacobians(Factor.from_function(group.position, p[0:2], d, jacobians=jacobians), values) < 1e-8
    first = Factor.from_function(group.position, p[0:2], d, jacobians=lambda X: jacobians(X, group.dim - d))
    with pytest.raises(JacobianError, match=r"its columns are in another order \(translation comes first\)"):
        check_jacobians(first, values)
