r"""Graduated non-convexity: an estimate that wrong measurements do not bend, and the list of those.

A measurement that may be wrong costs no more than c^2, whatever its residual s = |b_i|^2: truncated least squares

    chi2 = sum of min(s, c^2),        c^2 = sigma0^2 q,   q the quantile of chi2 of that many numbers

has a minimum for every choice of measurements. So the kernel is bent slowly from a parabola (`nls.robust.kernels`),
with one weighted step for every bend. This follows one minimum from the first, where all measurements pull, to the
last.

From odometry the first minimum is wrong if half of the closures are wrong, or if they come in groups that agree with
one another. So `nls.robust.preselection` chooses the start. All closures are taken where noise explains their optimum:
nothing has to be chosen then. Otherwise the start is odometry and the closures that it could verify, from
`nls.robust.accepted_closures`. From there mu begins where closures pull that are within 10 thresholds, or 1000,
whichever ends lower. The first keeps rejected ones out, the second takes back right closures that the start did not fit
yet. The second is left out where so many wrong ones are within it that factorizing becomes ten times dearer. At last
the groups that all others contradict are left out, where that moves the map.

    sigma0^2 = min(9 noise, max(1, noise)),      noise = chi2 over its 5 % quantile with what `Growth` accepted

is 1, the stated sigmas, unless they are too small, or more than three times too large. Where all residuals are a
hundredth of a sigma, a quantile of chi2 lets wrong closures of a meter pass. Where no closure was accepted, or all fit
exactly, noise is 1.

Tests of contacts of a sonar begin with those that agree, `nls.robust.contacts`, under a kernel of their own.
Landmarks that are no longer determined leave with what is rejected, `nls.robust.landmarks`.

Whether the choice can be trusted is a question of its own: `Preselection.doubts`, of any choice `verdict.doubts`.

Source: H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", RA-L
5(2), 2020.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models.advice import Advice
from models.algebra import Array, Mask
from models.chi_squared import chi2_gate, chi2_tail
from models.errors import GraphError, OptionError, SingularGeometryError, UnderconstrainedError
from models.options import check_between
from nls.analysis.redundancy import Unverified, unverified_groups
from nls.graph import FactorGraph
from nls.optimizers import Result
from nls.posegraph import closures, says_poses
from nls.robust import verdict
from nls.robust.contacts import doubted_contacts, selected
from nls.robust.kernels import LOSSES
from nls.robust.landmarks import landmarks_of
from nls.robust.loop_graph import loop_graph
from nls.robust.preselection import Preselection
from nls.robust.truncated_least_squares import Truncated
from nls.robust.verdict import Doubt
from nls.sparse.threads import single_thread
from nls.values import Values, refuse_other


@dataclass(frozen=True)
class Rejected:
    """A measurement that was rejected: its name, and how many sigmas (stated ones) it is off.

    `number` is that of its factor in the given graph, `measurement` its own in the factor, counted from 0. `keys` are
    its variables. `chance` bounds the probability that noise takes one of all tested measurements so far off, loop
    closures from what the kept ones predict.
    """

    factor: str
    sigmas: float
    number: int
    measurement: int
    keys: tuple[Keys, ...]
    chance: float


@dataclass(frozen=True)
class Left:
    """A landmark that was removed with its rejected measurements: its name, and how many tested ones it had."""

    variable: str
    measurements: int


@dataclass(frozen=True, repr=False)
class Robustified:
    """An estimate without wrong measurements; ``print`` gives the table.

    Attributes
    ----------
    result : the optimization of what was kept; its values are the estimate.
    graph : what was kept.
    weights : per factor of the given graph (n,): 1 kept, 0 rejected.
    rejected : the others by name, the worst first; without those of landmarks that left.
    left : landmarks that left, by number.
    doubted : how many measurements could have been rejected.
    sigma0 : by what the stated sigmas were multiplied for the threshold.
    probability : with which a right measurement is kept, if its sigmas are right.
    local : sigma0 as neighboring closures show it, without any estimate; nan where nothing was preselected.
    doubts : why the choice may be wrong; empty where nothing speaks against it.
    """

    result: Result
    graph: FactorGraph
    weights: list[Array]
    rejected: tuple[Rejected, ...]
    doubted: int
    sigma0: float
    probability: float
    local: float = field(default=float("nan"))
    doubts: tuple[Doubt, ...] = ()
    left: tuple[Left, ...] = ()

    @property
    def strain(self) -> float:
        """Noise of the estimate over noise between neighbors: 1 to 2.2 where closures were chosen well, nan without.

        Far above that the closures and their weights do not fit together. Near 1 it proves nothing: a whole group of
        wrong closures that was accepted does not show.
        """
        return float(np.sqrt(self.result.chi2_final / max(self.result.dof, 1))) / self.local

    @property
    def expected_by_chance(self) -> float:
        """How many right measurements are rejected on average, if their sigmas are right: n (1 - p).

        n is unknown. It is estimated from the kept ones, which are n p.
        """
        kept = self.doubted - len(self.rejected) - sum(landmark.measurements for landmark in self.left)
        return kept * (1 - self.probability) / self.probability

    @cached_property
    def unverified(self) -> tuple[Unverified, ...]:
        """Accepted groups of closures that carry the map and that nothing verifies; computed at the first access.

        The other kept ones are the reference, so a group whose contradictions were rejected is listed. Factors and
        measurements are numbered as in the given graph. None where something is free: nothing has a redundancy there.
        """
        factors = [number for number, w in enumerate(self.weights) if w.any()]
        indices = [np.flatnonzero(self.weights[number]).tolist() for number in factors]
        try:
            groups = unverified_groups(self.graph, self.result.values)
        except UnderconstrainedError:
            return ()
        return tuple(replace(g, closures=tuple((factors[f], indices[f][k]) for f, k in g.closures)) for g in groups)

    def __repr__(self) -> str:
        return f"Robustified({len(self.rejected)} of {self.doubted} rejected, {self.result!r})"

    def report(self, most: int = 10) -> list[str]:
        """Lines: how many were rejected, how many by chance, doubts, unverified groups, and the first rejected ones."""
        from nls.explanation.doubts import of_choice, unverified

        lines = [*(finding.says for finding in of_choice(self)), *(f"doubtful: {doubt}" for doubt in self.doubts)]
        lines += [unverified(group).says for group in self.unverified]
        lines += [f"  {r.factor}  {r.sigmas:.3g} sigmas" for r in self.rejected[:most]]
        return lines + ([f"  and {len(self.rejected) - most} more"] if len(self.rejected) > most else [])

    def __str__(self) -> str:
        return "\n".join([str(self.result), *self.report()])


@contextmanager
def _advising_another_start() -> Iterator[None]:
    """Name a start to whoever began where a measurement has no value, as targets and sensors at zero do."""
    try:
        yield
    except SingularGeometryError as error:
        error.advise(Advice("start"))
        raise


@single_thread()
@_advising_another_start()
def gnc(
    graph: FactorGraph,
    values: Values,
    loss: str = "tls",
    probability: float = 0.99,
    doubted: Sequence[Factor] | None = None,
    preselect: bool = True,
) -> Robustified:
    """The estimate without outliers, and which measurements they are.

    Parameters
    ----------
    graph, values : the graph, and a start; both stay as they are. With `preselect` only the first pose of it matters.
    loss : ``tls``, truncated least squares, or ``gm``, Geman and McClure's; contacts that were selected have ``gm``.
    probability : with which a right measurement is kept, if its sigmas are right.
    doubted : factors of the graph whose measurements may be wrong, all others are trusted. When omitted the loop
        closures: relative poses of two that are no neighbors in number.
    preselect : begin with what `nls.robust.grow` accepts, and of tested contacts of a sonar with those that agree
        along all that is trusted. False, or with other `doubted` measurements: begin with all of them, at the
        values given; odometry for example, ``nls.initialize(graph, values, "odometry")``.

    Returns
    -------
    Robustified

    Raises
    ------
    OptionError
        No such loss; a probability that is none.
    GraphError
        A factor that is not in the graph, nothing to test, or no pose graph to preselect in.
    SingularGeometryError
        A start that is none, such as zeros where targets are seen: the advice names `nls.initialize`.
    UnderconstrainedError
        Without what was rejected something is free that is no landmark, or what is trusted leaves a pose of a contact
        free.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> from factors import Between, Diagonal
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=30)
    >>> x, = nls.kinds("x")
    >>> wrong = Between(x[[3, 7]], x[[20, 52]], [[1, 0, 0], [0, 2, 1]], Diagonal(x=0.05, y=0.05, yaw=0.01))
    >>> graph = nls.FactorGraph([*world.graph.factors, wrong])
    >>> estimate = nls.gnc(graph, world.truth)
    >>> [rejected.factor for rejected in estimate.rejected], estimate.result.converged
    (['Between(x3, x20)', 'Between(x7, x52)'], True)
    """
    refuse_other("gnc", graph, values)
    if not isinstance(loss, str) or loss not in LOSSES:
        raise OptionError("loss", loss, "one of " + ", ".join(LOSSES))
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.99")
    masks = _loop_closures(graph, values) if doubted is None else _named(graph, doubted)
    total = sum(int(mask.sum()) for mask in masks)
    if not total:
        message = "this graph has no loop closures, and other measurements are tested only if `doubted` names them"
        raise GraphError(message, advice=[Advice.robust("Cauchy", 1), Advice("doubt")])
    landmarks = landmarks_of(graph, values, masks)
    dims = [values.gather(factor)[0].dim for factor in graph.factors]
    problem = Truncated(graph, masks, [chi2_gate(dim, probability) for dim in dims], landmarks)
    if preselect and doubted is None:
        preselected = Preselection(problem, loop_graph(graph, values), loss, probability)
        doubts = preselected.doubts()
        choice, variance, local = preselected.kept(), preselected.variance, preselected.loops.neighbors.typical
        off = problem.least_distances(choice)
    else:
        if preselect and doubted_contacts(graph, values, masks):
            choice = problem.softened(*selected(graph, values, landmarks))
        else:
            choice = problem.choice(values, loss, np.inf)
        variance, local = 1.0, float("nan")
        doubts = verdict.doubts(choice.result, total - problem.rejected(choice.inliers), total, probability)
        doubts += verdict.no_start(values) if doubts else []
        off = choice.s
    gone = landmarks.gone(choice.inliers)
    left: list[Left] = []
    for kind, mask in gone.items():
        keys, counts = Keys(kind, values.stack(kind).numbers[mask]), landmarks.counts(kind, masks)[mask]
        left += [Left(repr(key), int(count)) for key, count in zip(keys, counts, strict=True)]
    tails = [np.minimum(total * chi2_tail(d2 / variance, np.array(m)), 1) for d2, m in zip(off, dims, strict=True)]
    rows = zip(graph.factors, masks, choice.inliers, choice.s, tails, landmarks.leaving(gone), strict=True)
    rejections = [
        Rejected(factor.describe(n), float(s[n]) ** 0.5, k, n, tuple(keys[[n]] for keys in factor.keys), float(p[n]))
        for k, (factor, d, m, s, p, leaves) in enumerate(rows)
        for n in np.flatnonzero(d & ~m & ~leaves).tolist()
    ]
    rejected = tuple(sorted(rejections, key=lambda rejection: -rejection.sigmas))
    weights = [m.astype(float) for m in choice.inliers]
    sigma0 = float(np.sqrt(variance))
    return Robustified(
        choice.result, choice.graph, weights, rejected, total, sigma0, probability, local, tuple(doubts), tuple(left)
    )


def _loop_closures(graph: FactorGraph, values: Values) -> list[Mask]:
    """Per factor which of its measurements are closures; none whose poses are not known without an estimate."""
    masks = closures(graph.pattern(values))
    return [mask & says_poses(factor) for mask, factor in zip(masks, graph.factors, strict=True)]


def _named(graph: FactorGraph, doubted: Sequence[Factor]) -> list[Mask]:
    """All measurements of some factors."""
    for factor in doubted:
        if not any(factor is f for f in graph.factors):
            raise GraphError(f"gnc: `doubted` names {factor!r:.80}, which is not in this graph")
    return [np.full(len(f), any(f is d for d in doubted)) for f in graph.factors]
