"""Supernodes: columns of a Cholesky factor L that are worked on together, as one dense front.

Column j of L has numbers in the rows `below` j; the first of them is the parent of j in the elimination tree, and the
others are below the parent too. So the columns of a node, merged into its parent, have no rows outside the parent's:

    front of a supernode = (J, S),   J its columns, S the rows below; S lies inside the front of its parent

Merging stores zeros and saves steps. Two nodes are merged where a model of the time says that it pays.

Source of the elimination tree: J. W. H. Liu, "The role of elimination trees in sparse factorization", SIAM J. Matrix
Anal. Appl. 11 (1990). The merging is C. Ashcraft's and R. Grimes' relaxed supernodes, ACM TOMS 15 (1989), by time.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Index
from nls.sparse.fill import rows_below, tree

__all__ = ["Supernodes"]

STEP, GATHER, FLOP = 60e-6, 3e-9, 0.2e-9  # seconds of one supernode, of one number moved, of one operation


class Supernodes:
    """Supernodes of a symmetric matrix of blocks, in elimination order; no number of the matrix is looked at.

    Parameters
    ----------
    widths : (V,) columns of every block column.
    row, column : (P,) blocks below the diagonal, row > column; repeats allowed.

    Attributes
    ----------
    width, height : (K,) columns of each supernode, and rows below them.
    columns : (n,) columns of L, supernode by supernode; those of number k are columns[first[k] : first[k + 1]].
    node, local : (n,) supernode of every column of L, and its place among the columns of that.
    parent : (K,) supernode whose front holds the rows below; -1 for none.
    children : (K,) how many have this parent.
    """

    def __init__(self, widths: Index, row: Index, column: Index) -> None:
        members, below = _merged(widths, row, column)
        V, K, n = len(widths), len(members), int(widths.sum())
        inside, outside = (np.array([len(rows) for rows in parts]) for parts in (members, below))
        nodes = np.arange(K)
        block_node = np.empty(V, dtype=np.intp)
        block_node[np.concatenate(members)] = np.repeat(nodes, inside)
        self.parent = np.array([block_node[rows[0]] if len(rows) else -1 for rows in below], dtype=np.intp)
        self.children = np.bincount(self.parent[self.parent >= 0], minlength=K)

        # Fronts: the block rows of J and S, one front after the other, then the rows themselves.
        blocks = np.concatenate([part for pair in zip(members, below, strict=True) for part in pair])
        owner = np.repeat(nodes, inside + outside)
        tall = widths[blocks]
        begin = np.cumsum(tall) - tall  # of a block row, in the rows of all fronts
        self._rows = np.repeat((np.cumsum(widths) - widths)[blocks] - begin, tall) + np.arange(int(tall.sum()))
        self._front = np.concatenate([[0], np.cumsum(np.bincount(owner, weights=tall, minlength=K))]).astype(np.intp)
        of_S = np.arange(len(blocks)) - (np.cumsum(inside + outside) - inside - outside)[owner] >= inside[owner]
        self.width = np.bincount(owner[~of_S], weights=tall[~of_S], minlength=K).astype(np.intp)
        self.height = np.diff(self._front) - self.width
        self.first = np.concatenate([[0], np.cumsum(self.width)])
        self.columns = self._rows[np.repeat(~of_S, tall)]
        self.node, self.local = np.empty(n, dtype=np.intp), np.empty(n, dtype=np.intp)
        self.node[self.columns] = np.repeat(nodes, self.width)
        self.local[self.columns] = np.arange(n) - np.repeat(self.first[:-1], self.width)

        # Where the rows S are in the front of the parent: the keys (front, block row) rise.
        up = self.parent[owner[of_S]]
        places = np.searchsorted(owner * V + blocks, up * V + blocks[of_S])
        rows, tall_S = begin[places] - self._front[up], tall[of_S]
        ends = np.cumsum(tall_S)
        self._place = np.repeat(rows - (ends - tall_S), tall_S) + np.arange(int(tall_S.sum()))
        self._below = np.concatenate([[0], np.cumsum(self.height)])

    def __len__(self) -> int:
        return len(self.width)

    def rows(self, k: int) -> Index:
        """Rows of L in the front of supernode k: its columns, then the rows below."""
        return self._rows[self._front[k] : self._front[k + 1]]

    def below(self, k: int) -> Index:
        """Where the rows below supernode k are in the front of its parent."""
        return self._place[self._below[k] : self._below[k + 1]]

    def place_below(self, k: Index, row: Index) -> Index:
        """Places of rows of L, given by (p,) supernode and row, among those below these supernodes, from 0."""
        rows = np.repeat(np.arange(len(self)), np.diff(self._front)) * len(self.node) + self._rows  # rising
        return np.searchsorted(rows, k * len(self.node) + row) - self._front[k] - self.width[k]

    @property
    def numbers(self) -> int:
        """Most numbers in fronts that are needed at one time, from the last supernode to the first."""
        size = ((self.width + self.height) ** 2).tolist()
        waiting, now, most = self.children.tolist(), 0, 0
        for k in range(len(self) - 1, -1, -1):
            now += size[k]
            most = max(most, now)
            if not waiting[k]:
                now -= size[k]
            p = int(self.parent[k])
            if p >= 0:
                waiting[p] -= 1
                if not waiting[p]:
                    now -= size[p]
        return most


def _merged(widths: Index, row: Index, column: Index) -> tuple[list[Index], list[Index]]:
    """Block columns of every supernode and block rows below them, both rising, by the last block column of each."""
    order = np.lexsort((column, row))
    row, column = row[order], column[order]
    members = _together(widths, rows_below(widths, row, column), tree(row, column, len(widths)))
    node = np.empty(len(widths), dtype=np.intp)
    node[np.concatenate(members)] = np.arange(len(members)).repeat([len(J) for J in members])
    order = np.argsort(node[column], kind="stable")
    rows = np.split(row[order], np.cumsum(np.bincount(node[column], minlength=len(members)))[:-1])
    inside: list[list[Index]] = [[J, S] for J, S in zip(members, rows, strict=True)]  # and what children have below
    below = []
    for J, parts in zip(members, inside, strict=True):
        S = np.unique(np.concatenate(parts))
        below.append(S[S > J[-1]])
        if len(below[-1]):
            inside[node[below[-1][0]]].append(below[-1])
    return members, below


def _together(widths: Index, below: Index, parent: list[int]) -> list[Index]:
    """Block columns of every supernode, rising: a child joins its parent in the tree where that saves time.

    The loop over block columns takes 10 ms for sphere2500.
    """
    width, height = widths.tolist(), below.tolist()
    V = len(width)
    members: list[list[int]] = [[j] for j in range(V)]
    seconds = [0.0] * V
    children: list[list[int]] = [[] for _ in range(V)]
    for j in range(V):
        now = _seconds(width[j], height[j])
        for child in children[j]:
            merged = _seconds(width[j] + width[child], height[j])
            if merged < now + seconds[child]:
                now = merged
                width[j] += width[child]
                members[j] += members[child]
                members[child] = []
        seconds[j] = now
        if parent[j] >= 0:
            children[parent[j]].append(j)
    return [np.array(sorted(J)) for J in members if J]


def _seconds(w: int, h: int) -> float:
    """Time a supernode of w columns and h rows below takes in the recursion of `nls.sparse.takahashi`."""
    return STEP + GATHER * (h * h + 0.5 * (w + h) ** 2) + FLOP * (2 * h * h * w + 3 * h * w * w + w * w * w)
