"""When an optimization is over: one rule a function, in lists in the order in which they are asked.

A rule takes a `Step` and returns a `Verdict`, or None where it does not apply; the first verdict ends the optimization.
Each rule is documented by its inequality. One of them is the stop rule: `update_sigmas`. The others end what it cannot.
"""

import math
from collections.abc import Callable, Sequence
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


def rounding(step: Step) -> Verdict | None:
    """|A dx|^2, with the steps to come, is within the rounding of chi2 and dx short; where it is long, a plateau.

    Not while shorter steps serve `update_tol`. Nor while those of a damped method get shorter: near a saddle chi2 does
    not show the first of those that leave it.
    """
    if not step.invisible:
        return None
    if step.leaves:
        return levels_off(step)
    last = step.sigmas == 0 or step.longer or (step.tolerance > 0 and step.undamped is None)
    return hidden(step) if last and step.rounds(step.sigmas_to_come**2) and step.agreed else None


def exact_fit(step: Step) -> Verdict | None:
    """|b| <= 1e-12 |b| of the start, and 1e-3 sqrt(max(dof, 1)); dx is short: nothing is left of what did not fit."""
    least = min(1e-24 * step.watch.chi2_initial, 1e-6 * max(step.watch.dof, 1))
    if not (step.system.chi2 <= least and step.short):
        return None
    return Verdict(Status.CONVERGED, f"exact fit: of chi2 {step.watch.chi2_initial:.3g} only {step.chi2:.1e} is left")


def hidden(step: Step) -> Verdict:
    """CONVERGED, as chi2 has no digits left."""
    return Verdict(
        Status.CONVERGED, f"noise floor of 16 digits: chi2 changes by rounding, |A dx| is {step.sigmas:.1e} sigmas"
    )


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


def update_sigmas(step: Step) -> Verdict | None:
    """|A dx| and the steps to come <= update_sigmas sqrt(min(chi2, max(dof, 1))); dx is shorter than before."""
    return small(step) if step.ending and step.fall >= 0 and step.shorter and step.agreed else None


def small(step: Step) -> Verdict:
    """CONVERGED, with |A dx| and its threshold."""
    share, rtol = step.watch.stop.share, step.watch.stop.chi2_rtol or 0.0
    by_fall = rtol > 0 and step.tolerance == math.sqrt(rtol * step.old.chi2)  # of two the one that stops first
    name = f"chi2_rtol {rtol:g}" if by_fall else f"update_sigmas {share:g}"
    return Verdict(Status.CONVERGED, f"|A dx| {step.sigmas:.1e} sigmas, at most {step.tolerance:.1e} ({name})")


def promise_missed(step: Step) -> Verdict | None:
    """max|dx| < update_tol, but chi2 fell by less than a tenth of the promise of the linear model."""
    missed = step.undamped is None and step.promised > 10 * max(step.fall, 0.0)
    if not (step.still and missed and not step.invisible):
        return None
    words = f"an update of {step.update:.1e} promised to lower chi2 by {step.promised:.3g} and brought {step.fall:.3g}"
    return Verdict(Status.STALLED, f"{words}; {CHECK}")


def update_norm(step: Step) -> Verdict | None:
    """max|dx| < update_tol, and 10 update_tol for the undamped step of a damped method."""
    if not (step.still and step.near):
        return None
    return Verdict(Status.CONVERGED, f"max|dx| {step.largest}, below {step.watch.stop.update_tol:g} (update_tol)")


def plateau(step: Step) -> Verdict | None:
    """|A dx| is small and dx no shorter, 6 times in a row."""
    return levels_off(step) if step.watch.level_steps >= PLATEAU else None


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


def refused_small(step: Step) -> Verdict | None:
    """|A dx| is small, or chi2 cannot show it, and the undamped step agrees."""
    if not ((step.sigmas <= step.tolerance or step.invisible) and step.agreed):
        return None
    if step.watch.level_steps >= PLATEAU:
        return levels_off(step)
    return hidden(step) if step.invisible else small(step)


# ---- no shorter step is left to try


def no_rise(step: Step) -> Verdict | None:
    """chi2 does not rise along the undamped step, as it would from a minimum, even where the Jacobian is singular."""
    return levels_off(step) if step.fall >= 0 or step.rounds(-step.fall) else None


def stationary(step: Step) -> Verdict | None:
    """max_k |A_k'b| / (|A_k| |b|) <= 1e-6."""
    size = step.system.scaled_gradient
    if size > 1e-6:  # more than chi2 of 16 digits can hide
        return None
    return Verdict(Status.CONVERGED, f"noise floor of 16 digits: no step lowers chi2; scaled gradient {size:.1e}")


def every_step_refused(step: Step) -> Verdict:
    """max_k |A_k'b| / (|A_k| |b|) > 1e-6."""
    return Verdict(Status.STALLED, f"every step was refused, the last one led {step.words}; {CHECK}")


# ---- limits


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
    """|A_k'b| / |A_k| > 5 for an unknown k, where the linear solver is not exact; and > 3 times the threshold.

    That is the pull of b on unknown k, in sigmas; chi2 would fall by its square along k alone. Noise pulls an unknown
    that is left alone by one or two (0.02 as a gradient on `hauv_hull`). So a small gradient cannot be asked for.
    """
    pull = step.system.scaled_gradient * math.sqrt(step.system.chi2)
    if not pull > max(5.0, 3 * step.tolerance):
        return None
    return Verdict(
        Status.STALLED,
        f"{step.watch.reason}, but the measurements still pull one unknown by {pull:.3g} sigmas: chi2 can fall "
        f"in a direction that the linear solver does not step ({step.words})",
    )


Rules = tuple[Rule, ...]
LIMITS: Rules = (iteration_limit, time_limit)
BEFORE_A_STEP: Rules = (unknown_lost, exact_fit, rounding)
OUTCOMES: Rules = (chi2_unbounded, update_sigmas, promise_missed, update_norm, plateau, cycle)
AFTER_A_STEP = OUTCOMES + LIMITS
AFTER_A_REFUSAL: Rules = (level_refused, refused_small, *LIMITS)
NO_STEP_LEFT: Rules = (no_rise, stationary, every_step_refused)
AT_THE_END: Rules = (pulled,)
GUARDS = (unknown_lost, above_the_best)
