"""A mission folder as a graph, its start and a report; `TRACKS` has the file that says the way, and its reader."""

from pathlib import Path

import numpy as np

from factors.keys import kinds
from models import SE3, R
from models.algebra import Array, Numbers
from models.errors import GraphFileError
from nls.graph import FactorGraph
from nls.missions.folder.acoustic import Acoustics
from nls.missions.folder.calibration import Calibrations, Compass, Spaces
from nls.missions.folder.contacts import add_contacts, leave_contacts
from nls.missions.folder.dvl import integrated
from nls.missions.folder.fixes import Pose, add_anchor, add_closures, add_fixes, plane_of
from nls.missions.folder.folder import MissionReport, read_tables
from nls.missions.folder.poses import compare_landmarks, true_values
from nls.missions.folder.rows import Assembly
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline, measured_times, shift_clocks
from nls.missions.folder.tracks import odometry, reckoned, walking
from nls.missions.starts.placing import along_measurements, place_beacons, turn_to, turn_to_measurements
from nls.stages import stage
from nls.starts import dead_reckoning, first_sighting
from nls.values import Values

TRACKS = (("odometry", odometry), ("path", reckoned), ("motion", walking), ("dvl", integrated))
x, l = kinds("x", "l")


def read_mission(
    folder: str | Path, elevation: str = "hinge", anchored: bool = True
) -> tuple[FactorGraph, Values, MissionReport]:
    """The graph of a mission folder, dead reckoning as its start, and a report; see the page on formats.

    Parameters
    ----------
    folder : a folder of CSV files.
    elevation : what is done about the elevation a sonar does not measure, see `factors.sonar_factors`.
    anchored : whether a pose is held where no file places the mission in the world.

    Returns
    -------
    graph : over the poses ``x`` and the landmarks ``l``, numbered as in the files. It has `XYH` and `ZPR`, `Position`
        and `Heading` of the anchor, and the factors of the contacts. Contacts without names are not in it.
    values : poses by dead reckoning, landmarks where they were seen first.
    report : with the truth, the sonar and its mounting, and the contacts without names, see `nls.missions.associated`.

    Raises
    ------
    GraphFileError
        No mission, or one that cannot be right; says which file and line, and what is implausible, which may be its
        cause.
    OptionError
        No such treatment of the elevation.
    """
    from nls.missions.checks.inspection import implausible

    tables, report = read_tables(folder)
    report.findings = implausible(tables, plane_of(tables.get("origin")))
    for finding in report.findings:
        report.warn(finding.says)
    try:
        if slow := [finding for finding in report.findings if finding.check == "time step" and "dvl" in tables]:
            table = tables[slow[0].file.removesuffix(".csv")]
            raise table.error("no log of sensors is as slow, and it would have a pose a second", slow[0].line - 1)
        return (*graph_of(tables, report, elevation, anchored), report)
    except GraphFileError as error:
        if not report.findings:
            raise
        where = f"{error.path}:" if error.line is None else f"{error.path}:{error.line}:"
        message = "; ".join([str(error).removeprefix(where).strip(), *(finding.says for finding in report.findings)])
        raise GraphFileError(message, error.path, error.line, advice=error.advice) from error


def graph_of(
    tables: dict[str, Table], report: MissionReport, elevation: str, anchored: bool = True
) -> tuple[FactorGraph, Values]:
    """The graph of the tables of a mission and its start; the report gets what they say besides, see `read_mission`.

    Raises
    ------
    GraphFileError
        Tables that cannot be right.
    """
    report.plane = plane_of(tables.get("origin"))
    calibrations = Calibrations(tables.get("calibration"))
    mission = Assembly(tables, report, calibrations, measured_times(tables, calibrations))
    report.elsewhere, graph = tables.get("dive_closures"), mission.graph
    numbers = next(add_track for table, add_track in TRACKS if table in tables)(mission)
    compass = next((known for factor in graph.factors if (known := calibrations.headings(factor)) is not None), None)
    report.compass = compass is not None
    report.truth = true_values(tables, numbers, report)
    timeline = Timeline(mission, numbers)
    add_fixes(mission, timeline)
    add_closures(mission, timeline)
    acoustics = Acoustics(mission, timeline, _depths(graph, numbers))
    if "anchor" not in tables:
        report.world = [name for name in ("fixes.csv",) if name in report.tags] + acoustics.absolute
    first = add_anchor(mission, numbers, compass, anchored)
    points = np.zeros(0, dtype=np.int64)
    if named := "contacts" not in tables or tables["contacts"].has("landmark"):
        points = add_contacts(mission, timeline, elevation)
        compare_landmarks(report, points)
    with stage("read start"):
        spaces: Spaces = {x: (SE3, SE3.identity(len(numbers)), numbers)} | acoustics.spaces() | calibrations.spaces()
        if len(points):
            spaces[l] = (R(3), np.zeros((len(points), 3)), points)
        start = _start(mission, acoustics.places, Values(spaces), first, compass)
    acoustics.shift()
    shift_clocks(mission, timeline, start, acoustics.ship_twist)
    for prior, source in calibrations.priors():
        mission.add(prior, source)
    report.calibrations = calibrations.given()
    if not named:
        leave_contacts(mission, timeline, elevation)
    return graph, start


def _start(mission: Assembly, places: Array, start: Values, first: Pose | None, compass: Compass | None) -> Values:
    """Dead reckoning, moved by a turn about the vertical and a step in the horizontal to where its anchor is, or to
    what was measured in the world; beacons and landmarks from there."""
    graph = mission.graph
    start = dead_reckoning(graph, start)
    turn = turn_to_measurements(graph, start, places, compass) if first is None else turn_to(start[first[0]], *first[1])
    start[x] = SE3.compose(turn, start[x])
    if "motion" in mission.tables:
        along_measurements(graph, start, places, compass)
    place_beacons(graph, start, places)
    return first_sighting(graph, start) if l.name in start.stacks else start


def _depths(graph: FactorGraph, numbers: Numbers) -> Array:
    """Measured depths (n,) of the poses, m, those without on the line between their neighbors."""
    tilt = next(factor for factor in graph.factors if factor.states("tilts"))  # every track has them
    order = np.argsort(tilt.keys[0].numbers)
    return np.asarray(np.interp(numbers, tilt.keys[0].numbers[order], tilt.z[order, 0]))
