"""From scans to a map: match submaps that may overlap, keep the closures that agree, and begin again from there.

Matches as columns, one row each: the candidates of closing and what became of them, and scans with those before.

A scan that fits those just before it tells what the sensor says of the way itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby

import numpy as np

from factors import Between, Cauchy, Covariance, Robust, SequentialMatch
from factors.keys import kinds
from models import SE2
from models.algebra import Array, Index, Mask
from models.errors import GraphError, OptionError
from models.options import check_whole
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.metrics import displacements
from nls.missions.scans.correlation import INDEPENDENT_POINTS, Field, Match, match_submap
from nls.missions.scans.scans import SUBMAP_HALF, Scans, centers, half_widths, pairs, submap
from nls.optimizers import Result
from nls.robust import gnc
from nls.values import Values

LEAST_SCORE = 0.8  # log-likelihood of a point: nearly any; a high floor loses the map, not the wrong matches
LEAST_ODDS = 1.5  # log odds of the best place against the second, in a window of 3 m
WIDEST_SPREAD = 1.0  # m, standard deviation of the position
KEYFRAMES_BEFORE = 6  # with which a scan is matched
WINDOW_BEFORE = (2.0, float(np.radians(4.0)))  # half widths of the search, m, rad
SELECTIONS = ("gnc", "cauchy", "none")
ROUNDS = 8
x = kinds("x")[0]


class Verdict(IntEnum):
    """The verdict on a match."""

    ACCEPTED = 0
    NO_FIT = 1
    AMBIGUOUS = 2
    AT_THE_RIM = 3
    WIDE = 4

    @property
    def words(self) -> str:
        """The name as words."""
        return self.name.lower().replace("_", " ")


ACCEPTED = Verdict.ACCEPTED


def verdicts(score: Array, ratio: Array, edge: Array, spread: Array, window: Array) -> Index:
    r"""`Verdict` (n,) of matches: the first that applies.

    The odds of the best place against the second are :math:`\exp(n\,(S_1 - S_2))` with n independent points. A window
    with twice as many places has twice as many that may fit by chance, so its odds have to be twice as large:

    .. math:: n\,(S_1 - S_2) \ge 1.5 + 2 \log(w / 3 m)

    Parameters
    ----------
    score, ratio, edge, spread : (n,), see `Match`.
    window : (n,) half widths w of the search in x and y, m.

    Examples
    --------
    >>> import numpy as np
    >>> same = dict(score=np.full(2, 2.0), ratio=np.full(2, 0.96), edge=np.zeros(2), spread=np.full(2, 0.4))
    >>> [Verdict(v).name for v in verdicts(**same, window=np.array([3.0, 20.0]))]
    ['ACCEPTED', 'AMBIGUOUS']
    """
    odds = INDEPENDENT_POINTS * score * (1 - ratio)
    doubt = odds < LEAST_ODDS + 2 * np.log(window / 3.0)
    reasons = [score < LEAST_SCORE, edge > 0.3, spread > WIDEST_SPREAD, doubt]
    names = [Verdict.NO_FIT, Verdict.AT_THE_RIM, Verdict.WIDE, Verdict.AMBIGUOUS]
    return np.asarray(np.select(reasons, names, ACCEPTED), dtype=np.intp)


@dataclass(frozen=True)
class MatchTable:
    """Matches, one row each; see `Match`.

    Attributes
    ----------
    pose : (n, 3) x, y, m, and yaw, rad.
    covariance : (n, 3, 3) in the frame of the scan, m and rad.
    score, ratio, edge, spread : (n,)

    Examples
    --------
    >>> import numpy as np
    >>> one = Match(np.array([1.0, 0.0, 0.2]), np.diag([0.04, 0.01, 1e-4]), score=2.0, second=0.5, edge=0.1)
    >>> fits = MatchTable.of([one])
    >>> fits.pose, fits.ratio, fits.spread
    (array([[1. , 0. , 0.2]]), array([0.25]), array([0.2]))
    """

    pose: Array
    covariance: Array
    score: Array
    ratio: Array
    edge: Array
    spread: Array

    @classmethod
    def of(cls, matches: Sequence[Match]) -> MatchTable:
        """The columns of matches, in their order; empty ones of no match."""
        numbers = np.array([(match.score, match.ratio, match.edge, match.spread) for match in matches])
        return cls(
            np.array([match.pose for match in matches]).reshape(-1, 3),
            np.array([match.covariance for match in matches]).reshape(-1, 3, 3),
            *numbers.reshape(-1, 4).T,
        )


@dataclass(frozen=True)
class Matches(MatchTable):
    """The matched candidates of a round, one row each.

    Attributes
    ----------
    i, j : (n,) keyframes in the middle of the earlier and of the later submap.
    pose, covariance : of j in the frame of i, see `MatchTable`.
    window : (n, 2) half widths of the search, m and rad.
    verdict : (n,) `Verdict`, accepted or why not.
    kept : (n,) whether the selection kept it.
    """

    i: Index
    j: Index
    window: Array
    verdict: Index
    kept: Mask

    def __len__(self) -> int:
        return len(self.i)

    @classmethod
    def around(cls, poses: Array, scans: Scans, i: Index, j: Index, window: Array) -> Matches:
        """Match the submaps (n,) around keyframes j with those around i, from present poses (count, 3), and test."""
        guess = SE2.between(poses[i], poses[j])
        part = {k: submap(poses, scans, k, SUBMAP_HALF) for k in np.unique(np.append(i, j)).tolist()}
        by_field: list[Match] = []
        order = np.argsort(i, kind="stable")  # one field at a time: they are large
        for a, rows in groupby(order.tolist(), key=lambda row: int(i[row])):
            field = Field(part[a])
            for row in rows:
                reach, turn = window[row].tolist()
                by_field.append(match_submap(field, part[int(j[row])], guess[row], (reach, turn)))
        fits = MatchTable.of([by_field[place] for place in np.argsort(order).tolist()])
        verdict = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, window[:, 0])
        return cls(**vars(fits), i=i, j=j, window=window, verdict=verdict, kept=np.zeros(len(i), dtype=bool))

    @property
    def accepted(self) -> Mask:
        """(n,) whether the selection tests it."""
        return np.asarray(self.verdict == ACCEPTED)


def sequential_matches(poses: Array, scans: Scans) -> SequentialMatch | None:
    """One factor between a keyframe and one a few before it for every scan that fits those before; None without any.

    A kernel weighs them: the points that are common to all scans because they move with the vehicle say that it stands.

    Parameters
    ----------
    poses : (count, 3) present estimate, SE2.
    scans : the points.
    """
    k = comparable(scans)
    fits = MatchTable.of(
        [match_submap(field_before(poses, scans, j), scans[j], np.zeros(3), WINDOW_BEFORE) for j in k.tolist()]
    )
    unjudged = np.zeros(len(k))  # ratio: a second place is no reason against a match in so narrow a window
    accepted = verdicts(fits.score, unjudged, fits.edge, fits.spread, np.full(len(k), WINDOW_BEFORE[0])) == ACCEPTED
    if not accepted.any():
        return None
    j = k[accepted]
    i = np.maximum(j - (KEYFRAMES_BEFORE + 1) // 2, 0)
    z = SE2.compose(SE2.between(poses[i], poses[j]), fits.pose[accepted])
    C = (KEYFRAMES_BEFORE + 1) * fits.covariance[accepted]  # the points of a scan take part in so many matches
    return SequentialMatch(x[i], x[j], z, Robust(Covariance(C), Cauchy(1.0)))


def comparable(scans: Scans) -> Index:
    """Keyframes (n,) that have points enough, and enough in the keyframes before them."""
    starts, k = scans.starts, np.arange(len(scans))
    before = starts[k] - starts[np.maximum(k - KEYFRAMES_BEFORE, 0)]
    return np.flatnonzero((np.diff(starts) >= 20) & (before >= 40))


def field_before(poses: Array, scans: Scans, k: int) -> Field:
    """The field of the keyframes before one, in its frame, from poses (count, 3)."""
    return Field(submap(poses, scans, k, (KEYFRAMES_BEFORE, -1)))


@dataclass(frozen=True)
class Round:
    """One round of closing.

    Attributes
    ----------
    matches : all candidates.
    poses : (count, 3) keyframes after it.
    chi2_dof : chi2 over degrees of freedom.
    moved : by how much it changed the shape of the track, m rms after a rigid motion.
    """

    matches: Matches
    poses: Array
    chi2_dof: float
    moved: float

    def __str__(self) -> str:
        m = self.matches
        return (
            f"{len(m)} candidates, {int(m.accepted.sum())} accepted, {int(m.kept.sum())} kept; "
            f"chi2/dof {self.chi2_dof:.2f}; keyframes moved {self.moved:.2f} m rms"
        )


@dataclass(frozen=True, repr=False)
class Closing:
    """A map from scans; ``print`` gives the rounds.

    Attributes
    ----------
    graph : the graph with the closures that were kept.
    result : its optimization.
    rounds : one `Round` each.
    settled : whether the last round moved the track by less than 0.3 m rms; two without a closure end, settled or not.
    """

    graph: FactorGraph
    result: Result
    rounds: tuple[Round, ...]
    settled: bool

    @property
    def values(self) -> Values:
        """The estimate."""
        return self.result.values

    @property
    def matches(self) -> Matches:
        """Matches of the last round."""
        return self.rounds[-1].matches

    def __repr__(self) -> str:
        return f"Closing({len(self.rounds)} rounds, {self.rounds[-1]})"

    def __str__(self) -> str:
        lines = [f"round {number}: {line}" for number, line in enumerate(self.rounds, 1)]
        return "\n".join([*lines, str(self.result)])


def close(
    graph: FactorGraph,
    values: Values,
    scans: Scans,
    rounds: int = ROUNDS,
    select: str = "gnc",
    sequential: bool = True,
    report: Callable[[Round], None] | None = None,
) -> Closing:
    """Close the loops of a graph of keyframes by their scans.

    Every round pairs submaps whose footprints overlap at the present estimate, and matches them in windows of three
    sigmas of their relative pose. Matches that are neither ambiguous nor at the rim nor wide are accepted (`verdicts`).
    The round chooses among them, and solves. The next begins at the better estimate, with submaps built anew and with
    new matches: no closure of a round stays because it was there.

    Parameters
    ----------
    graph, values : the keyframes x (SE2), numbered as in the scans, and what else measures them; see
        `nls.missions.scans.dead_reckoning`. Both stay as they are.
    scans : the points.
    rounds : at most.
    select : ``gnc``, graduated non-convexity; ``cauchy``, a kernel on all accepted; ``none``, least squares of all.
    sequential : match every scan with those just before it too.
    report : called after every round.

    Raises
    ------
    GraphError
        Keyframes that are not those of the scans.
    OptionError
        No such selection; fewer than one round.
    """
    check_whole("rounds", rounds, 1)
    if select not in SELECTIONS:
        raise OptionError("select", select, "one of " + ", ".join(SELECTIONS))
    refuse_other_keyframes(values, scans)
    history: list[Round] = []
    closed, settled = graph, False
    result = graph.optimize(values)
    for _ in range(rounds):
        matches = match_all(closed, result.values, scans)
        start = result.values
        steps = sequential_matches(start[x], scans) if sequential else None
        measured = graph if steps is None else FactorGraph([*graph.factors, steps], graph.fixed)
        closures, better, kept = chosen(measured, start, matches, select)
        matches.kept[matches.accepted] = kept
        closed = measured if closures is None else FactorGraph([*measured.factors, closures], measured.fixed)
        result = closed.optimize(better)
        moved = float(np.sqrt(np.mean(displacements(result.values[x][:, :2], start[x][:, :2]) ** 2)))
        history.append(Round(matches, result.values[x], result.chi2_final / max(result.dof, 1), moved))
        if report is not None:
            report(history[-1])
        empty = len(history) > 1 and not any(r.matches.kept.any() for r in history[-2:])
        if (settled := moved < 0.3) or empty:
            break
    return Closing(closed, result, tuple(history), settled)


def refuse_other_keyframes(values: Values, scans: Scans) -> None:
    """Refuse values whose poses x are not the keyframes of the scans.

    Raises
    ------
    GraphError
    """
    stack = values.stack(x)
    if stack.manifold is not SE2 or not np.array_equal(stack.numbers, np.arange(len(scans))):
        raise GraphError(
            f"close: poses x of {stack.manifold}, {len(stack)} of them; expected SE2, x0 to x{len(scans) - 1}, one for "
            "each keyframe of the scans"
        )


def match_all(graph: FactorGraph, values: Values, scans: Scans) -> Matches:
    """All candidates of a round, matched and tested; none where no two submaps overlap."""
    middle = centers(scans)
    a, b = pairs(values[x], scans, middle)
    i, j = middle[a], middle[b]
    pair = x[i], x[j]
    relative = Marginals(graph, values, pairs=[pair]).relative(*pair) if len(i) else np.zeros((0, 3, 3))
    return Matches.around(values[x], scans, i, j, half_widths(relative))


def shares(i: Index, j: Index) -> Array:
    """How many times (n,) the covariance of each closure between submaps i and j counts in the estimate.

    Closures of one submap share its points, and its error: together they say no more than one of them.
    """
    uses = np.bincount(np.append(i, j))
    return np.asarray((uses[i] + uses[j]) / 2)


def chosen(
    graph: FactorGraph, start: Values, matches: Matches, select: str = "gnc"
) -> tuple[Between | None, Values, Mask]:
    """The closures that a selection keeps, if any, the values to go on from, and which of the accepted they are (n,).

    Every closure is tested by its own covariance, and counts in the estimate as `shares` says.
    """
    accepted = matches.accepted
    kept = np.ones(int(accepted.sum()), dtype=bool)
    i, j, z, C = matches.i[accepted], matches.j[accepted], matches.pose[accepted], matches.covariance[accepted]
    if select == "gnc" and len(kept):
        closures = Between(x[i], x[j], z, Covariance(C))
        robust = gnc(FactorGraph([*graph.factors, closures], graph.fixed), start, doubted=[closures])
        start, kept = robust.result.values, robust.weights[-1] > 0
    if not kept.any():
        return None, start, kept
    i, j, z = i[kept], j[kept], z[kept]
    shared = Covariance(C[kept] * shares(i, j)[:, None, None])
    return Between(x[i], x[j], z, Robust(shared, Cauchy(1.0)) if select == "cauchy" else shared), start, kept
