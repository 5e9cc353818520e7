r"""Graduated non-convexity: an estimate that wrong measurements do not bend, and the list of those.

A measurement that may be wrong costs no more than c^2, whatever its residual s = |b_i|^2: truncated least squares

    chi2 = sum of min(s, c^2),        c^2 = sigma0^2 q,   q the quantile of chi2 of that many numbers

has a minimum for every choice of measurements. So the kernel is bent slowly, by a number mu, from a parabola

    TLS   w = 1 for s <= mu/(mu+1) c^2,   0 for s >= (mu+1)/mu c^2,   c sqrt(mu(mu+1)/s) - mu between;   mu from ~0 up
    GM    w = (mu c^2 / (mu c^2 + s))^2;                                                                 mu down to 1

with one weighted step for every mu, which follows one minimum from the first, where all measurements pull, to the last.

From odometry that is not the right first one if half of the closures are wrong, or if they come in groups that agree
with one another. For pose graphs the start is therefore that of `nls.robust.growth`, odometry and the closures it could
verify, and mu begins at 1, where what is far out is out.

sigma0 is 1, the stated sigmas, unless the accepted closures show them to be more than three times too large (`Growth`):
where all residuals are a hundredth of a sigma, a quantile of chi2 lets wrong closures of a meter pass.

Source: H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", RA-L
5(2), 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from factors.base import Factor
from factors.robust import Kernel
from models.algebra import Array
from models.errors import GraphError, OptionError
from models.options import is_number
from nls.filters.consistency import chi2_gate
from nls.graph import FactorGraph
from nls.linear.threads import single_thread
from nls.optimizers import Optimizer, Result, Status
from nls.robust.closures import Mask, loop_closures, with_only
from nls.robust.growth import grow
from nls.starts import chordal
from nls.values import Values

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.optimizers.watch import Watch
    from nls.system import LinearSystem

__all__ = ["LOSSES", "Rejected", "Robustified", "gnc"]

FASTER = 1.4  # mu from step to step, as in the paper
DONE = 1e3  # mu of a kernel that is as good as truncated
PASSES = 8  # of choosing and solving at most; three are the rule
FAR = 20.0  # thresholds; what is farther out than that, after preselection, has no weight at any mu
WIDE = 3.0  # times sigma0 of what was accepted: residuals have heavier tails than chi2
BETTER = 1e-3  # part of chi2 by which another start must be lower


class TruncatedSquares(Kernel):
    """min(s, c^2), made convex by a small mu; `mu` is raised while it is in use."""

    mu = 1.0

    def rho(self, s: Array) -> Array:
        c, mu = self.c, self.mu
        between = 2 * c * np.sqrt(mu * (mu + 1) * s) - mu * (c * c + s)
        return np.where(s <= mu / (mu + 1) * c * c, s, np.where(s >= (mu + 1) / mu * c * c, c * c, between))

    def weight(self, s: Array) -> Array:
        c, mu = self.c, self.mu
        least = mu / (mu + 1) * c * c
        return np.clip(c * np.sqrt(mu * (mu + 1) / np.maximum(s, least)) - mu, 0.0, 1.0)

    def begin(self, worst: float) -> None:
        """The mu at which the worst residual still pulls."""
        self.mu = self.c**2 / max(2 * worst - self.c**2, self.c**2)

    def bend(self) -> bool:
        """The next mu; False at the last."""
        self.mu *= FASTER
        return self.mu < DONE


class GemanMcClureSquares(Kernel):
    """Geman and McClure's kernel with c^2 widened by a large mu; `mu` is lowered while it is in use."""

    mu = 1.0

    def rho(self, s: Array) -> Array:
        wide = self.mu * self.c**2
        return wide * s / (wide + s)

    def weight(self, s: Array) -> Array:
        wide = self.mu * self.c**2
        return np.square(wide / (wide + s))

    def begin(self, worst: float) -> None:
        """The mu at which the worst residual still pulls."""
        self.mu = max(2 * worst / self.c**2, 1.0)

    def bend(self) -> bool:
        """The next mu; False at the last."""
        last, self.mu = self.mu == 1.0, max(self.mu / FASTER, 1.0)
        return not last


