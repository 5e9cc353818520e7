"""Wrong measurements: the worst is removed and all others are tested again, until none stands out.

One wrong loop closure bends the map, and the closures beside it look wrong, too; without it they do not. A group of
wrong closures that support each other is taken out as one. The linear problem decides
about both; then the rest is optimized, and closures that fit the rest after all come back, a group's one by one.

Closures between the same two stretches of track share their errors. Wrong ones support each other: without one of them
the others still hold the map where it is, and right closures look wrong. Without the whole group they do not:

    t_g = e_g' (I - C_g)^-1 e_g  ~  chi2(m_g),    C_g = A_g P A_g',

with the stacked residuals e_g of the group and the joint covariance C_g of what the fit says about it. t_g is what chi2
falls by without the group, exactly where the problem is linear. Groups and single measurements differ in m. So they
compete by the probability of chi2(m) above t: a right closure in a group adds 3 to m, and about 3 to t.

C_g costs one solution for every number of the group. Only the groups of the largest mean squared residual are tested. A
group without which something is free stays.
"""

from collections import ChainMap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from models.algebra import Array, Index
from models.chi_squared import chi2_log_tail, chi2_tail
from models.errors import EvaluationError, GraphError, UnderconstrainedError
from nls.analysis.leave_one_out import (
    UNCHECKED,
    Checked,
    Linearization,
    Tested,
    Together,
    checks,
    kinds_of,
    left_out,
    spoiled,
    stacked,
)
from nls.analysis.redundancy import closure_groups
from nls.graph import FactorGraph
from nls.linear.factorization import SingularSystemError
from nls.optimizers import LevenbergMarquardt, Stop
from nls.posegraph import odometry
from nls.sparse.pattern import Pattern, measuring
from nls.stages import announce
from nls.starts import chordal
from nls.values import Values

ITERATIONS = 25  # of optimizing the rest
MOST = 100  # measurements or groups that are taken out, each at the cost of a solve and of a look at all others
SIGNIFICANT = 1e-3  # chance of the worst measurement among all, if the model is right

Place = tuple[int, int]  # number of the batch, of the measurement in it
Rivals = tuple[int, Place | None]  # how many others it may be instead, and one of these


@dataclass(frozen=True)
class GroupTest:
    """A group against all other measurements.

    Attributes
    ----------
    batch, index : (k,) number of the batch, of the measurement in it.
    t : squared distance from the prediction of all others, in its sigmas.
    log_tail : logarithm of the probability of a larger t, if the model is right.
    """

    batch: Index
    index: Index
    t: float
    log_tail: float


class GroupTests:
    """The groups of closures that may be wrong.

    Parameters
    ----------
    checked : every measurement against all others; the tests follow when measurements are taken out of it.
    scale : (k,) by batch, by what the squared residuals of every measurement are divided.
    most : closures of a group; larger groups are a reference for the others.
    """

    def __init__(self, checked: Checked, scale: list[Array], most: int) -> None:
        self._checked, self._scale = checked, scale
        self._joint: dict[int, Together] = {}
        self._groups: list[tuple[Index, Index]] = []
        for group in closure_groups(checked.linear.pattern):
            counts = stacked(checked.w, group.batch, group.index) > 0
            if 1 < counts.sum() <= most:
                self._groups.append((group.batch[counts], group.index[counts]))

    def worst(self) -> GroupTest | None:
        """The group of the least probable t, of those of which no closure has been taken out; None without any."""
        w, groups = self._checked.w, self._groups
        e = [e * np.sqrt(w / s)[:, None] for e, w, s in zip(self._checked.e, w, self._scale, strict=False)]
        squared = [np.square(e_k).mean(axis=1) for e_k in e]
        whole = [number for number, group in enumerate(groups) if stacked(w, *group).all()]
        whole.sort(key=lambda number: -float(stacked(squared, *groups[number]).mean()))
        tests = (self._test(number, e) for number in whole[:3])  # wrong groups were among the first 3 of 13 to 205
        return min((test for test in tests if test is not None), key=lambda test: test.log_tail, default=None)

    def _test(self, number: int, e: list[Array]) -> GroupTest | None:
        """One group, None where something is free without it.

        Parameters
        ----------
        number : of the group.
        e : residuals of all measurements by batch, times the root of weight over scale.
        """
        batch, index = self._groups[number]
        if number not in self._joint:
            self._joint[number] = self._checked.together(batch, index)
        root = self._checked.roots(batch, index)
        C = root[:, None] * self._joint[number].C * root
        (t,), (r,) = left_out(stacked(e, batch, index)[None], C[None], np.ones(1))
        if r.min() <= UNCHECKED:
            return None
        models = {k: self._checked.linear.pattern.batches[k].model for k in np.unique(batch)}
        idle = sum(int((model.dim - measuring(model)[index[batch == k]]).sum()) for k, model in models.items())
        return GroupTest(batch, index, float(t), chi2_log_tail(float(t), int((r > UNCHECKED).sum()) - idle))


