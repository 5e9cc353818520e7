"""``nls solve``: read, start, optimize, write, report. One stage a function; an output that fails loses no other."""

import argparse
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module

import nls
from models.advice import Advice, listed
from nls.cli import formats
from nls.cli.graph_file import GraphFile
from nls.cli.inputs import input_of
from nls.cli.outputs import PAGES, PICTURES, Color, complain, live, refuse_name, refuse_unwritable, say, write_json
from nls.cli.run import Clock, Problem, Run, Solved
from nls.cli.solve_report import SCHEMA, advice, input_line, record_of, table, write_page
from nls.io.files import refuse_absent
from nls.linear import LU, QR, SOLVERS, DenseCholesky, DenseQR, Pinv, default_solver
from nls.sparse.threads import openmp
from nls.stages import announce, collected

OF_SCIPY = (LU, QR, DenseCholesky, DenseQR, Pinv)  # linear solvers that import it late


def solve(options: argparse.Namespace) -> int:
    """Solve and report; returns the exit status."""
    kind = input_of(options)
    run = _checked(kind)
    with collected() as stages:
        problem = _begun(kind, _read(kind, run))
    problem = _check_graph(kind, replace(problem, stages=stages))
    with _free_written(kind, problem):
        solved = kind.solved(problem)
        if options.improve:
            solved = _improved(kind, solved)
    solved = kind.finished(solved)
    _write(kind, solved)
    if options.certify and not options.improve:
        solved = _certified(solved)
    if options.report:
        attempt(solved, {options.report: partial(write_page, kind, solved, solved.result)})
        run.clock.lap("report")
    _report(kind, solved)
    return _status(kind, solved)


def _checked(kind: GraphFile) -> Run:
    """The run, once all outputs can be written."""
    options = kind.options
    refuse_absent(file for file in kind.files if file != "-")
    clock = Clock(options.began, options.startup)
    solver = None if options.linear_solver == "auto" else SOLVERS[options.linear_solver]()
    stop = nls.Stop(options.update_sigmas, options.update_tol, options.chi2_rtol, options.max_iterations)
    others = ("covariance", "write_graph", "plot", "view", "report", "json")
    files = {"-o": kind.output_file, **{f"--{name.replace('_', '-')}": getattr(options, name) for name in others}}
    refuse_unwritable(files, *kind.files)
    kind.check_options()
    _refuse_sigmas(kind)
    if options.covariance and (os.path.isfile(options.covariance) or not os.path.exists(options.covariance)):
        refuse_name("--covariance", options.covariance, (".csv", ".csv.gz"))
    for option, suffixes in (("plot", PICTURES), ("report", PAGES), ("view", PAGES)):
        refuse_name(f"--{option}", getattr(options, option), suffixes)
    if options.view:
        from nls.plot.view import drawing_package

        drawing_package()  # before the work
    form = kind.output_format()
    kind.check_renumber(form)
    kind.import_modules()
    clock.lap("imports")
    return Run(options=options, clock=clock, solver=solver, stop=stop, form=form)


def _refuse_sigmas(kind: GraphFile) -> None:
    """Refuse scales from measurements that were chosen by the stated sigmas, or from an optimum that may be left.

    Raises
    ------
    OptionError
    """
    options = kind.options
    if options.sigmas != "stated" and (kind.rejects or options.improve):
        rejects = f"--robust {kind.robust}, which rejects by the stated sigmas; a kernel such as cauchy goes with it"
        improves = "--improve: estimated scales belong to one optimum; --certify goes with it"
        raise nls.OptionError("--sigmas", options.sigmas, f"stated with {rejects if kind.rejects else improves}")


def _read(kind: GraphFile, run: Run) -> Problem:
    """Graph and values, as they are solved."""
    options = run.options
    as_read, values, report = kind.read_to_solve()
    kind.check_format("-o", run.form, report)
    if live() and not options.quiet and options.json != "-":
        say(input_line(report, len(values), len(as_read)))
    options.phase.begin(f"while computing the initial guess of {options.file}")
    graph = kind.prepared(as_read, values, report)
    run.clock.lap("read")
    _import_solver(run, values.dim)
    run.clock.lap("imports")
    return Problem(**vars(run), as_read=as_read, values=values, report=report, graph=graph, start=values)


