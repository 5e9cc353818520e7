r"""The result of an optimization: values, why it stopped, a record of every iteration; and whether noise explains chi2.

One rule judges every result, of a file or a mission, plain or robust. chi2 of d degrees of freedom has the
expectation d. With sigmas that are right it is above its 97.5 % quantile in one of forty cases. Beyond that bound
something is wrong, if little: sigmas a few percent too small do it in a large graph. Above twice its expectation sigmas
are wrong by more than 40 %, or measurements contradict each other. Such a result is implausible.

A robust kernel hides what does not fit: its sum of costs is small whatever was measured. So a robust optimum is judged
by plain chi2 of the measurements that the kernel keeps, and by how many it ignores. A measurement is ignored where

    w(s) <= w(q) / 2,   q the 99 % quantile of chi2 of its numbers

with s its squared whitened residual and w the weight. Noise alone makes fewer than 1 % of these, by any kernel that
gives q a weight. A kernel is for a few wrong rows. Where it ignores more than a quarter of a table it silences a
sensor. Where nothing checks what is left no number tells whether it is right. Both are implausible.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from factors.base import Factor
from models.advice import Advice, listed
from models.algebra import Array, Mask
from models.html_table import html_table
from nls.sparse.pattern import measuring
from nls.values import Values

TWICE = 2.0  # chi2 per degree of freedom
SILENCED = 0.25  # part of a table that may be ignored


class Fit(Enum):
    """How well an optimum fits its measurements; the value says what that means."""

    PLAUSIBLE = "the residuals agree with the stated noise"
    HIGH = "more than noise explains"
    IMPLAUSIBLE = "wrong sigmas, outliers, a local minimum, or a stationary point that is no minimum"


def fit(chi2: float, dof: int, robust: bool = False) -> Fit:
    """How well chi2 agrees with its degrees of freedom.

    Parameters
    ----------
    chi2 : at an optimum; with robust kernels of the measurements that they keep.
    dof : degrees of freedom; 0 or below counts as 1: chi2 is rounding then, or the point is no minimum.
    robust : whether a factor has a robust kernel: a robust optimum is none of chi2, so it may be somewhat higher.

    Examples
    --------
    >>> [fit(chi2, 100).name for chi2 in (90.0, 140.0, 210.0)]
    ['PLAUSIBLE', 'HIGH', 'IMPLAUSIBLE']
    >>> [fit(chi2, 100, robust=True).name for chi2 in (140.0, 210.0)], fit(7.0, 3).name
    (['PLAUSIBLE', 'IMPLAUSIBLE'], 'PLAUSIBLE')
    """
    dof = max(dof, 1)
    if chi2 <= dof or (robust and chi2 <= TWICE * dof):  # most results: SciPy is not imported for these
        return Fit.PLAUSIBLE
    from scipy.special import gammaincc

    if gammaincc(dof / 2, chi2 / 2) >= 0.025:  # within its 97.5 % quantile
        return Fit.PLAUSIBLE
    return Fit.IMPLAUSIBLE if chi2 > TWICE * dof else Fit.HIGH


class Share(NamedTuple):
    """A table of measurements at a robust optimum, and how much of it the kernel ignored.

    Attributes
    ----------
    name : type of factor; odometry and loop closures are two tables.
    ignored, total : measurements.
    numbers : in the ignored ones.
    chi2 : squared whitened residuals of the others, without a kernel.
    """

    name: str
    ignored: int
    total: int
    numbers: int
    chi2: float

    def __str__(self) -> str:
        percent = f" ({100 * self.ignored / self.total:.3g} %)" if self.ignored else ""
        return f"{self.ignored} of {self.total} {self.name}{percent}"


def shares(factors: Sequence[Factor], values: Values, names: Sequence[str] = ()) -> tuple[Share, ...]:
    """How much of every table robust kernels ignored.

    Parameters
    ----------
    factors, values : of the optimum.
    names : of the table of every factor; its type when omitted.

    Examples
    --------
    >>> from factors import Cauchy, Isotropic, Prior, Robust
    >>> from factors.keys import kinds
    >>> from models import R
    >>> (x,) = kinds("x")
    >>> fixes = Prior(x[[0, 0, 0, 0]], [[0.0], [0.1], [0.0], [50.0]], Robust(Isotropic(0.1), Cauchy(1.0)))
    >>> print(*shares([fixes], Values({x: (R(1), [0.0])})))
    1 of 4 Prior (25 %)
    """
    tables: dict[tuple[str, bool], Share] = {}
    for factor, name in zip(factors, names or [factor.name for factor in factors], strict=True):
        out, s, numbers = _ignored(factor, values)
        first, last = factor.keys[0], factor.keys[-1]
        between = first.kind == last.kind and not factor.sequential
        jumps = np.abs(first.numbers - last.numbers) > 1 if between else np.zeros(len(s), dtype=bool)
        for closing in set(jumps.tolist()):
            rows, table = jumps == closing, tables.get((name, closing), Share(name, 0, 0, 0, 0.0))
            count, chi2 = int(out[rows].sum()), float(s[rows & ~out].sum())
            total, lost = table.total + int(rows.sum()), table.numbers + round(numbers * count)
            tables[name, closing] = Share(name, table.ignored + count, total, lost, table.chi2 + chi2)
    of = {True: "closures", False: "of odometry"}
    return tuple(
        share._replace(name=f"{name} {of[closing]}") if (name, not closing) in tables else share
        for (name, closing), share in tables.items()
    )


def _ignored(factor: Factor, values: Values) -> tuple[Mask, Array, float]:
    """Ignored measurements (n,), squared residuals (n,), and how many numbers one measurement has."""
    from scipy.special import chdtri

    s, kernel, model = factor.chi2(values), factor.kernel, values.gather(factor)[0]
    if kernel is None or factor.limit_only:
        return np.zeros(len(s), dtype=bool), s, 0.0
    bound = 0.5 * kernel.weight(np.array([chdtri(model.dim, 0.01)]))  # half the weight at the 99 % quantile q
    return kernel.weight(s) <= bound, s, int(measuring(model).sum()) / max(len(s), 1)


HEADS = ("iteration", "chi2", "max|dx|", "seconds")


class Status(Enum):
    """Why an optimization ended; the value is the sentence shown. Only CONVERGED is success."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "the iteration limit was reached before it converged"
    MAX_TIME = "the time limit was reached before it converged"
    STALLED = "no further step lowers chi2 although its gradient is not small"
    CYCLING = "chi2 goes up and down without falling"
    DIVERGED = "chi2 or the update grew beyond bounds or is not finite"
    STOPPED = "stopped by the callback"
    INTERRUPTED = "interrupted by the user"


