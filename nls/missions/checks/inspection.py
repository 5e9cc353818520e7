"""All checks of a mission, and which of their findings are left when one explains another."""

from dataclasses import replace

import numpy as np

from models.geodesy import LocalPlane
from nls.missions.checks.agreement import clocks_by_spans, jumping, of_fixes, of_heading, of_track, of_way_down
from nls.missions.checks.alone import alone, attitude_of, sound_speeds
from nls.missions.checks.findings import Cause, Implausible
from nls.missions.checks.log import Log, read_fixes, read_log
from nls.missions.checks.special import repeated, special_values, stale, without
from nls.missions.folder.columns import ANGLES
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
    special = special_values(tables)
    first, tables = _placed(special, tables), without(tables, special)
    if clocks := clocks_by_spans(tables):  # nothing is compared at other times
        return first + _placed(clocks, tables)
    log, fixes = read_log(tables, plane), read_fixes(tables.get("fixes"), plane)
    thin, path, way = log and log.thinned(), tables.get("path"), None
    if thin is not None:  # times and places of the vehicle by its DVL or its path
        way = thin.t_v, thin.way()
    elif path is not None:
        way = path.floats("time_s")[:, 0], path.floats("x_m", "y_m")
    if old := [*stale(log, fixes, way), *repeated(tables)]:
        first, tables = first + _placed(old, tables), without(tables, old)
        log, fixes = read_log(tables, plane), read_fixes(tables.get("fixes"), plane)
    if log is not None:
        out = of_log(log)
    else:
        out = of_track(tables, fixes) + (of_fixes(fixes, np.zeros(len(fixes.t), dtype=bool)) if fixes else [])
    if "sound-speed" in tables:
        out += sound_speeds(tables["sound-speed"])
    if (ship := tables.get("ship")) is not None:
        out += attitude_of("ship.csv", ship.rising("time_s"), ship.floats(*ANGLES))
    return first + _placed(out, tables)


def _placed(entries: list[Implausible], tables: dict[str, Table]) -> list[Implausible]:
    """Findings with the lines of their rows, and the names of their files as they are."""
    out = []
    for entry in entries:
        lines = tables[entry.file.removesuffix(".csv")].lines + 1
        out.append(replace(entry, line=int(lines[entry.line]), lines=tuple(lines[list(entry.lines)].tolist())))
    return out


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
    causes = [{(r.cause, r.file) for r in entry.readings} for entry in single]
    narrowed = [tuple(r for r in readings if (r.cause, r.file) in own) for own in causes]
    if any(narrowed):  # one sensor alone shows it, and the others say which unit it is
        return [replace(e, readings=r) if r else e for e, r in zip(single, narrowed, strict=True)]
    return single + (of_heading(thin) or together or of_fixes(thin.fixes, jumping(thin)))
