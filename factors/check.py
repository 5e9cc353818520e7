"""Checking a factor's Jacobians against central differences, and naming the likely cause of a difference."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from factors.base import Factor, Model
from factors.differences import STEP, difference_steps
from models.algebra import Array
from models.errors import JacobianError

__all__ = ["check_jacobians"]

EPS = float(np.finfo(float).eps)


class Gatherer(Protocol):
    """What `check_jacobians` needs of values: the bound factor and one stack per slot."""

    def gather(self, factor: Factor) -> tuple[Model, tuple[Array, ...]]: ...


def check_jacobians(factor: Factor, values: Gatherer, rtol: float = 1e-6) -> float:
    """Compare every A of a factor with minus the central difference of b.

    Parameters
    ----------
    factor : the factor, any batch.
    values : the point to check at; choose one with non-zero residuals.
    rtol : largest difference allowed beyond rounding, relative to the largest entry of that Jacobian.

    Returns
    -------
    float
        The largest relative difference found, less what the rounding of b leaves of a central difference: exactly 0.0
        where they agree in every digit a difference has, as analytic Jacobians usually do.

    Raises
    ------
    JacobianError
        With the worst entry, both values, and the likely cause (sign, transpose, degrees, factor of 2).

    Examples
    --------
    >>> from factors import Between, Isotropic, check_jacobians
    >>> from models import SE2
    >>> from nls import Values, kinds
    >>> (x,) = kinds("x")
    >>> values = Values({x: (SE2, [[0, 0, 0.3], [1, 2, -0.5]])})
    >>> check_jacobians(Between(x[0], x[1], [1, 1, 1], Isotropic(0.1)), values) < 1e-8
    True
    """
    model, X = values.gather(factor)
    A, b = model.linearize(*X)
    worst, largest = 0.0, max((float(np.abs(A_k).max(initial=0.0)) for A_k in A), default=0.0)
    for slot, A_k in enumerate(A):
        steps = difference_steps(model.manifolds[slot], X[slot])
        numeric = numerical(model, X, slot, steps)
        difference = np.abs(A_k - numeric)
        scale = float(np.abs(numeric).max(initial=0.0))
        # what rounding of b and of the coordinates leaves of a central difference says nothing about the Jacobian
        coordinate = (steps / STEP) ** 3
        rounding = 10 * EPS / steps[:, None, :] * (np.abs(b)[:, :, None] + scale * coordinate[:, None, :])
        excess = np.maximum(difference - rounding, 0.0)
        size = max(scale, 1e-3 * largest)  # a Jacobian of zeros has no scale of its own
        found = float(excess.max(initial=0.0)) / size if size else 0.0
        if found > rtol:
            n, row, column = (int(i) for i in np.unravel_index(np.argmax(excess), excess.shape))
            analytic, other = float(A_k[n, row, column]), float(numeric[n, row, column])
            manifold = model.manifolds[slot]
            raise JacobianError(
                f"{factor.describe(n)}: whitened Jacobian, residual row {row}, component "
                f"{manifold.components[column]} of {factor.keys[slot][[n]]}: analytic {analytic:.9g}, central "
                f"difference {other:.9g}{_likely_cause(A_k, numeric)}",
                factor.name,
                (slot, n, row, column),
                analytic,
                other,
            )
        worst = max(worst, found)
    return worst


def numerical(model: Model, X: tuple[Array, ...], slot: int, steps: Array) -> Array:
    """Minus the central difference of b with respect to a tangent step of one slot, (n, m, dim)."""
    manifold = model.manifolds[slot]
    A = np.empty((len(model.z), model.dim, manifold.dim))
    for d in range(manifold.dim):
        delta = np.zeros((len(model.z), manifold.dim))
        delta[:, d] = steps[:, d]
        moved = []
        for sign in (1.0, -1.0):
            Y = list(X)
            Y[slot] = manifold.retract(X[slot], sign * delta)
            moved.append(model.error(*Y))
        A[:, :, d] = -(moved[0] - moved[1]) / (2 * steps[:, d : d + 1])
    return A


def _likely_cause(A: Array, numeric: Array) -> str:
    """What students most often got wrong, when it explains the whole Jacobian or one of its columns."""
    causes = {
        "the sign is flipped": -numeric,
        "it is in degrees, or radians are taken for degrees": np.deg2rad(numeric),
        "degrees are taken for radians": np.rad2deg(numeric),
        "a factor 2 is missing (half angles?)": numeric / 2,
        "there is a factor 2 too many (half angles?)": numeric * 2,
    }
    d = A.shape[-1]
    if d == A.shape[-2]:
        causes["it is transposed"] = numeric.mT
    if d in (3, 6):  # SE(2), SE(3)
        causes["its columns are in another order (translation comes first)"] = np.roll(numeric, d // 2, axis=-1)
    for cause, candidate in causes.items():
        if np.allclose(A, candidate, rtol=1e-4, atol=1e-6):
            return f"; likely: {cause}"
        columns = np.isclose(A, candidate, rtol=1e-4, atol=1e-6).all(axis=(0, 1))
        wrong = ~np.isclose(A, numeric, rtol=1e-4, atol=1e-6).all(axis=(0, 1))
        if wrong.any() and columns[wrong].all():
            return f"; likely, in column(s) {np.flatnonzero(wrong).tolist()}: {cause}"
    return ""
