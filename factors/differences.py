r"""Jacobians by central differences through retract, the whole batch at once: for a prediction that has none.

A column is differenced with two steps, h and g, and extrapolated (Richardson):

    D(h) = (f(h) - f(-h)) / 2h,      D = D(h) + T,      T = (D(h) - D(g)) / (g^2/h^2 - 1)

g is h times the golden ratio: a period of f that divides one step does not divide the other. A sixth value, f(t) at
t = h/pi, is not used for D. It is compared with the polynomial P of degree 4 through f(0), f(+-h) and f(+-g), so a
structure of f within h is seen. The error of D, measurement by measurement:

    error = rounding / h  +  |delta4| / h  +  |T| max|T| / max|D|  +  |f(t) - P(t)| / t

rounding is twice that of f, and of x times |D|. delta4 = f(g) + f(-g) - 2 f(0) - g^2/h^2 (f(h) + f(-h) - 2 f(0)) is 0
for a smooth f and h -> 0, and otherwise the noise of f or its curvature. |T| is the truncation that was removed; the
rest is assumed to be the same part of |T|. |f(t) - P(t)| counts beyond its own rounding.

The first step comes from the size of the variable. Where the error is too large, another step is tried. It is smaller
where f is not smooth within g or not finite, and larger where rounding dominates. Then one between the two is tried. A
difference at a larger step is believed only if the one at a smaller step agrees, within the errors of both; else the
smaller step is right. Most columns take one trial, 5 evaluations; factors of poses take 6.3 on average, of parameters
of unknown scale about 13, and a noisy or very fine function up to 45.

Source: J. Lyness, C. Moler, SIAM J. Numer. Anal. 4 (1967); R. Hamming, Introduction to Applied Numerical Analysis,
1971 (the noise of a function from its table of differences); O. Lepski, Theory Probab. Appl. 35 (1991) (the largest
step that all smaller ones confirm).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from factors.return_values import Batch
from models import Manifold
from models.algebra import Array, Mask
from models.errors import EvaluationError, SingularGeometryError
from models.manifolds.units import ANGLES

__all__ = ["EPS", "derivative"]

EPS = float(np.finfo(float).eps)
FIRST = 5e-4  # first step of a variable of size 1: eps^(1/5), where rounding balances what extrapolation leaves
LEAST = 1e-7  # first step at least, relative to the size: rounding of the variable leaves 9 digits
ENOUGH = 4e-9  # error relative to the largest entry of the column of a measurement that needs no other step
SMOOTH = 1e-3  # relative error above which f may not be smooth within g, so that the error tells little
MOST = 0.5  # step at most, relative to the size of the variable or, where that is less, to 1
ROUGH = 0.1  # relative error above which it is no error at all, unless it is rounding
FAINT = 1e6  # a change of f by so many roundings may still be noise of its inner numbers
FAR, NEAR = 1e3, 16.0  # by how much the next step differs: where this one tells nothing, and where it nearly does
CLOSE = 4.0  # ratio of two steps that need none between
GOLDEN, PART = (1 + 5**0.5) / 2, 1 / np.pi  # g / h and t / h: no period divides all three
SAFE = 4.0  # times the error of a difference is its uncertainty
TRIALS = 9  # at most, from 5e-4 to 5e-28
TINY = float(np.finfo(float).tiny)


def central_differences(
    factor: Batch, manifolds: tuple[Manifold, ...], space: Manifold, X: tuple[Array, ...], h: Array
) -> tuple[Array, ...]:
    """H_k (n, dim, dim_k) of h(X [+] d) = h [+] H d, one per variable.

    Parameters
    ----------
    factor, manifolds, space : the factor, the spaces of its variables and of its measurement.
    X, h : the stacks (n, size_k), and the prediction there.

    Raises
    ------
    EvaluationError
        The prediction is finite at X, and at no step from there.
    """
    rounding = EPS * sizes(space, h)
    H = []
    for slot, manifold in enumerate(manifolds):

        def change(Y: Array, slot: int = slot) -> Array:
            return space.local(h, factor.predict(manifolds, *X[:slot], Y, *X[slot + 1 :])[0])

        H_k, _ = derivative(change, manifold, X[slot], rounding)
        lost = ~np.isfinite(H_k)
        lost[~np.isfinite(h).all(axis=1)] = False  # refused as such, by name
        if lost.any():
            n, _, d = (int(i) for i in np.argwhere(lost)[0])
            key = factor.keys[slot][[n]]
            raise EvaluationError(
                f"{factor.describe(n)}: no central difference in component {manifold.components[d]} of {key}: its "
                "prediction is finite here but not beside it, however small the step; move its values into the domain "
                "of the function, or give Jacobians",
                factor.name,
                [k[[n]] for k in factor.keys],
                where=f"Jacobian with respect to {key}",
            )
        H.append(H_k)
    return tuple(H)


def derivative(
    change: Callable[[Array], Array], manifold: Manifold, X: Array, rounding: Array, first: float = FIRST
) -> tuple[Array, Array]:
    """Derivative (n, m, dim) with respect to a tangent step of one variable, and its uncertainty (n, m, dim).

    Parameters
    ----------
    change : f(Y) - f(X), (n, m), of a stack Y (n, size).
    manifold, X : of the variable.
    rounding : (n, m) of f.
    first : step to begin with, of a variable of size 1.
    """
    size = sizes(manifold, X)
    columns = []
    for d, unit in enumerate(np.eye(manifold.dim)):

        def along(t: Array, unit: Array = unit) -> Array:
            return change(manifold.retract(X, t[:, None] * unit))

        columns.append(_column(along, size[:, d], rounding, first))
    D, U = (np.stack(parts, axis=2) for parts in zip(*columns, strict=True))
    return D, U


def sizes(manifold: Manifold, X: Array) -> Array:
    """Size (n, dim) of elements by tangent component: of their numbers, of a position in any axes, 1 of an angle."""
    if manifold.dim == manifold.size and not manifold.body_axes:
        return np.where(np.isin(manifold.components, list(ANGLES)), 1.0, np.abs(X))
    size, t = np.ones((len(X), manifold.dim)), manifold.position(X)
    size[:, : t.shape[1]] = np.abs(t).max(axis=1, keepdims=True, initial=0.0)
    return size


class _Trial(NamedTuple):
    """What one step gives.

    Attributes
    ----------
    D, error : (n, m) derivative and its error.
    relative : (n,) the largest error, relative to the largest D.
    rounded : (n,) whether most of it is rounding, so that a larger step has less.
    silent : (n,) whether f does not change, but for rounding.
    """

    D: Array
    error: Array
    relative: Array
    rounded: Mask
    silent: Mask


def _column(along: Callable[[Array], Array], size: Array, rounding: Array, first: float) -> tuple[Array, Array]:
    """Derivative (n, m) of f(t) - f(0) at t = 0 (n,), and its error."""
    n = len(rounding)
    step = np.where(size > EPS, np.maximum(first * np.cbrt(size), LEAST * size), first)  # 0 has no size: as if 1
    most = MOST * np.maximum(size, 1.0)
    D, error = np.full(rounding.shape, np.nan), np.full(rounding.shape, np.inf)
    lowest, best_step, going = np.full(n, np.inf), np.full(n, np.inf), np.ones(n, dtype=bool)
    silent = np.zeros(n, dtype=bool)
    low, high = np.zeros(n), np.full(n, np.inf)  # largest step with too much rounding, smallest beyond the smooth part
    for k in range(TRIALS):
        step = np.maximum((size + step) - size, 4 * EPS * size)  # what the variable can move by
        try:
            trial = _trial(along, step, size, rounding)
        except (EvaluationError, SingularGeometryError):
            if k == TRIALS - 1 and np.isnan(D).any():
                raise  # no step stays where f can be evaluated
            high = np.where(going, np.minimum(high, step), high)
            step = np.where(going, step / FAR, step)
            continue
        relative, rounded = trial.relative, trial.rounded
        new, old = trial.error.max(axis=1), error.max(axis=1)
        apart, below = np.abs(trial.D - D).max(axis=1) > SAFE * (new + old), step < best_step
        apart &= ~trial.silent & ~silent  # no change at all may be the rounding of inner numbers
        better = going & np.where(below, apart | (relative <= lowest), ~apart & (new < old) & (relative <= lowest))
        D[better], error[better] = trial.D[better], trial.error[better]
        lowest[better], best_step[better], silent[better] = relative[better], step[better], trial.silent[better]
        low, high = np.where(rounded, np.maximum(low, step), low), np.where(rounded, high, np.minimum(high, step))
        wide = rounded & (step >= np.where(trial.silent, 2 * first * np.maximum(size, 1.0), most))
        worth = better | ~rounded | (below & (lowest > SMOOTH))  # not smooth, and no better: noise, or a fine structure
        going &= (relative > ENOUGH) & ~wide & (high > CLOSE * low) & worth
        if not going.any():
            break
        stride = np.where(better & (relative <= SMOOTH), NEAR, FAR)
        after = np.where(rounded, np.minimum(step * stride, most), step / stride)
        between = (low > 0) & np.isfinite(high)
        after[between] = np.sqrt(low[between] * high[between])
        step = np.where(going, after, step)
    return D, error


@np.errstate(all="ignore")  # a step may leave the domain of f
def _trial(along: Callable[[Array], Array], step: Array, size: Array, rounding: Array) -> _Trial:
    h, g, t = (((size + k * step) - size)[:, None] for k in (1.0, GOLDEN, PART))
    a, b, c, d, e = (along(x[:, 0]) for x in (h, -h, g, -g, t))
    change, ratio = np.abs([a, b, c, d, e]).max(axis=0), (g / h) ** 2
    T = ((a - b) / (2 * h) - (c - d) / (2 * g)) / (ratio - 1)
    D = np.where(change <= 2 * rounding, 0.0, (a - b) / (2 * h) + T)
    largest = np.maximum(np.maximum(np.abs(D), np.abs(T)).max(axis=1), TINY)
    unsure = 2 * (rounding + EPS * (size[:, None] + 2 * h) * np.abs(D))
    delta4, u = c + d - ratio * (a + b), (t / h) ** 2
    P = t * (D - u * T) + u * (a + b) / 2 + u * (u - 1) * delta4 / (2 * ratio * (ratio - 1))
    miss = np.maximum(np.abs(e - P) - unsure, 0.0) / t
    noise = unsure / h
    bent = np.abs(delta4) / h + np.abs(T) * (np.abs(T).max(axis=1) / largest)[:, None] + miss
    worst = (noise + bent).max(axis=1)
    relative = np.where(np.isfinite(worst), worst / largest, np.inf)
    faint = change.max(axis=1) <= FAINT * rounding.max(axis=1)
    rounded = (bent.max(axis=1) <= 8 * noise.max(axis=1)) | faint
    error = np.where((rounded | (relative <= ROUGH))[:, None], noise + bent, np.inf)
    return _Trial(D, error, relative, rounded, (change <= 2 * rounding).all(axis=1))
