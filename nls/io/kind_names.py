"""Kinds of variables by the names that graph text files know: poses x and points l."""

from __future__ import annotations

from collections.abc import Callable

from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, R
from nls.graph import FactorGraph
from nls.io.records import KINDS
from nls.values import Values

__all__ = ["with_known_kinds"]


def with_known_kinds(graph: FactorGraph, values: Values) -> tuple[FactorGraph, Values, list[str]]:
    """The graph with its only kind of poses called x and its only kind of points l, and what was changed, in words.

    A graph with more kinds, or with others, is given back as it is, as is one in which nothing has to change.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from nls import kinds
    >>> A, L = kinds("A", "L")
    >>> graph = FactorGraph([Landmark(A[1], L[[1, 2]], [[1.0, 0.0], [2.0, 0.0]], Isotropic(0.1))])
    >>> values = Values({A: (SE2, [[0, 0, 0]], [1]), L: (R(2), [[1, 0], [2, 0]], [1, 2])})
    >>> graph, values, changes = with_known_kinds(graph, values)
    >>> graph.factors, values, changes
    ([Landmark(x[1, 1], l[1, 2])], Values(x: 1 x SE2, l: 2 x R(2)), ['poses A are written as x, points L as l'])
    """
    poses = [stack for stack in values.stacks.values() if stack.manifold in (SE2, SE3)]
    points = [stack for stack in values.stacks.values() if stack.manifold in (R(2), R(3))]
    if len(poses) != 1 or len(points) > 1 or len(values.stacks) > 2 or len(poses + points) != len(values.stacks):
        return graph, values, []
    names = {stack.kind: KINDS[role] for stack, role in zip(poses + points, ("pose", "point"), strict=False)}
    changes = ", ".join(
        f"{noun} {old} {'are written ' if noun == 'poses' else ''}as {name}"
        for noun, (old, name) in zip(("poses", "points"), names.items(), strict=False)
        if old != name
    )
    if not changes:
        return graph, values, []
    stacks = values.stacks.values()
    renamed = Values({names[s.kind]: (s.manifold, s.X, s.numbers) for s in stacks})
    return with_keys(graph, lambda keys: Keys(names[keys.kind], keys.numbers)), renamed, [changes]


def with_keys(graph: FactorGraph, key: Callable[[Keys], Keys]) -> FactorGraph:
    """The same measurements, and the same held, of other variables."""
    other = FactorGraph([replaced(factor, tuple(map(key, factor.keys))) for factor in graph.factors])
    for keys in graph.fixed:
        other.fix(key(keys))
    return other
