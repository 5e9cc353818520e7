"""The landmarks of a mission that names none: a stage between reading and solving."""

from __future__ import annotations

from dataclasses import replace

from factors.keys import kinds
from models.errors import GraphFileError, UnderconstrainedError
from nls.graph import FactorGraph
from nls.missions.contacts import associate
from nls.missions.folder.contacts import sonar_parts
from nls.missions.folder.report import MissionReport
from nls.stages import announce, stage
from nls.values import Values

l = kinds("l")[0]


def associated(graph: FactorGraph, values: Values, report: MissionReport) -> tuple[FactorGraph, Values, MissionReport]:
    """The graph of a mission with the contacts that its file gives no names, once their landmarks are found.

    Reading a mission leaves such contacts out of the graph, and counts them. Association solves the graph several
    times. Landmarks are numbered from 0 in the order of their first contacts. Undecided contacts become no factors.

    Parameters
    ----------
    graph, values, report : of `nls.load` or `read_mission`. All three stay as they are.

    Returns
    -------
    graph, values, report : with the factors of the decided contacts, their landmarks ``l``, and the lines of both; a
        note says how many contacts landmarks explain. The same three where no contact is without a name.

    Raises
    ------
    GraphFileError
        The track is not determined without the contacts.

    Notes
    -----
    See the page on the theory of association, and `nls.sonar.contacts.associate`, which takes any graph.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import nls, sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=1, per_leg=8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = nls.missions.write_mission(folder, mission.graph, mission.sonar, mission.offset)
    ...     file = Path(folder, "contacts.csv")
    ...     rows = [row.split(",") for row in file.read_text().splitlines()]
    ...     _ = file.write_text("".join(",".join(row[:1] + row[2:]) + "\\n" for row in rows))
    ...     graph, values, report = nls.load(folder)
    >>> report.counts["contacts_without_names"], list(values.stacks)
    (265, ['x'])
    >>> graph, values, report = nls.missions.associated(graph, values, report)
    >>> report.counts, list(values.stacks)
    ({}, ['x', 'l'])
    >>> graph.optimize(values).converged
    True
    """
    if (unnamed := report.unnamed) is None:
        return graph, values, report
    assert report.sonar is not None
    with stage("associate"):
        announce(f"{len(unnamed):,} contacts without names")
        try:
            answer = associate(graph, values, unnamed.contacts, report.sonar.aperture)
        except UnderconstrainedError as error:
            needed = "names no landmarks, so that the track must be determined without them"
            raise GraphFileError(f"{needed}: {error.message}", unnamed.table.path, advice=error.advice) from error
    remark, replaced = f"contacts.csv names no landmarks: {answer}", unnamed.note(report.path)
    notes = [remark if note == replaced else note for note in report.notes]
    factors, sources = list(graph.factors), list(report.sources)
    if answer.landmarks:
        rows = unnamed.rows[answer.numbers >= 0]
        for factor, own in sonar_parts(answer.sightings, unnamed.table, rows, report, unnamed.elevation):
            factors.append(factor)
            sources.append(own)
        values = Values.of([*values.stacks.values(), answer.values.stack(l)])
    return FactorGraph(factors, graph.fixed), values, replace(report, notes=notes, sources=sources, unnamed=None)
