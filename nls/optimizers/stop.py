"""When an optimization is over: one rule a function, in lists in the order in which they are asked.

A rule takes a `Step` and returns a `Verdict`, or None where it does not apply; the first verdict ends the optimization.
Each rule is documented by its inequality. The thresholds are those in force, `Stop.in_force`; 0 is one that is off.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

import numpy as np

from nls.optimizers.result import Status
from nls.optimizers.step import ROUNDING, Step

CHECK = "check the Jacobians with factors.check_jacobians"


class Verdict(NamedTuple):
    """The end of an optimization: its status, the sentence with the numbers, and the name of the rule."""

    status: Status
    reason: str
    rule: str = ""


Rule = Callable[[Step], Verdict | None]


def ask(rules: Sequence[Rule], step: Step) -> Verdict | None:
    """The verdict of the first rule that has one; CONVERGED also has to pass the `GUARDS`."""
    for rule in rules:
        if verdict := rule(step):
            verdict = verdict._replace(rule=verdict.rule or rule.__name__)
            guards = GUARDS if verdict.status is Status.CONVERGED else ()
            objections = (guard(step, verdict) for guard in guards)
            return next((objection for objection in objections if objection), verdict)
    return None


# ---- before a step, which is known but not taken


def unknown_lost(step: Step, verdict: Verdict | None = None) -> Verdict | None:
    """|A_k| = 0 for an unknown k that was measured before."""
    measured = step.watch.scaled(step.system) > 0
    lost = measured & (step.system.column_norms == 0)
    if not lost.any():
        return None
    key, name = step.system.column(int(np.argmax(lost)))
    return Verdict(
        Status.DIVERGED,
        f"no measurement depends on {name} of {key} any more, as one did at the initial guess: the estimate is on a "
        "plateau without a minimum",
        "unknown_lost",
    )


def zero(step: Step) -> Verdict | None:
    """chi2 = 0; or A'b = 0, and dx is short."""
    if step.system.chi2 == 0.0:
        return Verdict(Status.CONVERGED, "chi2 is 0")
    if step.slope == 0.0 and step.short:
        return Verdict(Status.CONVERGED, "the scaled gradient is 0")
    return None


def scaled_gradient(step: Step) -> Verdict | None:
    """max_k |A_k'b| / (|A_k| |b|) <= gradient_tol, and dx is short."""
    size, most = step.slope, step.tol.gradient_tol
    if not (0 < size <= most and step.short):
        return None
    return Verdict(Status.CONVERGED, f"scaled gradient {size:.1e}, below {most:g} (gradient_tol)")


# ---- after a step

PLATEAU = 6  # steps on a plateau, one after the other; a tail such as exp(-x) gives 11 before rounding
PATIENCE = 10  # steps without a new best before a return to an earlier chi2 counts as a cycle


def chi2_unbounded(step: Step) -> Verdict | None:
    """chi2 >= 1e12 chi2 of the start, or not finite."""
    if step.chi2 < 1e12 * step.watch.history[0].chi2:  # no problem of ours comes back from there
        return None
    return grown(step)


def grown(step: Step) -> Verdict:
    """DIVERGED, with the last rise of chi2."""
    return Verdict(Status.DIVERGED, f"chi2 {step.old.chi2:.3g} -> {step.chi2:.3g} by an update of {step.update:.3g}")


def promise_missed(step: Step) -> Verdict | None:
    """max|dx| < update_tol, but chi2 fell by less than a tenth of the promise of the linear model."""
    if not (step.still and step.missed):
        return None
    words = f"an update of {step.update:.1e} promised to lower chi2 by {step.promised:.3g} and brought {step.fall:.3g}"
    return Verdict(Status.STALLED, f"{words}; {CHECK}")


def update_norm(step: Step) -> Verdict | None:
    """max|dx| < update_tol, and 10 update_tol for the undamped step of a damped method."""
    if not (step.still and step.near):
        return None
    return Verdict(Status.CONVERGED, f"max|dx| {step.largest}, below {step.tol.update_tol:g} (update_tol)")


