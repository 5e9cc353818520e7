"""Preparation of a graph by ``solve`` and ``explain``: robust kernels on it, kinds of variables held."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from nls.cli.outputs import input_name

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.values import Values

__all__ = ["believes_all", "prepare"]


def prepare(as_read: FactorGraph, values: Values, report: LoadReport, options: argparse.Namespace) -> FactorGraph:
    """The graph under the robust kernel, with the kinds held that were asked for; the one read stays as it is.

    Parameters
    ----------
    as_read, values, report : of the file; the report gets a note on a number that was left out.
    options : of the command.

    Raises
    ------
    GraphFileError
        A file without a measurement.
    OptionError
        No such kernel, type of factor or kind of variable.
    """
    import nls
    from factors.robust import kernel_from_text
    from models.options import did_you_mean
    from nls.cli import outliers
    from nls.cli.choices import GNC, KERNELS, ROBUST, ROBUST_OF_SOLVE

    if not as_read.factors:
        raise nls.GraphFileError(
            "has no measurement: nothing to optimize; add edges, or see the variables with nls plot",
            input_name(options.file),
        )
    graph = nls.FactorGraph(as_read.factors, as_read.fixed)
    if options.robust is not None and not outliers.is_gnc(options.robust):
        name, separator, kernel = options.robust.rpartition("=")
        names = list(dict.fromkeys(factor.name for factor in graph.factors))
        if separator and name not in names:
            raise nls.OptionError(
                "--robust",
                name,
                "no type, or one of those in the graph: " + ", ".join(names) + did_you_mean(name, names),
            )
        if (kind := kernel.partition(":")[0]) not in KERNELS:
            more, near = (ROBUST_OF_SOLVE, GNC) if options.command == "solve" else (ROBUST, ())
            raise nls.OptionError("--robust", options.robust, more + did_you_mean(kind, [*KERNELS, *near]))
        robust = kernel_from_text(kernel)
        if ":" not in kernel:
            report.notes.append(
                f"--robust {options.robust}: taken as {kernel}:{robust.c:g}, 95 % efficient without outliers"
            )
        graph.factors = [f.robust(robust) if name in ("", f.name) else f for f in graph.factors]
    for kind in options.hold:
        if kind not in values.stacks:
            raise nls.OptionError(
                "--hold", kind, "one of the kinds " + ", ".join(values.stacks) + did_you_mean(kind, values.stacks)
            )
        graph.fix(nls.Keys(kind, values.stack(kind).numbers))
    return graph


def believes_all(options: argparse.Namespace, report: LoadReport) -> bool:
    """Whether ``--robust none`` is given for a mission; without a kernel then, as if it were not."""
    options.all_contacts = options.robust == "none" and report.format == "mission"
    if options.all_contacts:
        options.robust = None
    return bool(options.all_contacts)
