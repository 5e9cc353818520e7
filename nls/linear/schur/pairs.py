"""All pairs of neighbors of eliminated variables, sorted by the block of S they belong to.

The lists of pairs are filled up to one of the lengths 1, 2, 3, 4, 6, 8, 12, ... with a block of zeros. So there are few
stacked products however many lengths there are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from models.algebra import Index
from nls.sparse.elimination import first_of_equals

__all__ = ["Pairs", "Products"]


class Products(NamedTuple):
    """Stacked products of one shape: block `target` of S loses sum_k Y[first[., k]]' Y[second[., k]]."""

    first: npt.NDArray[np.int32]  # (m, length), which of the Y_lp of its dimension
    second: npt.NDArray[np.int32]
    target: Index  # (m,)
    shape: tuple[int, int]


class Pairs:
    """All pairs of neighbors of every eliminated variable, by the block of S they belong to.

    Parameters
    ----------
    l, p : (n,) neighbors p of every l, by rising l and then p, each once.
    count, groups : how many l and p there are.
    own : only the pairs of a neighbor with itself, which make the diagonal blocks of S.

    Attributes
    ----------
    first, second : (pairs,) places in l and p; the p of the second is not above that of the first.
    length, high, low : (blocks,) how many pairs every block of S has, one block after the other, and its p.
    """

    def __init__(self, l: Index, p: Index, count: int, groups: int, own: bool = False) -> None:
        if own:
            first = second = np.arange(len(l), dtype=np.int32)
        else:
            first, second = _all_pairs(l)
        block = p[first] * groups + p[second]
        order = np.argsort(block, kind="stable")
        block = block[order]
        begins = np.flatnonzero(first_of_equals(block))
        self.first, self.second = first[order], second[order]
        self.length = np.diff(np.append(begins, len(block)))
        self.count = count
        self.high, self.low = np.divmod(block[begins], max(groups, 1))

    def products(self, height: Index, dims: Index, target: Index) -> list[Products]:
        """The pairs as stacked products.

        Parameters
        ----------
        height : (n,) dimension of the p of every pair (l, p), which are counted anew for each dimension.
        dims : dimension of every p.
        target : where every block of S begins.
        """
        local = np.empty(len(height), dtype=np.int32)
        dummy = {}
        for D in np.unique(height):
            same = np.flatnonzero(height == D)
            local[same], dummy[int(D)] = np.arange(len(same)), len(same)
        filled, base = _filled_up(self.length), int(dims.max(initial=0)) + 1
        shape = (filled * base + dims[self.high]) * base + dims[self.low]
        within = np.arange(len(self.first)) - np.repeat(np.cumsum(self.length) - self.length, self.length)
        every, out = np.repeat(shape, self.length), []
        for code in np.unique(shape):
            high_digits, C = divmod(int(code), base)
            length, D = divmod(high_digits, base)
            blocks, pairs = np.flatnonzero(shape == code), np.flatnonzero(every == code)
            at = np.repeat(np.arange(len(blocks)), self.length[blocks]) * length + within[pairs]
            sides = []
            for side, size in ((self.first, D), (self.second, C)):
                index = np.full(len(blocks) * length, dummy[size], dtype=np.int32)
                index[at] = local[side[pairs]]
                sides.append(index.reshape(-1, length))
            out.append(Products(sides[0], sides[1], target[blocks], (D, C)))
        return out


def _all_pairs(l: Index) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Places in l, rising, of the two members of every pair with one l, the second not behind the first."""
    degree = np.bincount(l)
    begin = np.cumsum(degree) - degree
    firsts, seconds = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.int32)]
    for k in np.flatnonzero(np.bincount(degree)):
        i, j = np.tril_indices(int(k))
        at = begin[degree == k, None]
        firsts.append((at + i).reshape(-1).astype(np.int32))
        seconds.append((at + j).reshape(-1).astype(np.int32))
    return np.concatenate(firsts), np.concatenate(seconds)


def _filled_up(length: Index) -> Index:
    """The next of 1, 2, 3, 4, 6, 8, 12, 16, ..., at most a third longer."""
    power = 1 << np.ceil(np.log2(np.maximum(length, 1))).astype(np.intp)
    return np.where(length <= 3 * power // 4, np.maximum(3 * power // 4, 1), power)
