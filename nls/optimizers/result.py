"""The result of an optimization: values, why it stopped, and a record of every iteration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

from models.advice import Advice, listed
from models.html_table import html_table
from nls.optimizers.fit import SILENCED, Fit, Share, fit
from nls.values import Values

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
    gradient : largest cosine between b and a column of A, after the step; nan where no other was computed from there.
    damping : lambda of Levenberg-Marquardt; 0 for Gauss-Newton.
    seconds : by part: linearize, assemble, factorize, solve, retract.
    reused : whether the step was solved with the factorization of the one before.
    """

    number: int
    chi2: float
    update: float = float("nan")
    gradient: float = float("nan")
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
    robust : whether a factor has a robust kernel: chi2 of what it believes is then compared with its expectation.
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
        """Steps that raised chi2, of an optimization that did not converge."""
        chi2 = [iteration.chi2 for iteration in self.history]
        return 0 if self.converged else sum(b > a for a, b in pairwise(chi2))

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
        """Sentences on how the methods went: which one failed and which continued, what was reused."""
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
        """chi2 and its degrees of freedom; with robust kernels those of the measurements that they believe."""
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
            of = " of the believed measurements" if self.shares else ""
            reasons.append(f"chi2{of} is {chi2 / max(dof, 1):.3g} times its expectation: {verdict.value}")
        return "; ".join(reasons)

    @property
    def _silenced(self) -> list[str]:
        """Measurements that a kernel may hide, in words."""
        many = [share for share in self.shares if share.ignored > SILENCED * share.total]
        out = [f"the kernel ignored {share}, not a few wrong ones" for share in many]
        if any(share.ignored for share in self.shares) and self.believed[1] <= 0:
            out.append("nothing checks the measurements that the kernel believes")
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
        # sigmas ten times too small are rare, wrong measurements or starts are not
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
        """Lines: chi2 and how it was reached, what is free, what is doubtful."""
        lines = [
            f"chi2 {self.chi2_initial:.6g} -> {self.chi2_final:.6g}, {self.dof} degrees of freedom"
            + (f" (ratio {self.ratio:.3g}, 1 expected)" if self.believed[1] > 0 else "")
            + f"; {self.method}, {self.linear_solver}; gauge: {self.gauge}"
        ]
        if (rises := self.rises) and not self.attempts:
            lines.append(f"chi2 rose in {rises} of {self.iterations} steps; LevenbergMarquardt() takes none that do")
        if self.underconstrained:
            lines.append(f"free, left where the start had them: {'; '.join(self.underconstrained)}")
        if self.shares:
            lines.append(f"ignored by the kernel: {', '.join(map(str, self.shares))}")
        if self.doubt:
            lines += [self.doubt, *(f"  -> {words}" for words in listed(self.advice))]
        return lines
