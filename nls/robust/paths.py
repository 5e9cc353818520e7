r"""How well a graph of odometry and accepted closures knows the pose of one place in another: along the shortest path.

The path of least summed uncertainty bounds the covariance of the relative pose from above; in the axes of the world its
links add up, P_ij = Ad(T_j)^-1 (sum of Ad(T_k) C_k Ad(T_k)') Ad(T_j)^-T.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.covariance.frames import turned
from nls.posegraph import Edges

__all__ = ["path_covariances"]

TOGETHER = 10_000_000  # places that paths are kept to, from all sources searched together: 120 MB


def path_covariances(edges: Edges, T: Array, i: Index, j: Index, meters: float) -> Array:
    """Covariances (m, d, d) of the pose of j in i, at j.

    Parameters
    ----------
    edges : what joins the places; they must join all of them.
    T : (n, size) poses.
    i, j : (m,) places.
    meters : the length that counts as much as a radian when paths are compared.
    """
    from scipy.sparse.csgraph import dijkstra

    group, n, d, r = edges.group, len(T), edges.group.dim, edges.group.point_dim
    variances = np.diagonal(edges.C, axis1=1, axis2=2)
    length = variances[:, :r].sum(axis=1) / meters**2 + variances[:, r:].sum(axis=1)
    pair = np.minimum(edges.i, edges.j) * n + np.maximum(edges.i, edges.j)
    order = np.lexsort((length, pair))
    best = order[np.r_[True, np.diff(pair[order]) > 0]]  # of several edges between two places the one known best
    pairs, ends = pair[best], np.stack([edges.i[best], edges.j[best]])
    world = turned(group.adjoint(T[ends[1]]), edges.C[best]).reshape(-1, d * d)
    steps = sp.csr_array((length[best], (ends.min(axis=0), ends.max(axis=0))), shape=(n, n))
    sums = np.zeros((len(i), d * d))
    sources, source = np.unique(i, return_inverse=True)
    size = max(TOGETHER // n, 1)
    for begin in range(0, len(sources), size):
        mine = np.flatnonzero((source >= begin) & (source < begin + size))
        _, before = dijkstra(steps, False, sources[begin : begin + size], return_predecessors=True)
        at, row = j[mine], source[mine] - begin
        while len(mine):  # all paths one step back, until each is where it began
            last = before[row, at]
            mine, row, at, last = (x[last >= 0] for x in (mine, row, at, last))
            sums[mine] += world[np.searchsorted(pairs, np.minimum(last, at) * n + np.maximum(last, at))]
            at = last
    return turned(group.adjoint(group.inverse(T[j])), sums.reshape(-1, d, d))
