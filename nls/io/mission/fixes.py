"""fixes.csv and closures.csv: positions of the vehicle, and poses as seen from other poses."""

from __future__ import annotations

import numpy as np

from factors import XYH, Between, Diagonal, Position
from factors.keys import kinds
from models import euler
from models.algebra import Index
from nls.graph import FactorGraph
from nls.io.mission.columns import ANGLES, LEVEL, PLACE, suffixed
from nls.io.mission.report import MissionReport
from nls.io.mission.rows import add_rows, arms, columns_together, horizontal
from nls.io.mission.table import Table
from nls.io.mission.timeline import Timeline

__all__ = ["add_closures", "add_fixes"]

(x,) = kinds("x")


def add_fixes(graph: FactorGraph, report: MissionReport, table: Table, timeline: Timeline) -> None:
    """Add the `Position` factors of fixes.csv.

    Raises
    ------
    GraphFileError
        Columns that do not fit together, no such pose or time, a place that cannot be.
    """
    poses, rows = timeline.poses("fixes", table)
    names: tuple[str, ...] = ("x", "y")
    z = horizontal(table, report.plane)
    if columns_together(table, "z_m", "sigma_z_m"):
        names, z = ("x", "y", "z"), np.column_stack([z, table.measured("z_m")])
    sigmas, arm = table.positive(*suffixed(PLACE[: len(names)])), arms(table)

    def fix(some: Index) -> Position:
        offset = None if arm is None else arm[some]
        return Position(x[poses[some, 0]], z[some], Diagonal(sigmas[some]), components=names, offset=offset)

    add_rows(graph, report, table, rows, fix)


def add_closures(graph: FactorGraph, report: MissionReport, table: Table, timeline: Timeline) -> None:
    """Add the factors of closures.csv: `Between` where it has all six coordinates, `XYH` where it has three.

    Raises
    ------
    GraphFileError
        Other columns, no such pose or time, a pose with itself.
    """
    poses, rows = timeline.poses("closures", table)
    if (same := rows & (poses[:, 0] == poses[:, 1])).any():
        k = int(np.argmax(same))
        raise table.at(k, f"the closure joins pose {poses[k, 0]} to itself")
    rest = ("z_m", "roll_rad", "pitch_rad")
    whole = columns_together(table, *rest, *suffixed(rest))
    names = (*PLACE, *ANGLES) if whole else LEVEL
    z, sigmas = table.attitude(*names), table.positive(*suffixed(names))
    if whole:
        z = euler.to_se3(np.column_stack([z[:, 3:], z[:, :3]]))

    def closure(some: Index) -> Between | XYH:
        i, j = x[poses[some, 0]], x[poses[some, 1]]
        return (Between if whole else XYH)(i, j, z[some], Diagonal(sigmas[some]))

    add_rows(graph, report, table, rows, closure)
