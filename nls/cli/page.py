"""``nls solve --report OUT.html``: what the page is told of the command, the file and the solution."""

from __future__ import annotations

import shlex
import warnings
from pathlib import Path
from typing import Any

import nls
from nls.cli.graph_file import GraphFile
from nls.cli.run import Problem, Solved
from nls.cli.timing import rows
from nls.io.files import write_bytes
from nls.plot.report import report as page


def write_page(kind: GraphFile, problem: Problem, result: nls.Result | nls.UnderconstrainedError, path: str) -> None:
    """Write the page of a run.

    Parameters
    ----------
    kind, problem : the input, and the run; a `Solved` one with its result.
    result : of the optimization, or the error in its place.
    path : of the page.
    """
    of_result: dict[str, Any] = {}
    if isinstance(problem, Solved):
        timings, choice = problem.timings, problem.choice
        of_result = {
            "certificate": problem.certificate,
            "rejected": () if choice is None else choice.rejected,
            "doubts": kind.doubts(problem),
            "seconds": {name: timings[name] for name in rows(timings) if name != "process"},
            **kind.page(problem),
        }
    unchecked = of_result.pop("unchecked", "")
    explanation = None
    if kind.explains:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nls.GraphWarning)  # they were given when it was solved
            values = problem.before if result.values is None else result.values
            explanation = kind.with_tables(kind.explanation(problem.graph, values, problem.report), problem.report)
    text = page(
        problem.graph,
        problem.before,
        result,
        explanation,
        title=Path(problem.report.path).name,
        init=problem.init,
        facts=_facts(kind, problem, result, unchecked),
        shell=True,
        **of_result,
    )
    write_bytes(path, text.encode(errors="backslashreplace"))  # names of files can be any bytes


def _facts(
    kind: GraphFile, problem: Problem, result: nls.Result | nls.UnderconstrainedError, unchecked: str
) -> dict[str, str]:
    """Where the solution comes from, by name."""
    options, report = problem.options, problem.report
    facts = {
        "file": report.path,
        "format": f"{report.format}, {report.dimension}",
        "lines": ", ".join(f"{count:,} {tag}" for tag, count in report.tags.items()),
        "command": shlex.join(["nls", *map(str, options.argv)]),
        "convention": report.convention,
        "starts": ", ".join(f"{name}: chi2 {chi2:.6g}" for name, chi2 in problem.starts.items()),
        "linear solver": getattr(result, "linear_solver", ""),
        "robust kernel": kind.robust or "",
        "held": ", ".join(f"all {kind}" for kind in options.hold),
        "unchecked": unchecked,
        "notes": "; ".join(report.notes),
        "version": f"leadline {nls.__version__}",
    }
    return {name: fact for name, fact in facts.items() if fact}
