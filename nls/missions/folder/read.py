"""A mission folder as a graph, its start and a report; and the choice between integrated odometry and a raw log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors import Diagonal, Heading, Position
from factors.base import Factor
from factors.keys import Keys, Kind, kinds
from models import SE3, Manifold, R, euler
from models.algebra import Array, Numbers
from models.errors import GraphFileError, OptionError
from models.geodesy import LocalPlane
from nls.graph import FactorGraph
from nls.io.report import Source
from nls.missions.folder.acoustic import Acoustics
from nls.missions.folder.calibration import Calibrations, Compass
from nls.missions.folder.clocks import shift_clocks
from nls.missions.folder.columns import LEVEL, suffixed
from nls.missions.folder.contacts import add_contacts, are_named, leave_contacts
from nls.missions.folder.fixes import add_closures, add_fixes
from nls.missions.folder.folder import read_tables
from nls.missions.folder.report import MissionReport
from nls.missions.folder.rows import Assembly
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline, measured_times
from nls.missions.folder.tracks import track
from nls.missions.folder.truth import compare_landmarks, true_values
from nls.missions.starts.placing import along_measurements, place_beacons, turn_to, turn_to_measurements
from nls.stages import stage
from nls.starts import dead_reckoning, first_sighting
from nls.values import Values

__all__ = ["graph_of", "read_mission"]

ANCHORED = (1e-3, 1e-3, 1e-4)  # sigmas, m m rad, of an anchor nobody gave: below what any vehicle knows of itself
x, l = kinds("x", "l")
Pose = tuple[Keys, Array]  # and x, y and yaw (3,) that it is to have


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
    from nls.missions.checks import implausible
    from nls.missions.checks.words import sentence

    tables, report = read_tables(folder)
    report.findings = implausible(tables, _plane(tables.get("origin")))
    for finding in report.findings:
        report.warn(sentence(finding))
    try:
        if slow := [finding for finding in report.findings if finding.check == "time step" and "dvl" in tables]:
            table = tables[slow[0].file.removesuffix(".csv")]
            raise table.error("no log of sensors is as slow, and it would have a pose a second", slow[0].line - 1)
        return (*graph_of(tables, report, elevation, anchored), report)
    except GraphFileError as error:
        if not report.findings:
            raise
        where = f"{error.path}:" if error.line is None else f"{error.path}:{error.line}:"
        message = "; ".join([str(error).removeprefix(where).strip(), *map(sentence, report.findings)])
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
    report.plane = _plane(tables.get("origin"))
    calibrations = Calibrations(tables.get("calibration"))
    mission = Assembly(tables, report, calibrations, measured_times(tables, calibrations))
    report.elsewhere, graph = tables.get("dive_closures"), mission.graph
    numbers = track(mission)
    compass = next((known for factor in graph.factors if (known := calibrations.headings(factor)) is not None), None)
    report.compass = compass is not None
    report.truth = true_values(tables, numbers, report)
    open_ended = not {"odometry", "poses"} & tables.keys()
    timeline = Timeline(numbers, report.vertex_times.get("x"), mission.times, open_ended, report)
    add_fixes(mission, timeline)
    add_closures(mission, timeline)
    acoustics = Acoustics(mission, timeline, _depths(graph, numbers))
    if "anchor" not in tables:
        report.world = [name for name in ("fixes.csv",) if name in report.tags] + acoustics.absolute
    first = _anchor(mission, numbers, compass, anchored)
    named = are_named(tables)
    points = add_contacts(mission, timeline, elevation) if named else np.zeros(0, dtype=np.int64)
    if named:
        compare_landmarks(report, points)
    with stage("read start"):
        start = _start(mission, acoustics, numbers, points, first, compass)
    acoustics.shift()
    shift_clocks(mission, timeline, start, acoustics.ship_twist)
    for prior, source in calibrations.priors():
        mission.add(prior, source)
    report.calibrations = calibrations.given()
    if not named:
        leave_contacts(mission, timeline, elevation)
    return graph, start


def _plane(origin: Table | None) -> LocalPlane | None:
    """The local plane at the one row of origin.csv."""
    if origin is None:
        return None
    if len(origin) > 1:
        raise origin.at(1, "a second origin; a mission has one")
    lat, lon = origin.measured("lat_deg", "lon_deg")[0].tolist()
    try:
        return LocalPlane(lat, lon)
    except OptionError as error:
        raise origin.at(0, str(error)) from error


def _start(
    mission: Assembly,
    acoustics: Acoustics,
    numbers: Numbers,
    points: Numbers,
    first: Pose | None,
    compass: Compass | None,
) -> Values:
    """Dead reckoning, moved by a turn about the vertical and a step in the horizontal to where its anchor is, or to
    what was measured in the world; beacons and landmarks from there."""
    spaces: dict[Kind, tuple[Manifold, Array, Numbers]] = {x: (SE3, SE3.identity(len(numbers)), numbers)}
    spaces |= acoustics.spaces() | mission.calibrations.spaces()
    if len(points):
        spaces[l] = (R(3), np.zeros((len(points), 3)), points)
    graph = mission.graph
    start = dead_reckoning(graph, Values(spaces))
    if first is None:
        turn = turn_to_measurements(graph, start, acoustics.places, compass)
    else:
        turn = turn_to(start[first[0]], *first[1])
    start[x] = SE3.compose(turn, start[x])
    if "motion" in mission.tables:
        along_measurements(graph, start, acoustics.places, compass)
    place_beacons(graph, start, acoustics.places)
    return first_sighting(graph, start) if len(points) else start


def _depths(graph: FactorGraph, numbers: Numbers) -> Array:
    """Measured depths (n,) of the poses, m, those without on the line between their neighbors."""
    tilt = next(factor for factor in graph.factors if factor.states("tilts"))  # every track has them
    order = np.argsort(tilt.keys[0].numbers)
    return np.asarray(np.interp(numbers, tilt.keys[0].numbers[order], tilt.z[order, 0]))


def _anchor(mission: Assembly, numbers: Numbers, compass: Compass | None, anchored: bool) -> Pose | None:
    """Add what holds the mission in the world, x, y and heading of a pose; the first such pose with these numbers.

    Nothing and None where other measurements are absolute. Else where nobody says so it is the first pose: at the
    truth, else at the first row of path.csv, else at 0. Its heading is held only where no compass measures it; with a
    compass it is the first pose that this one sees. Where the mission need not be anchored, nothing holds it.
    """
    tables, report = mission.tables, mission.report
    if (table := tables.get("anchor")) is not None:
        table.unique("i", "pose")
        i = table.known("i", numbers, "nothing else measures this pose; anchor one of the track")
        z, sigmas = table.measured(*LEVEL), table.positive(*suffixed(LEVEL))
        for factor in _held(x[i], z, sigmas):
            mission.add(factor, table.source())
        return x[i[:1]], z[0]
    if report.world:
        return None
    anchor, z, where = x[numbers[:1]], np.zeros(3), "0"
    if "path" in tables:
        z, where = tables["path"].attitude(*LEVEL)[0], "the first row of path.csv"
    if compass is not None:
        poses, yaw = compass
        first = int(np.argmin(poses.numbers))
        anchor, z[2] = poses[[first]], yaw[first]
    if "x" in report.truth.stacks and anchor in report.truth:
        true, where = euler.from_se3(report.truth[anchor])[0, [3, 4, 2]], "the truth"
        z = true if compass is None else np.append(true[:2], z[2])
    if not anchored:
        return anchor, z
    factors, held = _held(anchor, z[None], np.array([ANCHORED])), "x, y and yaw"
    if compass is not None:
        factors, held = factors[:1], "x and y"
    for factor in factors:
        mission.add(factor, Source(report.path, np.zeros(1, dtype=np.intp)))
    report.notes.append(f"there is no anchor.csv: {held} of {anchor} are held at {where}")
    if report.plane is not None and compass is None and where == "0":
        report.warn(f"nothing says where {anchor} is on the Earth, nor its heading; write both to anchor.csv")
    return anchor, z


def _held(poses: Keys, z: Array, sigmas: Array) -> list[Factor]:
    """x, y and yaw (n, 3) of poses with their standard deviations."""
    return [
        Position(poses, z[:, :2], Diagonal(sigmas[:, :2]), components=("x", "y")),
        Heading(poses, z[:, 2:], Diagonal(sigmas[:, 2:])),
    ]
