"""``nls solve``: read, start, optimize, write, report. One stage a function; all pass one `Job`."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from nls.cli.formats import mission_of
from nls.cli.outputs import PAGES, PICTURES, complain, refuse_name, refuse_unwritable, say, write_json

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.cli.progress import Progress
    from nls.optimizers import Optimizer
    from nls.robust import Robustified


def solve(options: argparse.Namespace) -> int:
    """Solve and report; returns the exit status."""
    job = _checked(options)
    _read(job)
    _check_graph(job)
    if job.select is None:
        _optimize(job)
    else:
        from nls.cli.scan_mission import close_loops

        close_loops(job)
    if options.improve:
        _improve(job)
    _write(job)
    if options.certify and not options.improve:
        _certify(job)
    _draw(job)
    _report(job)
    return _status(job)


def _checked(options: argparse.Namespace) -> Job:
    """The job, once all outputs can be written."""
    import nls
    from nls.cli.formats import output_format, refuse_other_formats
    from nls.cli.job import Job
    from nls.cli.sigmas import refuse
    from nls.cli.timing import Clock
    from nls.io.files import refuse_absent
    from nls.linear import SOLVERS

    refuse_absent(file for file in (options.file, *options.dives) if file != "-")
    clock = Clock(options.began, options.startup)
    solver = None if options.linear_solver == "auto" else SOLVERS[options.linear_solver]()
    stop = nls.Stop(options.update_tol, options.chi2_rtol, max_iterations=options.max_iterations)
    job, mission = Job(options, clock, solver, stop), os.path.isdir(options.file)
    output_files = {"-o": None if mission else options.output, "--covariance": options.covariance}
    output_files |= {"--write-graph": options.write_graph}
    output_files |= {"--plot": options.plot, "--report": options.report, "--json": options.json}
    refuse_unwritable(output_files, options.file, *options.dives)
    if mission:
        from nls.cli.scan_mission import selection_of

        if (select := selection_of(options)) is not None:
            job.select, options.robust, options.init = select, None, "file"
    refuse(options.sigmas, options.robust, options.improve)
    if options.covariance and (os.path.isfile(options.covariance) or not os.path.exists(options.covariance)):
        refuse_name("--covariance", options.covariance, (".csv", ".csv.gz"))
    refuse_name("--plot", options.plot, PICTURES)
    refuse_name("--report", options.report, PAGES)
    if mission:
        from nls.cli.mission import refuse_unwritable_folder

        for folder in (options.file, *options.dives):
            refuse_unwritable_folder(options.output, folder, options.to)
    elif options.output:
        job.form = output_format("-o", options.output, options.to)
        _refuse_output(job)
    if options.write_graph:
        if not mission:
            raise nls.OptionError("--write-graph", options.write_graph, "a mission as input; -o writes another graph")
        job.form = output_format("--write-graph", options.write_graph, None)
        if job.select is None:
            refuse_other_formats(options.write_graph, job.form)
    if options.renumber:
        from nls.io.renumbering import check_renumber

        check_renumber(job.form or ("mission" if mission else "no output"))
    from nls.starts import initialize  # noqa: F401 - counted as an import

    clock.lap("imports")
    return job


def _refuse_output(job: Job) -> None:
    """Refuse to write an optimum to a format without values, or less than was read over the input."""
    from models.errors import OptionError
    from nls.cli import outliers
    from nls.cli.outputs import refuse_loss
    from nls.io.dialects import FORMATS

    options, form = job.options, job.form
    if form in FORMATS and not FORMATS[form].holds_values:
        allowed = f"a format that holds the optimum, such as g2o: {form} files hold measurements only"
        raise OptionError("-o", options.output, allowed)
    if options.sigmas != "stated":
        refuse_loss("-o", options, f"--sigmas {options.sigmas} replaces the stated sigmas")
    if outliers.is_gnc(options.robust):
        refuse_loss("-o", options, f"{options.robust} leaves out the measurements it rejects")


def _read(job: Job) -> None:
    """Graph, values and start."""
    from nls.cli import formats
    from nls.cli.outputs import refuse_loss
    from nls.cli.preparation import believes_all, prepare
    from nls.stages import collected

    options = job.options
    with collected() as job.stages:
        job.as_read, job.values, job.report = formats.read(options, to_solve=True)
        believes_all(options, job.report)
        if job.form and job.form != job.report.format:
            refuse_loss("-o", options, f"{job.form} files do not hold all that {job.report.format} files do")
        options.phase.doing = f"while searching for a start for {options.file}"
        job.graph = prepare(job.as_read, job.values, job.report, options)
        job.clock.lap("read")
        _start(job)
        job.chi2_read = _chi2_read(job)
        job.clock.lap("init")


def _start(job: Job) -> None:
    """The start values; with graduated non-convexity also the measurements to believe."""
    import nls
    from models.errors import UnderconstrainedError
    from nls.cli import outliers
    from nls.cli.solve_outputs import write_free

    options = job.options
    if not outliers.is_gnc(options.robust):
        job.start, job.init, job.starts = nls.initialize(job.graph, job.values, options.init)
        return
    try:
        choice = outliers.chosen(options.robust, options.init, job.graph, job.values)
    except UnderconstrainedError as error:
        job.start = job.values
        write_free(job, error)
        raise
    _take(job, choice, options.robust)


def _take(job: Job, choice: Robustified, name: str) -> None:
    """The graph without what was rejected, to begin with at its optimum."""
    from nls.cli import outliers

    job.choice, job.graph, job.start, job.init = choice, choice.graph, choice.result.values, name
    job.sources = job.report.sources
    job.as_read, job.report = outliers.without_rejected(job.as_read, choice, job.report)
    job.values = outliers.without_left(job.values, choice.result.values)
    if job.form and (count := len(choice.rejected)):
        job.report.notes.append(f"{job.graph_file} holds the graph without the {count} rejected measurements")
    job.starts = {job.init: choice.result.chi2_final}


def _chi2_read(job: Job) -> float | None:
    """chi2 of the values as read; None where it does not exist there, as for a bearing to the place of the sensor."""
    from models.errors import EvaluationError, SingularGeometryError

    try:
        return job.starts["file"] if "file" in job.starts else job.graph.chi2(job.values)
    except (EvaluationError, SingularGeometryError):
        return None


def _check_graph(job: Job) -> None:
    """Refuse before the work what the output cannot hold, or the certificate is not for."""
    from nls.cli.formats import refuse_unwritable_graph

    if job.options.crs is not None:
        from nls.cli.mission import chosen_projection

        job.projection = chosen_projection(job.options.crs, job.options.output, job.report)
    if job.form:
        refuse_unwritable_graph(job.graph_file, job.form, job.as_read, job.start, job.report, job.options.renumber)
    if job.options.certify or job.options.improve:
        from nls.certificate.problem import certifiable

        certifiable(job.graph, job.start)
    job.clock.lap("check")


def _optimize(job: Job) -> None:
    """The optimum, of a mission without wrong contacts where that of all says that some are wrong."""
    from nls.cli.hint import explain_misfit
    from nls.cli.outliers import choice_of

    _find_optimum(job)
    options = job.options
    judges = not options.all_contacts and options.robust is None and options.sigmas == "stated"
    if judges and (choice := choice_of(job.graph, job.values, job.result, job.report)) is not None:
        _take(job, choice, "gnc-tls")
        _find_optimum(job)
    job.clock.lap("optimize")
    if job.report.format == "mission":
        explain_misfit(job.report, job.graph, job.result, job.options, job.choice is None and job.sigmas is None)
        job.clock.lap("report")


def _find_optimum(job: Job) -> None:
    """The optimum; where something is free, the outputs that can tell so, and the error."""
    from models.errors import UnderconstrainedError
    from nls.cli.progress import Progress
    from nls.cli.solve_outputs import write_free

    options = job.options
    options.phase.now(f"while solving {options.file}")
    with Progress("solve", options.max_iterations, options.quiet) as progress:
        try:
            if options.sigmas != "stated":
                _estimate(job, _optimizer(job, progress))
            else:
                job.result = job.graph.optimize(job.start, _optimizer(job, progress), job.solver, options.gauge)
            _name_tables(job)
        except UnderconstrainedError as error:
            write_free(job, error)
            raise


def _name_tables(job: Job) -> None:
    """Of a mission under a kernel, say what is ignored by the file of every table."""
    from nls.optimizers.fit import shares

    if job.result.shares and (mission := mission_of(job.report)):
        factors = job.graph.factors
        names = [f"{factor.name} ({table})" for factor, table in zip(factors, mission.tables, strict=True)]
        job.result.shares = shares(factors, job.result.values, names)


def _estimate(job: Job, optimizer: Optimizer) -> None:
    """The scales of the sigmas, the graphs with rescaled noise, and the optimum."""
    from nls.analysis.variance_components import variance_components
    from nls.cli.sigmas import rescaled_report

    _, _, groups = job.options.sigmas.partition(":")
    job.sigmas = variance_components(job.graph, job.start, groups or "kinds", optimizer, job.solver, job.options.gauge)
    as_read = job.sigmas.rescaled(job.as_read)
    job.report = rescaled_report(job.report, job.as_read, as_read)
    job.graph, job.as_read, job.result = job.sigmas.graph, as_read, job.sigmas.result
    if job.form:
        job.report.notes.append(f"{job.graph_file} holds the estimated sigmas, not the stated ones")


def _optimizer(job: Job, progress: Progress) -> Optimizer:
    """The optimizer by name; auto leaves it to the library."""
    from nls.optimizers import OPTIMIZERS, default_optimizer

    name = job.options.method
    if name == "auto":
        return default_optimizer(job.graph.factors, job.stop, progress.show)
    return OPTIMIZERS[name](job.stop, progress.show)


def _improve(job: Job) -> None:
    """From a solution that is refuted, or stopped too early, on to the optimum of lower chi2, until there is none."""
    _certify(job)
    while job.certificate is not None and job.certificate.better is not None:
        job.refuted.append(job.result.chi2_final)
        job.start, job.init = job.certificate.better, "better poses"
        job.starts["better poses"] = job.graph.chi2(job.start)
        _find_optimum(job)
        job.clock.lap("optimize")
        _certify(job)


def _write(job: Job) -> None:
    """Every output but the reports."""
    from nls.cli.solve_outputs import write_outputs

    if job.report.format == "mission":
        from nls.cli.dives import SolvedDives
        from nls.cli.solved_mission import SolvedMission

        job.solved = (SolvedDives if job.options.dives else SolvedMission)(job)
    write_outputs(job)
    job.clock.lap("write")


def _certify(job: Job) -> None:
    """The certificate; without ``--improve`` last of the work, as it can take longer than the solution."""
    import nls
    from models.errors import LeadlineError

    job.options.phase.now("while certifying the optimum")
    try:
        job.certificate = nls.certify(job.graph, job.result.values, job.stop)
    except LeadlineError as error:
        job.certificate = None
        job.failed.append(error)
    job.clock.lap("certify")


def _draw(job: Job) -> None:
    """The page to look at."""
    if job.options.report:
        from nls.cli.report import write_report
        from nls.cli.solve_outputs import attempt

        attempt(job, [(lambda path: write_report(job, job.result, path), job.options.report)])
        job.clock.lap("report")


def _report(job: Job) -> None:
    """The report for programs and the table."""
    from models.errors import GraphFileError
    from nls.cli import certificate, outliers, sigmas
    from nls.cli.solve_report import record_of, table

    options, written = job.options, job.options.phase.written
    record = record_of(job)
    named = [options.json] if options.json not in (None, "-") else []
    record["written"] = written + named  # it names itself
    try:
        options.phase.now("while writing the report")
        write_json(record, options.json)
        written += named
    except GraphFileError as error:
        record["written"] = written
        job.failed.append(error)
    if not options.quiet and options.json != "-":
        rows = [] if job.choice is None else outliers.rows(job.choice, options.robust is not None)
        rows += [] if job.sigmas is None else sigmas.rows(job.sigmas)
        rows += [] if job.certificate is None else certificate.rows(job.certificate, job.refuted)
        rows += [] if job.solved is None else job.solved.lines(record[job.solved.name])
        say(table(record, job.result, rows, job.report.warnings, options.verbose))


def _status(job: Job) -> int:
    """The exit status; reasons for another than 0 on standard error."""
    import nls
    from nls.cli import certificate
    from nls.cli.hint import asking
    from nls.cli.solve_report import advice

    options, result = job.options, job.result
    allowed = options.allow_unconverged and result.status in (nls.Status.MAX_ITERATIONS, nls.Status.MAX_TIME)
    if not result.converged and not (allowed and options.quiet):
        reason = f"{result.status.value}: {result.ending}; {advice(result, allowed)}"
        say(f"nls: {reason}; see: {asking(options, options.phase.written)}", error=True)
    if refuted := job.certificate is not None and job.certificate.verdict == "refuted":
        say(f"nls: {certificate.summary(job.certificate)}", error=True)
    doubts = [] if options.allow_doubtful or refuted else job.doubts
    if doubts and (result.converged or allowed):
        say(f"nls: doubtful: {'; '.join(doubts)}; take the estimate with --allow-doubtful", error=True)
    for failure in job.failed:
        complain(failure)
    if job.failed and options.debug:
        raise job.failed[0]
    return 1 if refuted or doubts or not (result.converged or allowed) else 2 if job.failed else 0
