r"""A choice among few groups of closures, improved by giving up one group or taking one back.

Closures that agree with neighbors are one witness, however many they are, and stay together. Each move is solved for;
the one that lowers the cost

    sum of min(s, c^2)

the most is taken, until none does. Graduation follows one minimum only and cannot leave it by itself. Where closures
are many no group decides alone, and each move costs as much as the whole choice.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Mask
from nls.robust.loop_graph import LoopGraph
from nls.robust.truncated_least_squares import Choice, Truncated

__all__ = ["exchanged"]

FEW, MANY = 60, 600  # groups, closures; with more there are others that check each group
TURNS = 10  # moves at most
BETTER = 1e-3  # of the cost by which a move must lower it


def exchanged(problem: Truncated, loops: LoopGraph, choice: Choice) -> tuple[Choice, list[Choice]]:
    """The choice no move improves, and where the last moves led."""
    cluster = loops.neighbors.cluster
    groups = np.unique(cluster)
    alternatives: list[Choice] = []
    if len(groups) > FEW or len(cluster) > MANY:
        return choice, alternatives
    for _ in range(TURNS):
        inliers = loops.accepted(choice.inliers)
        alternatives = [_moved(problem, loops, choice, inliers, cluster == group) for group in groups]
        best = min(alternatives, key=lambda alternative: alternative.cost)
        if best.cost >= choice.cost * (1 - BETTER):
            break
        choice = best
    return choice, alternatives


def _moved(problem: Truncated, loops: LoopGraph, choice: Choice, inliers: Mask, group: Mask) -> Choice:
    """The choice without a group, or with all of it where most of it is rejected."""
    takes = 2 * (inliers & group).sum() < group.sum()
    masks = loops.masks(inliers | group if takes else inliers & ~group)
    start = problem.graph.only(masks).optimize(choice.result.values).values
    return problem.settled(start)
