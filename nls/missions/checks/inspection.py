"""All checks of a mission, and which of their findings are left when one explains another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.algebra import Array
from models.geodesy import LocalPlane
from nls.missions.checks.agreement import of_way_down
from nls.missions.checks.alone import ALONE, sound_speeds
from nls.missions.checks.clocks import of_clocks
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Log, read_fixes, read_log
from nls.missions.checks.special import repeated, special_values, stale, without
from nls.missions.checks.track import jumping, of_fixes, of_heading, of_ship, of_track
from nls.missions.folder.table import Table

__all__ = ["implausible", "of_log"]


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
    if clocks := of_clocks(tables):  # nothing is compared at other times
        return special + [_placed(entry, tables) for entry in clocks]
    log = read_log(tables, plane) if "dvl" in tables else None
    old = [*stale(log, read_fixes(tables.get("fixes"), plane), _way(tables, log)), *repeated(tables)]
    if old:
        special += [_placed(entry, tables) for entry in old]
        tables = without(tables, old)
        log = read_log(tables, plane) if "dvl" in tables else None
    if log is None:
        fixes = read_fixes(tables.get("fixes"), plane)
        out = of_track(tables, fixes) + (of_fixes(fixes, np.zeros(len(fixes.t), dtype=bool)) if fixes else [])
    else:
        out = of_log(log)
    out += sound_speeds(tables.get("sound-speed"))
    out += of_ship(tables["ship"]) if "ship" in tables else ()
    return special + [_placed(entry, tables) for entry in out]


def _way(tables: dict[str, Table], log: Log | None) -> tuple[Array, Array] | None:
    """Times and places of the vehicle by its DVL or its path."""
    if log is not None:
        thin = log.thinned()
        return thin.t_v, thin.way()
    if (path := tables.get("path")) is not None:
        return path.floats("time_s")[:, 0], path.floats("x_m", "y_m")
    return None


def _placed(entry: Implausible, tables: dict[str, Table]) -> Implausible:
    """With the line of its row, and the name of the file as it is."""
    table = tables[entry.file.removesuffix(".csv")]
    lines = tuple((table.lines[list(entry.lines)] + 1).tolist())
    return replace(entry, line=int(table.lines[entry.line]) + 1, lines=lines)


def of_log(log: Log) -> list[Implausible]:
    """Implausible numbers in a raw log; lines are rows, counted from 0."""
    alone = [entry for check in ALONE for entry in check(log)]
    thin = log.thinned()
    if any(map(_breaks, alone)) or len(thin.t_v) < 2:
        return alone
    together = of_way_down(thin)
    explained_units = {r.file for entry in together for r in entry.readings if r.cause is Cause.UNIT}
    alone = [entry for entry in alone if entry.check != "scatter" or entry.file not in explained_units]
    readings = together[0].readings if together else ()
    named = {(r.cause, r.file) for r in readings}
    if any(_names(entry, named) for entry in alone):  # one sensor alone shows it, and the others say which unit it is
        return [_narrowed(entry, readings) if _names(entry, named) else entry for entry in alone]
    return alone + (of_heading(thin) or together or of_fixes(thin.fixes, jumping(thin)))


def _names(entry: Implausible, causes: set[tuple[Cause, str]]) -> bool:
    """Whether a finding has one of these causes in one of these files."""
    return any((reading.cause, reading.file) in causes for reading in entry.readings)


def _narrowed(entry: Implausible, readings: tuple[Reading, ...]) -> Implausible:
    """A finding with those of the readings that are of its own causes and files."""
    own = {(reading.cause, reading.file) for reading in entry.readings}
    return replace(entry, readings=tuple(r for r in readings if (r.cause, r.file) in own))


def _breaks(entry: Implausible) -> bool:
    """Whether no other sensor can be compared after this."""
    upside_down = entry.check == "tilt" and entry.readings[0].cause is Cause.AXES
    return upside_down or entry.check in ("time step", "bottom lock")
