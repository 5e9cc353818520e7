"""Formats by suffix: what the commands read and write, graphs and trajectories alike."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from models.listing import some
from nls.cli.outputs import input_name

if TYPE_CHECKING:
    from models.errors import LeadlineError
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.missions import MissionReport
    from nls.values import Values

    Read = tuple[FactorGraph, Values, LoadReport]


def output_format(option: str, path: str, named: str | None) -> str:
    """The format of an output, the value of an option: as named, else by the suffix; errors as for `nls.save`."""
    from nls.io.formats import format_of

    return format_of(path, named, "--to FORMAT", option)


def read(
    options: argparse.Namespace, stage: Callable[[Read], Read] = lambda read: read
) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph, start and report of the file, folder or stream of a command; a trajectory has no measurements.

    Reading solves nothing. A command that solves may add a stage, which is shown as part of the reading.
    """
    from nls.cli.progress import Progress
    from nls.stages import listened

    options.phase.doing = f"while reading {options.file}"
    with Progress("read", quiet=getattr(options, "quiet", False), late=True) as progress, listened(progress.say):
        graph, values, report = stage(_read(options))
    options.phase.as_read = graph, report
    return graph, values, report


def name_lines(error: LeadlineError, graph: FactorGraph, report: LoadReport) -> None:
    """Name in an error the lines of the measurements that it is about, if they were read from some."""
    keys, name = getattr(error, "keys", ()), getattr(error, "factor", "")
    places: list[str] = []
    for k, factor in enumerate(graph.factors[: len(report.sources)]):
        if factor.name == name and [(a.kind, 1) for a in factor.keys] == [(b.kind, len(b)) for b in keys]:
            same = np.all([a.numbers == b.numbers for a, b in zip(factor.keys, keys, strict=True)], axis=0)
            places += [report.place(k, row) for row in np.flatnonzero(same).tolist()]
    if places:
        error.message = f"{some(places)}: {error.message}"


def _read(options: argparse.Namespace) -> tuple[FactorGraph, Values, LoadReport]:
    import nls
    from nls.io.formats import Reading, refuse_needless, suffix_of, suffixes

    lines = options.repair_information, getattr(options, "elevation", None), options.ignore_tags, options.drop_absent
    how = Reading(options.convention, options.dialect, *lines)
    if dives := getattr(options, "dives", []):
        return nls.load([options.file, *dives], *how)
    if options.file == "-":
        if sys.stdin is None:
            raise nls.GraphFileError("cannot be read: standard input is closed", input_name(options.file))
        return nls.io.load_stream(sys.stdin.buffer, input_name(options.file), *how)
    row = suffixes().get(suffix_of(options.file))
    if row is None or not row.poses_alone or options.dialect != "auto" or os.path.isdir(options.file):
        return nls.load(options.file, *how)
    refuse_needless(options.file, row.name, how)
    return row.read(how, options.file)


def mission_of(report: LoadReport) -> MissionReport | None:
    """The report of a mission, or of several dives; None of other inputs."""
    if report.format != "mission":
        return None
    from nls.missions import MissionReport

    assert isinstance(report, MissionReport)
    return report


def rendered(
    path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport, renumber: bool = False
) -> tuple[bytes, list[str]]:
    """The bytes of a file in a format, and remarks about what it does not hold; ``renumber`` as for `nls.save`."""
    from nls.io import rendered as rendered_graph
    from nls.io.formats import FORMATS

    if report.format == "mission":
        refuse_lines(path, form)
    if not FORMATS[form].tagged:
        return rendered_graph(path, graph, values, report, form)
    with _renamed(graph, values, report, renumber) as (graph, values, changes):
        data, notes = rendered_graph(path, graph, values, report, form)
    return data, changes + notes


def refuse_lines(path: str, form: str) -> None:
    """Refuse a format that has no lines for the graph of a mission.

    Raises
    ------
    GraphError
    """
    from models.errors import GraphError
    from nls.io.formats import FORMATS

    if FORMATS[form].measurements and not FORMATS[form].whole:
        raise GraphError(
            f"{path}: a mission cannot be written as {form}, which has no lines for its steps and contacts; "
            f"{_names('whole', 'and')} hold it, and {_names('poses_alone', 'or')} its poses"
        )


def _names(trait: str, word: str) -> str:
    """The names of the formats with a trait."""
    from nls.io.formats import FORMATS

    return f" {word} ".join(row.name for row in FORMATS.values() if getattr(row, trait))


def refuse_unwritable_graph(
    path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport, renumber: bool = False
) -> None:
    """Refuse what `rendered` refuses; for graph text files without their text.

    Raises
    ------
    GraphError
    """
    from nls.io.formats import FORMATS
    from nls.io.write import refuse_unwritable_graph

    if not FORMATS[form].tagged:
        rendered(path, form, graph, values, report)
        return
    with _renamed(graph, values, report, renumber) as (graph, values, _):
        refuse_unwritable_graph(path, form, graph, values, report)


@contextmanager
def _renamed(
    graph: FactorGraph, values: Values, report: LoadReport, renumber: bool
) -> Iterator[tuple[FactorGraph, Values, list[str]]]:
    """Under the names that graph text files know; errors inside say so, as they name variables like that."""
    from models.errors import GraphError
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
    except GraphError as error:
        message = "; ".join([error.message, *changes])
        raise GraphError(message, error.keys, error.factor, error.index, error.advice) from error
