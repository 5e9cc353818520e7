"""Checking a factor's Jacobians against central differences, and naming the likely cause of a difference."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from factors.base import Factor, Model
from factors.check_parts import check_parts
from factors.differences import EPS, FIRST, ROUGH, SAFE, derivative, sizes
from factors.noise import square, whiten
from factors.robust import Kernel
from models.algebra import Array, Mask
from models.errors import GraphError, GraphWarning, JacobianError
from models.listing import several

__all__ = ["check_jacobians"]

VAGUE = 1e-3  # uncertainty of a column, relative to its largest entry, that is worth a warning
ROUNDING = 16 * EPS  # of A, relative to the largest column of its measurement, each times the size of its variable
DUST = 1e-6  # a difference below this part of the same, and of the residual, may be noise where A is 0
OTHER = 0.6 * FIRST  # step of a second difference: what rounding of the first happens to hide, it shows
KERNEL_STEP = 1e-4  # relative step of s: what the difference leaves out is about its square
RTOL, ATOL = 1e-4, 1e-6  # of entries that are those of a cause
RATIOS = {  # of analytic to numeric, without its sign
    np.pi / 180: "it is in degrees, or radians are taken for degrees",
    180 / np.pi: "degrees are taken for radians",
    0.5: "a factor 2 is missing (half angles?)",
    2.0: "there is a factor 2 too many (half angles?)",
}


class Gatherer(Protocol):
    """Values for `check_jacobians`: the bound factor and one stack per slot."""

    def gather(self, factor: Factor) -> tuple[Model, tuple[Array, ...]]: ...


class Graph(Protocol):
    """A graph for `check_jacobians`."""

    @property
    def factors(self) -> Sequence[Factor]: ...


def check_jacobians(factor: Factor | Graph, values: Gatherer, rtol: float = 1e-6) -> float:
    """Compare every A of a factor, or of all of a graph, with minus the derivative of b, `factors.differences`.

    Parameters
    ----------
    factor : a factor, any batch; or a graph.
    values : the point to check at; choose one with non-zero residuals.
    rtol : largest disagreement allowed, relative to the largest entry of its column and measurement.

    Returns
    -------
    float
        The largest relative disagreement of all factors, beyond the uncertainty of the differences. It is exactly 0.0
        where they agree in every digit a difference has, as analytic Jacobians usually do.

    Raises
    ------
    JacobianError
        With the worst entry, both values, and the likely cause (ratio of analytic to difference: sign, degrees,
        factor of 2; transpose, transposed rotation); of a graph that of the factor that disagrees most.
    GraphError
        A robust kernel whose `weight` is not d rho / ds. Neither a factor nor a graph; an array of n rows that the
        class does not declare, `per_measurement` and `shared`; a measurement whose residual changes where the batch is
        cut, reversed or one longer.

    Warns
    -----
    GraphWarning
        A factor without Jacobians of its own: nothing is compared. A column with too few digits in its differences, or
        with none at any step: a mistake of a thousandth would not show. A column lost in the rounding of the others of
        its measurement counts as 0.

    Examples
    --------
    >>> from factors import Between, Isotropic, check_jacobians
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> values = Values({x: (SE2, [[0, 0, 0.3], [1, 2, -0.5]])})
    >>> step = Between(x[0], x[1], [1, 1, 1], Isotropic(0.1))
    >>> check_jacobians(step, values) < 1e-8, check_jacobians(FactorGraph([step]), values) < 1e-8
    (True, True)
    """
    if isinstance(factor, Factor):
        return _check_factor(factor, values, rtol)
    if not hasattr(factor, "factors"):
        raise GraphError(f"check_jacobians: expected a factor or a graph, got {factor!r:.60}")
    largest, errors = 0.0, []
    for member in factor.factors:
        try:
            largest = max(largest, _check_factor(member, values, rtol))
        except JacobianError as error:
            errors.append(error)
    if not errors:
        return largest
    worst = max(errors, key=lambda error: error.deviation)
    if len(errors) > 1:
        others = f"the worst of {several(len(errors), 'factor')} that disagree, of {len(factor.factors)}"
        worst = JacobianError(
            f"{worst.message}; {others}", worst.factor, worst.entry, worst.analytic, worst.numeric, worst.deviation
        )
    raise worst


def _check_factor(factor: Factor, values: Gatherer, rtol: float) -> float:
    """The largest relative disagreement of one factor; errors and warnings as those of `check_jacobians`."""
    model, X = values.gather(factor)
    A, b = model.linearize(*X)
    h, own = factor.predict(model.manifolds, *X)
    if own is None:
        nothing = "predict returns no Jacobians, so central differences are used and there is nothing to compare"
        warnings.warn(f"{factor!r:.200}: {nothing}", GraphWarning, stacklevel=3)
    if factor.kernel is not None:
        _check_kernel(factor.kernel)
    rounding = EPS * (whiten(np.abs(model.W), sizes(model.space, h)[:, model.rows]) + np.abs(b))
    extents = [sizes(m, Y)[:, None, :] for m, Y in zip(model.manifolds, X, strict=True)]
    largest = np.max(
        [np.abs(A_k * s).max(axis=(1, 2), keepdims=True) for A_k, s in zip(A, extents, strict=True)], axis=0
    )  # a variable at 0 adds nothing to the terms of the others
    check_parts(model, X, b, rounding / EPS + largest[:, 0])
    deviations = [0.0]
    for slot, (A_k, manifold) in enumerate(zip(A, model.manifolds, strict=True)):

        def change(Y: Array, slot: int = slot) -> Array:
            return b - model.error(*X[:slot], Y, *X[slot + 1 :])

        numeric, error, certain = derivative(change, manifold, X[slot], rounding)
        again, *_ = derivative(change, manifold, X[slot], rounding, OTHER)
        column = np.abs(A_k).max(axis=1, keepdims=True)
        extent = np.maximum(extents[slot], 1.0)
        most = np.maximum(largest / extent, column)
        floor = ROUNDING * most
        error = SAFE * (error + np.abs(numeric - again)) + floor
        scale = rounding.max(axis=1)[:, None, None] / EPS
        others = [np.abs(A_j * s).max(axis=(1, 2), keepdims=True) for A_j, s in zip(A, extents, strict=True)]
        del others[slot]
        known = np.abs(numeric) * certain[:, None] * extent
        reached = np.max([scale, known.max(axis=(1, 2), keepdims=True), *others], axis=0)
        uncertain = error.max(axis=1, keepdims=True)
        lost = ~certain[:, None] & (uncertain > ROUGH * np.abs(numeric).max(axis=1, keepdims=True))
        lost &= uncertain * extent > DUST * reached
        error[np.broadcast_to(lost, error.shape)] = np.inf
        excess = np.where(np.isfinite(error), np.maximum(np.abs(A_k - numeric) - error, 0.0), 0.0)
        slope = np.abs(numeric).max(axis=1, keepdims=True)
        size = np.fmax(column, slope)
        relative = excess / np.where(size > 0, size, 1.0)
        deviation = float(relative.max(initial=0.0))
        if deviation > rtol:
            n, row, d = (int(i) for i in np.unravel_index(np.argmax(relative), relative.shape))
            analytic, difference = float(A_k[n, row, d]), float(numeric[n, row, d])
            raise JacobianError(
                f"{factor.describe(n)}: whitened Jacobian, residual row {row}, component "
                f"{manifold.components[d]} of {factor.keys[slot][[n]]}: analytic {analytic:.9g}, central "
                f"difference {difference:.9g} +- {error[n, row, d]:.1g}{_likely_cause(A_k, numeric, model.W)}",
                factor.name,
                (slot, n, row, d),
                analytic,
                difference,
                deviation,
            )
        deviations.append(deviation)
        error = np.where(np.isfinite(error), error, np.inf).max(axis=1, keepdims=True)
        matters = (column > floor) | (slope > DUST * np.maximum(most, reached / extent)) | np.isinf(error)
        vague = np.where(matters, error / np.where(size > 0, size, 1.0), 0.0)
        if (vague > VAGUE).any():
            n, _, d = (int(i) for i in np.unravel_index(np.argmax(vague), vague.shape))
            doubt = f"is uncertain by {vague[n, 0, d]:.1g} of the largest entry of its column, so smaller mistakes"
            if not vague[n, 0, d] < 1:
                doubt = "is uncertain by more than the column itself, at every step, so mistakes"
            warnings.warn(
                f"{factor.describe(n)}: component {manifold.components[d]} of {factor.keys[slot][[n]]}: the central "
                f"difference {doubt} cannot be seen; check at other values, or with the variable in another unit",
                GraphWarning,
                stacklevel=3,
            )
    return max(deviations)


def _check_kernel(kernel: Kernel) -> None:
    """Compare weights with central differences of rho, over four decades of s around c^2.

    Raises
    ------
    GraphError
        A weight that is not d rho / ds.
    """
    s = kernel.c**2 * np.logspace(-2.013, 1.987, 41)  # none is c^2, where a weight may jump
    slope = (kernel.rho(s * (1 + KERNEL_STEP)) - kernel.rho(s * (1 - KERNEL_STEP))) / (2 * KERNEL_STEP * s)
    weight = np.asarray(kernel.weight(s), dtype=float)
    k = int(np.argmax(np.abs(weight - slope)))
    if not abs(weight[k] - slope[k]) <= RTOL:
        wrong = f"weight is {weight[k]:.4g} at s = {s[k]:.4g}, where d rho / ds is {slope[k]:.4g}"
        raise GraphError(f"{kernel!r}: {wrong}; expected weight = d rho / ds, s the squared whitened residual")


def _likely_cause(A: Array, numeric: Array, W: Array) -> str:
    """The mistake students most often make that explains the whole Jacobian or its wrong columns.

    Parameters
    ----------
    A, numeric : (n, m, d) whitened Jacobians, analytic and by differences.
    W : the whitener.
    """
    wrong = ~_close(A, numeric).all(axis=(0, 1))
    if not wrong.any():
        return ""
    columns = "" if wrong.all() else f", in column(s) {np.flatnonzero(wrong).tolist()}"
    if ratio := _ratio(A[..., wrong], numeric[..., wrong]):
        return f"; likely{columns}: {ratio}"
    d, causes = A.shape[-1], {}
    if d == A.shape[-2]:
        causes["it is transposed"] = numeric.mT
    if d in (3, 6):  # SE(2), SE(3)
        causes["its columns are in another order (translation comes first)"] = np.roll(numeric, d // 2, axis=-1)
    if (turned := _rotations_transposed(numeric, W)) is not None:
        causes["a rotation in it is transposed"] = turned
    for cause, candidate in causes.items():
        if _close(A, candidate).all():
            return f"; likely: {cause}"
        if _close(A, candidate)[..., wrong].all():
            return f"; likely{columns}: {cause}"
    return ""


def _close(A: Array, candidate: Array) -> Mask:
    """Whether entries (n, m, d) are those of a candidate."""
    return np.isclose(A, candidate, rtol=RTOL, atol=ATOL)


def _ratio(A: Array, numeric: Array) -> str:
    """The ratio of analytic to numeric entries where all have the same, and its cause where it has one; else empty.

    One entry has a ratio by itself, so another than those of `RATIOS` needs two.
    """
    if not numeric.any():
        return ""
    ratio = float((A * numeric).sum() / (numeric * numeric).sum())
    if not _close(A, ratio * numeric).all():
        return ""
    if abs(ratio) < RTOL:
        return "a derivative is left out; the ratio is 0 for all entries"
    causes = ["the sign is flipped"] if ratio < 0 else []
    causes += [cause for size, cause in RATIOS.items() if abs(abs(ratio) / size - 1) < RTOL]
    if not causes and np.count_nonzero(np.abs(numeric) > ATOL) < 2:
        return ""
    return f"{' and '.join(causes) or 'a constant factor'}; the ratio is {ratio:.5g} for all entries"


def _rotations_transposed(numeric: Array, W: Array) -> Array | None:
    """A whitened Jacobian W H with the rotations among the blocks of H transposed; None where there is none.

    H has rotations of vectors, in space (3, 3) or in the plane (2, 2), at rows and columns that are multiples of 3 or
    2. Whitening spoils them, so it is undone.
    """
    W = square(W)
    if (np.linalg.det(W) == 0).any():
        return None
    H = np.asarray(np.linalg.solve(W, numeric), dtype=float)
    for k in (3, 2):
        turned = H.copy()
        for row in range(0, H.shape[1] - k + 1, k):
            for column in range(0, H.shape[2] - k + 1, k):
                block = H[:, row : row + k, column : column + k]
                if np.allclose(block @ block.mT, np.eye(k), atol=1e-6):
                    turned[:, row : row + k, column : column + k] = block.mT
        if not np.allclose(turned, H, atol=1e-6):
            return whiten(W, turned)
    return None
