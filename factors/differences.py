r"""Jacobians by central differences through retract, the whole batch at once: for a prediction that has none.

A column is differenced with two steps, h and g, and extrapolated (Richardson):

    D(h) = (f(h) - f(-h)) / 2h,      D = D(h) + T,      T = (D(h) - D(g)) / (g^2/h^2 - 1)

g is h times the golden ratio: a period of f that divides one step does not divide the other. A sixth value, f(t) at
t = h/pi, is not used for D. It is compared with the polynomial P of degree 4 through f(0), f(+-h) and f(+-g), so a
structure of f within h is visible. The error of D, measurement by measurement:

    error = rounding / h  +  |delta4| / h  +  |T| max|T| / max|D|  +  |f(t) - P(t)| / t

rounding is twice that of f, and of x times |D|. delta4 = f(g) + f(-g) - 2 f(0) - g^2/h^2 (f(h) + f(-h) - 2 f(0)) is 0
for a smooth f and h -> 0, and otherwise the noise of f or its curvature. |T| is the truncation that was removed; the
rest is assumed to be the same part of |T|. |f(t) - P(t)| counts beyond its own rounding.

The rounding that |f| has is a lower bound alone: 10 - hypot(x - 6, 8) at 0 is 0, its inner numbers are not. The steps
show the rest. Curvature falls with a high power of the step, so |f(t) - P(t)| is far less than |delta4| and |T| h.
Rounding of inner numbers is the same at every step, and in all three. A fine structure of f, unresolved, looks the
same. It is told from noise by smaller steps:

- At one of them f is smooth: a structure. That derivative is right.
- At none of them, down to where f stands still: noise. A larger step is right, the largest that is smooth.

The first step comes from the size of the variable, in its own units, never from |f|. Where the error is too large,
another step is tried. It is smaller where f is curved, rough or not finite, and larger where rounding dominates or f
stands still. Then one between the two is tried. A difference at a larger step is believed only if the one at a smaller
step agrees, within the errors of both, and the noise that smaller steps have met counts at the larger ones.

A column whose error remains above 4e-4 of the change of f is refused by name: a jump, or too few digits. Four are not:

- A kink has the same difference at every step, the mean of both sides, and a slope that does not grow as steps fall.
  At sqrt|x| and cbrt(x) it grows. slope is the largest change of f, by the step.
- A derivative that vanishes, as of x^3 at 0, is as small as its error at every step. The slope bounds it. Where that,
  or the error, falls to 1e-6 of the slope at larger steps, the column is 0. One trial at the largest step shows more.
- A column that is noise, 1e-6 of the largest, is 0: f does not depend on that component.
- An error below 1e-9 of the largest column, or in the rounding of the residual, is nothing.

Not seen is what would take smaller steps at every f. A trial with an error below 1e-3 is believed. A structure or jump
with less than that part of the change of f, such as 1e-12 sin(1e9 x) beside x, counts as noise. |x| at 1e-300 is a kink
at x: steps end near 1e-22. Where a kink or root is in the rounding of f, f stands still at small steps. A plateau looks
the same, and the column may be 0.

Most columns take one trial, 5 evaluations. A column of zeros takes two, one with unknown noise 3 to 8, and a very fine
or flat function up to 14.

Source: J. Lyness, C. Moler, SIAM J. Numer. Anal. 4 (1967); R. Hamming, Introduction to Applied Numerical Analysis,
1971, and J. More, S. Wild, "Estimating computational noise", SIAM J. Sci. Comput. 33 (2011) (the noise of a function
from its table of differences); O. Lepski, Theory Probab. Appl. 35 (1991) (the largest step that all smaller ones
confirm).
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
CERTAIN = 4e-4  # error relative to the change of f above which a column is refused: 4 to 6 times what is really wrong
LIKE = 32.0  # other signs of noise are at most so many times what the sixth value misses by; those of curvature more
FAR, NEAR = 1e3, 16.0  # by how much the next step differs: where this one tells nothing, and where it nearly does
NARROW = 100.0  # ratio of steps, the larger rough, the smaller in the rounding, with nothing between that is better
FAINT = 1e4  # roundings of the residual: an error over the size of the variable that is less leaves a column as it is
NONE = 1e-9  # part of the largest column that is nothing: an error that is less leaves a column as it is
DUST = 1e-6  # an error below this part of the largest column is that of a column that is 0, or nearly
CLOSE = 4.0  # ratio of two steps that need none between
GOLDEN, PART = (1 + 5**0.5) / 2, 1 / np.pi  # g / h and t / h: no period divides all three
SAFE = 4.0  # times the error of a difference is its uncertainty
DEEP = 1e16  # what looks like noise at all steps down to such a part of the first is noise
TRIALS = 14  # at most
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
        The prediction is finite at X, and at no step from there; or a column has too few digits at every step.
    """
    rounding, columns = EPS * sizes(space, h), []
    for slot, manifold in enumerate(manifolds):

        def change(Y: Array, slot: int = slot) -> Array:
            return space.local(h, factor.predict(manifolds, *X[:slot], Y, *X[slot + 1 :])[0])

        columns.append(derivative(change, manifold, X[slot], rounding))
    H, errors, certain = zip(*columns, strict=True)
    if all(sure.all() for sure in certain):
        return H
    extents = [np.maximum(sizes(m, Y), 1.0)[:, None] for m, Y in zip(manifolds, X, strict=True)]
    largest = np.max([np.abs(H_k * s).max(axis=(1, 2)) for H_k, s in zip(H, extents, strict=True)], axis=0)
    for slot, (H_k, error, extent) in enumerate(zip(H, errors, extents, strict=True)):
        nothing = (np.abs(H_k) <= SAFE * error) & (error * extent <= DUST * largest[:, None, None])
        dust = ~certain[slot] & nothing.all(axis=1)  # what the noise of the other columns is in this one
        H_k[np.broadcast_to(dust[:, None], H_k.shape)] = 0.0
        most = (error * extent).max(axis=1)
        faint = (most <= FAINT * rounding.max(axis=1, keepdims=True)) | (most <= NONE * largest[:, None])
        lost = ~(certain[slot] | dust | faint) & np.isfinite(h).all(axis=1, keepdims=True)
        if lost.any():  # where h is not finite, that is refused, by name
            n, d = (int(i) for i in np.argwhere(lost)[0])
            raise _refusal(factor, n, slot, manifolds[slot].components[d], H_k[n, :, d], error[n, :, d])
    return H


