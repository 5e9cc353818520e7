"""New names of variables: kinds that graph text files know, numbers where all vertices share one numbering.

A file with new numbers cannot say the old ones. Widely used readers lose edges over a comment, and stop at an unknown
tag. So the old names are stated in a note, all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, R
from models.algebra import Numbers
from nls.graph import FactorGraph
from nls.io.formats import check_renumber as check_renumber
from nls.io.gtsam_keys import VertexIds
from nls.io.records import KINDS
from nls.io.report import LoadReport
from nls.values import Stack, Values

__all__ = ["check_renumber", "renumbered", "with_keys", "with_known_kinds"]


def renumbered(
    graph: FactorGraph, values: Values, report: LoadReport | None = None, names: Mapping[str, str] | None = None
) -> tuple[FactorGraph, Values, list[str]]:
    """The graph with every number once, and which variable was which, in words.

    Poses keep their numbers. Places of sensors, then points, keep those that no variable before them has; the others
    get the numbers behind the largest, in the order of the old ones. Where these are too large, they get the first that
    are free.

    Parameters
    ----------
    graph, values : not changed; given back as they are where every number is there once.
    report : as for `nls.save`; kinds whose ids are keys of GTSAM keep their numbers.
    names : what the kinds were called in the graph of the user, for the words; as they are when omitted.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from models import R
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Landmark(x[0], l[[0, 7, 1]], [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]]), l: (R(2), [[1, 0], [2, 0], [3, 0]], [0, 7, 1])})
    >>> graph, values, notes = renumbered(graph, values)
    >>> graph.factors, values.stack(l).numbers.tolist(), notes
    ([Landmark(x[0, 0, 0], l[8, 7, 9])], [8, 7, 9], ['2 variables have new numbers: l8 to l9 were l0 to l1'])
    """
    keyed = VertexIds(graph, values, report).keyed
    stacks = sorted((stack for stack in values.stacks.values() if stack.kind not in keyed), key=_rank)
    used = np.concatenate([np.zeros(0, dtype=np.int64), *(stack.numbers for stack in stacks)])
    taken: Numbers = used[:0]
    new = {stack.kind: stack.numbers for stack in values.stacks.values()}
    runs, count = [], 0
    for stack in stacks:
        numbers = np.array(stack.numbers)
        clash = np.flatnonzero(np.isin(numbers, taken))
        if len(clash):
            clash = clash[np.argsort(numbers[clash])]
            numbers[clash] = _free(used, len(clash))
            used = np.concatenate([used, numbers[clash]])
            old = (names or {}).get(stack.kind, stack.kind)
            runs += _runs(stack.kind, numbers[clash], old, stack.numbers[clash])
            count += len(clash)
        new[stack.kind] = numbers
        taken = np.concatenate([taken, numbers])
    if not count:
        return graph, values, []

    def key(keys: Keys) -> Keys:
        return Keys(keys.kind, new[keys.kind][values.stack(keys.kind).index(keys)])

    other = Values({s.kind: (s.manifold, s.X, new[s.kind]) for s in values.stacks.values()})
    have = "variables have new numbers" if count > 1 else "variable has a new number"
    return with_keys(graph, key), other, [f"{count} {have}: {', '.join(runs)}"]


def _rank(stack: Stack) -> int:
    """Poses of the vehicle first, then places of sensors, then all others."""
    return 2 if stack.manifold not in (SE2, SE3) else 1 if stack.kind == KINDS["mount"] else 0


def _runs(kind: str, new: Numbers, old_kind: str, old: Numbers) -> list[str]:
    """Which variables (n,) were which, in words; one phrase where both go on by 1.

    Examples
    --------
    >>> _runs("l", np.array([7, 8, 9]), "L", np.array([0, 1, 5]))
    ['l7 to l8 were L0 to L1', 'l9 was L5']
    """
    breaks = np.flatnonzero((np.diff(new) != 1) | (np.diff(old) != 1)) + 1
    runs = []
    for run in np.split(np.arange(len(new)), breaks):
        a, b = run[0], run[-1]
        several = f"{kind}{new[a]} to {kind}{new[b]} were {old_kind}{old[a]} to {old_kind}{old[b]}"
        runs.append(several if b > a else f"{kind}{new[a]} was {old_kind}{old[a]}")
    return runs


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
