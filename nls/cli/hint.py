"""Where ``nls solve`` names ``nls explain``: something is free, nothing converged, chi2 is more than noise explains."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from models.advice import Advice, listed
from nls.cli import outliers
from nls.cli.formats import mission_of

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.optimizers import Result
    from nls.values import Values

__all__ = ["asking", "doubts", "explain_misfit", "gnc_applies"]


def asking(options: argparse.Namespace, written: Sequence[str] = ()) -> str:
    """The command that explains the graph of this one: as it was read, or without what was rejected if that is written.

    Parameters
    ----------
    options : of ``nls solve``.
    written : files that exist by now.
    """
    if os.path.isdir(options.file) and (command := _asking_of_scans(options.file, written)):
        return command
    wrong = outliers.is_gnc(options.robust)
    of_lines = ["--drop-absent"] * options.drop_absent
    of_lines += ["--ignore-tags", options.ignore_tags] if options.ignore_tags else []
    if wrong and options.output in written and options.to is None:
        same = os.path.splitext(options.file)[1] == os.path.splitext(options.output)[1]  # lines left out are in it
        return shlex.join(["nls", "explain", _named(options.output), *of_lines * same])
    words = ["nls", "explain", *map(_named, [options.file, *options.dives])]
    options_of_solve = {
        "--dialect": options.dialect if options.dialect != "auto" else None,
        "--convention": options.convention if options.convention != "g2o" else None,
        "--elevation": options.elevation,
        "--init": options.init if options.init != "auto" else None,
        "--robust": "none" if options.all_contacts else None if wrong else options.robust,
    }
    words += [word for name, value in options_of_solve.items() if value is not None for word in (name, value)]
    words += ["--repair-information"] * options.repair_information + of_lines
    words += [word for kind in options.hold for word in ("--hold", kind)]
    return shlex.join(words)


def _asking_of_scans(folder: str, written: Sequence[str]) -> str:
    """The command that explains the graph with the closures of a scan mission, or writes it; empty for another one."""
    from nls.cli.scan_mission import GRAPH
    from nls.missions.scans.folder import is_scan_mission

    if not is_scan_mission(folder):
        return ""
    graph = next((name for name in written if os.path.basename(name) == GRAPH), None)
    return shlex.join(["nls", "explain", graph] if graph else ["nls", "solve", _named(folder), "-o", "OUT"])


def _named(file: str) -> str:
    """A file name that is not taken for an option; standard input is none."""
    return f"./{file}" if file.startswith("-") and file != "-" else file


def separate_parts(graph: FactorGraph, values: Values) -> list[str]:
    """The note on parts that no measurement joins, of a graph that has several."""
    from nls.gauge import choose_gauge, component_labels, fixed_variables

    pattern = graph.pattern(values)
    if not component_labels(pattern).any():  # one part, beginning with the first variable
        return []
    from nls.explanation.explanation import separate_parts

    gauge = choose_gauge("first", pattern, values, fixed_variables(graph.fixed, values))
    return ["; ".join([f.says, *listed(f.advice, shell=True)]) for f in separate_parts(pattern, gauge)]


def explain_misfit(
    report: LoadReport, graph: FactorGraph, result: Result, options: argparse.Namespace, as_read: bool = True
) -> None:
    """Errors of whole tables of a mission, and what explains an implausible chi2, into its report.

    Nothing is tried of several dives, of a graph that is not as read, and where special values or units of its tables
    are wrong: those come first.
    """
    if (mission := mission_of(report)) is None:
        return
    from nls.missions.checks.table_errors import table_errors
    from nls.optimizers.fit import TWICE

    chi2, dof = result.believed
    mission.errors = table_errors(graph, result.values, chi2, dof, mission) if result.converged and dof > 0 else []
    if not as_read or getattr(options, "dives", []):
        mission.errors = [replace(error, evident=False) for error in mission.errors]
        return
    implausible = bool(result.doubt) and result.chi2_final > TWICE * result.dof
    if not (implausible or any(error.evident for error in mission.errors)):
        return
    from nls.cli.progress import Progress
    from nls.missions.checks.trials import explained, worth_trying
    from nls.missions.folder.folder import read_tables
    from nls.stages import listened

    if worth_trying(mission.findings):
        with Progress("explain", quiet=getattr(options, "quiet", False)) as progress, listened(progress.say):
            tables = read_tables(mission.path)[0]
            explanation = explained(tables, result.chi2_final, result.dof, mission.errors, options.elevation or "hinge")
        if explanation.trials or "contacts.csv" not in mission.tags:  # the mounting of a sonar is not tried
            mission.explained = explanation


def gnc_applies(graph: FactorGraph, result: Result, options: argparse.Namespace) -> list[str]:
    """Graduated non-convexity, or another start, where chi2 is far off and closures may be wrong."""
    if options.robust is not None or Advice("start") not in result.advice:
        return []
    from nls.explanation.doubts import graduates

    return listed([Advice("gnc"), Advice("start")] * graduates(graph, result.values), shell=True)


def doubts(
    result: Result, options: argparse.Namespace, written: Sequence[str] = (), cures: Sequence[str] = ()
) -> list[str]:
    """The note on a chi2 that is above what noise explains, by the rule of `nls.optimizers.fit`.

    Parameters
    ----------
    result : of the optimization.
    options, written : as for `asking`.
    cures : what else explains or cures it, in words.
    """
    if not (result.misfit or cures):
        return []
    cure = ["without --robust none, wrong contacts are found and left out"] * options.all_contacts
    cure += cures or listed((piece for piece in result.advice if piece.action != "explain"), shell=True)
    problem = [f"implausible: {result.doubt}" if result.doubt else result.misfit] * bool(result.misfit)
    return ["; ".join([*problem, *cure, f"see: {asking(options, written)}"])]
