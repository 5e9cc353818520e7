"""fixes.csv and closures.csv: positions of the vehicle, and poses as seen from others, of other dives, too."""

from __future__ import annotations

import numpy as np

from factors import XYH, Between, Diagonal, Position
from factors.keys import Keys, kinds
from models import euler
from nls.missions.folder.columns import ANGLES, LEVEL, PLACE, UPRIGHT, suffixed
from nls.missions.folder.rows import Assembly, add_rows, arms, columns_together, horizontal
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline

__all__ = ["add_closures", "add_fixes", "closures"]

(x,) = kinds("x")


def add_fixes(mission: Assembly, timeline: Timeline) -> None:
    """Add the `Position` factors of fixes.csv.

    Raises
    ------
    GraphFileError
        Columns that do not fit together, no such pose or time, a place that cannot be.
    """
    if (table := mission.tables.get("fixes")) is None:
        return
    poses, rows = timeline.poses("fixes", table)
    names: tuple[str, ...] = ("x", "y")
    z = horizontal(table, mission.report.plane)
    if columns_together(table, "z_m", "sigma_z_m"):
        names, z = ("x", "y", "z"), np.column_stack([z, table.measured("z_m")])
    sigmas, arm = table.positive(*suffixed(PLACE[: len(names)])), arms(table)
    fixes = Position(x[poses[:, 0]], z, Diagonal(sigmas), components=names, offset=arm)
    add_rows(mission.graph, mission.report, table, rows, fixes)


def add_closures(mission: Assembly, timeline: Timeline) -> None:
    """Add the factors of closures.csv: `Between` where it has all six coordinates, `XYH` where it has three.

    Raises
    ------
    GraphFileError
        Other columns, no such pose or time, a pose with itself.
    """
    if (table := mission.tables.get("closures")) is None:
        return
    poses, rows = timeline.poses("closures", table)
    same = rows & (poses[:, 0] == poses[:, 1])
    table.refuse_rows(same, lambda k: f"the closure joins pose {poses[k, 0]} to itself")
    add_rows(mission.graph, mission.report, table, rows, closures(table, x[poses[:, 0]], x[poses[:, 1]]))


def closures(table: Table, i: Keys, j: Keys) -> Between | XYH:
    """The factor of n rows that say where the poses j (n,) are in the axes of the poses i (n,).

    Raises
    ------
    GraphFileError
        Numbers that cannot be.
    """
    whole = columns_together(table, *UPRIGHT, *suffixed(UPRIGHT))
    names = (*PLACE, *ANGLES) if whole else LEVEL
    z, sigmas = table.attitude(*names), table.positive(*suffixed(names))
    if whole:
        z = euler.to_se3(np.column_stack([z[:, 3:], z[:, :3]]))
    return (Between if whole else XYH)(i, j, z, Diagonal(sigmas))
