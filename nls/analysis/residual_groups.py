r"""Groups of residuals that share one scale of their sigmas, and estimates of the scales.

The symbols are those of `nls.analysis.variance_components`.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from factors.robust import Kernel
from models.algebra import Array, Index, Mask
from models.errors import OptionError
from models.manifolds.units import unit
from nls.analysis.leave_one_out import Checked, kinds_of
from nls.sparse.pattern import Batch, Pattern, measuring

GROUPS = ("kinds", "units", "components")
EXACT_ROWS, PROBES = 4000, 200  # of T_kl; 200 columns give T_kl to some percent
COLUMNS_AT_ONCE = 256  # solved for together


Parts = list[tuple[int, Index, Index]]  # of some batches some measurements and some of their components


def residual_groups(pattern: Pattern, groups: str) -> dict[str, Parts]:
    """The numbers of every scale, by its name.

    Parameters
    ----------
    pattern : of the graph.
    groups : one of `GROUPS`, see `variance_components`.

    Raises
    ------
    OptionError
        Correlated components that shall have scales of their own.
    """
    out: dict[str, Parts] = {}
    for name, kind in kinds_of(pattern, len(pattern.batches)).items():
        variables = dict.fromkeys(pattern.batches[k].kinds for k, _ in kind)
        for kinds in variables:
            own = [(k, index) for k, index in kind if pattern.batches[k].kinds == kinds]
            full = name if len(variables) == 1 else f"{name} of {', '.join(kinds)}"
            out |= _split(pattern, full, own, groups)
    return out


def _split(pattern: Pattern, name: str, kind: list[tuple[int, Index]], groups: str) -> dict[str, Parts]:
    """One group of a kind, or one for each unit or component."""
    split: dict[str, Parts] = {}
    for k, index in kind:
        model = pattern.batches[k].model
        whole = groups == "kinds" or model.factor.eliminated
        label = ["" if whole else (unit(c) or c) if groups == "units" else c for c in model.names]
        columns = {of: np.flatnonzero([other == of for other in label]) for of in dict.fromkeys(label)}
        if len(columns) > 1 and model.W.ndim == 3:
            information = model.W.mT @ model.W
            apart = np.array(label)[:, None] != np.array(label)
            if (information[:, apart] != 0).any():
                expected = f"'kinds': components of {model.factor!r} are correlated, so they share a scale"
                raise OptionError("groups", groups, expected)
        for own in columns.values():
            full = f"{name}: {', '.join(np.array(model.names)[own])}" if len(columns) > 1 else name
            split.setdefault(full, []).append((k, index, own))
    return split


class Residuals:
    """The residuals of every group, and the estimate of its scale.

    Parameters
    ----------
    checked : the optimum.
    groups : K groups of numbers.

    Attributes
    ----------
    v, r : (K,) squared residuals, corrected for kernels, and redundancies.
    numbers : (K,) numbers that measure something.
    """

    def __init__(self, checked: Checked, groups: Sequence[Parts]) -> None:
        self._factorization, self._A = checked.factorization, checked.linear.system.A
        K, pattern = len(groups), checked.linear.pattern
        self.v, self.numbers, self._spent, self._likeness = np.zeros((4, K))
        self._f = np.zeros((pattern.m, K))
        self._rows = np.zeros((pattern.m, K), dtype=bool)
        for k, parts in enumerate(groups):
            for number, index, columns in parts:
                batch = pattern.batches[number]
                w, e, C = checked.w[number][index], checked.e[number][index], checked.C[number][index]
                beta, likeness = _under_noise(batch, index)
                f = np.sqrt(w / beta)[:, None] * e[:, columns]
                count = measuring(batch.model, columns)[index]
                self.v[k] += np.square(f).sum()
                self.numbers[k] += count.sum()
                self._spent[k] += (w[:, None] * np.diagonal(C, axis1=1, axis2=2)[:, columns]).sum()
                self._likeness[k] += (likeness * count).sum()
                rows = batch.rows.start + index[:, None] * batch.model.dim + columns
                self._f[rows, k], self._rows[rows, k] = f, True
        self.r = self.numbers - self._spent
        self._likeness /= np.maximum(self.numbers, 1)

    def step(self, free: Mask) -> tuple[Array, Array]:
        """Steps of log sigma^2 of the free groups, and standard deviations in whose units they are judged."""
        f, v, r = self._f[:, free], self.v[free], self.r[free]
        g = self._A.T @ f
        F = (np.diag(v) - g.T @ self._factorization.solve(g)) / 2
        eigenvalues, V = np.linalg.eigh(F)
        if not len(F) or eigenvalues[0] <= 0:
            return np.log(v / r), np.sqrt(2 / r)
        step = V @ (V.T @ (v - r) / 2 / eigenvalues)
        sd = np.sqrt(np.square(V) @ (1 / eigenvalues))
        return (step if np.abs(step).max() <= 1.0 else np.log(v / r)), sd  # beyond, Foerstner's step is the safer one

    def covariance(self, free: Mask) -> Array:
        """(K, K) of log sigma^2, the inverse of the expected information; nan for groups that are not free."""
        K = len(free)
        T, chosen = np.zeros((K, K)), np.flatnonzero(free)
        rng = np.random.default_rng(0)
        for l in chosen:
            rows = np.flatnonzero(self._rows[:, l])
            exact = len(rows) <= EXACT_ROWS
            for begin in range(0, len(rows) if exact else PROBES, COLUMNS_AT_ONCE):
                if exact:
                    columns = self._A[rows[begin : begin + COLUMNS_AT_ONCE]].T.toarray()
                else:
                    signs = rng.choice([-1.0, 1.0], (len(rows), min(COLUMNS_AT_ONCE, PROBES - begin)))
                    columns = self._A[rows].T @ (signs / np.sqrt(PROBES))
                squares = np.square(self._A @ self._factorization.solve(columns)).sum(axis=1)
                T[chosen, l] += squares @ self._rows[:, chosen]
        T = (T + T.T) / 2
        N = (np.diag(self.r - self._spent) + T) / 2 * np.multiply.outer(self._likeness, self._likeness)
        out = np.full((K, K), np.nan)
        out[np.ix_(chosen, chosen)] = np.linalg.inv(N[np.ix_(chosen, chosen)])
        return out


def _under_noise(batch: Batch, index: Index) -> tuple[Array, Array]:
    """beta (k,) of the measurements, and the correlation of w(s) s with s: both 1 without a kernel."""
    kernel, m = batch.model.factor.kernel, measuring(batch.model)[index]
    beta, likeness = np.ones((2, len(m)))
    if kernel is not None:
        for number in np.unique(m[m > 0]):
            beta[m == number], likeness[m == number] = _means(kernel, int(number))
    return beta, likeness


@cache
def _means(kernel: Kernel, m: int) -> tuple[float, float]:
    """E[w(s) s] / m and the correlation of w(s) s with s, of s ~ chi2(m)."""
    from scipy.special import gammaincinv

    s = 2 * gammaincinv(m / 2, (np.arange(4000) + 0.5) / 4000)
    ws = kernel.weight(s) * s
    return float(ws.mean() / m), float(np.corrcoef(ws, s)[0, 1])
