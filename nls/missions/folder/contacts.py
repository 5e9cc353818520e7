"""contacts.csv and sonar.csv: contacts of an imaging sonar, as factors."""

from collections.abc import Iterator

import numpy as np

from factors import Diagonal, Elevation, Factor, RangeAzimuth, sonar_factors
from factors.keys import kinds
from factors.sighting import Sighting
from factors.sonar import first_contacts, refuse_search
from models import euler
from models.algebra import Array, Index, Numbers
from models.errors import OptionError
from models.sensors import ImagingSonar
from nls.io.report import Source
from nls.missions.folder.columns import ANGLES, CONTACT, PLACE, suffixed
from nls.missions.folder.folder import MissionReport, Unnamed
from nls.missions.folder.rows import Assembly
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline
from nls.values import Values

SLACK = 4.0  # sigmas a contact may lie outside the fan or window before it is worth a note: noise at the edge does
x, l = kinds("x", "l")


def add_contacts(mission: Assembly, timeline: Timeline, elevation: str) -> Numbers:
    """Add what the sonar saw of named landmarks to the graph; returns their numbers, rising."""
    if (table := mission.tables.get("contacts")) is None:
        return np.zeros(0, dtype=np.int64)
    contacts, rows = _measured(mission, timeline, table.integers("landmark"), elevation)
    for factor, own in sonar_parts(contacts, table, rows, mission.report, elevation):
        mission.add(factor, own)
    return np.unique(contacts.keys[1].numbers)


def leave_contacts(mission: Assembly, timeline: Timeline, elevation: str) -> None:
    """Leave contacts without names to the report, with a note; landmarks of the truth have other numbers."""
    report, table = mission.report, mission.tables["contacts"]
    contacts, rows = _measured(mission, timeline, np.arange(len(table)), elevation)
    next(sonar_parts(contacts, table, rows, report, elevation))  # refuses a treatment that association would not have
    report.unnamed = Unnamed(contacts, table, rows, elevation)
    report.notes.append(report.unnamed.note(report.path))
    report.truth = Values.of(stack for name, stack in report.truth.stacks.items() if name != l.name)


def _measured(mission: Assembly, timeline: Timeline, k: Numbers, elevation: str) -> tuple[RangeAzimuth, Index]:
    """The contacts within the track as measurements of landmarks k (n,), and their rows; the sonar in the report."""
    refuse_search(elevation)
    table, report = mission.tables["contacts"], mission.report
    report.sonar, report.offset = _sonar(mission.tables["sonar"])
    i, within = timeline.poses("contacts", table)
    table.positive("range_m")
    z = table.measured(*CONTACT)
    r, azimuth = z.T
    table.refuse_numbers(~(np.abs(azimuth) <= np.pi), azimuth, "radians, -pi to pi", "azimuth_rad")
    near, far = report.sonar.window
    sigmas = table.positive(*suffixed(CONTACT))
    slack_r, slack_azimuth = SLACK * sigmas.T
    outside = (np.abs(azimuth) > report.sonar.fan / 2 + slack_azimuth) | (r < near - slack_r) | (r > far + slack_r)
    if count := int(outside.sum()):
        contact = f"the first of {count} contacts" if count > 1 else "a contact"
        where = f"{table.place(int(np.argmax(outside)))}: {contact} outside the fan or range window of sonar.csv"
        cure = "correct fan_rad, range_min_m or range_max_m there, or delete what the sonar cannot have seen"
        report.notes.append(f"{where}; used all the same: {cure}")
    rows = np.flatnonzero(within)
    return RangeAzimuth(x[i[rows, 0]], l[k[rows]], z[rows], Diagonal(sigmas[rows]), report.offset), rows


def sonar_parts(
    contacts: Sighting, table: Table, rows: Index, report: MissionReport, elevation: str
) -> Iterator[tuple[Factor, Source]]:
    """The factors of contacts, of rows (n,) of the table, each with its lines."""
    assert report.sonar is not None
    pose, target = contacts.keys[:2]
    for factor in sonar_factors(pose, target, contacts.z, contacts.noise, report.sonar, report.offset, elevation):
        first = first_contacts(pose, target) if type(factor) is Elevation else slice(None)  # as in `sonar_factors`
        yield factor, table.source(rows[first])


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
