"""Determination by the data of a mission: its calibrations, and how many measured numbers check its dead reckoning.

Of a calibration it is told how much of what was not known before is left,

    share = sigma after all measurements / sigma of the row in calibration.csv

1 where no measurement says anything, near 0 where they say everything. A calibration that keeps `LEFT` of its sigma is
not determined: its value is the stated one.

A raw log measures depth and attitude at each pose and a step to the next. These are as many numbers as unknowns, so
whatever the DVL says fits. The degrees of freedom left for the position are those of the graph without those of the
yaw:

    checks = dof - max(0, headings + turns - poses)

with `Heading` as headings, and the rows of `XYH` that say the turn and nothing of x and y as turns.
"""

from typing import Any

import numpy as np

from factors import XYH, Heading
from factors.keys import Keys, Kind, kinds
from models.algebra import Array, Mask, Numbers
from models.errors import UnderconstrainedError
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.io.table import EMPTY
from nls.missions.folder.folder import MissionReport
from nls.values import Values

LEFT = 0.9  # of the sigma: 81 % of the variance
YAW = 2  # column of XYH
(x,) = kinds("x")


def determinations(values: Values, report: MissionReport, marginals: Marginals | None) -> list[dict[str, Any]]:
    """The calibrations of a solved mission in the report for programs, in the order of calibration.csv.

    Parameters
    ----------
    values, report : the solution of a mission.
    marginals : its covariances; None where there are none, so that no sigma is known.

    Returns
    -------
    name : in calibration.csv; ``gyro_bias`` is that of the first minute.
    value, sigma : after the measurements; sigma is None where it is not known.
    sigma_before : before them.
    sigmas_away : how far the estimate is from the stated value, in sigmas before the measurements.
    share : the part of the sigma before the measurements that is left.
    determined : whether the measurements say more of it than was known before.
    """
    rows = []
    for name, (believed, before) in report.calibrations.items():
        kind, sigma = Kind(name), None
        if marginals is not None and marginals.status(kind)[0] == "estimated":
            sigma = float(np.sqrt(marginals.covariance(kind[0])[0, 0]))
        value, share = float(values[kind[0]][0]), None if sigma is None else sigma / before
        row = {"name": name, "value": value, "sigma": sigma, "sigma_before": before}
        row |= {"sigmas_away": abs(value - believed) / before, "share": share}
        rows.append(row | {"determined": None if share is None else share <= LEFT})
    return rows


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
    yaws = W[:, YAW] != 0 if W.ndim == 2 else (W[:, :, YAW] != 0) & (W[:, :, :YAW] == 0).all(axis=2)
    return int(yaws.sum()) * (len(factor) if len(W) == 1 else 1)


def sigma_at_the_end(marginals: Marginals | None, report: MissionReport) -> float | None:
    """Standard deviation of the distance of the last pose from the true one, m: the root of the trace of its x, y, z.

    None where there are no covariances, or it is free.
    """
    if marginals is None:
        return None
    numbers = marginals.values.stack("x").numbers
    last = int(numbers[np.argmax(report.vertex_times.get("x", numbers))])
    try:
        return float(np.sqrt(np.trace(marginals.covariance(x[last], view="position"))))
    except UnderconstrainedError:
        return None


def covariances(values: Values, marginals: Marginals | None, kind: Kind, view: str | None = None) -> Array:
    """Covariances (n, k, k) of the variables of a kind, nan where there are none; view as for `nls.Marginals`."""
    stack = values.stack(kind)
    size = 3 if view == "position" else stack.manifold.dim
    Sigma = np.full((len(stack), size, size), np.nan)
    if marginals is not None and (known := determined(marginals, kind, stack.numbers)).any():
        Sigma[known] = marginals.covariance(kind[stack.numbers[known]], view=view)
    return Sigma


def determined(marginals: Marginals, kind: Kind, numbers: Numbers) -> Mask:
    """Which variables (n,) of a kind have a covariance."""
    known = ~np.isin(marginals.status(kind), EMPTY)
    return np.asarray(known[marginals.values.stack(kind).index(kind[numbers])])


def undetermined(marginals: Marginals, kind: Kind) -> Keys:
    """The variables of a kind without a covariance."""
    numbers = marginals.values.stack(kind).numbers
    return kind[numbers[~determined(marginals, kind, numbers)]]


def or_empty(rows: Array) -> list[list[str]]:
    """Cells of a table, empty where a number is not known."""
    return [["" if np.isnan(number) else repr(number) for number in row] for row in rows.tolist()]