def relative_decrease(step: Step) -> Verdict | None:
    """fall <= chi2_rtol chi2, and the sum of falls to come; dx is shorter than before; the undamped step agrees."""
    if not (step.tol.chi2_rtol > 0 and step.ending and step.shorter and step.agreed):
        return None
    ratio = step.fall / step.old.chi2
    return Verdict(Status.CONVERGED, f"relative decrease of chi2 {ratio:.1e}, below {step.tol.chi2_rtol:g} (chi2_rtol)")


def noise_floor(step: Step) -> Verdict | None:
    """max|dx| >= 0.99 of the step before, its promise is within the rounding of chi2, and dx is short."""
    if not (step.undamped is None and step.longer and step.invisible and step.short):
        return None
    return Verdict(
        Status.CONVERGED, f"noise floor of 16 digits: chi2 changes by rounding, max|dx| {step.largest} falls no further"
    )


def plateau(step: Step) -> Verdict | None:
    """fall <= chi2_rtol chi2 and dx no shorter, 6 times in a row; or a long step that chi2 cannot show."""
    if step.watch.level_steps >= PLATEAU or (not step.short and step.invisible and step.leaves):  # the cheapest first
        return levels_off(step)
    return None


def levels_off(step: Step) -> Verdict:
    """DIVERGED, along a plateau."""
    last = step.watch.history[-1]
    return Verdict(
        Status.DIVERGED,
        f"chi2 levels off at {last.chi2:.6g} while the steps do not get shorter, {last.update:.3g} the last: a plateau "
        "that keeps falling, without a minimum",
    )


def cycle(step: Step) -> Verdict | None:
    """No new best for 10 steps, and chi2 within 1e-6 of one of them."""
    watch, chi2 = step.watch, step.chi2
    if watch.since_best < PATIENCE or step.invisible:
        return None
    if not any(abs(chi2 - record.chi2) <= 1e-6 * chi2 for record in watch.history[-PATIENCE:-1]):
        return None
    return Verdict(Status.CYCLING, f"chi2 {chi2:.6g} was met before; the lowest is {watch.lowest:.6g}")


# ---- after a trial step that was refused


def level_refused(step: Step) -> Verdict | None:
    """|fall| is within the rounding of chi2, and dx is long."""
    return levels_off(step) if step.rounds(abs(step.fall)) and step.leaves else None


def promise_small(step: Step) -> Verdict | None:
    """promise <= chi2_rtol chi2, and the undamped step agrees."""
    ratio = step.promised / step.system.chi2
    if not (step.tol.chi2_rtol > 0 and ratio <= step.tol.chi2_rtol and step.agreed):
        return None
    if step.watch.level_steps >= PLATEAU:
        return levels_off(step)
    reason = f"promised relative decrease of chi2 {ratio:.1e}, below {step.tol.chi2_rtol:g} (chi2_rtol)"
    return Verdict(Status.CONVERGED, reason)


def promise_invisible(step: Step) -> Verdict | None:
    """The promise is within the rounding of chi2, and the undamped step agrees."""
    if not (step.invisible and step.agreed):
        return None
    if step.watch.level_steps >= PLATEAU:
        return levels_off(step)
    ratio = step.promised / step.system.chi2
    return Verdict(
        Status.CONVERGED, f"noise floor of 16 digits: no step promises a relative decrease of chi2 above {ratio:.1e}"
    )


# ---- no shorter step is left to try


def no_rise(step: Step) -> Verdict | None:
    """chi2 does not rise along the undamped step, as it would from a minimum, even where the Jacobian is singular."""
    return levels_off(step) if step.fall >= 0 or step.rounds(-step.fall) else None


