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
from nls.graph import FactorGraph
from nls.robust.closures import Index, Mask
from nls.starts.edges import PoseEdges
from nls.values import Values

__all__ = ["misfits"]

LARGE = 60  # closures; larger groups are what the others are judged by
WIDE, FITS = 2.0, 0.999  # a group misfits beyond so many times this quantile: residuals have heavier tails than chi2


def misfits(graph: FactorGraph, values: Values, edges: PoseEdges, closures: Index, group: Index, noise: float) -> Mask:
    """Which closures (k,) belong to a group that the rest of the graph contradicts.

    Parameters
    ----------
    graph, values : what was accepted, and its optimum.
    edges : all relative poses.
    closures : (k,) the accepted closures among them; group : (k,) a number for the group of each.
    noise : chi2 per degree of freedom at the optimum.
    """
    rows = [model.linearize(*values.gather(model.factor)[1]) for model in edges.models]
    b = np.concatenate([b for _, b in rows])[closures]
    A = [np.concatenate([sides[slot] for sides, _ in rows])[closures] for slot in (0, 1)]
    ends = [edges.i[closures], edges.j[closures]]
    marginals, numbers = Marginals(graph, values), values.stacks[edges.kinds[0]].numbers
    wrong, d = np.zeros(len(closures), dtype=bool), edges.group.dim
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(group[order]) > 0])
    for members in np.split(order, starts[1:]):
        k = len(members)
        if k > LARGE:
            continue
        nodes, place = np.unique(np.concatenate([end[members] for end in ends]), return_inverse=True)
        blocks = np.zeros((k, d, len(nodes), d))
        for block, at in zip(A, np.split(place, 2), strict=True):
            blocks[np.arange(k), :, at] = block[members]
        P = marginals.joint(Keys(edges.kinds[0], numbers[nodes]), frame="body").matrix
        A_g, b_g = blocks.reshape(k * d, -1), b[members].reshape(-1)
        t = float(b_g @ np.linalg.solve(np.eye(k * d) - A_g @ P @ A_g.T, b_g))
        wrong[members] = t > WIDE * noise * chi2_gate(k * d, FITS)
    return wrong
