r"""The measurements, one by one and by kind: against the prediction of all others.

    t_i = e_i' (I - C_i)^-1 e_i  ~  chi2(m_i)      under the model, without measurement i (w_i = 1)
    dof = sum_i m_i - tr(w_i C_i)                  of a kind: its numbers, less what it has spent on the unknowns

With a weight w_i < 1 of a robust kernel the covariance of the residual without i is

    (I - w_i C_i)^-1 (I + (1 - w_i) C_i)

In the axes of C_i, with eigenvalues c, both are sums. Where 1 - w c vanishes nothing else checks that direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_gate
from nls.analysis.linearization import Checked
from nls.posegraph import closures, odometry
from nls.sparse.pattern import Batch, Pattern, measuring

UNCHECKED = 1e-6  # redundancy; an error there must be a thousand sigmas to leave one in the residual
UNSEEN_REDUNDANCY = 1e-9  # redundancy of a direction; what is less is rounding


@dataclass(frozen=True)
class Tested:
    """The measurements of one batch.

    Attributes
    ----------
    t : (k,) squared distance from the prediction of all others, in its sigmas.
    m : (k,) numbers that all others check, the degrees of freedom of t.
    rows : (k,) numbers that measure something.
    dof : (k,) share of the degrees of freedom of chi2.
    checked : (k,) whether all its numbers are checked.
    """

    t: Array
    m: Index
    rows: Index
    dof: Array
    checked: Mask


def tested(batch: Batch, e: Array, C: Array, w: Array) -> Tested:
    """t and redundancy of the measurements of a batch, from residuals e (k, m), C (k, m, m) and weights (k,)."""
    t, r = left_out(e, C, w)
    redundant, rows = r > UNCHECKED, measuring(batch.model)
    idle = C.shape[1] - rows  # zero rows: nothing spent, nothing redundant
    m = np.maximum(redundant.sum(axis=1) - idle, 0)
    return Tested(t, m, rows, r.sum(axis=1) - idle, np.asarray(redundant.all(axis=1)))


def left_out(e: Array, C: Array, w: Array) -> tuple[Array, Array]:
    """t (k,) and redundancy along the axes of C (k, m), from residuals e (k, m), C (k, m, m) and weights (k,)."""
    c, V = np.linalg.eigh(C)
    r = 1 - w[:, None] * c
    along = np.square(np.matvec(V.mT, e))
    variance = np.where(r > UNCHECKED, r * (1 + (1 - w)[:, None] * c), np.inf)
    return (along / variance).sum(axis=1), r


def kinds_of(pattern: Pattern, count: int) -> dict[str, list[tuple[int, Index]]]:
    """Measurements by kind: factor type, relative poses in steps and closures if there are both; (batch, indices)."""
    out: dict[str, list[tuple[int, Index]]] = {}
    split = list(zip(pattern.batches, odometry(pattern), closures(pattern), strict=True))[:count]
    mixed = {batch.model.factor.name for batch, _, closing in split if closing.any()}
    for k, (batch, along, closing) in enumerate(split):
        name = batch.model.factor.name
        if batch.model.factor.limit_only:
            continue
        sides = {name: np.ones(len(batch), dtype=bool)}
        if name in mixed:
            sides = {f"{name}, steps": along, f"{name}, closures": closing, name: ~along & ~closing}
        for side, mask in sides.items():
            if mask.any():
                out.setdefault(side, []).append((k, np.flatnonzero(mask)))
    return out


def spoiled(tests: list[Tested], kind: list[tuple[int, Index]]) -> float:
    """By what the variances of a kind are too small, judged by the middle one of its t, which outliers do not move.

    nan where there are too few to say.
    """
    t = np.concatenate([tests[k].t[indices] for k, indices in kind])
    m = np.concatenate([tests[k].m[indices] for k, indices in kind])
    if (m > 0).sum() < 3:
        return float("nan")
    return middle_variance(t[m > 0], m[m > 0])


def middle_variance(t: Array, m: Index) -> float:
    """The middle one of some squared distances t (n,), each over the median of chi2 of its m (n,) numbers, m > 0."""
    medians = np.ones(int(m.max()) + 1)
    medians[1:] = [chi2_gate(d, 0.5) for d in range(1, len(medians))]
    return float(np.median(t / medians[m]))


def checks(checked: Checked, count: int) -> list[Tested]:
    """Of every batch of measurements."""
    batches = checked.linear.pattern.batches[:count]
    return [tested(*arguments) for arguments in zip(batches, checked.e, checked.C, checked.w, strict=False)]
