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
        inside, outside = _lengths(members), _lengths(below)
        nodes = np.arange(K)
        block_node = np.empty(V, dtype=np.intp)
        block_node[_joined(members)] = np.repeat(nodes, inside)
        self.parent = np.array([block_node[rows[0]] if rows else -1 for rows in below], dtype=np.intp)
        self.children = np.bincount(self.parent[self.parent >= 0], minlength=K)

        # Fronts: the block rows of J and S, one front after the other, then the rows themselves.
        blocks = _joined([J + S for J, S in zip(members, below, strict=True)])
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


def _merged(widths: Index, row: Index, column: Index) -> tuple[list[list[int]], list[list[int]]]:
    """Block columns of every supernode and block rows below them, both rising, by the last block column of each.

    The loop over block columns is the elimination itself: 13 ms for sphere2500, 60 ms for city10000.
    """
    V, width = len(widths), widths.tolist()
    ends = np.cumsum(np.bincount(column, minlength=V))[:-1]
    below = [set(rows.tolist()) for rows in np.split(row[np.argsort(column, kind="stable")], ends)]
    children: list[list[int]] = [[] for _ in range(V)]
    members: list[list[int]] = [[j] for j in range(V)]
    seconds = [0.0] * V
    for j in range(V):
        rows = below[j]
        h = sum(map(width.__getitem__, rows))
        now = _seconds(width[j], h)
        for child in children[j]:
            merged = _seconds(width[j] + width[child], h)
            if merged < now + seconds[child]:
                now = merged
                width[j] += width[child]
                members[j] += members[child]
                members[child], below[child] = [], set()
        seconds[j] = now
        if rows:
            parent = min(rows)
            below[parent] |= rows
            below[parent].discard(parent)
            children[parent].append(j)
    roots = [j for j in range(V) if members[j]]
    return [sorted(members[j]) for j in roots], [sorted(below[j]) for j in roots]


def _seconds(w: int, h: int) -> float:
    """Time a supernode of w columns and h rows below takes in the recursion of `nls.sparse.takahashi`."""
    return STEP + GATHER * (h * h + 0.5 * (w + h) ** 2) + FLOP * (2 * h * h * w + 3 * h * w * w + w * w * w)


def _lengths(lists: list[list[int]]) -> Index:
    return np.array([len(numbers) for numbers in lists], dtype=np.intp)


def _joined(lists: list[list[int]]) -> Index:
    return np.array([number for numbers in lists for number in numbers], dtype=np.intp)