def _refusal(factor: Batch, n: int, slot: int, component: str, D: Array, error: Array) -> EvaluationError:
    """The error that names a column without a difference, or with one that is too uncertain."""
    key = factor.keys[slot][[n]]
    column = f"{factor.describe(n)}: no central difference in component {component} of {key}: its prediction"
    why = "is finite here but not beside it, however small the step; move its values into the domain of the function"
    if np.isfinite(D).all():
        uncertain = f"{np.abs(D).max():.3g} is uncertain by {error.max():.1g}, expected {CERTAIN:g} of it"
        why = (
            f"has a jump, a kink or too few digits at every step: {uncertain}; subtract large numbers before small ones"
        )
    message = f"{column} {why}, or give Jacobians"
    return EvaluationError(message, factor.name, [k[[n]] for k in factor.keys], where=f"Jacobian with respect to {key}")


def derivative(
    change: Callable[[Array], Array], manifold: Manifold, X: Array, rounding: Array, first: float = FIRST
) -> tuple[Array, Array, Mask]:
    """Derivative (n, m, dim) by a tangent step of one variable, its error, and which columns are certain (n, dim).

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
    D, error, certain = zip(*columns, strict=True)
    return np.stack(D, axis=2), np.stack(error, axis=2), np.stack(certain, axis=1)


def sizes(manifold: Manifold, X: Array) -> Array:
    """Size (n, dim) of elements by tangent component: of their numbers, of a position in any axes, 1 of an angle."""
    if manifold.dim == manifold.size and not manifold.body_axes:
        return np.where(np.isin(manifold.components, list(ANGLES)), 1.0, np.abs(X))
    size, t = np.ones((len(X), manifold.dim)), manifold.position(X)
    size[:, : t.shape[1]] = np.abs(t).max(axis=1, keepdims=True, initial=0.0)
    return size


class _Trial(NamedTuple):
    """The result of one step.

    Attributes
    ----------
    D, error : (n, m) derivative and its error.
    largest : (n,) the largest D.
    slope : (n,) the largest change of f, by the step.
    bent : (n,) by how much f leaves a polynomial.
    rounded : (n,) whether the known rounding is most of the error, so that a larger step has less.
    noisy : (n,) whether rounding of inner numbers would look like that; or a structure finer than the step.
    silent : (n,) whether f does not change, but for the known rounding.
    """

    D: Array
    error: Array
    largest: Array
    slope: Array
    bent: Array
    rounded: Mask
    noisy: Mask
    silent: Mask


@np.errstate(over="ignore", invalid="ignore")  # what is not finite has no error
def _column(along: Callable[[Array], Array], size: Array, rounding: Array, first: float) -> tuple[Array, Array, Mask]:
    """Derivative (n, m) of f(t) - f(0) at t = 0 (n,), its error, and whether it is certain (n,)."""
    n = len(rounding)
    step = np.where(size > EPS, np.maximum(first * np.cbrt(size), LEAST * size), first)  # 0 has no size: as if 1
    least, natural, most = 4 * EPS * size, 2 * first * np.maximum(size, 1.0), MOST * np.maximum(size, 1.0)
    D, error = np.full(rounding.shape, np.nan), np.full(rounding.shape, np.inf)
    lowest, best, slope = (np.full(n, np.inf) for _ in range(3))  # of the trial that is believed; best: its step
    deepest, shallow, gentle, calm = (np.full(n, np.inf) for _ in range(4))  # least: step at which f moves, slope, gap
    grain, steep = np.zeros(n), np.zeros(n)  # the largest noise, and the largest slope, that a step has met
    silent, noise, steady, firm, certain, climbed = (np.zeros(n, dtype=bool) for _ in range(6))
    going = np.ones(n, dtype=bool)
    low, high = np.zeros(n), np.full(n, np.inf)  # largest step with too much rounding, smallest beyond the smooth part
    top, border = np.zeros(n), np.full(n, np.inf)  # largest step with noise or a fine structure, smallest out of domain
    for k in range(TRIALS):
        step = np.maximum((size + step) - size, least)  # what the variable can move by
        try:
            trial = _trial(along, step, size, rounding)
        except (EvaluationError, SingularGeometryError):
            if k == TRIALS - 1 and np.isnan(D).any():
                raise  # no step stays where f can be evaluated
            high, border = (np.where(going, np.minimum(edge, step), edge) for edge in (high, border))
            step = np.where(going, np.where(low > 0, np.sqrt(low * step), step / FAR), step)
            continue
        if k == 0 and (trial.error.max(axis=1) <= ENOUGH * trial.largest).all() and not trial.silent.any():
            return trial.D, trial.error, going  # most columns
        below, noisy = step < best, trial.noisy
        met = np.where(below | ~(noise | firm), 0.0, grain / step)  # noise of f that smaller steps have met
        unsure = trial.error + met[:, None]
        finite = np.isfinite(unsure).all(axis=1)
        moved = finite & ~trial.silent
        known = np.where(moved, trial.slope, np.nan)
        steep, gentle = np.fmax(steep, known), np.fmin(gentle, known)
        deepest, shallow = np.where(moved & (step < deepest), [step, trial.slope], [deepest, shallow])
        relative = np.where(moved, unsure.max(axis=1) / trial.largest, np.inf)
        doubt = (trial.bent / step + met) / trial.slope
        clear = (relative <= SMOOTH) | (trial.rounded & ((relative <= ROUGH) | (doubt <= SMOOTH)))
        fine = noisy & ~clear & ~trial.rounded & ~noise
        flat = noise & (step > NEAR * top) & (trial.bent <= SAFE * grain)  # no more than smaller steps: not of a kink
        small = trial.silent | trial.rounded | (noisy & ~fine) | flat
        gap, rise = np.abs(trial.D - D).max(axis=1), np.where(below, 1, -1) * (trial.slope - slope)  # at a smaller step
        same = np.maximum(gap, rise) <= CERTAIN * np.minimum(slope, trial.slope)
        kink = fine & (lowest > ROUGH) & (relative > ROUGH) & same
        trusted = np.where((small | kink | (relative <= ROUGH))[:, None], unsure, np.inf)
        new, old = trusted.max(axis=1), error.max(axis=1)
        apart = gap > SAFE * (new + old)
        down = np.where(trial.silent, lowest > ROUGH, (clear & apart) | (relative <= lowest))
        up = (clear & ~firm) | (~apart & (new < old) & ((relative <= lowest) | noise))
        up = np.where(trial.silent, noise & ~firm, up)
        up = np.where(silent, flat | trial.silent | trial.rounded | (relative <= ROUGH), up)
        nearer = kink & below & (gap < calm)
        better = going & ~climbed & (nearer | (np.where(below, down, up) & (clear | ~steady)))
        steady, calm = steady | kink, np.where(nearer, gap, calm)
        small &= better | below | trial.silent | noise
        D[better], error[better], lowest[better] = trial.D[better], trusted[better], relative[better]
        best[better], silent[better], slope[better] = step[better], trial.silent[better], trial.slope[better]
        certain = np.where(better, ~trial.silent & ((doubt <= CERTAIN) | (certain & ~below)), certain)
        firm = np.where(better, clear, firm)
        grain = np.where(better & below & clear, 0.0, grain)  # resolved: what a larger step has met was no noise
        grain = np.where(noisy & ~trial.rounded, np.maximum(grain, trial.bent), grain)
        border = np.where(finite, border, np.minimum(border, step))
        low, high = np.where(small, np.maximum(low, step), low), np.where(small, high, np.minimum(high, step))
        deep, rough = (high <= NARROW * low) | (step <= 2 * least), (step * DEEP <= top) & ~small & ~firm & ~noise
        bottom = (top > step) & ~firm & ~noise & deep
        top, noise = np.where(fine, np.maximum(top, step), top), noise | bottom
        low, high = np.where(bottom, np.maximum(low, top), low), np.where(bottom, border, high)
        wide = small & ~bottom & (step >= 0.9 * np.where(trial.silent, natural, most))
        worth = better | ~small | bottom | ~firm
        going &= (relative > ENOUGH) & ~wide & (high > CLOSE * low) & worth & ~(rough | climbed)
        climbs = (shallow < ROUGH * steep) & ~(going | silent | steady | certain | climbed)
        going, climbed = going | climbs, climbed | climbs
        if not going.any():
            break
        stride = np.where(better & clear, NEAR, FAR)
        larger = np.clip(2 * relative / ENOUGH, NEAR, FAR)  # rounding counts by its part of a step
        after = np.where(small, np.maximum(step * larger, np.where(trial.silent, natural, 0.0)), step / stride)
        after = np.where(bottom, top * FAR, after)
        between = (low > 0) & np.isfinite(high)
        after[between] = np.sqrt(low[between] * high[between])
        step = np.where(going, np.minimum(np.where(climbs, most, after), most), step)
    certain |= silent | (steady & (shallow <= 2 * gentle))  # of a kink; of a root, the slope grows
    bound = np.minimum(shallow, error.max(axis=1))
    vanishes = ~certain & (shallow < ROUGH * steep) & (bound <= DUST * steep) & (np.abs(D) <= SAFE * error).all(axis=1)
    D[vanishes], error[vanishes] = 0.0, bound[vanishes, None]
    return D, error, certain | vanishes


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
    miss, curved = np.abs(e - P), np.abs(delta4) / h + np.abs(T) * (np.abs(T).max(axis=1) / largest)[:, None]
    error = unsure / h + curved + np.maximum(miss - unsure, 0.0) / t
    noise, bent, level = (q.max(axis=1) for q in (unsure / h, curved + miss / t, unsure / h + miss / t))
    silent = (change <= 2 * rounding).all(axis=1)
    slope, most = np.maximum(change.max(axis=1) / h[:, 0], TINY), np.maximum(bent, np.abs(T).max(axis=1))
    rounded, noisy = (bent <= 8 * noise) & ~silent, (most <= LIKE * level) & ~silent
    return _Trial(D, error, largest, slope, bent * h[:, 0], rounded, noisy, silent)