def _import_solver(run: Run, columns: int) -> None:
    """Import the libraries of the linear solver, and of the default one for a start; look for their threads."""
    if run.solver is not None:
        run.solver.require()
    if isinstance(default_solver(columns), OF_SCIPY) or isinstance(run.solver, OF_SCIPY):
        import_module("scipy.sparse.linalg")
    openmp()


def _begun(kind: GraphFile, problem: Problem) -> Problem:
    """The initial guess; with graduated non-convexity also the measurements to keep."""
    graph, values = problem.graph, problem.values  # of all measurements
    if kind.rejects:
        from nls.cli.outliers import chosen

        with _free_written(kind, problem):
            choice = chosen(str(kind.robust), kind.init, graph, values)
        problem = problem.without(choice, str(kind.robust))
    else:
        start, init, starts = nls.initialize(graph, values, kind.init)
        problem = replace(problem, start=start, init=init, starts=starts)
    try:  # it may not exist there, as for a bearing to the place of the sensor
        chi2 = problem.starts["file"] if "file" in problem.starts else graph.chi2(values)
    except (nls.EvaluationError, nls.SingularGeometryError):
        chi2 = None
    problem.clock.lap("init")
    return replace(problem, chi2_read=chi2)


def _check_graph(kind: GraphFile, problem: Problem) -> Problem:
    """The projection; refused before the work is what the output cannot hold, or the certificate is not for."""
    options, form = problem.options, problem.form
    problem = replace(problem, projection=kind.projection(problem.report))
    if form:
        about = problem.as_read, problem.start, problem.report
        formats.refuse_unwritable_graph(problem.graph_file, form, *about, options.renumber)
    if options.certify or options.improve:
        from nls.certificate.problem import certifiable

        certifiable(problem.graph, problem.start)
    problem.clock.lap("check")
    return problem


def _improved(kind: GraphFile, solved: Solved) -> Solved:
    """From a solution that is refuted, or stopped too early, on to the optimum of lower chi2, until there is none."""
    solved = _certified(solved)
    while solved.certificate is not None and (better := solved.certificate.better) is not None:
        starts = {**solved.starts, "better poses": solved.graph.chi2(better)}
        refuted = (*solved.refuted, solved.result.chi2_final)
        solved = kind.optimum(replace(solved, start=better, init="better poses", starts=starts, refuted=refuted))
        solved.clock.lap("optimize")
        solved = _certified(solved)
    return solved


def _certified(solved: Solved) -> Solved:
    """The certificate; without ``--improve`` last of the work, as it can take longer than the solution."""
    solved.options.phase.now("while certifying the optimum")
    try:
        certificate = nls.certify(solved.graph, solved.result.values, solved.stop)
    except nls.LeadlineError as error:
        certificate = None
        solved.failed.append(error)
    solved.clock.lap("certify")
    return replace(solved, certificate=certificate)


# --- outputs ----------------------------------------------------------------------------------------------------------


def attempt(run: Run, outputs: Mapping[str, Callable[[str], None]]) -> None:
    """Write files by their paths, whether or not another can be; names of those written and errors are added."""
    for path, write in outputs.items():
        try:
            run.options.phase.now(f"while writing {path}")
            write(path)
            run.options.phase.written.append(path)
        except nls.GraphFileError as error:  # names the file itself
            run.failed.append(error)
        except (nls.LeadlineError, OSError, MemoryError) as error:
            message, cures = (error.message, error.advice) if isinstance(error, nls.LeadlineError) else (str(error), ())
            run.failed.append(nls.LeadlineError(f"{path} was not written: {message}", cures))


def _write(kind: GraphFile, solved: Solved) -> None:
    """Write every output but the reports."""
    options = solved.options
    if options.covariance and not solved.result.converged:
        solved.report.notes.append(f"no covariances were written to {options.covariance}: this is no optimum")
    try:
        with kind.room:
            attempt(solved, kind.outputs(solved))
    except nls.GraphFileError as error:  # no folder, no files in it
        solved.failed.append(error)
    if options.covariance and solved.result.converged:
        attempt(solved, {options.covariance: partial(_covariance, kind, solved)})
    if options.plot:
        attempt(solved, {options.plot: partial(_plot, kind, solved)})
    if options.view:
        attempt(solved, {options.view: lambda path: kind.view_solved(solved).save(path)})
    solved.clock.lap("write")


