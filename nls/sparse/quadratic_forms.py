"""U' H^-1 U of many narrow matrices U of few rows, without H^-1 U.

With H = L L' it is Y'Y, L Y = U. Rows of Y are zero but for those on the way from the rows of U up to the root of the
elimination tree. Matrices that begin near one another in that tree share most of the way, and go it together.

Source: T. A. Davis, "Direct Methods for Sparse Linear Systems", 2006, section 3.2: the reach of a sparse right side.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, product
from nls.sparse.takahashi import DenseColumns, Supernodes
from nls.sparse.threads import single_thread
from nls.stages import announce

TOGETHER = 192  # columns that go the way together


@single_thread()
def quadratic_forms(nodes: Supernodes, L: sp.csc_array, p: Index, U: sp.csc_array, d: int) -> Array:
    """(g, d, d) matrices U_k' H^-1 U_k of g matrices of d columns.

    Parameters
    ----------
    nodes, L, p : the supernodes of L, with H[p][:, p] = L L'.
    U : (n, g d) the matrices side by side, the rows in the order of H.
    d : columns of each.
    """
    place = np.empty(len(p), dtype=np.intp)
    place[p] = np.arange(len(p))
    row, column = place[U.indices], np.repeat(np.arange(U.shape[1]), np.diff(U.indptr))
    g, node = U.shape[1] // d, nodes.node[row]
    first = np.full(g, len(nodes))
    np.minimum.at(first, column // d, node)
    rank = np.empty(g, dtype=np.intp)
    rank[np.argsort(first, kind="stable")] = np.arange(g)
    number = rank[column // d]  # of the matrix, in the order of their beginnings
    order = np.argsort(number, kind="stable")
    row, node, number, within, data = row[order], node[order], number[order], column[order] % d, U.data[order]
    step = max(1, TOGETHER // d)
    cuts = np.searchsorted(number, np.arange(0, g + step, step))
    columns, dense = DenseColumns(L, nodes), dict[int, tuple[Array, Array]]()
    where, out = np.empty(len(p), dtype=np.intp), np.zeros((g, d, d))
    for k, (begin, end) in enumerate(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)):
        if k:
            announce(f"{k * step:,} of {g:,} groups of closures")
        way = _way(nodes, node[begin:end])
        rows = np.concatenate([nodes.rows(j)[: nodes.width[j]] for j in way] or [np.zeros(0, dtype=np.intp)])
        where[rows] = np.arange(len(rows))
        Y = np.zeros((len(rows), step, d))
        Y[where[row[begin:end]], number[begin:end] - k * step, within[begin:end]] = data[begin:end]
        flat, at = Y.reshape(len(rows), step * d), 0
        for j in way:
            if j not in dense:
                dense[j] = columns.of(j)
            L_JJ_inv, L_SJ = dense[j]
            J = slice(at, at := at + len(L_JJ_inv))
            flat[J] = L_JJ_inv @ flat[J]
            if len(L_SJ):
                flat[where[nodes.rows(j)[len(L_JJ_inv) :]]] -= L_SJ @ flat[J]
        Y = np.ascontiguousarray(Y.transpose(1, 0, 2))
        out[k * step : (k + 1) * step] = product(Y.mT, Y)[: g - k * step]
    return out[rank]


def _way(nodes: Supernodes, begin: Index) -> list[int]:
    """Supernodes from some up to the roots, rising."""
    way: set[int] = set()
    for k in np.unique(begin).tolist():
        while k >= 0 and k not in way:
            way.add(k)
            k = int(nodes.parent[k])
    return sorted(way)
