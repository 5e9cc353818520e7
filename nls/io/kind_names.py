"""Kinds of variables by the names that graph text files know: poses x and points l."""

from __future__ import annotations

from copy import copy

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models import SE2, SE3, R
from models.algebra import Numbers
from nls.graph import FactorGraph
from nls.io.records import KINDS
from nls.values import Values

__all__ = ["with_known_kinds"]

POSE, POINT, MOUNT = KINDS["pose"], KINDS["point"], KINDS["mount"]


def with_known_kinds(graph: FactorGraph, values: Values, apart: bool = False) -> tuple[FactorGraph, Values, list[str]]:
    """The graph with its only kind of poses called x and its only kind of points l, and what was changed, in words.

    Points whose numbers poses have, too, get the numbers after the largest, or free ones where these are too large,
    unless points are numbered ``apart``. A graph with more kinds, or with others, is given back as it is, as is one in
    which nothing has to change.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from nls import kinds
    >>> A, L = kinds("A", "L")
    >>> graph = FactorGraph([Landmark(A[1], L[[1, 2]], [[1.0, 0.0], [2.0, 0.0]], Isotropic(0.1))])
    >>> values = Values({A: (SE2, [[0, 0, 0]], [1]), L: (R(2), [[1, 0], [2, 0]], [1, 2])})
    >>> graph, values, changes = with_known_kinds(graph, values)
    >>> graph.factors, values, changes
    ([Landmark(x[1, 1], l[3, 2])], Values(x: 1 x SE2, l: 2 x R(2)), ['poses A are written as x, points L as l; 1 of \
the points had the number of a pose: they are numbered from 3'])
    """
    poses = [stack for stack in values.stacks.values() if stack.manifold in (SE2, SE3)]
    points = [stack for stack in values.stacks.values() if stack.manifold in (R(2), R(3))]
    if len(poses) != 1 or len(points) > 1 or len(values.stacks) > 2 or len(poses + points) != len(values.stacks):
        return graph, values, []
    names = {stack.kind: name for stack, name in zip(poses + points, (POSE, POINT), strict=False)}
    new = {stack.kind: np.array(stack.numbers) for stack in poses + points}
    changes = ", ".join(
        f"{noun} {old} {'are written ' if noun == 'poses' else ''}as {name}"
        for noun, (old, name) in zip(("poses", "points"), names.items(), strict=False)
        if old != name
    )
    clash = np.isin(points[0].numbers, poses[0].numbers) if points and not apart else np.zeros(0, dtype=bool)
    if clash.any():
        numbers = _free(np.concatenate([stack.numbers for stack in poses + points]), int(clash.sum()))
        new[points[0].kind][clash] = numbers
        changes += f"; {clash.sum()} of the points had the number of a pose: they are numbered from {numbers[0]}"
    if not changes:
        return graph, values, []

    def key(keys: Keys) -> Keys:
        return Keys(names[keys.kind], new[keys.kind][values.stacks[keys.kind].index(keys)])

    renamed_graph = FactorGraph([_with_keys(factor, tuple(map(key, factor.keys))) for factor in graph.factors])
    for keys in graph.fixed:
        renamed_graph.fix(key(keys))
    stacks = values.stacks.values()
    return (
        renamed_graph,
        Values({names[s.kind]: (s.manifold, s.X, new[s.kind]) for s in stacks}),
        [changes.removeprefix("; ")],
    )


def _free(numbers: Numbers, count: int) -> Numbers:
    """So many numbers that nothing has: those after the largest, where they are below 2^63, else the first from 0.

    Examples
    --------
    >>> _free(np.array([0, 7]), 2), _free(np.array([0, 2**63 - 1]), 2)
    (array([8, 9]), array([1, 2]))
    """
    largest = int(numbers.max())
    if largest + count < 2**63:
        return largest + 1 + np.arange(count)
    free: Numbers = np.setdiff1d(np.arange(len(numbers) + count), numbers)[:count]
    return free


def _with_keys(factor: Factor, keys: tuple[Keys, ...]) -> Factor:
    """The same measurements of other variables."""
    substitute = copy(factor)
    substitute.keys = keys
    return substitute
