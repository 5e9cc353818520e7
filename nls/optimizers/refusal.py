"""Stop rules for trial steps that a damped method refused; signature and order as in `nls.optimizers.stop`."""

from __future__ import annotations

from nls.optimizers.step import Step
from nls.optimizers.stop import CHECK, LIMITS, PLATEAU, Rule, Verdict, levels_off
from nls.optimizers.thresholds import Status

__all__ = ["AFTER_A_REFUSAL", "NO_STEP_LEFT"]

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

STATIONARY = 1e-6  # scaled gradient of a point from which no step leads down, within what chi2 of 16 digits can show


def no_rise(step: Step) -> Verdict | None:
    """chi2 does not rise along the undamped step, as it would from a minimum, even where the Jacobian is singular."""
    return levels_off(step) if step.fall >= 0 or step.rounds(-step.fall) else None


def stationary(step: Step) -> Verdict | None:
    """max_k |A_k'b| / (|A_k| |b|) <= 1e-6."""
    size = step.slope
    if size > STATIONARY:
        return None
    return Verdict(Status.CONVERGED, f"noise floor of 16 digits: no step lowers chi2; scaled gradient {size:.1e}")


def every_step_refused(step: Step) -> Verdict:
    """max_k |A_k'b| / (|A_k| |b|) > 1e-6."""
    return Verdict(Status.STALLED, f"every step was refused, the last one led {step.words}; {CHECK}")


AFTER_A_REFUSAL: tuple[Rule, ...] = (level_refused, promise_small, promise_invisible, *LIMITS)
NO_STEP_LEFT: tuple[Rule, ...] = (no_rise, stationary, every_step_refused)
