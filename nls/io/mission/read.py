"""A mission folder as a graph, its start and a report; and the choice between integrated odometry and a raw log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors import XYH, ZPR, Diagonal, Elevation, Heading, Position, sonar_factors
from factors.base import Factor
from factors.keys import Keys, Kind, kinds
from factors.sonar import first_contacts, refuse_search
from models import SE3, Manifold, R, euler
from models.algebra import Array, Numbers
from models.errors import OptionError
from models.geodesy import LocalPlane
from models.sensors import ImagingSonar
from nls.graph import FactorGraph
from nls.io.mission.acoustic import Acoustics
from nls.io.mission.calibration import Calibrations, Compass
from nls.io.mission.clocks import shift_clocks
from nls.io.mission.columns import ANGLES, CONTACT, LEVEL, PLACE, TILT, suffixed
from nls.io.mission.fixes import add_closures, add_fixes
from nls.io.mission.folder import read_tables
from nls.io.mission.placing import place_beacons, turn_to, turn_to_measurements
from nls.io.mission.report import MissionReport
from nls.io.mission.table import Table
from nls.io.mission.timeline import Timeline, measured_times
from nls.io.report import Source
from nls.sparse.components import connected
from nls.stages import stage
from nls.starts import dead_reckoning, first_sighting
from nls.values import Values

__all__ = ["read_mission"]

ANCHORED = (1e-3, 1e-3, 1e-4)  # sigmas, m m rad, of an anchor nobody gave: below what any vehicle knows of itself
SLACK = 4.0  # sigmas a contact may lie outside the fan or window before it is worth a note: noise at the edge does
x, l = kinds("x", "l")


def read_mission(folder: str | Path, elevation: str = "hinge") -> tuple[FactorGraph, Values, MissionReport]:
    """The graph of a mission folder, dead reckoning as its start, and a report; see the page on formats.

    Parameters
    ----------
    folder : a folder of CSV files.
    elevation : what is done about the elevation a sonar does not measure, see `factors.sonar_factors`.

    Returns
    -------
    graph : over the poses ``x`` and the landmarks ``l``, numbered as in the files: `XYH` and `ZPR`, `Position` and
        `Heading` of the anchor, and the factors of the contacts.
    values : poses by dead reckoning, landmarks where they were seen first.
    report : with the truth, the sonar and its mounting.

    Raises
    ------
    GraphFileError
        No mission, or one that cannot be right; says which file and line.
    OptionError
        No such treatment of the elevation.
    """
    tables, report = read_tables(folder)
    report.plane = _plane(tables.get("origin"))
    calibrations = Calibrations(tables.get("calibration"))
    times = measured_times(tables, calibrations)
    if "odometry" in tables:
        numbers, factors = _track(tables, report)
    else:
        from nls.io.mission.log import integrated

        numbers, factors = integrated(tables, report, calibrations, times)
    report.truth = _truth(tables, numbers, report)
    graph = FactorGraph(factors)
    open_ended = "odometry" not in tables and "poses" not in tables
    timeline = Timeline(numbers, report.vertex_times.get("x"), times, open_ended, report)
    if "fixes" in tables:
        add_fixes(graph, report, tables["fixes"], timeline)
    if "closures" in tables:
        add_closures(graph, report, tables["closures"], timeline)
    acoustics = Acoustics(graph, report, tables, timeline, calibrations, _depths(graph, numbers))
    if "anchor" not in tables:
        report.world = [name for name in ("fixes.csv",) if name in report.tags] + acoustics.absolute
    compass = next((known for factor in factors if (known := calibrations.headings(factor)) is not None), None)
    anchors, first = _anchor(tables, numbers, compass, report)
    for factor in anchors:
        graph.add(factor)
    points = _contacts(tables, numbers, graph, report, elevation)
    _compare(report, points)
    with stage("read start"):
        start = _start(graph, numbers, points, first, compass, calibrations, acoustics)
    shift_clocks(graph, report, start, tables, timeline, calibrations, acoustics.ship_twist)
    for prior in calibrations.priors(report):
        graph.add(prior)
    report.calibrations = calibrations.given()
    return graph, start, report


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
    graph: FactorGraph,
    numbers: Numbers,
    points: Numbers,
    first: tuple[Keys, Array] | None,
    compass: Compass | None,
    calibrations: Calibrations,
    acoustics: Acoustics,
) -> Values:
    """Dead reckoning, moved by a turn about the vertical and a step in the horizontal to where its anchor is, or to
    what was measured in the world; beacons and landmarks from there."""
    spaces: dict[Kind, tuple[Manifold, Array, Numbers]] = {x: (SE3, SE3.identity(len(numbers)), numbers)}
    spaces |= acoustics.spaces() | calibrations.spaces()
    if len(points):
        spaces[l] = (R(3), np.zeros((len(points), 3)), points)
    start = dead_reckoning(graph, Values(spaces))
    if first is None:
        turn = turn_to_measurements(graph, start, acoustics.places, compass)
    else:
        turn = turn_to(start[first[0]], *first[1])
    start[x] = SE3.compose(turn, start[x])
    place_beacons(graph, start, acoustics.places)
    return first_sighting(graph, start) if len(points) else start


def _depths(graph: FactorGraph, numbers: Numbers) -> Array:
    """Measured depths (n,) of the poses, m, those without on the line between their neighbors."""
    tilt = next(factor for factor in graph.factors if factor.states("tilts"))
    order = np.argsort(tilt.keys[0].numbers)
    return np.asarray(np.interp(numbers, tilt.keys[0].numbers[order], tilt.z[order, 0]))


def _track(tables: dict[str, Table], report: MissionReport) -> tuple[Numbers, list[Factor]]:
    """Numbers of the poses, rising, and the factors of odometry.csv and zpr.csv."""
    odometry, zpr = tables["odometry"], tables["zpr"]
    i, j = odometry.integers("i"), odometry.integers("j")
    if (same := i == j).any():
        k = int(np.argmax(same))
        raise odometry.at(k, f"the step joins pose {i[k]} to itself")
    numbers = np.unique(np.concatenate([i, j]))
    pieces = np.unique(connected(numbers.searchsorted(i), numbers.searchsorted(j), len(numbers)))
    if len(pieces) > 1:
        report.warn(
            f"odometry.csv leaves the track in {len(pieces)} pieces, the second begins at pose {numbers[pieces[1]]}: "
            "only landmarks that both saw, or an anchor of each, say where they are to each other; is a row missing?"
        )
    again = len(i) - len(np.unique(np.stack([i, j]), axis=1).T)
    if again:
        report.notes.append(f"odometry.csv measures {again} steps more than once: all of them count")
    tilted = zpr.unique("i", "pose")
    zpr.known("i", numbers, "odometry.csv has no such pose")
    if len(bare := np.setdiff1d(numbers, tilted)):
        report.warn(f"{len(bare)} poses have no row in zpr.csv, the first is {bare[0]}: their depth and tilt are free")
    if "poses" in tables:
        report.vertex_times["x"] = _times(tables["poses"], numbers)
    report.sources += [odometry.source(), zpr.source()]
    return numbers, [
        XYH(x[i], x[j], odometry.measured(*LEVEL), Diagonal(odometry.positive(*suffixed(LEVEL)))),
        ZPR(x[tilted], zpr.attitude(*TILT), Diagonal(zpr.positive(*suffixed(TILT)))),
    ]


def _times(poses: Table, numbers: Numbers) -> Array:
    """Times (n,) of the poses, s, in the order of their numbers."""
    ids, t = poses.unique("i", "pose"), poses.rising("time_s")
    poses.known("i", numbers, "nothing measures this pose; leave it out")
    if len(missing := np.setdiff1d(numbers, ids)):
        raise poses.at(
            len(poses) - 1, f"this is the last row, and pose {missing[0]} has none; give a time for every pose"
        )
    return t[np.argsort(ids)]


def _truth(tables: dict[str, Table], numbers: Numbers, report: MissionReport) -> Values:
    """True poses and landmarks, where there are files of them."""
    true: dict[Kind, tuple[Manifold, Array, Numbers]] = {}
    if (table := tables.get("truth")) is not None:
        ids = table.unique("i", "pose")
        true[x] = (SE3, euler.to_se3(table.attitude(*ANGLES, *PLACE)), ids)
        if not np.isin(ids, numbers).any():
            raise table.at(0, f"pose {ids[0]} and all others are none of the track's, {numbers[0]} to {numbers[-1]}")
        if missing := len(np.setdiff1d(numbers, ids)):
            report.notes.append(f"truth.csv has no row for {missing} of {len(numbers)} poses: errors are of the others")
        if more := len(np.setdiff1d(ids, numbers)):
            report.notes.append(f"truth.csv has {more} poses nothing measures: not used")
    if (table := tables.get("landmarks")) is not None:
        true[l] = (R(3), table.measured(*PLACE), table.unique("landmark", "landmark"))
    return Values(true)


def _compare(report: MissionReport, points: Numbers) -> None:
    """Say which landmarks cannot be judged by landmarks.csv, and which of its rows judge none."""
    if "l" not in report.truth.stacks:
        return
    known = report.truth.stack("l").numbers
    missing, more = len(np.setdiff1d(points, known)), len(np.setdiff1d(known, points))
    if not len(points):
        report.notes.append("landmarks.csv is not used: there is no contacts.csv")
    elif missing == len(points):
        report.notes.append(
            f"landmarks.csv is not used: none of its landmarks, {known[0]} the first, is in contacts.csv, where "
            f"{points[0]} is; their errors are not known"
        )
    else:
        if missing:
            report.notes.append(
                f"landmarks.csv has no row for {missing} of {len(points)} landmarks: errors are of the others"
            )
        if more:
            report.notes.append(f"landmarks.csv has {more} landmarks nothing measures: not used")


def _anchor(
    tables: dict[str, Table], numbers: Numbers, compass: Compass | None, report: MissionReport
) -> tuple[list[Factor], tuple[Keys, Array] | None]:
    """What holds the mission in the world, x, y and heading of a pose; the first such pose with these numbers.

    Nothing and none where other measurements are absolute. Else where nobody says so it is the first pose, and its
    heading only where no compass measures it; with a compass it is the first pose that this one sees.
    """
    if (table := tables.get("anchor")) is not None:
        table.unique("i", "pose")
        i = table.known("i", numbers, "nothing else measures this pose; anchor one of the track")
        z, sigmas = table.measured(*LEVEL), table.positive(*suffixed(LEVEL))
        report.sources += [table.source()] * 2
        return _held(x[i], z, sigmas), (x[i[:1]], z[0])
    if report.world:
        return [], None
    anchor, z, where = x[numbers[:1]], np.zeros(3), "0"
    if compass is not None:
        poses, yaw = compass
        first = int(np.argmin(poses.numbers))
        anchor, z[2] = poses[[first]], yaw[first]
    if "x" in report.truth.stacks and anchor in report.truth:
        true, where = euler.from_se3(report.truth[anchor])[0, [3, 4, 2]], "the truth"
        z = true if compass is None else np.append(true[:2], z[2])
    factors, held = _held(anchor, z[None], np.array([ANCHORED])), "x, y and yaw"
    if compass is not None:
        factors, held = factors[:1], "x and y"
    report.sources += [Source(report.path, np.zeros(1, dtype=np.intp))] * len(factors)
    report.notes.append(f"there is no anchor.csv: {held} of {anchor} are held at {where}")
    return factors, (anchor, z)


def _held(poses: Keys, z: Array, sigmas: Array) -> list[Factor]:
    """x, y and yaw (n, 3) of poses with their standard deviations."""
    return [
        Position(poses, z[:, :2], Diagonal(sigmas[:, :2]), components=("x", "y")),
        Heading(poses, z[:, 2:], Diagonal(sigmas[:, 2:])),
    ]


def _contacts(
    tables: dict[str, Table], numbers: Numbers, graph: FactorGraph, report: MissionReport, elevation: str
) -> Numbers:
    """Add what the sonar saw to the graph; returns the numbers of the landmarks, rising."""
    if (table := tables.get("sonar")) is not None:
        report.sonar, report.offset = _sonar(table)
    if (table := tables.get("contacts")) is None:
        return np.zeros(0, dtype=np.int64)
    assert report.sonar is not None
    refuse_search(elevation)
    i = table.known("i", numbers, "a contact of a pose that nothing else measures; is it missing in the track?")
    k = table.integers("landmark")
    table.positive("range_m")
    z = table.measured(*CONTACT)
    r, azimuth = z.T
    if (behind := ~(np.abs(azimuth) <= np.pi)).any():
        row = int(np.argmax(behind))
        raise table.at(row, f"azimuth_rad is {float(azimuth[row])!r}; expected radians, -pi to pi")
    near, far = report.sonar.window
    sigmas = table.positive(*suffixed(CONTACT))
    slack_r, slack_azimuth = SLACK * sigmas.T
    outside = (np.abs(azimuth) > report.sonar.fan / 2 + slack_azimuth) | (r < near - slack_r) | (r > far + slack_r)
    if count := int(outside.sum()):
        contact = f"the first of {count} contacts" if count > 1 else "a contact"
        report.notes.append(
            f"{table.place(int(np.argmax(outside)))}: {contact} outside the fan or range window of sonar.csv; used all "
            "the same: correct fan_rad, range_min_m or range_max_m there, or delete what the sonar cannot have seen"
        )
    for factor in sonar_factors(x[i], l[k], z, Diagonal(sigmas), report.sonar, report.offset, elevation):
        graph.add(factor)
        ids = first_contacts(x[i], l[k]) if type(factor) is Elevation else slice(None)  # as in `sonar_factors`
        report.sources.append(table.source(ids))
    return np.unique(k)


def _sonar(table: Table) -> tuple[ImagingSonar, Array]:
    """The sonar of the one row of sonar.csv, and its mounting (7,)."""
    if len(table) > 1:
        raise table.at(1, "a second sonar; a mission has one")
    fan, aperture, near, far = table.floats("fan_rad", "aperture_rad", "range_min_m", "range_max_m")[0].tolist()
    beams, bins = int(table.integers("beams")[0]), int(table.integers("bins")[0])
    try:
        sonar = ImagingSonar(table.text_of("name")[0], beams, bins, fan, aperture, (near, far))
    except OptionError as error:
        raise table.at(0, str(error)) from error
    return sonar, euler.to_se3(table.measured(*ANGLES, *PLACE)[0])
