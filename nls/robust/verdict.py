"""When not to trust an estimate from selected closures: too little was kept, or what was kept does not fit together.

Every kind of doubt, its sentence, its bound and what decides it.
"""

from dataclasses import dataclass
from enum import Enum
from math import exp, gamma, log, log1p, sqrt
from typing import Any, NamedTuple

import numpy as np

from models.algebra import Mask
from models.chi_squared import chi2_gate
from models.findings import Numbered, Sentences, register
from nls.metrics import displacements
from nls.optimizers import Fit, Result
from nls.robust.accepted_closures import FITS, Witness, misfits
from nls.robust.loop_graph import LoopGraph, unit_variance
from nls.robust.truncated_least_squares import Choice, Truncated
from nls.values import Values

UNLIKELY = 0.05  # of chi2 to be smaller, or larger
HALF_DOUBTED = 0.5  # of the tested measurements: to reject more is too much
SAME_MAP = 0.005  # of the extent: a map that moves less is the same
STRAIN = 2.38  # times the typical noise between neighbors; of public graphs 0.9 to 2.35
QUIET = 0.6  # times the stated sigmas: a map with less noise shows that these are not too small
AWAY = 0.01  # part of the extent by which the map of another choice is away, at least


APART = "{meters:.3g} m ({fraction!p:.2g} % of its extent) and {radians:.2g} rad"


class DoubtKind(Enum):
    """Why not to trust an estimate; the value is the sentence."""

    FEW_KEPT = "{count} of {total} tested measurements were kept, less than half"
    NO_START = "all {total} poses begin at one place: get an initial guess, nls.initialize(graph, values)"
    DEAD_RECKONING = "the kept closures span {count} of the {total} odometry steps that all closures span"
    CONTRADICTED = (
        "{count} of {total} kept closures contradict the others: without them the map moves {fraction!p:.2g} %"
    )
    UNCHECKED = "a wrong closure would pass with a probability of {fraction!p:.2g} %: the redundancy is too low"
    ALONE = (
        "{count} of {total} kept closures agree with no neighbor: their noise is {number:.3g} times that of the others,"
        " and without them the map moves {fraction!p:.2g} %"
    )
    RIVAL = "another selection fits about as well (cost {number:+.2g} rejections); its map is " + APART + " away"
    WEAK = (
        "{count} of {total} kept closures are wrong with odds of {number:.2g} to 1: without them the map is "
        + APART
        + " away, {sigmas:.2g} of its sigmas"
    )
    STRAINED = "the noise of the map is {number:.3g} times that between neighboring closures"
    UNEXPLAINED = "chi2 of the kept measurements is {number:.3g} times its degrees of freedom"
    SIGMAS = "most neighboring closures differ by {number:.3g} sigmas: these are too small, or most are wrong"


SENTENCES: Sentences = {kind: kind.value for kind in DoubtKind}
register(__name__, *DoubtKind)


@dataclass(frozen=True)
class Doubt(Numbered):
    """One reason not to trust an estimate, and its numbers.

    Attributes
    ----------
    kind : the reason.
    count, total : how many measurements, or steps, of how many.
    number : a ratio, or how many measurements.
    fraction : of its extent, by which the map moves; a probability.
    meters, radians : by which the other map of a rival differs, nan of other kinds; rms of positions and of rotations.
    sigmas : that difference as the other map is uncertain.
    """

    kind: DoubtKind
    count: int = 0
    total: int = 0
    number: float = float("nan")
    fraction: float = float("nan")
    meters: float = float("nan")
    radians: float = float("nan")
    sigmas: float = float("nan")

    def record(self) -> dict[str, Any]:
        """The doubt for programs, and in words; `fraction` is ``part``."""
        record = super().record()
        part = record.pop("fraction")
        return record | {"kind": self.kind.name, "part": part}

    def __str__(self) -> str:
        return self.says


def doubts(result: Result, inlier_count: int, doubted: int, probability: float, tried: bool = False) -> list[Doubt]:
    """Reasons not to trust any choice: how much was kept, and whether chi2 of it is plausible.

    Of a right half n, a third where groups were `tried`, chance rejects n (1 - p) on average. More than three
    standard deviations above that are too many.
    """
    reasons, n = [], (1 / 3 if tried else HALF_DOUBTED) * doubted
    if inlier_count < n * probability - 3.0 * sqrt(n * probability * (1 - probability)):
        reasons.append(Doubt(DoubtKind.FEW_KEPT, inlier_count, doubted))
    if result.dof > 0 and result.fit is Fit.IMPLAUSIBLE:
        reasons.append(Doubt(DoubtKind.UNEXPLAINED, number=result.chi2_final / result.dof))
    return reasons


