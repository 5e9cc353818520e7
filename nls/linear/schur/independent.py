"""Unknowns that share no factor with each other, found from the structure alone.

Their part of A'A is block diagonal: each can be eliminated without the others. Landmarks that are only seen from poses
are such a set, and so are the points of a bundle adjustment; but nothing here knows what a landmark is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from models.algebra import Index, Mask
from nls.sparse.blocks import Blocks
from nls.sparse.components import connected
from nls.sparse.pattern import Pattern

__all__ = ["independent", "separate", "together", "twins"]


SEARCHED = 16  # kinds among which the best set is searched for


def independent(pattern: Pattern, blocks: Blocks) -> tuple[Mask, str]:
    """The free variables that can be eliminated one by one.

    All variables of the kinds of which no two variables share a factor; where several sets of kinds will do, the one
    with the most columns (of more than 16 such kinds one with many). In a graph without such a kind (a pose graph:
    poses are joined to poses) single variables, few neighbors first.

    Parameters
    ----------
    pattern : the numbering of the graph.
    blocks : which of its free variables share a factor.

    Returns
    -------
    gone : (V,) which of the free variables.
    sentence : in words.
    """
    names, u, v, V = list(pattern.numbers), blocks.u, blocks.v, len(blocks.dims)
    kind = np.repeat(np.arange(len(names)), [len(numbers) for numbers in pattern.numbers.values()])[~pattern.held]
    columns = np.bincount(kind, weights=blocks.dims, minlength=len(names)).astype(np.intp)
    joined = np.zeros((len(names), len(names)), dtype=bool)
    joined[kind[u], kind[v]] = joined[kind[v], kind[u]] = True
    chosen = _heaviest([k for k in range(len(names)) if columns[k] > 0 and not joined[k, k]], joined, columns)
    gone = np.isin(kind, chosen) if chosen else separate(u, v, V)
    count, total = np.bincount(kind[gone], minlength=len(names)), np.bincount(kind, minlength=len(names))
    parts = [
        names[k] if count[k] == total[k] else f"{count[k]:,} of {total[k]:,} {names[k]}" for k in np.flatnonzero(count)
    ]
    names_of_gone = " and ".join(parts) if parts else "nothing"
    return gone, f"{names_of_gone} eliminated: {int(blocks.dims[gone].sum()):,} of {int(blocks.dims.sum()):,} columns"


def _heaviest(kinds: Sequence[int], joined: Mask, columns: Index) -> list[int]:
    """The set of kinds, no two of them joined, with the most columns; the first of equals.

    A search takes time exponential in the number of kinds (24: 1 s; 40: half an hour). Of more than `SEARCHED` the one
    with the most columns is taken, and those it is joined to left out, until so few are left.
    """
    chosen: list[int] = []
    while len(kinds) > SEARCHED:
        most = max(kinds, key=lambda k: columns[k])
        chosen.append(most)
        kinds = [k for k in kinds if k != most and not joined[most, k]]
    return chosen + _searched(kinds, joined, columns)


def _searched(kinds: Sequence[int], joined: Mask, columns: Index) -> list[int]:
    """The best set with the first of the kinds, or the best without it."""
    if not kinds:
        return []
    first, tail = kinds[0], kinds[1:]
    apart = [k for k in tail if not joined[first, k]]
    with_first = [first, *_searched(apart, joined, columns)]
    if len(apart) == len(tail):
        return with_first
    left = _searched(tail, joined, columns)
    return with_first if columns[with_first].sum() >= columns[left].sum() else left


def twins(pattern: Pattern, blocks: Blocks, gone: Mask) -> Index:
    """A number (V,) for every free variable, the same for those that see the same eliminated ones in the same factors.

    Pose and lens of a camera are such twins where each has its own; a lens that all share is the twin of none.

    Parameters
    ----------
    pattern, blocks : as for `independent`.
    gone : (V,) which of the free variables are eliminated.
    """
    u, v, V = blocks.u, blocks.v, len(gone)
    pair = np.unique(np.concatenate([u * V + v, v * V + u])[np.concatenate([gone[v] > gone[u], gone[u] > gone[v]])])
    p, l = np.divmod(pair, max(V, 1))
    names = np.random.default_rng(0).integers(1 << 62, size=V, dtype=np.uint64)
    signature = np.zeros(V, dtype=np.uint64)  # sums that differ as the sets differ, but for a chance of 1e-19 a pair
    np.add.at(signature, p, names[l])
    number = np.full(len(pattern.held), -1, dtype=np.intp)  # of what is held: the last place of these three
    number[~pattern.held] = np.arange(V)
    gone, stays, signature = np.append(gone, False), np.append(~gone, False), np.append(signature, 0)
    joined = [np.zeros((2, 0), dtype=np.intp)]
    for batch in pattern.batches:
        slots = [number[variables] for variables in batch.variables]
        landmark = np.any([gone[i] for i in slots], axis=0)
        for a, b in combinations(slots, 2):
            same = landmark & stays[a] & stays[b] & (signature[a] == signature[b])
            joined.append(np.stack([a[same], b[same]]))
    a, b = np.concatenate(joined, axis=1)
    return connected(a, b, V)


def together(order: Index, group: Index) -> Index:
    """The same variables in an order in which each group is together, where its first member was.

    Examples
    --------
    >>> import numpy as np
    >>> together(np.array([3, 0, 2, 1]), np.array([0, 1, 1, 0])).tolist()
    [3, 0, 2, 1]
    >>> together(np.array([3, 2, 0, 1]), np.array([0, 1, 1, 0])).tolist()
    [3, 0, 2, 1]
    """
    number = group[order]
    _, first, inverse = np.unique(number, return_index=True, return_inverse=True)
    return order[np.argsort(first[inverse], kind="stable")]


def separate(u: Index, v: Index, V: int) -> Mask:
    """A maximal set of nodes (V,) of which no two are neighbors; those of few neighbors first.

    In every round the nodes that come before all their neighbors are taken, and the neighbors left out. There are about
    log V rounds when nodes of equally many neighbors come in random order (fixed seed).

    Source: M. Luby, "A simple parallel algorithm for the maximal independent set problem", SIAM J. Comput. 15 (1986).

    Examples
    --------
    >>> import numpy as np
    >>> separate(np.array([0, 0, 0]), np.array([1, 2, 3]), 5).tolist()
    [False, True, True, True, True]
    """
    a, b = np.concatenate([u, v]), np.concatenate([v, u])
    rank = np.empty(V, dtype=np.intp)
    rank[np.lexsort((np.random.default_rng(0).permutation(V), np.bincount(a, minlength=V)))] = np.arange(V)
    chosen, left = np.zeros((2, V), dtype=bool)
    while len(a):
        before = np.full(V, V)
        np.minimum.at(before, a, rank[b])
        chosen[a[rank[a] < before[a]]] = True
        left[b[chosen[a]]] = True
        on = ~(chosen[a] | left[a] | left[b])
        a, b = a[on], b[on]
    return ~left