def _covariance(kind: GraphFile, solved: Solved, path: str) -> None:
    from nls.io.table import write_covariances

    announce("marginals")
    write_covariances(path, solved.marginals, unmeasured=kind.unmeasured(solved.report))


def _plot(kind: GraphFile, solved: Solved, path: str) -> None:
    from nls.plot.picture import write_picture

    write_picture(path, kind.picture(solved), kind.marks(solved))


@contextmanager
def _free_written(kind: GraphFile, problem: Problem) -> Iterator[None]:
    """Where something is free, write the outputs that can say so; the error names these and what explains it."""
    options, written, report = problem.options, problem.options.phase.written, problem.report
    try:
        yield
    except nls.UnderconstrainedError as error:
        if error.silent is not None and len(problem.graph.factors) == len(report.sources):
            error.message = f"{report.place(*error.silent)}: {error.message}"
        if options.report:
            attempt(problem, {options.report: partial(write_page, kind, problem, error)})
        if options.json:
            attempt(problem, {options.json: partial(_write_free, problem, error)})
        for failure in problem.failed:
            complain(failure)
        names = ", ".join(name for name in written if name != "-")
        explain = Advice("explain", (kind.asking(),))
        error.advice = (*error.advice, explain, *(Advice("written", (names,)),) * bool(names))
        raise


def _write_free(problem: Problem, error: nls.UnderconstrainedError, where: str) -> None:
    """The report for programs on a graph that leaves something free."""
    record = {
        "schema": SCHEMA,
        "input": problem.report.path,
        "format": problem.report.format,
        "converged": False,
        "status": "UNDERCONSTRAINED",
        "reason": error.message,
        "advice": listed(error.advice, shell=True),
        "underconstrained": list(error.components),
        "written": [*problem.options.phase.written, *([where] if where != "-" else [])],
        "notes": problem.report.notes,
    }
    write_json(record, where)


def _report(kind: GraphFile, solved: Solved) -> None:
    """The report for programs and the table."""
    options, written = solved.options, solved.options.phase.written
    record = record_of(kind, solved)
    named = [options.json] if options.json not in (None, "-") else []
    record["written"] = written + named  # it names itself
    try:
        options.phase.now("while writing the report")
        write_json(record, options.json)
        written += named
    except nls.GraphFileError as error:
        record["written"] = written
        solved.failed.append(error)
    if not options.quiet and options.json != "-":
        first = "" if live() else f"{input_line(solved.report, record['variables'], record['factors'])}\n"
        doubtful = Color.DOUBTFUL if record["doubtful"] else Color.GOOD
        say(first + table(kind, solved, record), verdict=("result ", doubtful if record["converged"] else Color.BAD))


def _status(kind: GraphFile, solved: Solved) -> int:
    """The exit status; reasons for another than 0 on standard error."""
    options, result, see = solved.options, solved.result, kind.asking(solved.options.phase.written)
    allowed = options.allow_unconverged and result.status in (nls.Status.MAX_ITERATIONS, nls.Status.MAX_TIME)
    if not result.converged and not (allowed and options.quiet):
        reason = f"{result.status.value}: {result.ending}; {advice(result, allowed)}"
        say(f"nls: {reason}; see: {see}", error=True)
    certificate = solved.certificate
    if refuted := certificate is not None and certificate.verdict == "refuted":
        say(f"nls: {'; '.join([certificate.sentence, *listed(certificate.advice, shell=True)])}", error=True)
    doubts = [] if options.allow_doubtful or refuted else kind.doubts(solved)
    if doubts and (result.converged or allowed):
        doubtful = f"{solved.report.path}: doubtful: {'; '.join(doubts)}"
        say(f"nls: {doubtful}; see: {see}; or take the estimate with --allow-doubtful", error=True)
    for failure in solved.failed:
        complain(failure)
    if solved.failed and options.debug:
        raise solved.failed[0]
    return 1 if refuted or doubts or not (result.converged or allowed) else 2 if solved.failed else 0
