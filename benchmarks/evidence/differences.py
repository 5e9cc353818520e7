"""Numeric Jacobians where the value of the residual says nothing about its rounding: right, refused or wrong?

    python benchmarks/evidence/differences.py [--out DIR]

Own factors by differences at variables from 0 and 1e-16 to 1e6, inner numbers of 1 to 1e8 and residuals of 0 to 1e3, in
R, SE2 and SE3. A column is right within 1e-4 of the exact one. `check_jacobians` gets the exact Jacobian, twice it, 0.
A second table has functions that are flat at the value, that have a kink there, or that have no derivative.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from script import Table, make_page

from factors import Bearing, Between, Factor, Isotropic, Landmark, Range, check_jacobians
from factors.conventions import innovation
from models import SE2, SE3, LieGroup, Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, JacobianError
from nls import Values, kinds

Function = Callable[[Array], Array]
x, l = kinds("x", "l")

VALUES = [0.0, 1e-16, 3e-16, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 30.0, 1e3, 1e6]
INNER = [1.0, 1e2, 1e4, 1e6, 1e8]
RESIDUALS = [0.0, 1e-12, 1e-6, 1.0, 1e3]
BEACONS = np.array([[1, 0, 0.2], [-0.3, 0.9, 0.1], [0.2, -0.8, -0.5], [0.6, 0.6, 0.52]])
RIGHT = 1e-4  # of a column
NOTHING = 1e-6  # part of the largest column below which one is compared with that part
FACTORS = {"landmark": Landmark, "bearing": Bearing, "range": Range}

SINGULAR: dict[str, tuple[Callable[[Array], Array], float]] = {  # of u = x - value; the slope, nan where there is none
    "u^3": (lambda u: u**3, 0.0),
    "u^4": (lambda u: u**4, 0.0),
    "u^5": (lambda u: u**5, 0.0),
    "1e20 u^9": (lambda u: 1e20 * u**9, 0.0),
    "u abs(u)": (lambda u: u * np.abs(u), 0.0),
    "abs(u)^1.5": (lambda u: np.abs(u) ** 1.5, 0.0),
    "u - sin(u)": (lambda u: u - np.sin(u), 0.0),
    "1 - cos(u)": (lambda u: 1 - np.cos(u), 0.0),
    "u^3 + 1e-3 u": (lambda u: u**3 + 1e-3 * u, 1e-3),
    "abs(u), a kink": (np.abs, 0.0),
    "max(u, 0), a kink": (lambda u: np.maximum(u, 0), 0.5),
    "sqrt(abs(u)), steep": (lambda u: np.sqrt(np.abs(u)), np.nan),
    "abs(u)^0.9, steep": (lambda u: np.abs(u) ** 0.9, np.nan),
    "cbrt(u), steep": (np.cbrt, np.nan),
    "sign(u), a jump": (np.sign, np.nan),
}


class Problem(NamedTuple):
    """A residual, and its exact Jacobian at a value."""

    manifold: Manifold
    X: Array
    residual: Function
    jacobian: Function


def ranges(d: int, value: float, inner: float, residual: float) -> Problem:
    """Ranges to beacons in d dimensions; of one dimension to a beacon beside the line."""
    X, B = value * np.array([1, -0.7, 0.4])[:d], inner * (np.array([[0.6]]) if d == 1 else BEACONS[:, :d])
    beside = 0.8 * inner if d == 1 else 0.0

    def distance(X: Array) -> Array:
        return np.asarray(np.sqrt(np.square(B - X[:, None]).sum(axis=2) + beside**2))

    z = distance(X[None])[0] + residual
    return Problem(R(d), X, lambda X: z - distance(X), lambda X: (B - X[:, None]) / distance(X)[..., None])


def wave(value: float, inner: float, residual: float) -> Problem:
    """Sines on a large constant: curved within 1 however large the inner numbers are."""
    w, phase = np.array([1.0, 0.5, 2.0]), np.array([0.2, 0.7, 1.1])
    z = inner + np.sin(w * value + phase) + residual
    return Problem(
        R(1),
        np.array([value]),
        lambda X: z - (inner + np.sin(w * X + phase)),
        lambda X: -(w * np.cos(w * X + phase))[..., None],
    )


def pose(group: LieGroup, value: float) -> Array:
    """A pose at a place of this size."""
    turn = [[0, 0, 0.3]] if group is SE2 else [[0, 0, 0, 0.2, 0.3, -0.5]]
    X = np.array(group.exp(np.array(turn, dtype=float))[0])
    X[: group.point_dim] = value * np.array([1, -0.7, 0.4])[: group.point_dim]
    return X


def seen(kind: str, group: LieGroup, value: float, inner: float, residual: float) -> Problem:
    """A point seen from a pose, by the prediction of a factor of the library."""
    X, d = pose(group, value), group.point_dim
    size = {"landmark": d, "bearing": d - 1, "range": 1}[kind]
    P, factor = (X[:d] + inner * BEACONS[0, :d])[None], FACTORS[kind](x[0], l[0], np.zeros(size), Isotropic(1.0))

    def predicted(X: Array) -> tuple[Array, Array]:
        h, H = factor.predict((group, R(d)), X, np.tile(P, (len(X), 1)))
        assert H is not None
        exact = np.array(H[0])
        if kind == "range":
            exact[:, :, d:] = 0.0  # of a turn, but for rounding
        return h, exact

    z = predicted(X[None])[0]
    return Problem(group, X, lambda X: predicted(X)[0] - z + residual, lambda X: predicted(X)[1])


def step(group: LieGroup, value: float, inner: float, residual: float) -> Problem:
    """A relative pose, with the second pose held."""
    X, turn = pose(group, value), np.full(group.dim - group.point_dim, 0.2)
    Y = group.retract(X[None], np.concatenate([inner * BEACONS[0, : group.point_dim], turn]))
    z = group.between(X[None], Y)

    def function(X: Array) -> Array:
        return innovation(group, group.between(X, np.tile(Y, (len(X), 1))), z, "g2o", False)[0] + residual

    def jacobian(X: Array) -> Array:
        h, H = Between(x[0], x[1], z[0], Isotropic(1.0)).predict((group, group), X, Y)
        J = innovation(group, h, z, "g2o", True)[1]
        assert H is not None
        assert J is not None
        return np.asarray(-J @ np.asarray(H[0]))

    return Problem(group, X, function, jacobian)


def singular(function: Function, slope: float, value: float, residual: float) -> Problem:
    """A function of x less its value: flat there, with a kink, or without a derivative."""
    return Problem(
        R(1), np.array([value]), lambda X: function(X - value) + residual, lambda X: np.full((len(X), 1, 1), slope)
    )


def problems() -> Iterator[tuple[str, Callable[[float, float, float], Problem]]]:
    """Kinds of residuals, by what they are and where."""
    yield from ((f"ranges in R({d})", partial(ranges, d)) for d in (1, 3))
    yield "sines in R(1)", wave
    for group in (SE2, SE3):
        yield from ((f"{kind} in {group}", partial(seen, kind, group)) for kind in FACTORS)
        yield f"relative pose in {group}", partial(step, group)


def by_differences(problem: Problem) -> tuple[str, float, float]:
    """What became of the Jacobian: right, refused or wrong; how far off it is, and evaluations a column."""
    calls = []

    def counted(X: Array) -> Array:
        calls.append(len(X))
        return problem.residual(X)

    exact = problem.jacobian(problem.X[None])[0]
    factor = Factor.from_function(counted, x[0], len(exact))
    model, X = Values({x: (problem.manifold, problem.X)}).gather(factor)
    try:
        (A,), _ = model.linearize(*X)
    except EvaluationError as error:
        named = "component" in str(error) and "x0" in str(error)
        return "refused" if named else "wrong", 0.0, len(calls) / exact.shape[1]
    size = np.abs(exact).max(axis=0)
    off = float((np.abs(A[0] - exact).max(axis=0) / np.maximum(size, NOTHING / RIGHT * (size.max() or 1.0))).max())
    return "right" if off <= RIGHT else "wrong", off, (len(calls) - 1) / exact.shape[1]


def checked(problem: Problem, scale: float) -> str:
    """How `check_jacobians` takes the exact Jacobian times this: passed, refused or doubted."""
    rows = len(problem.jacobian(problem.X[None])[0])
    factor = Factor.from_function(
        problem.residual, x[0], rows, jacobians=lambda X: [scale * np.asarray(problem.jacobian(X))]
    )
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        try:
            check_jacobians(factor, Values({x: (problem.manifold, problem.X)}))
        except JacobianError:
            return "refused"
    return "doubted" if doubts else "passed"


def counted(ends: list[tuple[str, float, float]]) -> list[int]:
    """How many are right, refused and wrong."""
    return [sum(end == which for end, _, _ in ends) for which in ("right", "refused", "wrong")]


def page() -> list[str]:
    """The page without its head."""
    titles = ["residual", "cases", "right", "refused", "wrong", "farthest off", "evaluations a column"]
    table = Table([*titles, "exact: passed / doubted / refused", "wrong: refused / doubted / passed"])
    for name, problem in problems():
        cases = [problem(*numbers) for numbers in product(VALUES, INNER, RESIDUALS)]
        ends = [by_differences(case) for case in cases]
        exact = [checked(case, 1.0) for case in cases]
        wrong = [checked(case, scale) for case in cases for scale in (0.0, 2.0)]
        table.add(
            *(name, len(cases), *counted(ends), f"{max(off for _, off, _ in ends):.0e}"),
            f"{np.mean([calls for _, _, calls in ends]):.1f}",
            " / ".join(str(exact.count(verdict)) for verdict in ("passed", "doubted", "refused")),
            " / ".join(str(wrong.count(verdict)) for verdict in ("refused", "doubted", "passed")),
        )
    singular_table = Table(["function", "slope", "right", "refused", "wrong"])
    for name, (function, slope) in SINGULAR.items():
        ends = [by_differences(singular(function, slope, *numbers)) for numbers in product(VALUES, RESIDUALS)]
        singular_table.add(name, "none" if np.isnan(slope) else f"{slope:g}", *counted(ends))
    return [
        f"Variables of {VALUES[0]:g} and {VALUES[1]:g} to {VALUES[-1]:g}, inner numbers of {INNER[0]:g} to "
        f"{INNER[-1]:g}, residuals of {RESIDUALS[0]:g} to {RESIDUALS[-1]:g}. A column is right within {RIGHT:g} of the "
        f"exact one; one that is less than {NOTHING / RIGHT:g} of the largest, within {NOTHING:g} of that. "
        "`check_jacobians` gets the exact Jacobian, and wrong ones: zeros, and twice the exact one.",
        *table,
        "Functions of u = x - value, with the same values and residuals, in R(1). If the slope is 0, a column is "
        f"right within {NOTHING:g}; at a kink, the mean of both sides is right; without a slope, only a refusal is "
        "right. Wrong are kinks and roots hidden by the rounding of f: f is constant for small steps, as on a "
        "plateau, and the column is 0.",
        *singular_table,
    ]


if __name__ == "__main__":
    make_page("Numerical Jacobians of residuals near 0", page)
