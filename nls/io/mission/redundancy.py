"""How many measured numbers check the position of dead reckoning, and how well it is known where none does.

A raw log measures depth and attitude at each pose and a step to the next. These are as many numbers as unknowns, so
whatever the DVL says fits. The degrees of freedom left for the position are those of the graph without those of the
yaw:

    checks = dof - max(0, headings + turns - poses)

with `Heading` as headings, and the rows of `XYH` that say the turn and nothing of x and y as turns.
"""

from __future__ import annotations

import numpy as np

from factors import XYH, Heading
from factors.keys import kinds
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.io.mission.report import MissionReport
from nls.values import Values

__all__ = ["position_checks", "sigma_at_the_end"]
YAW = 2  # column of XYH
(x,) = kinds("x")


def position_checks(graph: FactorGraph, values: Values, dof: int) -> int:
    """Measured numbers beyond those that say where the vehicle is: 0 where nothing checks dead reckoning.

    Parameters
    ----------
    graph, values : of a mission, with poses ``x``.
    dof : degrees of freedom of the graph.
    """
    headings = sum(len(factor) for factor in graph.factors if isinstance(factor, Heading))
    turns = sum(_turns(factor, values) for factor in graph.factors if isinstance(factor, XYH))
    return max(0, dof - max(0, headings + turns - len(values.stack("x"))))


def _turns(factor: XYH, values: Values) -> int:
    """Rows of a batch of steps that measure the yaw, and neither x nor y."""
    W = values.gather(factor)[0].W
    if W.ndim == 2:
        rows = int((W[:, YAW] != 0).sum())
    else:
        rows = int(((W[:, :, YAW] != 0) & (W[:, :, :YAW] == 0).all(axis=2)).sum())
    return rows * (len(factor) if len(W) == 1 else 1)


def sigma_at_the_end(marginals: Marginals, report: MissionReport) -> float:
    """Standard deviation of the distance of the last pose from the true one, m: the root of the trace of its x, y, z.

    Raises
    ------
    UnderconstrainedError
        It is free.
    """
    numbers = marginals.values.stack("x").numbers
    last = int(numbers[np.argmax(report.vertex_times.get("x", numbers))])
    return float(np.sqrt(np.trace(marginals.covariance(x[last], view="position"))))
