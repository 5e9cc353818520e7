"""contacts.csv and sonar.csv: what an imaging sonar saw, as factors."""

from __future__ import annotations

import numpy as np

from factors import Diagonal, Elevation, sonar_factors
from factors.keys import kinds
from factors.sonar import first_contacts, refuse_search
from models import euler
from models.algebra import Array, Numbers
from models.errors import OptionError
from models.sensors import ImagingSonar
from nls.graph import FactorGraph
from nls.io.mission.columns import ANGLES, CONTACT, PLACE, suffixed
from nls.io.mission.report import MissionReport
from nls.io.mission.table import Table

__all__ = ["add_contacts"]

SLACK = 4.0  # sigmas a contact may lie outside the fan or window before it is worth a note: noise at the edge does
x, l = kinds("x", "l")


def add_contacts(
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