def no_start(values: Values) -> list[Doubt]:
    """The doubt where all poses of a kind began at one place, as zeros do."""
    poses = [stack.X for stack in values.stacks.values() if stack.manifold.body_axes and len(stack) > 1]
    return [Doubt(DoubtKind.NO_START, total=len(X)) for X in poses if not np.ptp(X, axis=0).any()]


class Difference(NamedTuple):
    """How far two maps differ in shape: rms of the positions after the best motion, of rotations with the first held.

    Attributes
    ----------
    fraction : of the extent; 1 without positions.
    """

    fraction: float
    meters: float
    radians: float


def difference(loops: LoopGraph, before: Values, after: Values) -> Difference:
    """How far a map is from another one."""
    p, q = (loops.places(values) for values in (before, after))
    turns = loops.poses.group.local(loops.track(before), loops.track(after))[:, p.shape[1] :]
    extent = float(np.ptp(p, axis=0).max(initial=0.0))
    meters = float(np.sqrt(np.square(displacements(p, q)).mean())) if extent else 0.0
    radians = float(np.sqrt(np.square(turns).sum(axis=1).mean()))
    return Difference(meters / extent if extent else 1.0, meters, radians)


@dataclass(frozen=True)
class Evidence:
    """A choice among loop closures, and what speaks against it.

    Attributes
    ----------
    rivals : the choice and others.
    tried : whether each group of closures more or less is among the others.
    variance : factor on the squares of the stated sigmas for the threshold.
    judged : the groups of the choice, tested against its other closures.
    moved : part of its extent by which the map moves without the contradicted groups.
    """

    problem: Truncated
    loops: LoopGraph
    choice: Choice
    rivals: list[Choice]
    tried: bool
    variance: float
    judged: list[Witness]
    moved: float


def preselected(evidence: Evidence, probability: float) -> list[Doubt]:
    """Reasons not to trust a choice among loop closures."""
    loops, result, moved = evidence.loops, evidence.choice.result, evidence.moved
    inliers = loops.accepted(evidence.choice.inliers)
    m, n = len(inliers), int(inliers.sum())
    reasons = doubts(result, n, m, probability, evidence.tried)
    span, spans = loops.spanned(inliers), loops.spanned(np.ones(m, dtype=bool))
    if span < 0.5 * spans:
        reasons.append(Doubt(DoubtKind.DEAD_RECKONING, span, spans))
    if moved > SAME_MAP:
        count = int(misfits(evidence.judged, result, loops).sum())
        reasons.append(Doubt(DoubtKind.CONTRADICTED, count, n, fraction=moved))
    reasons += [*_alone(evidence, inliers), *_rivals(evidence, inliers), *_unchecked(evidence, inliers)]
    if (ratio := strain(loops, result)) > STRAIN:
        reasons.append(Doubt(DoubtKind.STRAINED, number=ratio))
    small = loops.neighbors.typical > 1 and _sigmas(result) > QUIET
    if small and (reasons or n < 0.6 * m or result.fit is not Fit.PLAUSIBLE):
        reasons.append(Doubt(DoubtKind.SIGMAS, number=loops.neighbors.typical))
    return reasons


def strain(loops: LoopGraph, result: Result) -> float:
    """Noise of an optimum over the typical one between neighbors, or the stated one if that is less."""
    return _sigmas(result) / min(loops.neighbors.typical, 1.0)


def _unchecked(evidence: Evidence, inliers: Mask) -> list[Doubt]:
    """Whether a wrong closure would pass; groups that agree are accepted where only single ones were rejected.

    Where all closures make one group, there is nothing to choose.
    """
    _, sizes = np.unique(evidence.loops.neighbors.cluster[~inliers], return_counts=True)
    single = len(sizes) > 0 and (sizes == 1).all()
    chances = [0.0 if single and len(w.members) > 1 else w.chance for w in evidence.judged]
    mean = float(np.mean(chances or [0.0]))
    chosen = not inliers.all() or len(chances) > 1
    # public graphs have 0.2 % at most
    return [Doubt(DoubtKind.UNCHECKED, fraction=mean)] if mean > 0.1 and chosen else []


def _alone(evidence: Evidence, inliers: Mask) -> list[Doubt]:
    """Whether the closures (m,) that agree with no neighbor are much noisier than all else without them.

    Where the stated sigmas are too large wrong closures fit, and right ones fit much better. One by one the wrong ones
    hide each other, so they are left out together.
    """
    loops, result = evidence.loops, evidence.choice.result
    alone = inliers & (loops.neighbors.support == 0)
    if not alone.any() or alone.sum() == inliers.sum():
        return []
    other = evidence.problem.among(evidence.choice, loops, ~alone).result
    if not 0 < other.dof < result.dof:
        return []
    ratio = (result.chi2_final - other.chi2_final) / (result.dof - other.dof) / noise(other)
    # right maps that move without such closures have a noise of 1.3 at most
    if ratio <= 2.5**2 or (moved := difference(loops, result.values, other.values).fraction) <= AWAY:
        return []
    count, total = int(alone.sum()), int(inliers.sum())
    return [Doubt(DoubtKind.ALONE, count, total, number=float(np.sqrt(ratio)), fraction=moved)]


