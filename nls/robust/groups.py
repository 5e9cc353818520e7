r"""Groups of closures judged by all the others: what would the rest of the graph say of them?

A group of wrong closures that agree can bend the odometry around it until each fits. Left out as a whole, with b_g and
A_g its rows at the optimum and P the covariance there, it has the statistic

    t_g = b_g' (I - A_g P A_g')^-1 b_g,

which is chi2 distributed with as many degrees of freedom as it has rows, if its closures are right: for a linear
problem it is what chi2 falls by when the group is taken out. No other solution is needed for it.

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968, for single measurements.
"""

from __future__ import annotations

import numpy as np

from factors.keys import Keys
from nls.chi_squared import chi2_gate
from nls.covariance import Marginals
from nls.optimizers import Result
from nls.robust.closures import Mask
from nls.robust.consistency import unit_variance
from nls.robust.loop_graph import LoopGraph

__all__ = ["misfits"]

LARGE = 60  # closures; larger groups are what the others are judged by
MANY = 300  # groups that are judged, those of the largest residuals
WIDE, FITS = 2.0, 0.999  # a group misfits beyond so many times this quantile: residuals have heavier tails than chi2


def misfits(loops: LoopGraph, result: Result, accepted: Mask) -> Mask:
    """Which closures (m,) belong to a group of neighbors that agree and that the rest of the graph contradicts.

    Parameters
    ----------
    loops, accepted : the graph, and the closures (m,) it is solved with.
    result : the optimum of these.
    """
    edges, values, graph = loops.edges, result.values, loops.graph.only(loops.masks(accepted))
    noise = unit_variance(result.chi2_final / max(result.dof, 1))
    rows = [model.linearize(*values.gather(model.factor)[1]) for model in edges.models]
    b = np.concatenate([b for _, b in rows])[~loops.odometry]
    A = [np.concatenate([sides[slot] for sides, _ in rows])[~loops.odometry] for slot in (0, 1)]
    ends = [edges.i[~loops.odometry], edges.j[~loops.odometry]]
    marginals, numbers = Marginals(graph, values), values.stacks[edges.kinds[0]].numbers
    wrong, d, kept = np.zeros(len(accepted), dtype=bool), edges.group.dim, np.flatnonzero(accepted)
    order = kept[np.argsort(loops.neighbors.cluster[kept], kind="stable")]
    starts = np.flatnonzero(np.diff(loops.neighbors.cluster[order])) + 1
    groups = [members for members in np.split(order, starts) if 0 < len(members) <= LARGE]
    groups.sort(key=lambda members: -float(np.square(b[members]).mean()))
    for members in groups[:MANY]:
        k = len(members)
        nodes, place = np.unique(np.concatenate([end[members] for end in ends]), return_inverse=True)
        blocks = np.zeros((k, d, len(nodes), d))
        for block, at in zip(A, np.split(place, 2), strict=True):
            blocks[np.arange(k), :, at] = block[members]
        P = marginals.joint(Keys(edges.kinds[0], numbers[nodes]), frame="body").matrix
        A_g, b_g = blocks.reshape(k * d, -1), b[members].reshape(-1)
        t = float(b_g @ np.linalg.solve(np.eye(k * d) - A_g @ P @ A_g.T, b_g))
        wrong[members] = t > WIDE * noise * chi2_gate(k * d, FITS)
    return wrong
