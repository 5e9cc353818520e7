r"""Powell's dogleg: the Gauss-Newton step, shortened along a bent path where the linear model is not trusted.

    A, b = linearization at X
    gn   = argmin |A dx - b|                                             Gauss-Newton
    c    = alpha D^-2 A'b,  alpha = |D^-1 A'b|^2 / |A D^-2 A'b|^2        Cauchy: lowest point downhill
    dx   = gn                                    if |D gn| <= radius
           radius c / |D c|                      if |D c| >= radius
           c + beta (gn - c), |D dx| = radius    otherwise
    if chi2(X retract dx) < chi2(X):  X = X retract dx;  radius as in Levenberg-Marquardt

D^2 is the diagonal of A'A, each entry the largest met so far (J. More, "The Levenberg-Marquardt algorithm", 1978). One
factorization per linearization, however many steps are tried from it. gn is damped too faintly to matter, except where
the system is singular: there it holds the free directions still, and the result names them. Sources: M. J. D. Powell,
"A hybrid method for nonlinear equations", 1970; J. Nocedal, S. Wright, Numerical Optimization, 2006, section 4.1.
"""

from __future__ import annotations

import math

import numpy as np

from models.algebra import Array
from nls.optimizers.problem import Undamped
from nls.optimizers.trust_region import TrustRegion
from nls.system import LinearSystem


class Dogleg(TrustRegion):
    """A trust region whose trials cost no further factorization: for starts far away.

    Parameters
    ----------
    stop : thresholds; ``max_iterations`` counts the steps that were taken.
    callback : called with every `Iteration`; returning True stops.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Factor
    >>> from models import R
    >>> from nls import Dogleg, FactorGraph, Values, kinds
    >>> (p,) = kinds("p")
    >>> rosenbrock = lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1)
    >>> graph = FactorGraph([Factor.from_function(rosenbrock, p[0], dim=2)])
    >>> result = graph.optimize(Values({p: (R(2), [-1.2, 1.0])}), Dogleg())
    >>> result.converged, result.values[p[0]].round(6)
    (True, array([1., 1.]))
    """

    name = "dogleg"

    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float
    ) -> tuple[Array, float]:
        gn = undamped.step(system, D)
        if float(np.linalg.norm(D * gn)) <= radius:
            return gn, 0.0
        downhill = system.gradient / D**2
        alpha = float(system.gradient @ downhill) / float(np.square(system.times(downhill)).sum())
        c = alpha * downhill
        near = float(np.linalg.norm(D * c))
        if near >= radius:
            return c * (radius / near), 0.0
        p, q = D * c, D * (gn - c)  # |p + beta q|^2 = radius^2, the root between 0 and 1, without cancellation
        a, half, gap = float(q @ q), float(p @ q), radius**2 - float(p @ p)
        root = math.sqrt(half * half + a * gap)
        beta = gap / (half + root) if half > 0 else (root - half) / a
        return np.asarray(c + beta * (gn - c)), 0.0
