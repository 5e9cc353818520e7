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
    B = sp.csc_array(U[p])  # rows in the order of L
    g, columns, dense = U.shape[1] // d, DenseColumns(L, nodes), dict[int, tuple[Array, Array]]()
    where, out = np.empty(len(p), dtype=np.intp), np.zeros((g, d, d))
    order = np.argsort(B.indices[np.minimum(B.indptr[:-1:d], B.nnz - 1)], kind="stable")
    chunks = np.array_split(order, np.arange(TOGETHER // d, g, TOGETHER // d))
    for k, chunk in enumerate(chunks):
        if k:
            announce(f"forward solve {k} of {len(chunks)}")
        part = B[:, (d * chunk[:, None] + np.arange(d)).reshape(-1)]
        way = _way(nodes, nodes.node[part.indices])
        rows = np.concatenate([nodes.columns[:0], *(nodes.rows(j)[: nodes.width[j]] for j in way)])
        where[rows] = np.arange(len(rows))
        Y, at = sp.csr_array(part)[rows].toarray(), 0
        for j in way:
            L_JJ_inv, L_SJ = dense[j] = dense.get(j) or columns.of(j)
            J = slice(at, at := at + len(L_JJ_inv))
            Y[J] = L_JJ_inv @ Y[J]
            Y[where[nodes.rows(j)[len(L_JJ_inv) :]]] -= L_SJ @ Y[J]
        Y_k = Y.reshape(len(rows), -1, d).transpose(1, 0, 2)
        out[chunk] = product(Y_k.mT, Y_k)
    return out


def _way(nodes: Supernodes, begin: Index) -> list[int]:
    """Supernodes from some up to the roots, rising."""
    way: set[int] = set()
    for k in np.unique(begin).tolist():
        while k >= 0 and k not in way:
            way.add(k)
            k = int(nodes.parent[k])
    return sorted(way)
