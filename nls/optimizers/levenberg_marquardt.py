r"""Levenberg-Marquardt: Gauss-Newton steps, damped until they stay within a radius and lower chi2.

    A, b = linearization at X
    dx   = argmin |A dx - b|^2 + lambda |D dx|^2,  lambda the least one with |D dx| <= radius
    gain = (chi2(X) - chi2(X retract dx)) / fall of chi2 in the linear model
    if gain > 0:     X = X retract dx
    if gain > 3/4:   radius = max(radius, 2.5 |D dx|)
    if gain < 1/4:   radius = 0.4 |D dx|
    if gain <= 0:    radius = 0.99 |D x| at most

D^2 is the diagonal of A'A, each entry the largest met so far. So the damping does not depend on units, and an unknown
that loses its influence is held. A refused step bounds the next one by the size |D x| of the estimate. Where a factor
has kinks (`Factor.damped`) the radius follows success alone.

The radius is met within `BAND`, by the secant of 1 / |D dx| over lambda, which is nearly a line. This takes one or two
factorizations, mostly. A fixed factor on lambda in place of it costs three times as many evaluations of the residuals.
Sources: D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963; J. More, "The
Levenberg-Marquardt algorithm: implementation and theory", 1978.

A small damped step proves nothing: damping makes every step small. Before the method says converged the undamped step
must agree that chi2 cannot fall. Also chi2 must not curve downward along that step, as at a saddle. Where that system
is singular, something is free: the result then says so in `Result.underconstrained`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from models.algebra import Array
from models.options import check_between
from nls.linear.factorization import SingularSystemError
from nls.optimizers.problem import FAINT, HOPELESS, Undamped
from nls.optimizers.trust_region import TrustRegion
from nls.system import LinearSystem

BAND = 0.8, 1.2  # parts of the radius between which |D dx| meets it


@dataclass(frozen=True)
class LevenbergMarquardt(TrustRegion):
    """The damped method: for starts far away, projections, residuals with kinks, and systems with free directions.

    Parameters
    ----------
    stop : thresholds; ``max_iterations`` counts the steps that were taken.
    callback : called with every `Iteration`; returning True stops.
    damping : least lambda of the first step, relative to the diagonal of A'A; a tenth of it for each step that
        follows. When omitted 1e-3 where a factor says that undamped steps fail (`Factor.damped`), otherwise none that
        matters: the Gauss-Newton step comes first.

    Raises
    ------
    OptionError
        A damping that is no number above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Factor
    >>> from models import R
    >>> from nls import FactorGraph, LevenbergMarquardt, Values, kinds
    >>> (p,) = kinds("p")
    >>> rosenbrock = lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1)
    >>> graph = FactorGraph([Factor.from_function(rosenbrock, p[0], dim=2)])
    >>> result = graph.optimize(Values({p: (R(2), [-1.2, 1.0])}), LevenbergMarquardt())
    >>> result.converged, result.values[p[0]].round(6)
    (True, array([1., 1.]))
    """

    damping: float | None = None
    name = "levenberg-marquardt"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping is not None:
            check_between("damping", self.damping, 0, HOPELESS, f"a number above 0 and below {HOPELESS:g}")

    def first_damping(self, kinked: bool) -> float:
        if self.damping is not None:
            return self.damping
        return 1e-3 if kinked else FAINT  # over a kink undamped steps are known to fail

    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float
    ) -> tuple[Array, float]:
        dx, below = undamped.step(system, D), undamped.damping
        length = float(np.linalg.norm(D * dx))
        if not BAND[1] * radius < length < math.inf:
            return dx, below
        above = float(np.linalg.norm(system.gradient / D)) / radius  # |D dx| <= |D^-1 A'b| / lambda
        above = max(above, 1e4 * below)  # but for rounding, where lambda is too faint for a nearly singular system
        old, old_length, trial = below, length, damping or above * radius / length
        for _ in range(10):  # trials of lambda: then the step is tried whatever its length
            damping = trial if below < trial < above else math.sqrt(max(below, 1e-10 * above) * above)
            if not below < damping < above:
                break
            try:
                dx = undamped.problem.solve(system, damping * D**2)
            except SingularSystemError:
                below, trial = damping, math.nan
                continue
            length = float(np.linalg.norm(D * dx))
            if BAND[0] * radius <= length <= BAND[1] * radius:
                break
            below, above = (damping, above) if length > radius else (below, damping)
            slope = (1 / length - 1 / old_length) / (damping - old)
            trial = damping + (1 / radius - 1 / length) / slope if slope > 0 else math.nan
            old, old_length = damping, length
        return dx, damping