def _rivals(evidence: Evidence, inliers: Mask) -> list[Doubt]:
    """The first choice for a different map that fits as well; else the one whose closures most likely are wrong.

    It fits as well where it takes closures that were rejected, and costs at most one rejection more: of closures,
    or of groups, as one wrong group may be larger than the right ones together.

    Parameters
    ----------
    inliers : (m,) closures of the choice.
    """
    loops, here = evidence.loops, evidence.choice.result.values
    c2, weak = evidence.variance * max(evidence.problem.c2), []
    for rival in evidence.rivals[1:]:
        apart = difference(loops, here, rival.result.values)
        if apart.fraction <= AWAY:
            continue
        theirs, worse = loops.accepted(rival.inliers), (rival.cost - evidence.rivals[0].cost) / c2
        given_up, taken = inliers & ~theirs, theirs & ~inliers
        if taken.any() or not given_up.any():  # the same closures may have a second minimum
            worse = min(worse, worse - _repeated(loops, given_up) + _repeated(loops, taken))
            if worse <= 1.0:
                return [Doubt(DoubtKind.RIVAL, 0, 0, worse, *apart)]
            continue
        distance = _distance(here, rival)
        odds = _odds(evidence, inliers, given_up, distance, max(rival.result.dof, 1))
        if odds > 0.005:  # right closures that hold a map with others have 1e-5 to 0.003
            weak += [Doubt(DoubtKind.WEAK, int(given_up.sum()), int(inliers.sum()), odds, *apart, sqrt(distance))]
    return sorted(weak, key=lambda doubt: -doubt.number)[:1]


def _repeated(loops: LoopGraph, closures: Mask) -> int:
    """How many of some closures (m,) repeat another one of their group, which rejected as one costs one rejection."""
    return int(closures.sum()) - len(np.unique(loops.neighbors.cluster[closures]))


def _distance(here: Values, rival: Choice) -> float:
    """Squared distance of a map from that of fewer closures in the uncertainty of the latter.

    Up to the second order it is chi2 of the fewer closures there less their minimum. No gauge enters it.
    """
    variance = unit_variance(rival.result.chi2_final / max(rival.result.dof, 1))
    return max(rival.graph.chi2(here) - rival.result.chi2_final, 0.0) / variance


def _odds(evidence: Evidence, inliers: Mask, given_up: Mask, distance: float, dof: int) -> float:
    r"""The odds that all g groups of k closures (m,) are wrong: (r p)^g exp(E / 2).

    r is the number of rejected groups for one that was kept. A wrong group lies anywhere on the map. A right one lies
    where the other map is, as far as that is uncertain: p is the ratio of both densities at its most probable place. E
    is what noise does not explain of the squared distance D,

        E = n log(1 + D / n) - q

    with n degrees of freedom behind the noise of the other map: of few it may be small by chance (Student). q is the
    99 % quantile of chi2 of (k - g) d, for the noise of odometry between the closures of a group.
    """
    cluster, d = evidence.loops.neighbors.cluster, evidence.loops.poses.group.dim
    kept, out = (set(cluster[closures].tolist()) for closures in (inliers, ~inliers))
    chance = np.zeros(len(inliers))
    for witness in evidence.judged:
        chance[witness.members] = witness.chance
    least = [float(chance[given_up & (cluster == group)].min()) for group in set(cluster[given_up].tolist())]
    if not all(least):
        return 0.0  # a group that is too large to be tested checks itself
    prior, peak = (len(out - kept) + 1) / (len(kept) + 1), gamma(d / 2 + 1) * (2 / chi2_gate(d, FITS)) ** (d / 2)
    repeated = (int(given_up.sum()) - len(least)) * d
    explained = chi2_gate(repeated, 0.99) if repeated else 0.0
    excess = max(dof * log1p(distance / dof) - explained, 0.0)
    # 700 is the largest exponent of a float
    return exp(min(sum(log(prior * peak * passing) for passing in least) + excess / 2, 700.0))


def _sigmas(result: Result) -> float:
    """Noise of an optimum, in the stated sigmas."""
    return float(np.sqrt(result.chi2_final / max(result.dof, 1)))


def noise(result: Result) -> float:
    """chi2 over its 5 % quantile, as of few numbers it may be small by chance; 1 where all fit exactly."""
    return unit_variance(result.chi2_final / chi2_gate(max(result.dof, 1), UNLIKELY))
