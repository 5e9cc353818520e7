"""Formats by suffix: what the commands read and write, graphs and trajectories alike."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
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

__all__ = ["mission_of", "refuse_unwritable_graph", "rendered"]


def output_format(option: str, path: str, named: str | None) -> str:
    """The format of an output, the value of an option: as named, else by the suffix, as for `nls.save`.

    Raises
    ------
    OptionError
    """
    from nls.io.dialects import SUFFIXES, format_of

    return format_of(path, named, SUFFIXES, "--to FORMAT", option)


def read(options: argparse.Namespace, to_solve: bool = False) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph, start and report of the file, folder or stream of a command; a trajectory has no measurements.

    Reading solves nothing. Only a graph to solve gets the contacts that name no landmarks, which association finds.
    """
    from nls.cli.progress import Progress
    from nls.stages import listened

    options.phase.doing = f"while reading {options.file}"
    with Progress("read", quiet=getattr(options, "quiet", False), late=True) as progress, listened(progress.say):
        graph, values, report = _read(options)
        if to_solve and (mission := mission_of(report)) and mission.unnamed:
            from nls.missions import associated

            graph, values, report = associated(graph, values, mission)
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
    from nls.io import load_stream
    from nls.io.dialects import LineOptions, refuse_needless
    from nls.io.trajectory import TRAJECTORIES, load_trajectory

    form = Path(options.file.lower().removesuffix(".gz")).suffix[1:]
    of_lines = LineOptions(options.repair_information, options.ignore_tags, options.drop_absent)
    elevation = getattr(options, "elevation", None)
    how = options.convention, options.dialect, of_lines.repair_information, elevation, *of_lines[1:]
    if dives := getattr(options, "dives", []):
        return nls.load([options.file, *dives], *how)
    if options.file == "-":
        if sys.stdin is None:
            raise nls.GraphFileError("cannot be read: standard input is closed", input_name(options.file))
        return load_stream(sys.stdin.buffer, input_name(options.file), *how)
    if form not in TRAJECTORIES or options.dialect != "auto" or os.path.isdir(options.file):
        return nls.load(options.file, *how)
    refuse_needless(options.file, form, of_lines)
    return nls.FactorGraph(), *load_trajectory(options.file, form, options.convention)


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
    from nls import io
    from nls.io.dialects import FORMATS

    if report.format == "mission":
        refuse_other_formats(path, form)
    if form not in FORMATS:
        return io.rendered(path, graph, values, report, form)
    with _renamed(graph, values, report, renumber) as (graph, values, changes):
        data, notes = io.rendered(path, graph, values, report, form)
    return data, changes + notes


def refuse_other_formats(path: str, form: str) -> None:
    """Refuse a format that has no lines for the graph of a mission.

    Raises
    ------
    GraphError
    """
    from models.errors import GraphError
    from nls import io

    if form not in (*io.POSES_ONLY, *io.NATIVE):
        raise GraphError(
            f"{path}: a mission cannot be written as {form}, which has no lines for its steps and contacts; "
            "npz and json hold it, and tum or kitti its poses"
        )


def refuse_unwritable_graph(
    path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport, renumber: bool = False
) -> None:
    """Refuse what `rendered` refuses; for graph text files without their text.

    Raises
    ------
    GraphError
    """
    from nls.io.dialects import FORMATS
    from nls.io.write import refuse_unwritable_graph

    if form not in FORMATS:
        rendered(path, form, graph, values, report)
        return
    with _renamed(graph, values, report, renumber) as (graph, values, _):
        refuse_unwritable_graph(path, graph, values, report, FORMATS[form])


@contextmanager
def _renamed(
    graph: FactorGraph, values: Values, report: LoadReport, renumber: bool
) -> Iterator[tuple[FactorGraph, Values, list[str]]]:
    """Under the names that graph text files know; errors inside say so, as they name variables like that."""
    from models.errors import GraphError
    from nls.io.renumbering import renumbered, with_known_kinds

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
