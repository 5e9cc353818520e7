r"""A clock offset between two sensors: one kind of measurement says where the vehicle was a moment before or after.

A measurement z made at time t + dt and attached to the pose of time t has the residual

    b = A dx + dt A_x v + noise          v the velocity of the pose in its tangent space, A_x the block of the pose

which is one unknown more. With a = A_x v over the rows of a kind, e = b - A dx what the fit leaves, P = (A'A)^-1,

    M = a'a - (A'a)' P (A'a),   dt = M^-1 a'e,   Sigma = M^-1,   fall of chi2 = (a'e)' M^-1 (a'e)  ~  chi2

the score test (C. R. Rao, "Large sample tests of statistical hypotheses", 1948). The velocity is the central difference
of poses that follow each other in number, per step or per second. Sigma and fall are scaled by chi2 / dof of the graph
where that is above 1. The equation is linear in dt: of an offset of many steps it gives the sign and about the size.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from models import SE2, SE3, LieGroup
from models.algebra import Array, Index, Mask, apply
from models.chi_squared import chi2_tail
from nls.analysis.leave_one_out import Checked, checks, kinds_of
from nls.values import Stack, Values

KNOWN = 1e-6  # M / a'a below which the motion is too even to tell an offset from a shift
MEASUREMENTS = 6  # of a kind, at least


@dataclass(frozen=True)
class ClockOffset:
    """A kind of measurement that was made before or after the poses it is attached to.

    Attributes
    ----------
    kind : name of the type of measurement.
    dt : offset: the measurement is of the time of its pose plus dt; in steps.
    sigma : of dt.
    fall : of chi2, when dt is estimated with everything else and the offsets before it.
    chance : of such a fall in one of the kinds that were tested, if there is no offset.
    """

    kind: str
    dt: float
    sigma: float
    fall: float
    chance: float


def clock_offsets(checked: Checked, values: Values, count: int) -> tuple[ClockOffset, ...]:
    """Kinds of measurements whose residuals go with the velocity of the vehicle.

    Parameters
    ----------
    checked : every measurement against all others, at the optimum.
    values : the optimum.
    count : number of factors of the graph; further ones of `checked` hold what is free.

    Returns
    -------
    tuple of ClockOffset
        The largest fall of chi2 first, each the one that chi2 falls most by beside those before. Together they must
        explain half of what noise does not.

    Notes
    -----
    Measurements of one pose and of points or nothing else are tested. At constant velocity in the axes of the body a
    forgotten lever arm ahead looks the same: dt times the speed.
    """
    stacks = {n: s for n, s in values.stacks.items() if s.manifold in (SE2, SE3) and len(s) >= MEASUREMENTS}
    speeds = {name: velocities(stack) for name, stack in stacks.items()}
    pattern = checked.linear.pattern
    slots = [[slot for slot, kind in enumerate(batch.kinds) if kind in speeds] for batch in pattern.batches]
    kinds = {
        name: [(k, slots[k][0]) for k, _ in kind]  # number of the factor, slot of its pose
        for name, kind in kinds_of(pattern, count).items()
        if sum(len(indices) for _, indices in kind) >= MEASUREMENTS and all(len(slots[k]) == 1 for k, _ in kind)
    }
    names = list(kinds)
    if not names:
        return ()
    score, M, determined = _test(checked, list(kinds.values()), speeds)
    duration = [max(len(speeds[pattern.batches[k].kinds[slot]]) for k, slot in kinds[name]) - 1 for name in names]
    chi2 = sum(float((w * np.square(e).sum(axis=1)).sum()) for w, e in zip(checked.w[:count], checked.e, strict=False))
    dof = sum(float(test.dof.sum()) for test in checks(checked, count))
    chosen: list[int] = []
    chances: list[float] = []
    falls: list[float] = []
    while candidates := [j for j in np.flatnonzero(determined).tolist() if j not in chosen]:
        further = [_fall(score, M, [*chosen, j]) - sum(falls) for j in candidates]
        best, fall = candidates[int(np.argmax(further))], max(further)
        scale = max(1.0, (chi2 - sum(falls) - fall) / max(dof - len(chosen) - 1, 1.0))
        chance = min(1.0, len(names) * float(chi2_tail(np.array(fall / scale), np.array(1))))
        if chance > 1e-3:
            break
        chosen, chances, falls = [*chosen, best], [*chances, chance], [*falls, fall]
    if not chosen or sum(falls) < 0.5 * (chi2 - dof):
        return ()
    dt = np.linalg.solve(M[np.ix_(chosen, chosen)], score[chosen])
    scale = max(1.0, (chi2 - sum(falls)) / max(dof - len(chosen), 1.0))
    sigma = np.sqrt(scale * np.diagonal(np.linalg.inv(M[np.ix_(chosen, chosen)])))
    offsets = [
        ClockOffset(names[j], float(d), float(s), fall, chance)
        for j, d, s, fall, chance in zip(chosen, dt, sigma, falls, chances, strict=True)
    ]
    # beyond a tenth of the duration it is no offset of a clock
    sensible = all(abs(o.dt) <= 0.1 * duration[j] for o, j in zip(offsets, chosen, strict=True))
    return tuple(offsets) if sensible else ()


def velocities(stack: Stack) -> Array:
    """Velocity of every pose (n, dim) in its tangent space, per step.

    .. math:: v_k = \\mathrm{Log}(x_{k-1}^{-1} x_{k+1}) / 2

    Parameters
    ----------
    stack : poses, two at least; the order of their numbers is that of time.

    Examples
    --------
    >>> velocities(Stack("x", SE2, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.arange(3))).tolist()
    [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    group = stack.manifold
    assert isinstance(group, LieGroup)
    order = np.argsort(stack.numbers, kind="stable")
    v = np.zeros((len(order), group.dim))
    v[order] = central_differences(group, stack.X[order], np.arange(len(order)))
    return v


def central_differences(group: LieGroup, X: Array, t: Array | Index) -> Array:
    """Velocities (n, dim) of poses X (n, size) at rising times t (n,), over the steps before and after each."""
    place = np.arange(len(X))
    before, after = np.maximum(place - 1, 0), np.minimum(place + 1, len(place) - 1)
    return np.asarray(group.log(group.between(X[before], X[after])) / (t[after] - t[before])[:, None])


def _test(
    checked: Checked, kinds: list[list[tuple[int, int]]], speeds: Mapping[str, Array]
) -> tuple[Array, Array, Mask]:
    """Scores a'e (q,), M (q, q), and which offsets the motion determines (q,)."""
    pattern = checked.linear.pattern
    score, size, columns = np.zeros(len(kinds)), np.zeros(len(kinds)), np.zeros((pattern.n, len(kinds)))
    for j, factors in enumerate(kinds):
        products = [[np.zeros((len(b), m.dim)) for m in b.model.manifolds] for b in pattern.batches]
        for k, slot in factors:
            batch, w = pattern.batches[k], checked.w[k][:, None]
            a = apply(checked.linear.A[k][slot], speeds[batch.kinds[slot]][batch.index[slot]])
            products[k] = [w * np.vecmat(a, A) for A in checked.linear.A[k]]
            score[j] += float((w * a * checked.e[k]).sum())
            size[j] += float((w * a * a).sum())
        columns[:, j] = pattern.by_column(products)
    M = np.diag(size) - columns.T @ checked.factorization.solve(columns)
    return score, (M + M.T) / 2, np.diagonal(M) > KNOWN * size


def _fall(score: Array, M: Array, chosen: list[int]) -> float:
    """Fall of chi2 with some offsets as unknowns; 0 where the motion does not distinguish them."""
    block = M[np.ix_(chosen, chosen)]
    unit = np.sqrt(np.outer(np.diagonal(block), np.diagonal(block)))
    if np.linalg.eigvalsh(block / unit)[0] < KNOWN:
        return 0.0
    return float(score[chosen] @ np.linalg.solve(block, score[chosen]))