class Iteration(NamedTuple):
    """One iteration: the state after its step, and the seconds its parts took.

    Attributes
    ----------
    number : 0 is the start.
    chi2 : after the step.
    update : max |dx| of the step; nan for the start.
    sigmas : |A dx| of the step, its length in units of its own uncertainty; for a damped step the root of the decrease
        that the linear model promised; nan for the start.
    damping : lambda of Levenberg-Marquardt; 0 for Gauss-Newton.
    seconds : by part: linearize, assemble, factorize, solve, retract.
    reused : whether the step was solved with the factorization of the one before.
    """

    number: int
    chi2: float
    update: float = float("nan")
    sigmas: float = float("nan")
    damping: float = 0.0
    seconds: Mapping[str, float] = MappingProxyType({})
    reused: bool = False


Callback = Callable[[Iteration], bool | None]  # True stops


class Attempt(NamedTuple):
    """A method that failed before another one continued from its best point.

    Attributes
    ----------
    method, status, reason : as of a `Result`.
    iterations : steps it took.
    """

    method: str
    status: Status
    reason: str
    iterations: int


@dataclass(repr=False, eq=False)
class Result:
    """The outcome of an optimization; ``print(result)`` shows the table.

    Attributes
    ----------
    values : the estimate of lowest chi2 of all evaluated; never worse than the start.
    status, reason : why it stopped, and the sentence with the numbers.
    converged : True only for `Status.CONVERGED`.
    chi2_initial, chi2_final : |b|^2, without one-half, at the start and at `values`; with robust kernels the sum of
        their costs.
    dof : rows of A that are not all zero, minus the unknowns the gauge leaves free: the expected chi2 at the optimum
        for Gaussian noise.
    history : one `Iteration` per step, the start first.
    linear_solver : the one that ran.
    gauge : the gauge, in words.
    timings : seconds by part, summed over the iterations.
    method : the optimizer; ``gauss-newton, then dogleg`` where the second continued.
    rule : name of the rule that stopped it, a function of `nls.optimizers.stop`.
    last_update : max |dx| of the last step with its unit, variable and component; empty where there was no step.
    attempts : methods that failed before the last one.
    robust : whether a factor has a robust kernel: chi2 of the kept measurements is then compared with its expectation.
    underconstrained : directions that stayed free under a damped method, in words: they are where the start had them.
    shares : of every table at a robust optimum how much the kernel ignored; empty without one.
    """

    values: Values
    status: Status
    reason: str
    history: list[Iteration]
    chi2_initial: float
    chi2_final: float
    dof: int
    linear_solver: str
    gauge: str
    timings: dict[str, float]
    method: str = "gauss-newton"
    rule: str = ""
    last_update: str = ""
    attempts: tuple[Attempt, ...] = ()
    robust: bool = False
    underconstrained: tuple[str, ...] = ()
    shares: tuple[Share, ...] = ()

    @property
    def converged(self) -> bool:
        return self.status is Status.CONVERGED

    @property
    def rises(self) -> int:
        """Steps that raised chi2, of an optimization that ended by itself and did not converge."""
        chi2 = [iteration.chi2 for iteration in self.history]
        ended = self.status in (Status.CONVERGED, Status.STOPPED, Status.INTERRUPTED)
        return 0 if ended else sum(b > a for a, b in pairwise(chi2))

    @property
    def iterations(self) -> int:
        """Steps taken."""
        return len(self.history) - 1

    @property
    def ending(self) -> str:
        """The reason, and the last max|dx|."""
        is_stated = not self.last_update or self.last_update in self.reason
        return self.reason if is_stated else f"{self.reason}; last max|dx| {self.last_update}"

    @property
    def reused(self) -> int:
        """Steps that were solved with the factorization of the one before."""
        return sum(iteration.reused for iteration in self.history)

    @property
    def remarks(self) -> list[str]:
        """Sentences on how the methods went: which failed, which continued, how many steps reused a factorization."""
        remarks = []
        for attempt in self.attempts:
            parts = [f"after {attempt.iterations} iterations", attempt.reason]
            how = ": ".join(dict.fromkeys(parts))  # a limit is both
            went_on = f"{self.method.rpartition('then ')[2]} continued from the lowest point"
            remarks.append(f"{attempt.method} ended as {attempt.status.name} {how}; {went_on}")
        if self.reused:
            remarks.append(f"{self.reused} of {self.iterations} steps reused the last factorization")
        return remarks

    @property
    def believed(self) -> tuple[float, int]:
        """chi2 and its degrees of freedom; with robust kernels those of the measurements that they keep."""
        if not self.shares:
            return self.chi2_final, self.dof
        return sum(share.chi2 for share in self.shares), self.dof - sum(share.numbers for share in self.shares)

    @property
    def ratio(self) -> float:
        """chi2 over its expectation, 1 for noise as stated; nan where nothing checks the measurements."""
        chi2, dof = self.believed
        return chi2 / dof if dof > 0 else float("nan")

    @property
    def fit(self) -> Fit:
        """Whether noise explains chi2; where it is `Fit.IMPLAUSIBLE`, `doubt` says so in words."""
        return Fit.IMPLAUSIBLE if self._silenced else fit(*self.believed, self.robust)

    @property
    def misfit(self) -> str:
        """How many times its expectation chi2 is, and what that means; empty where it is plausible."""
        reasons = self._silenced
        if (verdict := fit(*self.believed, self.robust)) is not Fit.PLAUSIBLE:
            chi2, dof = self.believed
            of = " of the measurements the kernel keeps" if self.shares else ""
            reasons.append(f"chi2{of} is {chi2 / max(dof, 1):.3g} times its expectation: {verdict.value}")
        return "; ".join(reasons)

    @property
    def _silenced(self) -> list[str]:
        """Measurements that a kernel may hide, in words."""
        many = [share for share in self.shares if share.ignored > SILENCED * share.total]
        out = [f"the kernel ignored {share}: too many to be outliers" for share in many]
        if any(share.ignored for share in self.shares) and self.believed[1] <= 0:
            out.append("nothing checks the measurements the kernel keeps")
        return out

    @property
    def doubt(self) -> str:
        """Causes of a chi2 that is implausible, `Fit.IMPLAUSIBLE`; empty where it is not."""
        return self.misfit if self.fit is Fit.IMPLAUSIBLE else ""

    @property
    def advice(self) -> tuple[Advice, ...]:
        """Cures where chi2 is implausible: the way to the cause, and another start where chi2 is far off."""
        if not self.doubt:
            return ()
        explain = Advice("explain", ("nls explain",))
        # sigmas ten times too small are rare, wrong measurements or initial guesses are not
        return (explain, Advice("start")) if self.chi2_final > 100.0 * max(self.dof, 1) else (explain,)

    def __repr__(self) -> str:
        return f"Result({self.status.name}, chi2 {self.chi2_initial:.6g} -> {self.chi2_final:.6g})"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """Number, chi2, update and seconds of every iteration."""
        return [
            (str(i.number), f"{i.chi2:.6g}", f"{i.update:.3e}" if i.number else "", f"{sum(i.seconds.values()):.4f}")
            for i in self.history
        ]

    @property
    def steps(self) -> list[str]:
        """Lines: chi2, update and seconds of every iteration."""
        rows = [HEADS, *self._rows()]
        return [f"{number:>9}  {chi2:>12}  {update:>9}  {seconds:>8}" for number, chi2, update, seconds in rows]

    def _repr_html_(self) -> str:
        return html_table(f"{self.status.name}: {self.ending}", HEADS, self._rows(), [*self.remarks, *self._facts()])

    def __str__(self) -> str:
        return "\n".join([*self.steps, *self.remarks, f"{self.status.name}: {self.ending}", *self._facts()])

    def _facts(self) -> list[str]:
        """Lines: chi2 and how it was reached, free directions, reasons not to trust it."""
        lines = [
            f"chi2 {self.chi2_initial:.6g} -> {self.chi2_final:.6g}, {self.dof} degrees of freedom"
            + (f" (ratio {self.ratio:.3g}, 1 expected)" if self.believed[1] > 0 else "")
            + f"; {self.method}, {self.linear_solver}; gauge: {self.gauge}"
        ]
        if (rises := self.rises) and not self.attempts:
            lines.append(f"chi2 rose in {rises} of {self.iterations} steps; LevenbergMarquardt() accepts no such step")
        if self.underconstrained:
            lines.append(f"free, kept at the initial guess: {'; '.join(self.underconstrained)}")
        if self.shares:
            lines.append(f"ignored by the kernel: {', '.join(map(str, self.shares))}")
        if self.doubt:
            lines += [self.doubt, *(f"  -> {words}" for words in listed(self.advice))]
        return lines
