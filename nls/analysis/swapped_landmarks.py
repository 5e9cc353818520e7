r"""Two landmarks whose sightings were exchanged, all from some time on or single ones.

Candidates are pairs of landmarks with sightings that do not fit, those first without which chi2 is lowest. For a pair
(a, b), from the poses of the optimum without them, two steps take turns until nothing changes:

    l_a, l_b = argmin of chi2 of their sightings, given which are exchanged
    a sighting is exchanged where chi2 of it is lower with the other landmark

from several beginnings: no sighting exchanged, and those after a quarter, a half and three quarters of the time. The
graph with the best exchange is then solved, poses and all, and compared with the one that stands
(`nls.analysis.alternatives`). Which s of n sightings are exchanged is one of C(n, s) tries.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from factors.replaced import replaced
from models.algebra import Array, Index, Mask
from models.errors import GraphWarning
from nls.analysis.alternatives import FIRST, REFUSED, UNLIKELY, Fit, decisive, expected, solved, supported
from nls.analysis.chi_squared import chi2_tail
from nls.analysis.exchanged_contacts import Exchanged
from nls.analysis.leave_one_out import Tested
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.sparse.pattern import measuring
from nls.starts.landmarks import locate_points, sees_landmarks
from nls.values import Values

__all__ = ["SwappedLandmarks", "swapped_landmarks"]

WORST = 6  # landmarks that are compared with each other
PAIRS = 6  # pairs for which the graph is solved
TURNS = 4  # of solving the graph, or of locating the landmarks, and choosing what is exchanged
EXPLAINED = 2.0  # chi2 per degree of freedom with all exchanged: false contacts leave more
BEGINNINGS = (1.0, 0.5, 0.25, 0.75)  # part of the sightings after which they are exchanged
FEWEST = 2  # exchanged sightings; a single one is an outlier


@dataclass(frozen=True)
class SwappedLandmarks(Exchanged):
    """Two landmarks that are one another in some of their sightings; chi2 is that of the whole graph.

    Attributes
    ----------
    dof : degrees of freedom of the graph, before and after.
    values : the optimum with all swapped pairs exchanged.
    """

    dof: int
    values: Values


def swapped_landmarks(
    graph: FactorGraph, values: Values, tests: Sequence[Tested] | None = None
) -> tuple[SwappedLandmarks, ...]:
    """Pairs of landmarks whose sightings were exchanged.

    Parameters
    ----------
    graph : not changed.
    values : its optimum.
    tests : its measurements against all others, one for each factor, `nls.analysis.leave_one_out.checks`. When omitted,
        as where A'A is singular, chi2 of each measurement counts, which is at most its t.

    Returns
    -------
    tuple of SwappedLandmarks
        With all of them exchanged noise explains chi2, or it is at most half and at most twice the degrees of freedom.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from factors.replaced import replaced
    >>> from nls.analysis.linearization import Checked, Linearization
    >>> from nls.analysis.leave_one_out import checks
    >>> world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True)
    >>> pose, target = world.sightings.keys
    >>> late, l3, l4 = pose.numbers > 45, target.numbers == 3, target.numbers == 4
    >>> numbers = np.where(late & l3, 4, np.where(late & l4, 3, target.numbers))
    >>> wrong = FactorGraph([world.first, world.odometry, replaced(world.sightings, [pose, Keys("l", numbers)])])
    >>> values = wrong.optimize(world.start).values
    >>> tests = checks(Checked(Linearization(wrong.pattern(values), values)), 3)
    >>> [(swap.first, swap.second) for swap in swapped_landmarks(wrong, values, tests)]
    [(l3, l4)]
    """
    pairs = _doubtful(graph, values, tests)
    standing = solved(graph, values, start=False) if pairs else None
    if standing is None or expected(standing):
        return ()
    fits = [(fit, pair) for pair in pairs if (fit := _without(standing, pair)) is not None]
    fits.sort(key=lambda without: without[0].chi2)
    now, swaps, tries = standing, [], len(pairs)
    candidates = fits[:PAIRS]
    while candidates and not expected(now):
        best = _best(now, candidates, len(pairs))
        if best is None:
            break
        fit, pair, places, count = best
        now, tries = fit, tries * count
        swaps.append((pair, places))
        candidates = [(without, other) for without, other in candidates if other != pair]
    if not swaps or not supported(standing, now, tries) or not (expected(now) or now.chi2 <= EXPLAINED * now.dof):
        return ()
    return tuple(
        SwappedLandmarks(pair[[0]], pair[[1]], places, standing.chi2, now.chi2, now.dof, now.values)
        for pair, places in swaps
    )


def _doubtful(graph: FactorGraph, values: Values, tests: Sequence[Tested] | None) -> list[Keys]:
    """Pairs of the landmarks with the most doubtful sightings."""
    count = len(graph)
    doubt: dict[str, dict[int, float]] = {}
    for k in landmark_factors(graph, values):
        factor = graph.factors[k]
        t, m = factor.chi2(values), measuring(values.gather(factor)[0])
        if tests is not None:
            t, m = tests[k].t, tests[k].m
        wrong = (chi2_tail(t, m) * count <= UNLIKELY) & ~np.array(factor.limit_only)
        of_kind = doubt.setdefault(factor.keys[1].kind, {})
        for number, distance in zip(factor.keys[1].numbers[wrong].tolist(), t[wrong].tolist(), strict=True):
            of_kind[number] = of_kind.get(number, 0.0) + distance
    pairs = []
    for kind, of_kind in doubt.items():
        worst = sorted(of_kind, key=lambda number: -of_kind[number])[:WORST]
        pairs += [Keys(kind, numbers) for numbers in combinations(sorted(worst), 2)]
    return pairs


def _without(now: Fit, pair: Keys) -> Fit | None:
    """The optimum without the sightings of two landmarks."""
    masks = [np.ones(len(factor), dtype=bool) for factor in now.graph.factors]
    for k in landmark_factors(now.graph, now.values):
        target = now.graph.factors[k].keys[1]
        if target.kind == pair.kind:
            masks[k] = ~np.isin(target.numbers, pair.numbers)
    local = solved(now.graph.only(masks), now.values, False, FIRST)
    if local is not None and expected(local):
        return local
    again = solved(now.graph.only(masks), now.values, True, FIRST)
    return min((fit for fit in (local, again) if fit is not None), key=lambda fit: fit.chi2, default=None)


def _best(
    now: Fit, candidates: list[tuple[Fit, Keys]], tries: int
) -> tuple[Fit, Keys, tuple[tuple[int, int], ...], int] | None:
    """The exchange of one pair after which chi2 is lowest, where it is decisive; the first that noise explains.

    Pairs are compared after the first iterations of each solve; the graph of the best one is solved to its end.
    """
    best = None
    for without, pair in candidates:
        exchange = _exchange(now, without.values, pair)
        if exchange is None:
            continue
        fit, places, count = exchange
        if decisive(now, fit, count * tries) and (best is None or fit.chi2 < best[0].chi2):
            best = fit, pair, places, count
            if expected(fit):
                break
    if best is None:
        return None
    begun, pair, places, count = best
    optimum = solved(begun.graph, begun.values, start=False)
    return None if optimum is None else (optimum, pair, places, count)


def _exchange(now: Fit, start: Values, pair: Keys) -> tuple[Fit, tuple[tuple[int, int], ...], int] | None:
    """The graph with the best exchange of a pair, the sightings exchanged, and of how many exchanges it is the best.

    Parameters
    ----------
    now : the graph.
    start : the optimum without the sightings of the pair.
    """
    sightings = Pair(now.graph, start, pair)
    best = sightings.best()
    if best is None:
        return None
    exchanged, points = best
    start = start.copy()
    start[pair] = points
    fit = solved(sightings.whole(exchanged), start, False, FIRST)
    for _ in range(TURNS):
        if fit is None:
            return None
        nearer = sightings.nearer(fit.values)
        if (nearer == exchanged).all():
            break
        exchanged = nearer
        fit = solved(sightings.whole(exchanged), fit.values, False, FIRST)
    if fit is None or exchanged.sum() < FEWEST:
        return None
    return fit, sightings.places(exchanged), math.comb(len(exchanged), int(exchanged.sum()))


def landmark_factors(graph: FactorGraph, values: Values) -> list[int]:
    """Numbers of the factors that see landmarks."""
    return [k for k, factor in enumerate(graph.factors) if sees_landmarks(factor, values)]


class Pair:
    """The sightings of two landmarks; those of one landmark from one pose are one sighting, whichever factors say so.

    Attributes
    ----------
    n : number of sightings, by the number of their pose.
    """

    def __init__(self, graph: FactorGraph, values: Values, pair: Keys) -> None:
        self.graph, self.values, self.pair = graph, values, pair
        self.rows: dict[int, Index] = {}
        labels = []
        for k in landmark_factors(graph, values):
            pose, target = graph.factors[k].keys[:2]
            if target.kind == pair.kind and len(rows := np.flatnonzero(np.isin(target.numbers, pair.numbers))):
                self.rows[k] = rows
                labels.append(np.column_stack([pose.numbers[rows], target.numbers[rows]]))
        sightings, group = np.unique(np.concatenate(labels), axis=0, return_inverse=True)
        self.n = len(sightings)
        ends = np.cumsum([len(rows) for rows in self.rows.values()])
        self.group = dict(zip(self.rows, np.split(group.reshape(-1), ends[:-1]), strict=True))
        self.parts = {k: graph.factors[k][rows] for k, rows in self.rows.items()}
        priors = [f for f in graph.factors if f.frame == "world" and f.keys[0].kind == pair.kind]
        self.priors = [f[mask] for f in priors if (mask := np.isin(f.keys[0].numbers, pair.numbers)).any()]

    def _relabelled(self, factor: Factor, mask: Mask) -> Factor:
        """The factor with the two landmarks exchanged in some measurements (n,)."""
        pose, target, *sensors = factor.keys
        a, b = self.pair.numbers
        numbers = np.where(target.numbers == a, b, np.where(target.numbers == b, a, target.numbers))
        return replaced(factor, [pose, Keys(target.kind, np.where(mask, numbers, target.numbers)), *sensors])

    def local(self, exchanged: Mask) -> FactorGraph:
        """Sightings and priors of the two, everything else held."""
        factors = [self._relabelled(sightings, exchanged[self.group[k]]) for k, sightings in self.parts.items()]
        held = [keys for factor in factors for slot, keys in enumerate(factor.keys) if slot != 1]
        return FactorGraph([*factors, *self.priors], held)

    def whole(self, exchanged: Mask) -> FactorGraph:
        """The graph with some sightings (n,) exchanged."""
        factors = list(self.graph.factors)
        for k, rows in self.rows.items():
            mask = np.zeros(len(factors[k]), dtype=bool)
            mask[rows] = exchanged[self.group[k]]
            if mask.any():
                factors[k] = self._relabelled(factors[k], mask)
        return FactorGraph(factors, self.graph.fixed)

    def places(self, exchanged: Mask) -> tuple[tuple[int, int], ...]:
        """Number of the factor and index of the measurements of some sightings (n,)."""
        chosen = {k: rows[exchanged[self.group[k]]] for k, rows in self.rows.items()}
        return tuple((k, i) for k, rows in chosen.items() for i in rows.tolist())

    def nearer(self, values: Values) -> Mask:
        """Sightings (n,) whose chi2 is lower with the other landmark."""
        gain: Array = np.zeros(self.n)
        for k, sightings in self.parts.items():
            swapped = self._relabelled(sightings, np.ones(len(sightings), dtype=bool))
            gain += np.bincount(self.group[k], sightings.chi2(values) - swapped.chi2(values), minlength=self.n)
        return gain > 0

    def best(self) -> tuple[Mask, Array] | None:
        """Which sightings (n,) are exchanged where chi2 is lowest, and the landmarks (2, d); poses stay."""
        damped = LevenbergMarquardt(Stop(max_iterations=FIRST))
        fits = []
        for beginning in BEGINNINGS:
            exchanged = np.arange(self.n) >= beginning * self.n
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", GraphWarning)  # other variables are not touched
                    for _ in range(TURNS):
                        graph = self.local(exchanged)
                        result = graph.optimize(locate_points(graph, self.values), damped)
                        fits.append((result.chi2_final, exchanged, result.values[self.pair]))
                        nearer = self.nearer(result.values)
                        if (nearer == exchanged).all():
                            break
                        exchanged = nearer
            except REFUSED:
                continue
        if not fits:
            return None
        _, exchanged, points = min(fits, key=lambda fit: (fit[0], int(fit[1].sum())))
        if 2 * exchanged.sum() > self.n and not self.priors:
            exchanged, points = ~exchanged, points[::-1]
        return exchanged, points