def stationary(step: Step) -> Verdict | None:
    """max_k |A_k'b| / (|A_k| |b|) <= 1e-6."""
    size = step.slope
    if size > 1e-6:  # more than chi2 of 16 digits can hide
        return None
    return Verdict(Status.CONVERGED, f"noise floor of 16 digits: no step lowers chi2; scaled gradient {size:.1e}")


def every_step_refused(step: Step) -> Verdict:
    """max_k |A_k'b| / (|A_k| |b|) > 1e-6."""
    return Verdict(Status.STALLED, f"every step was refused, the last one led {step.words}; {CHECK}")


# ---- limits

ROUND = 20  # steps up and down without a new best, and none above those before: no search still going on


def up_and_down(step: Step) -> Verdict | None:
    """steps >= max_iterations, and the last 20 went up and down, no lower than the best and no higher than before."""
    watch = step.watch
    since = [record.chi2 for record in watch.history[len(watch.history) - watch.since_best :]]
    before, latest = since[:-ROUND], since[-ROUND:]
    falls = sum(b < a for a, b in pairwise(latest))
    swings = len(before) >= ROUND and max(latest) <= max(before) and 0 < falls < ROUND - 1
    if not (swings and watch.step_count >= watch.limit):
        return None
    words = f"chi2 has gone up and down for {watch.since_best} steps, at {watch.history[-1].chi2:.6g} now"
    return Verdict(Status.CYCLING, f"{words}; the lowest is {watch.lowest:.6g}")


def iteration_limit(step: Step) -> Verdict | None:
    """steps >= max_iterations."""
    count = step.watch.step_count
    return Verdict(Status.MAX_ITERATIONS, f"after {count} iterations") if count >= step.watch.limit else None


def time_limit(step: Step) -> Verdict | None:
    """seconds > max_seconds."""
    seconds = perf_counter() - step.watch.began
    return Verdict(Status.MAX_TIME, f"after {seconds:.1f} s") if seconds > step.watch.stop.max_seconds else None


# ---- where it has converged


def above_the_best(step: Step, verdict: Verdict) -> Verdict | None:
    """chi2 > (1 + 1e-9) of the lowest, and not by rounding."""
    chi2, lowest = step.chi2, step.watch.lowest
    if chi2 <= lowest * (1 + ROUNDING) or step.rounds(chi2 - lowest):
        return None
    above = f"{verdict.reason}, but at chi2 {chi2:.6g}, above the {lowest:.6g} met before, which is returned"
    return Verdict(Status.STALLED, above, "above_the_best")


def pulled(step: Step) -> Verdict | None:
    """|A_k'b| / |A_k| > 5 for an unknown k, where the linear solver is not exact; and its square > 10 chi2_rtol chi2.

    That is the pull of b on unknown k, in sigmas; chi2 would fall by its square along k alone. Noise pulls an unknown
    that is left alone by one or two (0.02 as a gradient on `hauv_hull`). So a small gradient cannot be asked for.
    """
    size = step.slope
    pull = size * math.sqrt(step.system.chi2)
    if not (pull > 5.0 and size > math.sqrt(10 * step.tol.chi2_rtol)):
        return None
    return Verdict(
        Status.STALLED,
        f"{step.watch.reason}, but the measurements still pull one unknown by {pull:.3g} sigmas: chi2 can fall "
        f"in a direction that the linear solver does not step ({step.words})",
    )


Rules = tuple[Rule, ...]
LIMITS: Rules = (up_and_down, iteration_limit, time_limit)
BEFORE_A_STEP: Rules = (unknown_lost, zero, scaled_gradient)
OUTCOMES: Rules = (chi2_unbounded, promise_missed, update_norm, relative_decrease, noise_floor, plateau, cycle)
AFTER_A_STEP = OUTCOMES + LIMITS
AFTER_A_REFUSAL: Rules = (level_refused, promise_small, promise_invisible, *LIMITS)
NO_STEP_LEFT: Rules = (no_rise, stationary, every_step_refused)
AT_THE_END: Rules = (pulled,)
GUARDS = (unknown_lost, above_the_best)
