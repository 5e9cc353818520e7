r"""Two landmarks whose sightings were exchanged: in one image, all from some time on, or single ones.

Exchanged in one image are two rejected contacts each of which fits the other landmark.

    s_ab = |W (z_a - h(x, l_b))|^2 <= q,     s_ba = |W (z_b - h(x, l_a))|^2 <= q

for two rejected contacts of landmarks a and b from one pose x, at an estimate without them; q is the 99 % quantile of
chi2 of two numbers. A false contact fits another landmark by accident, two at once hardly ever do.

Candidates are pairs of landmarks with sightings that do not fit, those first without which chi2 is lowest. For a pair
(a, b), from the poses of the optimum without them, two steps take turns until nothing changes:

    l_a, l_b = argmin of chi2 of their sightings, given which are exchanged
    a sighting is exchanged where chi2 of it is lower with the other landmark

from several beginnings: no sighting exchanged, and those after a quarter, a half and three quarters of the time. The
graph with the best exchange is then solved, poses and all, and compared with the one that stands
(`nls.analysis.alternatives`). Which s of n sightings are exchanged is one of C(n, s) tries.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from factors import Factor, Sighting
from factors.keys import Keys
from factors.replaced import replaced
from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_gate, chi2_tail
from models.errors import GraphWarning
from nls.analysis.alternatives import FIRST, REFUSED, UNLIKELY, Fit, decisive, expected, solved, supported
from nls.analysis.leave_one_out import Tested
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.sparse.pattern import measuring
from nls.starts.landmarks import locate_points, sees_landmarks
from nls.values import Values

TURNS = 4  # of solving the graph, or of locating the landmarks, and choosing what is exchanged


@dataclass(frozen=True)
class Exchanged:
    """Two landmarks that were taken for one another.

    Attributes
    ----------
    first, second : the landmarks.
    places : number of the factor and index of every contact that was exchanged, two for each image.
    standing, chi2 : chi2 of these contacts with their own landmarks, and with each other's.
    """

    first: Keys
    second: Keys
    places: tuple[tuple[int, int], ...]
    standing: float
    chi2: float


def exchanged_contacts(graph: FactorGraph, values: Values, rejected: Sequence[Mask]) -> tuple[Exchanged, ...]:
    """Pairs of landmarks with exchanged contacts, those with the most first.

    Parameters
    ----------
    graph : with all contacts.
    values : an estimate without those that were rejected; contacts of landmarks without a value are passed over.
    rejected : per factor which of its measurements (n,) were; those that are no contacts are passed over.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=12, wrong_associations=0.02)
    >>> rejected = [mission.wrong if f is mission.contacts else np.zeros(len(f), bool) for f in mission.graph.factors]
    >>> pairs = exchanged_contacts(mission.graph, mission.truth, rejected)
    >>> bool(sum(len(pair.places) for pair in pairs) > 0.9 * mission.wrong.sum())
    True
    """
    from scipy.spatial import cKDTree

    exchanges: dict[tuple[str, int, int], list[tuple[int, int, float, float]]] = {}
    for number, (factor, mask) in enumerate(zip(graph.factors, rejected, strict=True)):
        if not isinstance(factor, Sighting) or not factor.contact or not mask.any():
            continue
        stack = values.stack(factor.keys[1].kind)
        rows = np.flatnonzero(mask & np.isin(factor.keys[1].numbers, stack.numbers))
        _, image = np.unique(factor.keys[0].numbers[rows], return_inverse=True)
        order = np.argsort(image, kind="stable")
        pairs = cKDTree(image[order, None].astype(float)).query_pairs(0.5, output_type="ndarray")
        a, b = rows[order[pairs[np.lexsort(pairs.T[::-1])]]].T
        s_ab, s_ba = _misfit(factor, values, a, b), _misfit(factor, values, b, a)
        s_a, s_b = _misfit(factor, values, a, a), _misfit(factor, values, b, b)
        fits = np.maximum(s_ab, s_ba) <= chi2_gate(2, 0.99)
        columns = (a, b, s_a, s_b, s_ab, s_ba)
        for i, j, own_a, own_b, at_b, at_a in zip(*(column[fits].tolist() for column in columns), strict=True):
            first, second = sorted(factor.keys[1].numbers[[i, j]].tolist())
            contacts = [(number, i, own_a, at_b), (number, j, own_b, at_a)]
            exchanges.setdefault((stack.kind, first, second), []).extend(contacts)
    pairs = []
    for (kind, first, second), contacts in exchanges.items():
        places = tuple((number, index) for number, index, *_ in contacts)
        standing, chi2 = (sum(column) for column in list(zip(*contacts, strict=True))[2:])
        pairs.append(Exchanged(Keys(kind, first), Keys(kind, second), places, standing, chi2))
    return tuple(sorted(pairs, key=lambda pair: -len(pair.places)))


def _misfit(factor: Sighting, values: Values, a: Index, b: Index) -> Array:
    """Squared whitened residuals of contacts a (k,) with the landmarks of contacts b."""
    contacts = factor[a]
    return replaced(contacts, [contacts.keys[0], factor.keys[1][b], *contacts.keys[2:]]).chi2(values)


@dataclass(frozen=True)
class SwappedLandmarks(Exchanged):
    """Two landmarks that are exchanged in some of their sightings; chi2 is of the whole graph.

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
    >>> from nls.analysis.leave_one_out import Checked, Linearization
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
    candidates = fits[:6]  # the graph is solved for each
    while candidates and not expected(now):
        best = _best(now, candidates, len(pairs))
        if best is None:
            break
        fit, pair, places, count = best
        now, tries = fit, tries * count
        swaps.append((pair, places))
        candidates = [(without, other) for without, other in candidates if other != pair]
    if not swaps or not supported(standing, now, tries) or not (expected(now) or now.chi2 <= 2.0 * now.dof):
        return ()  # false contacts leave more chi2
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
        worst = sorted(of_kind, key=lambda number: -of_kind[number])[:6]
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
    if fit is None or exchanged.sum() < 2:  # a single one is an outlier
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
        for beginning in (1.0, 0.5, 0.25, 0.75):  # part of the sightings after which they are exchanged
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
