"""Outputs of ``nls solve``: no outcome is lost where one of them fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nls.cli.formats import mission_of
from nls.cli.outputs import complain, write_json

if TYPE_CHECKING:
    from models.errors import UnderconstrainedError
    from nls.cli.job import Content, Job


MARK = "doubtful.txt"  # beside the files of a doubtful solution: its reasons, one a line
Output = tuple[Callable[[str], None], str | None]


def write_outputs(job: Job) -> None:
    """Write every output but the reports."""
    options = job.options
    outputs: list[Output] = [(lambda path: _covariance(job, path), options.covariance)]
    if options.covariance and not job.result.converged:
        job.report.notes.append(f"no covariances were written to {options.covariance}: this is no optimum")
        outputs = []
    outputs.append((lambda path: _plot(job, path), options.plot))
    outputs.append((lambda path: _optimum(job, path), options.write_graph))
    if job.solved is None or not options.output:
        optimum = None if job.solved else options.output
        attempt(job, [(lambda path: _optimum(job, path), optimum), *outputs])
        return
    from models.errors import GraphFileError
    from nls.io.files import new_folder

    try:
        with new_folder(options.output):
            files, text = job.solved.files(), "".join(f"{reason}\n" for reason in job.solved.doubts).encode()
            if text:
                files[MARK] = lambda: text
            else:
                Path(options.output, MARK).unlink(missing_ok=True)  # of another solution
            folder = options.output
            attempt(job, [(partial(_write_file, job, make), str(Path(folder, name))) for name, make in files.items()])
    except GraphFileError as error:  # no folder, no files in it
        job.failed.append(error)
    attempt(job, outputs)


def _write_file(job: Job, make: Content, path: str) -> None:
    """Write a file of a solution, in a folder that is made where it is missing."""
    from nls.io.files import write_bytes

    content = make()
    Path(path).parent.mkdir(exist_ok=True)
    if isinstance(content, bytes):
        write_bytes(path, content)
    else:
        _write_picture(job, content, path)


def _write_picture(job: Job, figure: Any, path: str) -> None:
    from nls.plot.picture import write_picture

    write_picture(path, figure, job.marks)


def _optimum(job: Job, path: str) -> None:
    from nls.cli.formats import rendered
    from nls.io.files import write_bytes

    data, notes = rendered(path, job.form, job.as_read, job.result.values, job.report, job.options.renumber)
    write_bytes(path, data)
    job.report.notes += notes


def _covariance(job: Job, path: str) -> None:
    from nls import Marginals
    from nls.io.table import write_covariances

    marginals = None if job.solved is None else job.solved.marginals
    if marginals is None:
        marginals = Marginals(job.graph, job.result.values, job.solver, job.options.gauge)
    mission = mission_of(job.report)
    write_covariances(path, marginals, unmeasured=mission.unmeasured if mission else ())


def _plot(job: Job, path: str) -> None:
    from nls.io.files import title_of
    from nls.plot import before_after

    title = title_of(job.report.path)
    figure = job.solved.picture() if job.solved else before_after(job.graph, job.before, job.result, title)
    _write_picture(job, figure, path)


def attempt(job: Job, outputs: Sequence[Output]) -> None:
    """Write what is asked for, whether or not another can be; names of those written and errors are added."""
    from models.errors import GraphFileError, LeadlineError

    for write, path in outputs:
        try:
            if path:
                job.options.phase.now(f"while writing {path}")
                write(path)
                job.options.phase.written.append(path)
        except GraphFileError as error:  # names the file itself
            job.failed.append(error)
        except (LeadlineError, OSError, MemoryError) as error:
            message, advice = (error.message, error.advice) if isinstance(error, LeadlineError) else (str(error), ())
            job.failed.append(LeadlineError(f"{path} was not written: {message}", advice))


def write_free(job: Job, error: UnderconstrainedError) -> None:
    """Write the outputs that can say what is free, and name in the error these and what explains it."""
    from models.advice import Advice
    from nls.cli.hint import asking
    from nls.cli.report import write_report

    options, written = job.options, job.options.phase.written
    if error.silent is not None and len(job.graph.factors) == len(job.report.sources):
        error.message = f"{job.report.place(*error.silent)}: {error.message}"
    page: Output = lambda path: write_report(job, error, path), options.report
    attempt(job, [page, (lambda path: _free(job, error, path), options.json)])
    for failure in job.failed:
        complain(failure)
    names = ", ".join(name for name in written if name != "-")
    error.advice = (*error.advice, Advice("explain", (asking(options),)), *(Advice("written", (names,)),) * bool(names))


def _free(job: Job, error: UnderconstrainedError, where: str) -> None:
    """The report for programs on a graph that leaves something free."""
    from models.advice import listed
    from nls.cli.solve_report import SCHEMA

    record = {
        "schema": SCHEMA,
        "input": job.report.path,
        "format": job.report.format,
        "converged": False,
        "status": "UNDERCONSTRAINED",
        "reason": error.message,
        "advice": listed(error.advice, shell=True),
        "underconstrained": list(error.components),
        "written": [*job.options.phase.written, *([where] if where != "-" else [])],
        "notes": job.report.notes,
    }
    write_json(record, where)