class NoOptimumError(Exception):
    """The rest of the measurements was not solved."""


@dataclass(frozen=True)
class Suspects:
    """Removed measurements, and the test of the rest without them.

    Attributes
    ----------
    places : (batch, index) in the order in which they were taken out.
    rivals : of each of them, how many others it might be instead, and one of these, None where there is none.
    accepted : (k,) by batch, 0 for these and 1 for all others.
    tests : of every batch at the end; t of a suspect is its distance from the prediction of the others.
    s : of every batch at the end (k,), squared residuals at the optimum of the rest, as the linear problem has it.
    values : the optimum of the rest.
    chi2, dof : of the rest there.
    many : whether the search was given up.
    """

    places: list[Place]
    rivals: dict[Place, Rivals]
    accepted: list[Array]
    tests: list[Tested]
    s: list[Array]
    values: Values
    chi2: float
    dof: float
    many: bool


def suspects(graph: FactorGraph, pattern: Pattern, values: Values, checked: Checked) -> Suspects:
    """Remove measurements that do not fit, the worst first.

    Parameters
    ----------
    graph : the measurements, what no measurement touches fixed; not changed.
    pattern : of `checked`; its first batches are those of the graph.
    values : the optimum.
    checked : every measurement against all others; changed.
    """
    count = len(graph.factors)
    kinds = kinds_of(pattern, count)
    scale = _scales(kinds, checks(checked, count), count)
    closing = sum(len(indices) for name, kind in kinds.items() if name.endswith("closures") for _, indices in kind)
    most = min(max(10, int(0.05 * closing)), MOST)  # that are looked for, and closures of a group
    removals: list[list[Place]] = []  # of one measurement, or of a group
    rivals: dict[Place, Rivals] = {}
    many = False
    for _ in range(3):
        fresh = _search(checked, scale, most, most - len(removals), count)
        removals += [list(removal) for removal in fresh]
        rivals |= dict(ChainMap(*fresh))
        many = len(removals) >= most
        if many or not fresh:
            break
        try:
            values, checked = _without(graph, pattern, values, list(chain(*removals)))
            chances = _chances(checks(checked, count), scale)
            significant = [[(k, i) for k, i in removal if chances[k][i] <= SIGNIFICANT] for removal in removals]
            if significant != removals:
                values, checked = _without(graph, pattern, values, list(chain(*significant)))
                removals = [removal for removal in significant if removal]
        except NoOptimumError:
            break  # the linear problem has the last word
    places = list(chain(*removals))
    tests, accepted = checks(checked, count), weights_without(pattern, places, count)
    s = [np.square(e).sum(axis=1) for e in checked.e[:count]]
    chi2 = sum(float(s_k[a > 0].sum()) for s_k, a in zip(s, accepted, strict=True))
    dof = round(sum(float(test.dof[a > 0].sum()) for test, a in zip(tests, accepted, strict=True)), 6) + 0.0
    return Suspects(places, rivals, accepted, tests, s, values, chi2, dof, many)


def _scales(kinds: dict[str, list[tuple[int, Index]]], tests: list[Tested], count: int) -> list[Array]:
    """By what t of every measurement is divided: where all of a kind are too large, the sigmas are, not they."""
    out = [np.ones(len(tests[k].t)) for k in range(count)]
    for kind in kinds.values():
        size = spoiled(tests, kind) if sum(len(indices) for _, indices in kind) >= 10 else 1.0
        for k, indices in kind:
            out[k][indices] = min(max(size, 1.0), 10.0)  # above that are no sigmas that are too small
    return out


