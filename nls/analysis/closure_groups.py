r"""Loop closures in groups of neighbors, each group judged as one measurement against all others.

Closures between the same two stretches of track share their errors. Wrong ones support each other: without one of them
the others still hold the map where it is, and right closures look wrong. Without the whole group they do not:

    t_g = e_g' (I - C_g)^-1 e_g  ~  chi2(m_g),    C_g = A_g P A_g',

with the stacked residuals e_g of the group and the joint covariance C_g of what the fit says about it. t_g is what chi2
falls by without the group, exactly where the problem is linear. Groups and single measurements differ in m. So they
compete by the probability of chi2(m) above t: a right closure in a group adds 3 to m, and about 3 to t.

C_g costs one solution for every number of the group. Only the groups of the largest mean squared residual are judged. A
group without which something is free stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from models import Manifold
from models.algebra import Array, Index
from nls.analysis.chi_squared import chi2_log_tail
from nls.analysis.leave_one_out import UNCHECKED, left_out
from nls.analysis.linearization import Checked, Together, stacked
from nls.posegraph import closures, odometry, places
from nls.sparse.elimination import connected
from nls.sparse.pattern import Pattern, measuring
from nls.values import Values

__all__ = ["ClosureGroup", "GroupTests", "closure_groups"]

WINDOW = 20  # steps at either end between closures of one group
JUDGED = 3  # groups, those of the largest mean squared residual: wrong groups were among the first 3 of 13 to 205


@dataclass(frozen=True)
class ClosureGroup:
    """Neighboring closures of one batch of measurements or of several.

    Attributes
    ----------
    batch, index : (k,) number of the batch, of the measurement in it.
    late : (k,) slot of the later pose.
    kinds : kinds of the poses.
    """

    batch: Index
    index: Index
    late: Index
    kinds: tuple[str, ...]

    def places(self, values: Values) -> Array:
        """(n, k) positions of all poses of the kinds, m."""
        stacks = [values.stacks[kind] for kind in self.kinds]
        return np.concatenate([stack.manifold.position(stack.X) for stack in stacks])


def closure_groups(pattern: Pattern) -> Iterator[ClosureGroup]:
    """Closures between trajectories, in groups of those within 20 steps of each other at both ends.

    Only kinds with steps from pose to pose are trajectories; rotations alone have no place on a map and no group.
    """
    from scipy.spatial import cKDTree

    masks = zip(pattern.batches, odometry(pattern), strict=True)
    tracks = {batch.kinds[0] for batch, steps in masks if steps.any()}
    sizes = [len(numbers) for numbers in pattern.numbers.values()]
    place = places(pattern) + np.repeat((WINDOW + 1) * np.arange(len(sizes)), sizes)  # none reaches the next kind
    tables = []
    for number, (batch, closing) in enumerate(zip(pattern.batches, closures(pattern), strict=True)):
        index = np.flatnonzero(closing)
        if len(index) and {*batch.kinds[:2]} <= tracks and _has_positions(pattern.manifolds[batch.kinds[0]]):
            ends = np.stack([place[batch.variables[slot][index]] for slot in (0, 1)], axis=1)
            late = ends.argmax(axis=1)
            tables.append(np.column_stack([np.full(len(index), number), index, late, np.sort(ends, axis=1)]))
    if not tables:
        return
    table = np.concatenate(tables)
    a, b = cKDTree(table[:, 3:].astype(float)).query_pairs(WINDOW, p=np.inf, output_type="ndarray").T
    label = connected(a, b, len(table))
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        numbers, indices, slots = table[members, :3].T
        kinds = tuple(sorted({*pattern.batches[numbers[0]].kinds[:2]}))
        yield ClosureGroup(numbers, indices, slots, kinds)


def _has_positions(manifold: Manifold) -> bool:
    return bool(manifold.position(manifold.identity()).shape[-1])


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
    most : closures of a group; larger groups are what the others are judged by.
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
        tests = (self._test(number, e) for number in whole[:JUDGED])
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
