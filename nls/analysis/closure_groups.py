"""Loop closures in groups of neighbors: closures between the same two stretches of track, which share their errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from models import Manifold
from models.algebra import Array, Index
from nls.posegraph import closures, odometry, places
from nls.sparse.components import connected
from nls.sparse.pattern import Pattern
from nls.values import Values

__all__ = ["ClosureGroup", "closure_groups"]

WINDOW = 20  # steps at either end between closures of one group


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
