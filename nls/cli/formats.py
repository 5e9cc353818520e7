"""Graphs in the formats of files: losses, names of variables, and lines in errors."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

import nls
import nls.io
from models.listing import some
from nls.io.formats import FORMATS


def name_lines(error: nls.LeadlineError, graph: nls.FactorGraph, report: nls.LoadReport) -> None:
    """Name in an error the lines of the measurements that it is about, if they were read from some."""
    keys, name = getattr(error, "keys", ()), getattr(error, "factor", "")
    places: list[str] = []
    for k, factor in enumerate(graph.factors[: len(report.sources)]):
        if factor.name == name and [(a.kind, 1) for a in factor.keys] == [(b.kind, len(b)) for b in keys]:
            same = np.all([a.numbers == b.numbers for a, b in zip(factor.keys, keys, strict=True)], axis=0)
            places += [report.place(k, row) for row in np.flatnonzero(same).tolist()]
    if places:
        error.message = f"{some(places)}: {error.message}"


def rendered(
    path: str, form: str, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport, renumber: bool = False
) -> tuple[bytes, list[str]]:
    """The bytes of a file in a format, and remarks about what it leaves out; ``renumber`` as for `nls.save`."""
    if FORMATS[report.format].folder:
        refuse_lines(path, form)
    if not FORMATS[form].tagged:
        return nls.io.rendered(path, graph, values, report, form)
    with _renamed(graph, values, report, renumber) as (graph, values, changes):
        data, notes = nls.io.rendered(path, graph, values, report, form)
    return data, changes + notes


def refuse_lines(path: str, form: str) -> None:
    """Refuse a format that has no lines for the graph of a mission.

    Raises
    ------
    GraphError
    """
    if FORMATS[form].measurements and not FORMATS[form].whole:
        whole = " and ".join(name for name, row in FORMATS.items() if row.whole)
        poses = " or ".join(name for name, row in FORMATS.items() if row.poses_alone)
        raise nls.GraphError(
            f"{path}: a mission cannot be written as {form}, which has no lines for its steps and contacts; "
            f"{whole} hold it, and {poses} its poses"
        )


def refuse_unwritable_graph(
    path: str, form: str, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport, renumber: bool = False
) -> None:
    """Refuse what `rendered` refuses; for graph text files without their text.

    Raises
    ------
    GraphError
    """
    from nls.io.write import refuse_unwritable_graph

    if not FORMATS[form].tagged:
        rendered(path, form, graph, values, report)
        return
    with _renamed(graph, values, report, renumber) as (graph, values, _):
        refuse_unwritable_graph(path, form, graph, values, report)


@contextmanager
def _renamed(
    graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport, renumber: bool
) -> Iterator[tuple[nls.FactorGraph, nls.Values, list[str]]]:
    """Under the names that graph text files know; errors inside say so, as they name variables like that."""
    from nls.io.variable_names import renumbered, with_known_kinds

    before = values.stacks
    changes: list[str] = []
    if not report.gtsam_kinds:
        graph, values, changes = with_known_kinds(graph, values)
    if renumber:
        names = dict(zip(values.stacks, before, strict=True))
        graph, values, numbers = renumbered(graph, values, report, names)
        changes = changes + numbers
    try:
        yield graph, values, changes
    except nls.GraphError as error:
        message = "; ".join([error.message, *changes])
        raise nls.GraphError(message, error.keys, error.factor, error.index, error.advice) from error