def _chances(tests: list[Tested], scale: list[Array]) -> list[Array]:
    """Chance of every measurement as the worst one of all, if the model is right."""
    n = sum(int((test.m > 0).sum()) for test in tests)
    return [np.minimum(chi2_tail(test.t / s, test.m) * n, 1.0) for test, s in zip(tests, scale, strict=True)]


def _search(checked: Checked, scale: list[Array], most: int, left: int, count: int) -> list[dict[Place, Rivals]]:
    """Up to `left` that do not fit, taken out of the linear problem one after the other, with the rivals of each.

    In a single loop every measurement is as far off as the wrong one. Odometry seldom is: it must be twice as far off.
    A group of up to `most` closures counts as one.
    """
    pattern = checked.linear.pattern
    steps = odometry(pattern)[:count]
    out: list[dict[Place, Rivals]] = []
    groups: GroupTests | None = None
    tests = checks(checked, count)
    off = _off(checked, tests, scale)
    while len(out) < left:
        worth = [far * np.where(along, 0.5, 1.0) for far, along in zip(off, steps, strict=True)]
        best, k, i = max((float(w.max()), k, int(w.argmax())) for k, w in enumerate(worth) if len(w))
        if not best > 0:
            break
        batch, index, level, m = np.array([k]), np.array([i]), float(off[k][i]), int(tests[k].m[i])
        groups = groups or GroupTests(checked, scale, most)
        if (group := groups.worst()) is not None and group.log_tail < chi2_log_tail(best * m, m):
            batch, index, level = group.batch, group.index, group.t / m
        as_far = [(j, int(o)) for j, far in enumerate(off) for o in np.flatnonzero(far >= 0.9 * level)]
        checked.take_out(batch, index)
        tests = checks(checked, count)
        off = _off(checked, tests, scale)
        places = list(zip(batch.tolist(), index.tolist(), strict=True))
        # what is as far off still is wrong by itself
        as_far = [(j, o) for j, o in as_far if not off[j][o] > 0 and (j, o) not in places]
        out.append(dict.fromkeys(places, (len(as_far), as_far[0] if as_far else None)))
        announce(f"{len(out)} outliers taken out")
    return out


def _off(checked: Checked, tests: list[Tested], scale: list[Array]) -> list[Array]:
    """(k,) by batch, the squared distance per number of every measurement that does not fit; 0 of all others."""
    out = []
    for k, (test, chance, s) in enumerate(zip(tests, _chances(tests, scale), scale, strict=True)):
        counts = not checked.linear.pattern.batches[k].model.factor.limit_only
        open_ = counts & test.checked & (checked.w[k] > 0) & (chance <= SIGNIFICANT) & (test.m > 0)
        out.append(np.where(open_, test.t / s / np.maximum(test.m, 1), 0.0))
    return out


def weights_without(pattern: Pattern, places: Sequence[Place], count: int) -> list[Array]:
    """By batch 1 for every measurement and 0 for some of them, (n,)."""
    accepted = [np.ones(len(batch)) for batch in pattern.batches[:count]]
    for k, i in places:
        accepted[k][i] = 0.0
    return accepted


def _without(graph: FactorGraph, pattern: Pattern, values: Values, places: list[Place]) -> tuple[Values, Checked]:
    """The optimum of all other measurements, from here, and every measurement against these.

    Raises
    ------
    NoOptimumError
        There is none, or none within `ITERATIONS`; or a factor is made from a function and has no parts.
    """
    accepted = weights_without(pattern, places, len(graph.factors))
    damped = LevenbergMarquardt(Stop(max_iterations=ITERATIONS))
    try:
        subgraph = graph.only([a > 0 for a in accepted])
        result = subgraph.optimize(values, damped)
        if not result.converged and (start := chordal(subgraph, values)) is not values:  # outliers bent it too far
            result = min(result, subgraph.optimize(start, damped), key=lambda candidate: candidate.chi2_final)
        if not result.converged:
            raise NoOptimumError(result.reason)
        return result.values, Checked(Linearization(pattern, result.values, accepted))
    except (SingularSystemError, EvaluationError, GraphError, UnderconstrainedError) as error:
        raise NoOptimumError(str(error)) from error
