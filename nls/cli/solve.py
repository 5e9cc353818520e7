"""``nls solve``: load, start, optimize, write, report."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nls.cli.outputs import PAGES, PICTURES, complain, refuse_name, refuse_unwritable, write_json

if TYPE_CHECKING:
    from models.errors import LeadlineError, UnderconstrainedError
    from nls.cli.mission import Solved
    from nls.cli.phase import Phase
    from nls.cli.progress import Progress
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.linear import LinearSolver
    from nls.optimizers import Iteration, Optimizer, Result, Stop
    from nls.values import Values

__all__ = ["solve"]

SHOWN = 12  # free directions in the table


def solve(options: argparse.Namespace) -> int:
    """Solve and report; returns the exit status."""
    import nls
    from models.errors import GraphFileError, LeadlineError, UnderconstrainedError
    from nls.cli import certified, outliers
    from nls.cli.formats import output_format, read, refuse_unwritable_graph
    from nls.cli.hint import asking, doubts
    from nls.cli.outputs import refuse_loss
    from nls.cli.prepared import prepared
    from nls.cli.progress import Progress
    from nls.cli.report import write_report
    from nls.cli.timing import Clock, peak_rss_mb
    from nls.linear import SOLVERS, default_solver
    from nls.stages import collected
    from nls.starts import initialize  # noqa: F401

    clock = Clock(options.began, options.startup)
    solver = default_solver() if options.linear_solver == "auto" else SOLVERS[options.linear_solver]()
    mission, form = os.path.isdir(options.file), ""
    output = None if mission else options.output
    others = options.covariance, options.plot, options.report
    refuse_unwritable(*others, json=options.json, graph=output, read=options.file)
    refuse_name("--plot", options.plot, PICTURES)
    refuse_name("--report", options.report, PAGES)
    if mission:
        from nls.cli.mission import refuse_unwritable_folder

        refuse_unwritable_folder(options.output, options.file, options.to)
    elif options.output:
        form = output_format(options.output, options.to)
        _refuse_no_values(options.output, form)
        if outliers.wanted(options.robust):
            refuse_loss(options, f"{options.robust} leaves out the measurements it rejects")
    stop = nls.Stop(options.update_tol, options.chi2_rtol, max_iterations=options.max_iterations)
    clock.lap("imports")
    with collected() as stages:
        as_read, values, report = read(options)
        if form and form != report.format:
            refuse_loss(options, f"{form} files do not hold all that {report.format} files do")
        options.phase.doing = f"while searching for a start for {options.file}"
        graph = prepared(as_read, values, options)
        clock.lap("read")
        wrong = outliers.wanted(options.robust)
        try:
            found = outliers.chosen(options.robust, options.init, graph, values) if wrong else None
        except UnderconstrainedError as error:
            _say_free(error, options, report, partial(write_report, options, graph, values, report, ("", {})))
            raise
        if found is None:
            start, init, tried = nls.initialize(graph, values, options.init)
        else:
            graph, start, init = found.graph, found.result.values, options.robust
            as_read, report = outliers.kept(as_read, found, report)
            report.notes += outliers.left_out(found, options.output)
            tried = {init: found.result.chi2_final}
        chi2_read = _chi2_read(graph, values, tried)
        before = start if chi2_read is None else values  # what a picture can show
        clock.lap("init")
    if form:  # what has no line in the format is refused before the work
        refuse_unwritable_graph(options.output, form, as_read, start, report)
    if options.certify:
        from nls.certificate.problem import certifiable

        certifiable(graph, start)
    clock.lap("check")
    written: list[str] = options.phase.written
    failed: list[LeadlineError] = []
    options.phase.now(f"while solving {options.file}")
    page = partial(write_report, options, graph, before, report, (init, tried))
    with Progress("solve", options.max_iterations, options.quiet) as progress:
        try:
            result = graph.optimize(start, _optimizer(options.method, graph, stop, progress), solver, options.gauge)
        except UnderconstrainedError as error:
            _say_free(error, options, report, page)
            raise
    clock.lap("optimize")
    solved = _solved(graph, values, result, report, solver, options.gauge)
    _write(options, form, as_read, before, graph, result, solver, report, solved, failed)
    said = {} if solved is None else {"mission": solved.record()}
    said |= {} if found is None else outliers.record(found)
    clock.lap("write")
    certificate = None
    if options.certify:  # last: it can take longer than the solution, which is written by now
        options.phase.now("while certifying the optimum")
        try:
            certificate = nls.certify(graph, result.values)
            said["certificate"] = certified.record(certificate)
        except LeadlineError as error:
            failed.append(error)
        clock.lap("certify")
    if options.report:
        seconds = clock.timings(result.timings, stages)
        rejected = () if found is None else found.rejected
        reasons = () if found is None else found.doubts
        last = partial(page, result, seconds, solved, certificate, rejected=rejected, doubts=reasons)
        _attempt(options.phase, [(last, options.report)], failed)
        clock.lap("report")
    timings = clock.timings(result.timings, stages)

    record: dict[str, Any] = {
        "input": report.path,
        "format": report.format,
        "dimension": report.dimension,
        "variables": len(values),
        "factors": len(graph) + len(said.get("rejected", ())),
        "convention": report.convention,
        "robust": options.robust,
        "held": options.hold,
        "init": init,
        "starts": tried,
        "method": result.method,
        "linear_solver": result.linear_solver,
        "chi2_file": chi2_read if report.vertices_given else None,
        "chi2_initial": result.chi2_initial,
        "chi2_final": result.chi2_final,
        "gauge": result.gauge,
        "dof": result.dof,
        "iterations": result.iterations,
        "converged": result.converged,
        "status": result.status.name,
        "reason": f"{result.status.value}: {result.ending}",
        "rule": result.rule,
        "reused": result.reused,
        "attempts": [vars(attempt) | {"status": attempt.status.name} for attempt in result.attempts],
        **said,
        "history": [_record(iteration) for iteration in result.history],
        "timings": timings,
        "underconstrained": list(result.underconstrained),
        "written": written,
        "unwritten": [error.message for error in failed],
        "notes": report.notes + doubts(result, options, written),
        "peak_rss_mb": peak_rss_mb(),
        "version": nls.__version__,
    }
    named = [options.json] if options.json not in (None, "-") else []
    record["written"] = written + named  # it names itself
    try:
        options.phase.now("while writing the report")
        write_json(record, options.json)
        written += named
    except GraphFileError as error:
        record["written"] = written
        failed.append(error)
    if not options.quiet and options.json != "-":
        shown = [] if found is None else outliers.rows(found)
        shown += [] if certificate is None else certified.rows(certificate)
        print(_table(record, result, shown, report.warnings, options.verbose))
    allowed = options.allow_unconverged and result.status in (nls.Status.MAX_ITERATIONS, nls.Status.MAX_TIME)
    if not result.converged and not (allowed and options.quiet):
        print(f"nls: {record['reason']}; {_advice(result, allowed)}; see: {asking(options, written)}", file=sys.stderr)
    refuted = certificate is not None and certificate.verdict == "refuted"
    if refuted:
        print("nls: refuted: this is a local optimum; another start (--init) may lead lower", file=sys.stderr)
    doubtful = outliers.doubtful(found, options.allow_doubtful)
    for failure in failed:
        complain(failure)
    if failed and options.debug:
        raise failed[0]
    return 1 if refuted or doubtful or not (result.converged or allowed) else 2 if failed else 0


def _say_free(
    error: UnderconstrainedError, options: argparse.Namespace, report: LoadReport, page: Callable[..., None]
) -> None:
    """Write the outputs that can say what is free, and name in the error these and what explains it."""
    from models.advice import Advice
    from nls.cli.hint import asking

    failed: list[LeadlineError] = []
    _attempt(options.phase, [(partial(page, error, {}, None, None), options.report)], failed)
    _attempt(options.phase, [(partial(_free, options, report, error), options.json)], failed)
    for failure in failed:
        complain(failure)
    names = ", ".join(name for name in options.phase.written if name != "-")
    error.advice = (*error.advice, Advice("explain", (asking(options),)), *(Advice("written", (names,)),) * bool(names))


def _free(options: argparse.Namespace, report: LoadReport, error: UnderconstrainedError, where: str) -> None:
    """The report for programs on a graph that leaves something free."""
    from models.advice import listed

    record = {
        "input": report.path,
        "format": report.format,
        "converged": False,
        "status": "UNDERCONSTRAINED",
        "reason": error.message,
        "advice": listed(error.advice, shell=True),
        "underconstrained": list(error.components),
        "written": [*options.phase.written, *([where] if where != "-" else [])],
        "notes": report.notes,
    }
    write_json(record, where)


def _refuse_no_values(output: str | None, form: str) -> None:
    """Refuse to write an optimum to a format without values."""
    from models.errors import OptionError
    from nls.io.dialects import FORMATS

    if form in FORMATS and not FORMATS[form].holds_values:
        allowed = f"a format that holds the optimum, such as g2o: {form} files hold measurements only"
        raise OptionError("output file", output, allowed)


def _chi2_read(graph: FactorGraph, values: Values, tried: dict[str, float]) -> float | None:
    """chi2 of the values as read; None where it does not exist there, as for a bearing to the place of the sensor."""
    from models.errors import EvaluationError, SingularGeometryError

    try:
        return tried["file"] if "file" in tried else graph.chi2(values)
    except (EvaluationError, SingularGeometryError):
        return None


def _write(
    options: argparse.Namespace,
    form: str,
    as_read: FactorGraph,
    before: Values,
    graph: FactorGraph,
    result: Result,
    solver: LinearSolver,
    report: LoadReport,
    solved: Solved | None,
    failed: list[LeadlineError],
) -> None:
    """Write every output but the reports."""
    from models.errors import GraphFileError
    from nls.io.files import made

    def optimum(path: str) -> None:
        from nls.cli.formats import rendered
        from nls.io.files import write_bytes

        data, notes = rendered(path, form, as_read, result.values, report)
        write_bytes(path, data)
        report.notes += notes

    def covariance(path: str) -> None:
        from nls import Marginals
        from nls.io.covariance_csv import write_covariances

        if solved is not None and solved.marginals is not None:
            write_covariances(path, solved.marginals, free=[solved.free])
        else:
            write_covariances(path, Marginals(graph, result.values, solver, options.gauge))

    def plot(path: str) -> None:
        from nls.plot import before_after
        from nls.plot.picture import write_picture

        write_picture(path, before_after(graph, before, result, title=Path(report.path).name))

    outputs: list[tuple[Callable[[str], None], str | None]] = [(covariance, options.covariance)]
    if options.covariance and not result.converged:
        report.notes.append(f"no covariances were written to {options.covariance}: this is no optimum")
        outputs = []
    outputs.append((plot, options.plot))
    if solved is None or not options.output:
        _attempt(options.phase, [(optimum, None if solved else options.output), *outputs], failed)
        return
    try:
        with made(options.output):
            _attempt(options.phase, solved.outputs(options.output), failed)
    except GraphFileError as error:  # no folder, no files in it
        failed.append(error)
    _attempt(options.phase, outputs, failed)


def _attempt(
    phase: Phase, outputs: Sequence[tuple[Callable[[str], None], str | None]], failed: list[LeadlineError]
) -> None:
    """Write what is asked for, whether or not another can be; names of those written and errors are added."""
    from models.errors import GraphFileError, LeadlineError

    for write, path in outputs:
        try:
            if path:
                phase.now(f"while writing {path}")
                write(path)
                phase.written.append(path)
        except GraphFileError as error:  # names the file itself
            failed.append(error)
        except (LeadlineError, OSError, MemoryError) as error:
            message, advice = (error.message, error.advice) if isinstance(error, LeadlineError) else (str(error), ())
            failed.append(LeadlineError(f"{path} was not written: {message}", advice))


def _solved(
    graph: FactorGraph, dead: Values, result: Result, report: LoadReport, solver: LinearSolver, gauge: str
) -> Solved | None:
    """The solution of a mission; None of a file."""
    if report.format != "mission":
        return None
    from nls.cli.mission import Solved
    from nls.io.mission import MissionReport

    assert isinstance(report, MissionReport)
    return Solved(graph, dead, result, report, solver, gauge)


def _optimizer(name: str, graph: FactorGraph, stop: Stop, progress: Progress) -> Optimizer:
    """The optimizer by name; auto leaves it to the library."""
    from nls.optimizers import OPTIMIZERS, default_optimizer

    kind = default_optimizer(graph.factors) if name == "auto" else OPTIMIZERS[name]
    return kind(stop, callback=progress.show)


def _table(report: dict[str, Any], result: Result, findings: list[str], warned: list[str], verbose: bool) -> str:
    from nls.io.text import several

    lines = result.steps if verbose else []
    file = "dead reckoning" if "mission" in report else "file"  # a mission has no start in a file
    start = ", ".join(f"{name.replace('file', file)} {chi2:.6g}" for name, chi2 in report["starts"].items())
    seconds = report["timings"]
    robust = f", robust kernel {report['robust']}" if report["robust"] and "rejected" not in report else ""
    ratio = f" (ratio {result.chi2_final / result.dof:.3g}, 1 expected)" if result.dof > 0 and not result.robust else ""
    lines += [
        f"input       {report['input']}: {several(report['variables'], 'variable')}, "
        f"{several(report['factors'], 'measurement')}, "
        f"{report['dimension']}",
        f"start       {report['init'].replace('file', file)} (chi2: {start})",
        f"chi2        {report['chi2_initial']:.6g} -> {report['chi2_final']:.9g} in "
        f"{several(report['iterations'], 'iteration')}, {report['dof']} degrees of freedom{ratio}, "
        f"convention {report['convention']}{robust}",
        f"solver      {report['method']}, {report['linear_solver']}; gauge: {report['gauge']}",
        f"time        {seconds['solved']:.3f} s from file to optimum, peak {report['peak_rss_mb']:.0f} MB",
        f"result      {report['reason']}",
        *(f"method      {remark}" for remark in result.remarks),
        *findings,
    ]
    if "mission" in report:
        from nls.cli.mission import lines as worth

        lines += worth(report["mission"])
    lines += [f"held        all {kind}" for kind in report["held"]]
    lines += [f"free        {direction}" for direction in report["underconstrained"][:SHOWN]]
    if (more := len(report["underconstrained"]) - SHOWN) > 0:
        lines.append(f"free        and {more} more directions")
    lines += [f"written     {name}" for name in report["written"]]
    lines += [f"note        {note}" for note in report["notes"] if note not in warned]
    if verbose:
        from nls.cli.timing import iterations, table

        lines += [*iterations(result.history), *table(seconds)]
    return "\n".join(lines)


def _advice(result: Result, allowed: bool) -> str:
    """What to try next, by status; an estimate that has not converged may be `allowed` already."""
    name = result.status.name
    if result.rises and not result.attempts:
        return f"chi2 rose in {result.rises} of {result.iterations} steps; try --method levenberg-marquardt"
    if name in ("MAX_ITERATIONS", "MAX_TIME"):
        return "allow more with --max-iterations" + (
            "" if allowed else ", or take the estimate with --allow-unconverged"
        )
    if name in ("STOPPED", "INTERRUPTED"):
        return "the best estimate so far was kept"
    return "the best estimate so far was kept; try another --init"


def _record(iteration: Iteration) -> dict[str, Any]:
    """One iteration for programs."""
    return {
        "iteration": iteration.number,
        "chi2": iteration.chi2,
        "update": iteration.update,
        "gradient": iteration.gradient,
        "lambda": iteration.damping,
        "seconds": iteration.seconds,
        "reused": iteration.reused,
    }
