"""``nls solve --report OUT.html``: what the page is told of the command, the file and the solution."""

from __future__ import annotations

import shlex
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from nls.cli.timing import rows

if TYPE_CHECKING:
    from models.errors import UnderconstrainedError
    from nls.cli.job import Job
    from nls.optimizers import Result


def write_report(job: Job, result: Result | UnderconstrainedError, path: str) -> None:
    """Write the page of a run.

    Parameters
    ----------
    job : the run.
    result : of the optimization, or the error in its place.
    path : of the page.
    """
    import nls
    from nls.cli.explain import explanation_of, with_tables
    from nls.io.files import write_bytes
    from nls.optimizers import Result
    from nls.plot.report import report as page

    solved, choice = job.solved, job.choice
    timings = job.timings if isinstance(result, Result) else {}
    explanation = None
    if job.select is None:  # closures between scans have no lines
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nls.GraphWarning)  # they were given when it was solved
            values = job.before if result.values is None else result.values
            explanation = with_tables(explanation_of(job.graph, values, job.report), job.report)
    text = page(
        job.graph,
        job.before,
        result,
        explanation,
        title=Path(job.report.path).name,
        init=job.init,
        marginals=None if solved is None else solved.marginals,
        certificate=job.certificate,
        rejected=() if choice is None else choice.rejected,
        doubts=job.doubts if isinstance(result, Result) else (),
        facts=_facts(job, result),
        seconds={name: timings[name] for name in rows(timings) if name != "process"},
        pictures={} if solved is None else solved.pictures(),
        figures={} if solved is None else solved.figures(),
        shell=True,
    )
    write_bytes(path, text.encode(errors="backslashreplace"))  # names of files can be any bytes


def _facts(job: Job, result: Result | UnderconstrainedError) -> dict[str, str]:
    """Where the solution comes from, by name."""
    import nls

    options, report = job.options, job.report
    facts = {
        "file": report.path,
        "format": f"{report.format}, {report.dimension}",
        "lines": ", ".join(f"{count:,} {tag}" for tag, count in report.tags.items()),
        "command": shlex.join(["nls", *map(str, options.argv)]),
        "convention": report.convention,
        "starts": ", ".join(f"{name}: chi2 {chi2:.6g}" for name, chi2 in job.starts.items()),
        "linear solver": getattr(result, "linear_solver", ""),
        "robust kernel": options.robust or "",
        "held": ", ".join(f"all {kind}" for kind in options.hold),
        **({} if job.solved is None else job.solved.facts()),
        "notes": "; ".join(report.notes),
        "version": f"leadline {nls.__version__}",
    }
    return {name: fact for name, fact in facts.items() if fact}
