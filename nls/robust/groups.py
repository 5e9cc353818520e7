r"""Groups of closures judged by all the others: what would the rest of the graph say of them?

A group of wrong closures that agree can bend the odometry around it until each fits. Left out as a whole, with b_g and
A_g its rows at the optimum and P the covariance there, it has the statistic

    t_g = b_g' (I - A_g P A_g')^-1 b_g,

which is chi2 distributed with as many degrees of freedom as it has rows, if its closures are right. For a linear
problem chi2 falls by it when the group is taken out. No other solution is needed for it. The P of all groups come out
of one selected inverse: solving for the columns of 300 groups of city10000 takes 22 s, this 1.

The same matrix tells how much that statistic can say. A closure c of the group is predicted by the rest with the
covariance S_c. In the units of its own noise this is the block of c in (I - A_g P A_g')^-1. A wrong closure that says
anything passes by chance with the probability

    volume of xi' S_c^-1 xi <= q  /  volume of all relative poses on the map.

Near 1 the closure is checked by nothing.

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968, for single measurements.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import gamma, pi

import numpy as np

from factors.keys import Keys
from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_gate
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.optimizers import Result
from nls.robust.loop_graph import LoopGraph, Neighbors, unit_variance
from nls.values import Values

LARGE = 60  # closures; larger groups are what the others, and their own loose parts, are judged by
# A group misfits beyond so many times this quantile; right ones of simulated graphs reach 1.4.
WIDER_GATE, FITS = 1.6, 0.999


@dataclass(frozen=True)
class Witness:
    """A group of closures, judged by the rest.

    Attributes
    ----------
    members : (k,) its closures.
    t : the statistic, of k d numbers.
    chance : probability with which the best checked of them would pass if it were wrong.
    """

    members: Index
    t: float
    chance: float


def misfits(judged: Iterable[Witness], result: Result, loops: LoopGraph) -> Mask:
    """Which closures (m,) belong to a group of neighbors that agree and that the rest of the graph contradicts.

    Parameters
    ----------
    judged : the groups, at the optimum `result` of the graph.
    """
    noise = unit_variance(result.chi2_final / max(result.dof, 1))
    wrong = np.zeros(len(loops.closures), dtype=bool)
    for witness in judged:
        gate = chi2_gate(len(witness.members) * loops.poses.group.dim, FITS)
        wrong[witness.members] = witness.t > WIDER_GATE * noise * gate
    return wrong


def witnesses(loops: LoopGraph, values: Values, accepted: Mask) -> Iterator[Witness]:
    """The groups of accepted closures (m,) at their optimum, those of the largest residuals first."""
    poses, graph, d = loops.poses, loops.graph.only(loops.masks(accepted)), loops.poses.group.dim
    rows = [batch.model.linearize(*batch.gather(values)) for batch in poses.batches]
    b = np.concatenate([b for _, b in rows])[poses.closures]
    A = [np.concatenate([sides[slot] for sides, _ in rows])[poses.closures] for slot in (0, 1)]
    ends = [poses.i[poses.closures], poses.j[poses.closures]]
    volume = np.linalg.slogdet(loops.closures.C)[1] / 2 + _passing(loops, values)
    groups = _judgeable(loops.neighbors, accepted)
    groups.sort(key=lambda members: -float(np.square(b[members]).mean()))
    del groups[300:]  # those of the largest residuals are judged
    touched = [np.unique(np.concatenate([end[members] for end in ends]), return_inverse=True) for members in groups]
    joint = _joint(graph, values, loops, [nodes for nodes, _ in touched])
    for members, (nodes, place), P in zip(groups, touched, joint, strict=True):
        k = len(members)
        blocks = np.zeros((k, d, len(nodes), d))
        for block, at in zip(A, np.split(place, 2), strict=True):
            blocks[np.arange(k), :, at] = block[members]
        A_g, b_g = blocks.reshape(k * d, -1), b[members].reshape(-1)
        S = np.linalg.inv(np.eye(k * d) - A_g @ P @ A_g.T)
        own = S.reshape(k, d, k, d)[np.arange(k), :, np.arange(k)]
        chance = np.exp(np.min(np.linalg.slogdet(own)[1] / 2 + volume[members]))
        yield Witness(members, float(b_g @ S @ b_g), min(float(chance), 1.0))


def _joint(graph: FactorGraph, values: Values, loops: LoopGraph, groups: list[Index]) -> Iterator[Array]:
    """The covariance (k d, k d) of each group of nodes (k,), in the axes of the body; one pass for all."""
    kind, d = loops.poses.kinds[0], loops.poses.group.dim
    numbers = values.stacks[kind].numbers
    if not groups:
        return
    lower = [np.tril_indices(len(nodes)) for nodes in groups]
    i, j = (np.concatenate([nodes[at[side]] for nodes, at in zip(groups, lower, strict=True)]) for side in (0, 1))
    pairs = Keys(kind, numbers[i]), Keys(kind, numbers[j])
    blocks = Marginals(graph, values, pairs=[pairs]).cross(*pairs, frame="body")
    begin = 0
    for nodes, (row, column) in zip(groups, lower, strict=True):
        k, end = len(nodes), begin + len(row)
        P = np.empty((k, d, k, d))
        P[row, :, column] = blocks[begin:end]
        P[column, :, row] = blocks[begin:end].mT
        begin = end
        yield P.reshape(k * d, k * d)


def _judgeable(neighbors: Neighbors, accepted: Mask) -> list[Index]:
    """Members of every accepted cluster, or of the parts of a large one, but for those that are large themselves."""
    cluster = neighbors.cluster
    large = np.bincount(cluster[accepted], minlength=len(cluster))[cluster] > LARGE
    group = np.where(large, neighbors.parts(accepted), cluster)
    closures = np.flatnonzero(accepted)
    order = closures[np.argsort(group[closures], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    return [members for members in groups if 0 < len(members) <= LARGE]


def _passing(loops: LoopGraph, values: Values) -> float:
    """Logarithm of the share of all relative poses on the map that lie in a unit ellipsoid, at the quantile."""
    d, places = loops.poses.group.dim, loops.places(values)
    span: Array = np.ptp(places, axis=0)
    sides = 2 * np.maximum(span, 1e-3 * span.max(initial=0.0))  # what is thinner is counted as so thick
    if not sides.all():
        return np.inf  # all in one place
    r = len(sides)
    ball = pi ** (d / 2) / gamma(d / 2 + 1) * chi2_gate(d, FITS) ** (d / 2)
    turns = {0: 1.0, 1: 2 * pi, 3: 8 * pi**2}[d - r]  # volume of all rotations, by their dimension
    return float(np.log(ball / turns) - np.log(sides).sum())
