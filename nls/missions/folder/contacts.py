"""contacts.csv and sonar.csv: what an imaging sonar saw, as factors."""

from __future__ import annotations

import numpy as np

from factors import Diagonal, Elevation, RangeAzimuth, sonar_factors
from factors.keys import kinds
from factors.sighting import Sighting
from factors.sonar import first_contacts, refuse_search
from models import R, euler
from models.algebra import Array, Index, Numbers
from models.errors import GraphFileError, OptionError, UnderconstrainedError
from models.sensors import ImagingSonar
from nls.missions.folder.columns import ANGLES, CONTACT, PLACE, suffixed
from nls.missions.folder.rows import Assembly
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import Timeline
from nls.stages import announce, stage
from nls.values import Values

__all__ = ["add_contacts", "add_unnamed_contacts", "are_named"]

SLACK = 4.0  # sigmas a contact may lie outside the fan or window before it is worth a note: noise at the edge does
x, l = kinds("x", "l")


def are_named(tables: dict[str, Table]) -> bool:
    """Whether contacts say which landmark they are of, or there are none."""
    return "contacts" not in tables or tables["contacts"].has("landmark")


def add_contacts(mission: Assembly, timeline: Timeline, elevation: str) -> Numbers:
    """Add what the sonar saw of named landmarks to the graph; returns their numbers, rising."""
    if (table := mission.tables.get("contacts")) is None:
        return np.zeros(0, dtype=np.int64)
    refuse_search(elevation)
    contacts, rows = _measured(mission, timeline, table.integers("landmark"))
    _add(mission, contacts, rows, elevation)
    return np.unique(contacts.keys[1].numbers)


def add_unnamed_contacts(mission: Assembly, timeline: Timeline, start: Values, elevation: str) -> Values:
    """Find which contacts are of one landmark and add those to the graph; the start with these landmarks."""
    from nls.missions.contacts import associate

    refuse_search(elevation)
    report = mission.report
    contacts, rows = _measured(mission, timeline, np.arange(len(mission.tables["contacts"])))
    assert report.sonar is not None
    with stage("associate"):
        announce(f"{len(contacts):,} contacts without names")
        try:
            associated = associate(mission.graph, start, contacts, report.sonar.aperture)
        except UnderconstrainedError as error:
            needed = "names no landmarks, so that the track must be determined without them"
            raise GraphFileError(
                f"{needed}: {error.message}", mission.tables["contacts"].path, advice=error.advice
            ) from error
    rows = rows[associated.numbers >= 0]
    report.notes.append(f"contacts.csv names no landmarks: {associated}")
    report.truth = Values.of(stack for name, stack in report.truth.stacks.items() if name != l.name)
    if not len(rows):
        return start
    _add(mission, associated.sightings, rows, elevation)
    values = Values.of([*start.stacks.values()])
    values.add(l, R(3), associated.values[l])
    return values


def _measured(mission: Assembly, timeline: Timeline, k: Numbers) -> tuple[RangeAzimuth, Index]:
    """The contacts within the track as measurements of landmarks k (n,), and their rows; the sonar in the report."""
    table, report = mission.tables["contacts"], mission.report
    report.sonar, report.offset = _sonar(mission.tables["sonar"])
    i, within = timeline.poses("contacts", table)
    table.positive("range_m")
    z = table.measured(*CONTACT)
    r, azimuth = z.T
    expected = "expected radians, -pi to pi"
    table.refuse_rows(~(np.abs(azimuth) <= np.pi), lambda k: f"azimuth_rad is {float(azimuth[k])!r}; {expected}")
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
    rows = np.flatnonzero(within)
    return RangeAzimuth(x[i[rows, 0]], l[k[rows]], z[rows], Diagonal(sigmas[rows]), report.offset), rows


def _add(mission: Assembly, contacts: Sighting, rows: Index, elevation: str) -> None:
    """Add contacts, of rows (n,) of the table, to the graph."""
    report, (pose, target) = mission.report, contacts.keys[:2]
    assert report.sonar is not None
    for factor in sonar_factors(pose, target, contacts.z, contacts.noise, report.sonar, report.offset, elevation):
        first = first_contacts(pose, target) if type(factor) is Elevation else slice(None)  # as in `sonar_factors`
        mission.add(factor, mission.tables["contacts"].source(rows[first]))


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