LOSSES: dict[str, type[TruncatedSquares | GemanMcClureSquares]] = {"tls": TruncatedSquares, "gm": GemanMcClureSquares}


@dataclass(frozen=True)
class Rejected:
    """A measurement that was rejected: its name, and how many sigmas (stated ones) it is off."""

    factor: str
    sigmas: float


@dataclass(frozen=True, repr=False)
class Robustified:
    """An estimate without wrong measurements; ``print`` gives the table.

    Attributes
    ----------
    result : the optimization of what was kept; its values are the estimate.
    graph : what was kept.
    weights : per factor of the given graph (n,): 1 kept, 0 rejected.
    rejected : the others by name, the worst first.
    doubted : how many measurements could have been rejected.
    sigma0 : by what the stated sigmas were multiplied for the threshold.
    local : sigma0 as neighboring closures show it, without any estimate; nan where nothing was preselected.
    """

    result: Result
    graph: FactorGraph
    weights: list[Array]
    rejected: tuple[Rejected, ...]
    doubted: int
    sigma0: float
    local: float = field(default=float("nan"))

    @property
    def strain(self) -> float:
        """Noise of the estimate over noise between neighbors, 1 to 2 where closures were chosen well; nan without."""
        return float(np.sqrt(self.result.chi2_final / max(self.result.dof, 1))) / self.local

    def __repr__(self) -> str:
        return f"Robustified({len(self.rejected)} of {self.doubted} rejected, {self.result!r})"

    def report(self, most: int = 10) -> list[str]:
        """Lines: how many were rejected at which threshold, and the first of them."""
        counted = f"{len(self.rejected)} of {self.doubted} doubted measurements rejected"
        lines = [f"{counted}, threshold at {self.sigma0:.3g} stated sigmas"]
        lines += [f"  {r.factor}  {r.sigmas:.3g} sigmas" for r in self.rejected[:most]]
        return lines + ([f"  and {len(self.rejected) - most} more"] if len(self.rejected) > most else [])

    def __str__(self) -> str:
        return "\n".join([str(self.result), *self.report()])


@dataclass(frozen=True)
class Graduated(Optimizer):
    """One Gauss-Newton step for every mu of some kernels, from the present one to the last."""

    kernels: tuple[TruncatedSquares | GemanMcClureSquares, ...] = ()
    name = "graduated"

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        going = True
        while going:
            X = problem.retract(X, problem.solve(system))
            going = sum(kernel.bend() for kernel in self.kernels) > 0
            system = problem.linearize(X)
        watch.best, watch.lowest = X, system.chi2
        watch.end(Status.STOPPED, "the kernels are as bent as they get")


