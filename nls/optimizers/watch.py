"""The memory of one optimization: its history, its best point, and the stop rules applied after every step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from nls.optimizers.result import Iteration
from nls.optimizers.stop import Status, Stop

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.optimizers.undamped import Undamped
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["Watch"]

BOUND = 1e12  # growth of chi2 over the start that no problem of ours comes back from
PATIENCE = 10  # steps without a new best before a return to an earlier chi2 counts as a cycle
ROUND = 20  # steps up and down without a new best, and none above those before: at the limit, no search still going on
SHORTER = 0.99  # an estimate that arrives takes steps that get shorter; on a plateau they do not
PLATEAU = 6  # so many such steps in a row, while chi2 hardly falls; a tail such as exp(-x) gives 11 before rounding
FARTHER = 10  # times update_tol: how far the undamped step may still lead when a damped one is shorter than that
AGREEMENT = 10  # a step that promised a much larger fall than it brought has not converged, it has missed
ALMOST = 10  # times chi2_rtol: a fall not worth a factorization, and ten times that where it is foreseen, with caution
CHECK = "check the Jacobians with factors.check_jacobians"
ROUNDING = 1e-9  # relative difference of chi2 that is no difference
STATIONARY = 1e-6  # scaled gradient of a point from which no step leads down, within what chi2 of 16 digits can show
SHORT = 0.01  # of the estimate, |D x|: an undamped step longer than that has not arrived, however little chi2 falls
PULL = 5.0  # sigmas by which noise hardly pulls an unknown that a solver leaves alone
EPS = 1e-15  # relative rounding of an error: of the numbers whose difference it is


class Watch:
    """Follows an optimizer step by step and says when it is over.

    Parameters
    ----------
    stop : the thresholds.
    callback : called with every `Iteration`; returning True stops.
    values, chi2, seconds : the start.

    Attributes
    ----------
    best, lowest : values of lowest chi2 so far, and that chi2.
    status, reason : None and empty until it is over.
    history : one `Iteration` per step, the start first.
    free : a damped method ended on this singular system; None when nothing is free, or nobody looked.
    """

    def __init__(
        self,
        stop: Stop,
        callback: Callable[[Iteration], bool | None] | None,
        values: Values,
        chi2: float,
        seconds: dict[str, float],
    ) -> None:
        self.stop, self.callback, self.began = stop, callback, perf_counter()
        self.history = [Iteration(0, chi2, seconds=seconds)]
        self.best, self.lowest, self._since_best = values, chi2, 0
        self._start = values
        self._fall, self._running = math.inf, 0  # of the last step; steps in a row that ran along a plateau
        self._longest: Array | float = 0.0  # column of A of each unknown
        self._halted = False  # by the callback, at the latest step
        self.status: Status | None = None
        self.reason = ""
        self.free: LinearSystem | None = None
        self._limits()

    def end(self, status: Status, reason: str) -> None:
        """It is over."""
        self.status, self.reason = status, reason

    def scale(self, system: LinearSystem) -> Array:
        """Lengths of the columns of A (n,), the largest met of each; 1 where none has reacted."""
        self._longest = np.maximum(self._longest, system.column_norms)
        return np.where(self._longest > 0, self._longest, 1.0)

    def flat(self, values: Values, system: LinearSystem, dx: Array) -> bool:
        """Whether the gradient of the current point vanishes, dx its undamped step; it is over then, without a step."""
        gradient = system.scaled_gradient
        self.history[-1] = replace(self.history[-1], gradient=gradient)
        if self.lost(system):
            return True
        if system.chi2 == 0.0 or (gradient <= self.stop.gradient_tol and self._close(values, system, dx)):
            self._settled(values, system, f"scaled gradient {gradient:.1e} <= {self.stop.gradient_tol:g}")
        return self.status is not None

    def step(
        self,
        values: Values,
        system: LinearSystem,
        dx: Array,
        promised: float,
        seconds: dict[str, float],
        damping: float = 0.0,
        undamped: Undamped | None = None,
    ) -> None:
        """Record a step that was taken, and apply the rules to it.

        Parameters
        ----------
        values, system : where it led, and the linearization there.
        dx, promised : the step, and the fall of the linear model's chi2.
        seconds, damping : for the record.
        undamped : for methods that shorten their steps: a short one proves nothing, this has to agree.
        """
        stop, old, chi2 = self.stop, self.history[-1], system.chi2
        fall, little = old.chi2 - chi2, stop.chi2_rtol * old.chi2
        update = float(np.abs(dx).max(initial=0.0))
        new = Iteration(old.number + 1, chi2, update, damping=damping, seconds=seconds)
        self.history.append(new)
        self._since_best += 1
        if chi2 < self.lowest:
            self.best, self.lowest, self._since_best = values, chi2, 0
        missed = undamped is None and promised > AGREEMENT * max(fall, little)
        missed = missed and not self._invisible(promised, values, system)
        still, level = update < stop.update_tol, 0 <= fall <= little and not missed
        ending = level and self._summed(fall, chi2, little)
        shorter, longer = update < SHORTER * old.update, update >= SHORTER * old.update  # neither after the first step
        plateau = ending and longer and (undamped is None or not self._close(values, system, dx))
        self._running = self._running + 1 if plateau else 0
        self._fall = fall
        unseen = self._invisible(promised, values, system)
        exhausted = longer and undamped is None and unseen
        if not chi2 < BOUND * self.history[0].chi2:
            self.end(Status.DIVERGED, f"chi2 {old.chi2:.3g} -> {chi2:.3g} by an update of {update:.3g}")
        elif still and missed:
            said = f"an update of {update:.1e} promised to lower chi2 by {promised:.3g} and brought {fall:.3g}"
            self.end(Status.STALLED, f"{said}; {CHECK}")
        elif still and self._near(values, system, dx, undamped):
            self._settled(values, system, f"max|dx| = {update:.1e} < {stop.update_tol:g}")
        elif ending and shorter and self._agreed(values, system, dx, undamped):
            self._settled(values, system, f"chi2 fell by {fall / old.chi2:.1e} of itself <= {stop.chi2_rtol:g}")
        elif exhausted and self._agreed(values, system, dx, None):
            self._settled(
                values, system, f"steps of {update:.1e} get no shorter, chi2 falls by no more than its rounding"
            )
        elif self._running >= PLATEAU or (unseen and self._leaves(values, system, dx, undamped)):
            self._plateau()
        elif self._cycles(chi2) and not self._invisible(promised, values, system):
            self.end(Status.CYCLING, f"chi2 {chi2:.6g} was met before; the lowest is {self.lowest:.6g}")
        else:
            self._limits()
        self._halted = self.callback is not None and bool(self.callback(new))
        if self._halted and self.status is None:
            self.end(Status.STOPPED, f"after {new.number} iterations")

    def reopen(self) -> None:
        """Not over after all, unless the callback or a limit ends it here."""
        self.status, self.reason = None, ""
        if self._halted:
            self.end(Status.STOPPED, f"after {self.history[-1].number} iterations")
        self._limits()

    @property
    def nearly(self) -> bool:
        """Whether little is left to gain, if the next step gets shorter as the latest did; chi2 falls by its square."""
        if len(self.history) < 3:
            return False
        before, update = self.history[-2].update, self.history[-1].update
        return update < SHORTER * before and self.small(self._fall * (update / before) ** 2 / 10)

    def small(self, fall: float) -> bool:
        """Whether a fall of chi2 is hardly more than what counts as none."""
        return 0 <= fall <= ALMOST * self.stop.chi2_rtol * self.history[-1].chi2

    def last(
        self, values: Values, system: LinearSystem, chi2: float, dx: Array, promised: float, seconds: dict[str, float]
    ) -> bool:
        """Take a step that may be the last; it is forgotten when it is not.

        Parameters
        ----------
        values, chi2 : where it led.
        system : where it came from.
        dx, promised, seconds : as for `step`.
        """
        old, update = self.history[-1], float(np.abs(dx).max(initial=0.0))
        fall, little = old.chi2 - chi2, self.stop.chi2_rtol * old.chi2
        missed = promised > AGREEMENT * max(fall, ROUNDING * chi2) and not self._invisible(promised, values, system)
        ending = 0 <= fall <= little and not missed and self._summed(fall, chi2, little)
        if not (ending and update < SHORTER * old.update and self._close(values, system, dx)):
            return False
        self.history.append(Iteration(old.number + 1, chi2, update, seconds=seconds))
        if chi2 < self.lowest:
            self.best, self.lowest = values, chi2
        self._settled(values, system, f"chi2 fell by {fall / old.chi2:.1e} of itself <= {self.stop.chi2_rtol:g}")
        if self.callback is not None:
            self.callback(self.history[-1])
        return True

    def refuse(
        self, values: Values, system: LinearSystem, dx: Array, promised: float, fall: float, undamped: Undamped
    ) -> None:
        """A trial step was not taken: over when it promised nothing, led along a plateau, or at a limit."""
        little = promised <= self.stop.chi2_rtol * system.chi2 or self._invisible(promised, values, system)
        if self._invisible(abs(fall), values, system) and self._leaves(values, system, dx, undamped):
            self._plateau()
        elif little and self._agreed(values, system, dx, undamped):
            if self._running >= PLATEAU:
                self._plateau()
            else:
                part = promised / system.chi2
                self._settled(values, system, f"no step promises to lower chi2 by more than {part:.1e} of itself")
        else:
            self._limits()

    def stall(self, values: Values, system: LinearSystem, chi2: float, led: str) -> None:
        """No shorter step is left to try: at a minimum within rounding, on a plateau, or because something is wrong.

        Parameters
        ----------
        values, system : the current point.
        chi2 : some way along the undamped step: it rises where a minimum is, even if the Jacobian is singular there.
        led : where the last step led.
        """
        rise = chi2 - system.chi2
        if rise <= 0 or self._invisible(rise, values, system):
            self._plateau()
        elif (gradient := system.scaled_gradient) <= STATIONARY:
            self._settled(values, system, f"no step lowers chi2 within its 16 digits; scaled gradient {gradient:.1e}")
        else:
            self.end(Status.STALLED, f"every step was refused, the last one led {led}; {CHECK}")

    def doubt(self, system: LinearSystem, solver: str) -> None:
        """Converged by the steps of a solver that is not exact: not where the best point, linearized, still pulls.

        A_k'b / |A_k| is what b pulls unknown k by, in sigmas; chi2 would fall by its square along k alone. Noise pulls
        what is left alone by one or two (0.02 as a gradient on `hauv_hull`), so a small gradient cannot be asked for.
        """
        pull, small = system.scaled_gradient * math.sqrt(system.chi2), math.sqrt(AGREEMENT * self.stop.chi2_rtol)
        if pull > PULL and system.scaled_gradient > small:
            self.end(
                Status.STALLED,
                f"{self.reason}, but the measurements still pull one unknown by {pull:.3g} sigmas: chi2 can fall where "
                f"the steps of the linear solver do not lead ({solver})",
            )

    def _summed(self, fall: float, chi2: float, little: float) -> bool:
        """Whether this fall and the latest, continued as a geometric series, add up to little."""
        return fall <= ROUNDING * chi2 or fall**2 <= little * (self._fall - fall)

    def _plateau(self) -> None:
        self.end(
            Status.DIVERGED,
            f"chi2 levels off at {self.history[-1].chi2:.6g} while the steps do not get shorter, "
            f"{self.history[-1].update:.3g} the last: a plateau that falls for ever, no minimum",
        )

    def _near(self, values: Values, system: LinearSystem, dx: Array, undamped: Undamped | None) -> bool:
        """Whether the undamped step is short as well; where something is free, its length says nothing."""
        if undamped is not None:
            dx = undamped.step(system, self.scale(system), strict=True)
            if undamped.free is not None:
                return self._agreed(values, system, dx, undamped)
        short = undamped is None or float(np.abs(dx).max(initial=0.0)) <= FARTHER * self.stop.update_tol
        return short and not self.lost(system) and self._close(values, system, dx)

    def _agreed(self, values: Values, system: LinearSystem, dx: Array, undamped: Undamped | None) -> bool:
        """Whether the undamped step, dx where no other was taken, promises no fall worth it and leads nowhere else."""
        if undamped is not None:
            dx = undamped.step(system, self.scale(system), strict=True)
            promised = float(dx @ system.gradient)
            little = AGREEMENT * self.stop.chi2_rtol * system.chi2
            if promised > little and not self._invisible(promised, values, system):
                return False
        free = undamped is not None and undamped.free is not None  # along what is free any length is as good
        return not self.lost(system) and (free or self._close(values, system, dx))

    def _close(self, values: Values, system: LinearSystem, dx: Array) -> bool:
        """Whether dx is short beside the estimate, or the start: a minimum is near, and no plateau that goes on."""
        D, restrict = self.scale(system), system.pattern.restrict
        sizes = (float(np.linalg.norm(D * restrict(X.coordinates))) for X in (values, self._start))
        length = float(np.linalg.norm(D * dx))
        return any(length <= SHORT * size for size in sizes)

    def _leaves(self, values: Values, system: LinearSystem, dx: Array, undamped: Undamped | None) -> bool:
        """Whether a step that chi2 does not react to is long, and not along something free."""
        if self._close(values, system, dx):
            return False
        if undamped is not None:
            undamped.step(system, self.scale(system), strict=True)
        return undamped is None or undamped.free is None

    def _invisible(self, change: float, values: Values, system: LinearSystem) -> bool:
        """Whether rounding may change chi2 by as much: an error is a difference of numbers as large as |A_k| |x_k|."""
        b, x = math.sqrt(system.chi2), np.abs(system.pattern.restrict(values.coordinates))
        error = EPS * max(b, float((system.column_norms * x).max(initial=0.0)))
        return change <= (2 * b + error) * error

    def visible(self, change: float, values: Values, system: LinearSystem) -> bool:
        """Whether chi2 changes by more than rounding can explain."""
        return change > ROUNDING * system.chi2 and not self._invisible(change, values, system)

    def lost(self, system: LinearSystem) -> bool:
        """Whether an unknown that was measured has lost its last derivative; it is over then."""
        self.scale(system)
        lost = (self._longest > 0) & (system.column_norms == 0)
        if lost.any():
            key, name = system.column(int(np.argmax(lost)))
            self.end(
                Status.DIVERGED,
                f"nothing reacts any more to {name} of {key}, which was measured at the start: the estimate went to a "
                "plateau, where there is no minimum",
            )
        return bool(lost.any())

    def _settled(self, values: Values, system: LinearSystem, rule: str) -> None:
        """CONVERGED where the last point is the best one up to rounding."""
        last = self.history[-1].chi2
        if last <= self.lowest * (1 + ROUNDING) or self._invisible(last - self.lowest, values, system):
            self.end(Status.CONVERGED, rule)
        else:
            above = f"{rule}, but at chi2 {last:.6g}, above the {self.lowest:.6g} met before, which is returned"
            self.end(Status.STALLED, above)

    def _cycles(self, chi2: float) -> bool:
        recent = self.history[-PATIENCE:-1]
        return self._since_best >= PATIENCE and any(abs(chi2 - h.chi2) <= 1e-6 * chi2 for h in recent)

    def _goes_round(self) -> bool:
        """Whether chi2 has gone up and down for long, no lower than the best point and no higher than before."""
        since = [h.chi2 for h in self.history[len(self.history) - self._since_best :]]
        before, latest = since[:-ROUND], since[-ROUND:]
        falls = sum(b < a for a, b in pairwise(latest))
        return len(before) >= ROUND and max(latest) <= max(before) and 0 < falls < ROUND - 1

    def _limits(self) -> None:
        taken, seconds = self.history[-1].number, perf_counter() - self.began
        if self.status is not None:
            return
        if taken >= self.stop.max_iterations and self._goes_round():
            said = f"chi2 has gone up and down for {self._since_best} steps, at {self.history[-1].chi2:.6g} now"
            self.end(Status.CYCLING, f"{said}; the lowest is {self.lowest:.6g}")
        elif taken >= self.stop.max_iterations:
            self.end(Status.MAX_ITERATIONS, f"after {taken} iterations")
        elif seconds > self.stop.max_seconds:
            self.end(Status.MAX_TIME, f"after {seconds:.1f} s")
