"""All checks of a mission, and which of their findings are left when one explains another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.geodesy import LocalPlane
from nls.missions.checks.agreement import jumping, of_fixes, of_heading, of_ship, of_track, of_way_down
from nls.missions.checks.alone import alone, sound_speeds
from nls.missions.checks.clocks import clocks_by_spans
from nls.missions.checks.findings import Cause, Implausible
from nls.missions.checks.log import Log, read_fixes, read_log
from nls.missions.checks.special import repeated, special_values, stale, without
from nls.missions.folder.table import Table


@np.errstate(over="ignore", invalid="ignore")  # numbers near the largest are far from all others
def implausible(tables: dict[str, Table], plane: LocalPlane | None) -> list[Implausible]:
    """Implausible numbers in the tables of a mission.

    Parameters
    ----------
    tables : by name, as read.
    plane : where x = y = 0 is on the Earth; None where no file says it.

    Raises
    ------
    GraphFileError
        A cell that is no number, as when the tables are read.
    """
    first = special_values(tables)
    special = [_placed(entry, tables) for entry in first]
    tables = without(tables, first)
    if clocks := clocks_by_spans(tables):  # nothing is compared at other times
        return special + [_placed(entry, tables) for entry in clocks]
    log = read_log(tables, plane) if "dvl" in tables else None
    thin, path, way = log and log.thinned(), tables.get("path"), None
    if thin is not None:  # times and places of the vehicle by its DVL or its path
        way = thin.t_v, thin.way()
    elif path is not None:
        way = path.floats("time_s")[:, 0], path.floats("x_m", "y_m")
    if old := [*stale(log, read_fixes(tables.get("fixes"), plane), way), *repeated(tables)]:
        special += [_placed(entry, tables) for entry in old]
        tables = without(tables, old)
        log = read_log(tables, plane) if "dvl" in tables else None
    if log is None:
        fixes = read_fixes(tables.get("fixes"), plane)
        out = of_track(tables, fixes) + (of_fixes(fixes, np.zeros(len(fixes.t), dtype=bool)) if fixes else [])
    else:
        out = of_log(log)
    out += sound_speeds(tables["sound-speed"]) if "sound-speed" in tables else ()
    out += of_ship(tables["ship"]) if "ship" in tables else ()
    return special + [_placed(entry, tables) for entry in out]


def _placed(entry: Implausible, tables: dict[str, Table]) -> Implausible:
    """With the line of its row, and the name of the file as it is."""
    table = tables[entry.file.removesuffix(".csv")]
    lines = tuple((table.lines[list(entry.lines)] + 1).tolist())
    return replace(entry, line=int(table.lines[entry.line]) + 1, lines=lines)


def of_log(log: Log) -> list[Implausible]:
    """Implausible numbers in a raw log; lines are rows, counted from 0."""
    single, thin = list(alone(log)), log.thinned()
    upside_down = any(entry.check == "tilt" and entry.readings[0].cause is Cause.AXES for entry in single)
    incomparable = upside_down or any(entry.check in ("time step", "bottom lock") for entry in single)
    if incomparable or len(thin.t_v) < 2:
        return single
    together = of_way_down(thin)
    explained_units = {r.file for entry in together for r in entry.readings if r.cause is Cause.UNIT}
    single = [entry for entry in single if entry.check != "scatter" or entry.file not in explained_units]
    readings = together[0].readings if together else ()
    named = {(r.cause, r.file) for r in readings}
    causes = [{(r.cause, r.file) for r in entry.readings} for entry in single]
    if any(own & named for own in causes):  # one sensor alone shows it, and the others say which unit it is
        narrowed = [tuple(r for r in readings if (r.cause, r.file) in own) for own in causes]
        return [replace(e, readings=r) if r else e for e, r in zip(single, narrowed, strict=True)]
    return single + (of_heading(thin) or together or of_fixes(thin.fixes, jumping(thin)))
