"""From scans to a map: match submaps that may overlap, keep the closures that agree, and begin again from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors import Between, Cauchy, Covariance, Robust
from factors.keys import kinds
from models import SE2
from models.algebra import Array, Index, Mask
from models.errors import GraphError, OptionError
from models.options import check_whole
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.metrics import displacements
from nls.missions.scans.matches import Matches, sequential_matches
from nls.missions.scans.scans import Scans, centers, half_widths, pairs
from nls.optimizers import Result
from nls.robust import gnc
from nls.values import Values

SELECTIONS = ("gnc", "cauchy", "none")
ROUNDS = 8
x = kinds("x")[0]


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
    """All candidates of a round, matched and judged; none where no two submaps overlap."""
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

    Every closure is judged by its own covariance, and counts in the estimate as `shares` says.
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
