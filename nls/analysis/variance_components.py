r"""One scale on the sigmas of every kind of measurement, from the residuals: Helmert's variance components.

The noise of kind k has the covariance sigma_k^2 Sigma_k: Sigma_k is stated, the scale sigma_k unknown. With rows
whitened by the current scales, P = (A'A)^-1, hat matrix A P A', residuals e = (I - A P A') b at the optimum, and E_k
the rows of kind k,

    v_k = e'E_k e,    r_k = tr((I - A P A') E_k),    sum r_k = degrees of freedom.

The likelihood of the residuals alone (restricted maximum likelihood) is largest where v_k = r_k for every kind, the
fixed point of Helmert and Foerstner, sigma_k^2 <- sigma_k^2 v_k / r_k. That step serves while scales are wrong by much;
near the end Newton's step in log sigma_k^2 serves, with the average of observed and expected information,

    d = F^-1 (v - r) / 2,    F_kl = e'E_k (I - A P A') E_l e / 2,

which costs one solution a kind. Steps that go on as the one before are lengthened by their geometric series. After
every step the graph is linearized and optimized again, until no step is above 2 % of its standard deviation. The
covariance of log sigma^2 is the inverse of the expected information,

    N_kl = tr((I - A P A') E_k (I - A P A') E_l) / 2 = (delta_kl (r_k - t_k) + T_kl) / 2,
    T_kl = |E_k A P A' E_l|_F^2,    t_k = tr(A P A' E_k),

so kinds that share their redundancy are uncertain together. The standard deviation of sigma_k is sigma_k
sqrt((N^-1)_kk) / 2; with one kind it is sigma_k / sqrt(2 r). T_kl is exact up to 4,000 rows of a kind; beyond, A' E_l
is multiplied by 200 random columns of signs, whose mean is T_kl.

A robust kernel weighs e with w(s), s = |e_i|^2 of m numbers, at the optimum. The sum of w s is compared with its mean
under Gaussian noise: without outliers the scale is right, and an outlier adds no more than the largest w s,

    v_k = sum w_i |e_i|^2 / beta(m_i),    beta(m) = E[w(s) s] / m,    s ~ chi2(m),

and N_kl is reduced by the correlations of w(s) s with s. This is Huber's second proposal for the scale.

Sources: F. R. Helmert, "Die Ausgleichungsrechnung nach der Methode der kleinsten Quadrate", 2nd ed., 1907; W.
Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten", Allgemeine Vermessungs-Nachrichten 86,
1979; A. Gilmour, R. Thompson, B. Cullis, "Average information REML", Biometrics 51, 1995; P. Teunissen, A.
Amiri-Simkooei, "Least-squares variance component estimation", Journal of Geodesy 82, 2008; P. Huber, "Robust estimation
of a location parameter", Annals of Mathematical Statistics 35, 1964, proposal 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from factors.base import Factor
from factors.rescaled import rescaled
from models.algebra import Array
from models.errors import GraphError, OptionError
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import UNCHECKED, Checked
from nls.analysis.residual_groups import GROUPS, Parts, Residuals, residual_groups
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.linear import LinearSolver
from nls.optimizers import Optimizer, Result, Status
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.values import Values, refuse_other

LEAST_REDUNDANCY = 1.0  # redundancy: one number of its own that a scale is estimated from


@dataclass(frozen=True)
class VarianceComponent:
    """The scale of one kind of measurement.

    Attributes
    ----------
    name : of the kind: ``Range``, ``Between, steps``, with groups ``Between: yaw``.
    measurements, numbers : of the kind: how many, and the numbers in them.
    redundancy : numbers of it that check the estimate, r_k.
    scale : on the stated sigmas; 1 where the data do not tell it.
    sigma : standard deviation of the scale; nan where the data do not tell it.
    known : whether the data tell the scale. If not, the stated sigmas are kept.
    """

    name: str
    measurements: int
    numbers: int
    redundancy: float
    scale: float
    sigma: float
    known: bool

    def __str__(self) -> str:
        redundancy = f"{round(self.redundancy, 6) + 0.0:.3g}" if self.redundancy < 100 else f"{self.redundancy:.0f}"
        share = f"redundancy {redundancy} of {self.numbers} numbers"
        if not self.known:
            unchecked = self.redundancy < LEAST_REDUNDANCY
            reason = "no other measurement checks them" if unchecked else "their errors cannot be detected"
            return f"{self.name}: stated sigmas kept, {reason} ({share})"
        return f"{self.name}: stated sigmas times {self.scale:.3g} +- {self.sigma:.2g} ({share})"


@dataclass(frozen=True, eq=False)
class VarianceComponents:
    """Scales of all kinds of measurements; ``print`` gives one line a kind.

    Attributes
    ----------
    components : one a kind.
    correlation : (K, K) between the logarithms of the scales; nan where one is not known.
    graph : the measurements with rescaled noise, under the kernels they had.
    result : its optimum.
    scales : (n, m) or (1, m) by factor of the graph given, on the sigmas of every component.
    rounds : optimizations.
    settled : whether the scales stopped changing, at an optimum.
    """

    components: tuple[VarianceComponent, ...]
    correlation: Array
    graph: FactorGraph
    result: Result
    scales: tuple[Array, ...]
    rounds: int
    settled: bool

    def rescaled(self, graph: FactorGraph) -> FactorGraph:
        """Another graph of the same factors, such as one without kernels, with rescaled noise."""
        pattern = Pattern(graph.factors, self.result.values)
        factors = [rescaled(batch.model, s) for batch, s in zip(pattern.batches, self.scales, strict=True)]
        return FactorGraph(factors, graph.fixed)

    def __str__(self) -> str:
        return "\n".join(map(str, self.components))


@single_thread()
def variance_components(
    graph: FactorGraph,
    values: Values,
    groups: Literal["kinds", "units", "components"] = "kinds",
    optimizer: Optimizer | None = None,
    linear_solver: LinearSolver | None = None,
    gauge: str = "first",
) -> VarianceComponents:
    """Scales on the stated sigmas that the residuals show, with their standard deviations.

    Parameters
    ----------
    graph : measurements with stated sigmas, which fix the ratios within a kind. It stays as it is.
    values : a start near the optimum.
    groups : one scale for each of these.

        - ``kinds``: kinds of measurements: type of factor, steps and closures apart, kinds of variables apart.
        - ``units``: as kinds, lengths (m), angles (rad) and other numbers apart.
        - ``components``: as kinds, every component apart.
    optimizer, linear_solver, gauge : as in `FactorGraph.optimize`.

    Returns
    -------
    VarianceComponents

    Raises
    ------
    OptionError
        No such groups; components that are correlated and shall have scales of their own.
    GraphError
        Weights or scales that differ too much for A'A.
    UnderconstrainedError
        The measurements leave something free.

    Notes
    -----
    A kind keeps its stated sigmas where its redundancy is below 1, or would be at the scale that fits. Examples are
    priors that nothing checks, or a yaw of odometry too exact for the others to check. Errors are taken for
    independent. The residuals show only a part of errors that last (a bias, a wrong speed of sound). With such errors
    the covariances stay too small.

    Examples
    --------
    A track of 300 poses along a line; odometry is three times worse than stated, fixes are as stated:

    >>> import numpy as np
    >>> from factors import Between, Isotropic, Prior
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds, variance_components
    >>> rng, (x,) = np.random.default_rng(0), kinds("x")
    >>> truth = np.arange(300.0)[:, None]
    >>> odometry = Between(x[:299], x[1:300], np.diff(truth, axis=0) + rng.normal(0, 0.3, (299, 1)), Isotropic(0.1))
    >>> fixes = Prior(x[:300], truth + rng.normal(0, 0.5, (300, 1)), Isotropic(0.5))
    >>> print(variance_components(FactorGraph([odometry, fixes]), Values({x: (R(1), truth)})))
    Between: stated sigmas times 2.7 +- 0.33 (redundancy 77.5 of 299 numbers)
    Prior: stated sigmas times 1 +- 0.057 (redundancy 221 of 300 numbers)
    """
    refuse_other("variance_components", graph, values)
    if groups not in GROUPS:
        raise OptionError("groups", groups, "one of " + ", ".join(GROUPS))
    if not len(graph):
        raise GraphError("the graph has no factors: nothing has a scale")
    stated = Pattern(graph.factors, values)
    by_name = residual_groups(stated, groups)
    every = list(by_name.values())
    theta = np.zeros(len(every))  # log sigma^2
    free, again = np.ones((2, len(every)), dtype=bool)
    settled, rounds, last = False, 0, np.zeros(0)
    while rounds < 50:
        rounds += 1
        log_variance, scales = theta.copy(), _scales(stated, every, theta)
        factors = [rescaled(batch.model, scale) for batch, scale in zip(stated.batches, scales, strict=True)]
        scaled_graph = FactorGraph(factors, graph.fixed)
        result = scaled_graph.optimize(values, optimizer, linear_solver, gauge)
        values = result.values
        ended = result.status in (Status.STOPPED, Status.INTERRUPTED, Status.MAX_TIME)
        residuals = Residuals(_checked(factors, graph, values, gauge), every)
        v, r = residuals.v, residuals.r
        vague = free & (((r < LEAST_REDUNDANCY) & (v <= r)) | (r < UNCHECKED * residuals.numbers) | (v <= 1e-12 * r))
        if ended:  # by the caller, who wants no further rounds
            break
        if vague.any():
            last = np.zeros(0)
            free &= ~vague
            theta[vague] = 0.0
            continue
        step, sd = residuals.step(free)
        if (np.abs(step) <= 0.02 * sd).all() and result.converged:
            if (few := free & (r < LEAST_REDUNDANCY)).any():
                last, free, again = np.zeros(0), free & ~few, again & ~few
                theta[few] = 0.0
                continue
            second = ~free & again & (r >= LEAST_REDUNDANCY)  # nothing checked them while other scales were wrong
            settled = not second.any()
            if settled:
                break
            last = np.zeros(0)
            free |= second
            again &= ~second
        else:
            theta[free] += _faster(step / sd, last) * step
            last = step / sd
    covariance = residuals.covariance(free)
    sd = np.sqrt(np.diagonal(covariance))
    sizes = [sum(len(index) for _, index, _ in parts) for parts in every]
    scale, numbers = np.exp(log_variance / 2), residuals.numbers.astype(int)
    columns = (column.tolist() for column in (numbers, r, scale, scale * sd / 2, free))
    components = tuple(map(VarianceComponent, by_name, sizes, *columns))
    correlation = covariance / (sd[:, None] * sd)
    return VarianceComponents(components, correlation, scaled_graph, result, tuple(scales), rounds, settled)


def _faster(step: Array, last: Array) -> float:
    """How much longer to make a step that goes on as the last one did: the sum of their geometric series, at most 5."""
    if len(last) != len(step) or not np.square(last).sum() > 0 or np.abs(step).max() > 1:
        return 1.0
    return float(1 / (1 - np.clip(step @ last / np.square(last).sum(), 0.0, 0.8)))


def _scales(pattern: Pattern, groups: Sequence[Parts], theta: Array) -> list[Array]:
    """The scales (n, m) of every batch."""
    scales = [np.ones((len(batch), batch.model.dim)) for batch in pattern.batches]
    for parts, scale in zip(groups, np.exp(theta / 2), strict=True):
        for k, index, columns in parts:
            scales[k][index[:, None], columns] = scale
    return scales


def _checked(factors: Sequence[Factor], graph: FactorGraph, values: Values, gauge: str) -> Checked:
    """The linearization of the optimum."""
    fixed = fixed_variables(graph.fixed, values)
    decided = choose_gauge(gauge, Pattern(factors, values), values, fixed)
    checked = freedom(decided.pattern.holding(decided.held), values).checked
    if checked is None:
        message = "weights differ too much to invert A'A; look for sigmas that are far too small"
        raise GraphError(f"variance components: {message}")
    return checked