@single_thread()
def gnc(
    graph: FactorGraph,
    values: Values,
    loss: str = "tls",
    probability: float = 0.99,
    doubted: Sequence[Factor] | None = None,
    preselect: bool = True,
) -> Robustified:
    """The estimate without wrong measurements, and which those are.

    Parameters
    ----------
    graph, values : the graph, and a start; both stay as they are. With `preselect` only the first pose of it matters.
    loss : ``tls``, truncated least squares, or ``gm``, Geman and McClure's.
    probability : with which a right measurement is kept, if its sigmas are right.
    doubted : factors of the graph whose measurements may be wrong, all others are trusted. When omitted the loop
        closures: `Between` of poses that are no neighbors in number.
    preselect : begin with what `nls.robust.grow` accepts. False, or with `doubted`: begin with all measurements, at
        the values given; odometry for example, ``nls.initialize(graph, values, "odometry")``.

    Returns
    -------
    Robustified

    Raises
    ------
    OptionError
        No such loss; a probability that is none.
    GraphError
        A factor that is not in the graph, nothing that may be doubted, or no pose graph to preselect in.
    UnderconstrainedError
        Without what was rejected something is free.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> from factors import Between, Diagonal
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=30)
    >>> x, = nls.kinds("x")
    >>> wrong = Between(x[[3, 7]], x[[20, 52]], [[1, 0, 0], [0, 2, 1]], Diagonal(x=0.05, y=0.05, yaw=0.01))
    >>> graph = nls.FactorGraph([*world.graph.factors, wrong])
    >>> found = nls.gnc(graph, world.truth)
    >>> [rejected.factor for rejected in found.rejected], found.result.converged
    (['Between(x3, x20)', 'Between(x7, x52)'], True)
    """
    if loss not in LOSSES:
        raise OptionError("loss", loss, "one of " + ", ".join(LOSSES))
    if not is_number(probability) or not 0 < probability < 1:
        raise OptionError("probability", probability, "a number between 0 and 1, such as 0.99")
    masks = loop_closures(graph, values) if doubted is None else _named(graph, doubted)
    total = sum(int(mask.sum()) for mask in masks)
    if not total:
        raise GraphError("nothing in this graph can be doubted: no loop closures; name factors with doubted=[...]")
    gates = [chi2_gate(_numbers(factor, values), probability) for factor in graph.factors]
    scale, local = 1.0, float("nan")
    if preselect and doubted is None:
        grown = grow(graph, values)
        first = _lowest(with_only(graph, grown.masks), grown.values)
        noise = first.chi2_final / max(first.dof, 1)
        values, scale, local = first.values, min(WIDE**2 * noise, max(1.0, noise)) or 1.0, grown.sigma0
    values = _bent(graph, values, masks, [scale * gate for gate in gates], loss, all_in=np.isnan(local))
    kept: list[Mask] = []
    for _ in range(PASSES):
        s = [factor.chi2(values) for factor in graph.factors]
        before, kept = kept, [~m | (k <= scale * q) for m, k, q in zip(masks, s, gates, strict=True)]
        if before and all((a == b).all() for a, b in zip(before, kept, strict=True)):
            break
        part = with_only(graph, kept)
        result = part.optimize(values) if before else _lowest(part, values)
        values = result.values
    off = [(float(k), f.describe(n)) for f, m, s_f in zip(graph.factors, kept, s, strict=True) for n, k in _out(m, s_f)]
    rejected = tuple(Rejected(name, k**0.5) for k, name in sorted(off, key=lambda each: -each[0]))
    return Robustified(result, part, [m.astype(float) for m in kept], rejected, total, float(np.sqrt(scale)), local)


def _out(kept: Mask, s: Array) -> list[tuple[int, float]]:
    """Numbers and chi2 of the measurements that are not kept."""
    out = np.flatnonzero(~kept)
    return list(zip(out.tolist(), s[out].tolist(), strict=True))


def _named(graph: FactorGraph, doubted: Sequence[Factor]) -> list[Mask]:
    """All measurements of some factors."""
    for factor in doubted:
        if not any(factor is f for f in graph.factors):
            raise GraphError(f"gnc: {factor!r:.80} is doubted, and not in this graph")
    return [np.full(len(f), any(f is d for d in doubted)) for f in graph.factors]


def _numbers(factor: Factor, values: Values) -> int:
    """Numbers of one measurement."""
    model, _ = values.gather(factor)
    return int(model.dim)


def _bent(
    graph: FactorGraph, values: Values, masks: list[Mask], thresholds: list[float], loss: str, all_in: bool
) -> Values:
    """Where graduated kernels lead from some values: from the convex one, or from what is near the threshold."""
    factors: list[Factor] = []
    kernels: list[TruncatedSquares | GemanMcClureSquares] = []
    for factor, mask, c2 in zip(graph.factors, masks, thresholds, strict=True):
        if (~mask).any():
            factors.append(factor[~mask])
        s = factor.chi2(values)
        near = mask if all_in else mask & (s <= FAR * c2)
        if near.any():
            kernel = LOSSES[loss](c2**0.5)
            if all_in:
                kernel.begin(float(s[near].max()))
            kernels.append(kernel)
            factors.append(factor[near].robust(kernel))
    if not kernels:
        return values
    doubted = FactorGraph(factors)
    doubted.fixed = list(graph.fixed)
    return doubted.optimize(values, Graduated(kernels=tuple(kernels))).values


def _lowest(graph: FactorGraph, values: Values) -> Result:
    """The optimum from the values or from the chordal start, whichever is lower."""
    result = graph.optimize(values)
    start = chordal(graph, values)
    if start is not values:
        other = graph.optimize(start)
        if other.chi2_final < result.chi2_final * (1 - BETTER):
            return other
    return result
