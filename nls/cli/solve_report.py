"""Reports of ``nls solve``: for programs, the table, and the data of its page."""

import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import nls
from models.advice import Advice, listed
from models.listing import several
from nls.cli.graph_file import GraphFile
from nls.cli.run import Problem, Solved, iteration_table, peak_rss_mb, time_rows, time_table
from nls.gauge import choose_gauge, component_labels, fixed_variables, touched_variables

SCHEMA = "solve 1"  # name and version of schema.json, which describes the report for programs
SHOWN = 12  # free directions in the table
# fields of the report for programs that are as in the result, a certificate, the scales of a kind, an iteration
OF_RESULT = "method linear_solver chi2_initial chi2_final gauge dof ratio doubt iterations converged rule reused"
OF_CERTIFICATE = "verdict chi2_given chi2_reached reached lower_chi2 cost_given cost proved lowest converged steps"
OF_KIND = "measurements numbers redundancy scale known"
OF_ITERATION = "chi2 update sigmas seconds reused"


def record_of(kind: GraphFile, solved: Solved) -> dict[str, Any]:
    """The report for programs, without the names of the files that are written."""
    options, result, report, written = solved.options, solved.result, solved.report, solved.options.phase.written
    additions, findings = _additions(kind, solved), kind.findings(report)
    explained = findings.get("explained")
    cures = [explained["sentence"]] if explained else _gnc_applies(kind, solved)
    cures = cures or ["first do what the warnings on its tables say"] * bool(findings.get("findings"))
    return {
        "schema": SCHEMA,
        "input": report.path,
        "format": report.format,
        "dimension": report.dimension,
        "variables": len(solved.values),
        "factors": len(solved.graph) + len(additions.get("rejected", ())),
        "convention": report.convention,
        "robust": kind.robust,
        "held": options.hold,
        "init": solved.init,
        "starts": solved.starts,
        "chi2_file": solved.chi2_read if report.vertices_given else None,
        **_same(result, OF_RESULT),
        "fit": result.fit.name,
        "ignored": [{"table": s.name, "ignored": s.ignored, "total": s.total} for s in result.shares],
        "doubtful": kind.doubts(solved),
        "status": result.status.name,
        "reason": f"{result.status.value}: {result.ending}",
        "attempts": [attempt._asdict() | {"status": attempt.status.name} for attempt in result.attempts],
        **additions,
        "history": [
            {"iteration": step.number, "lambda": step.damping, **_same(step, OF_ITERATION)} for step in result.history
        ],
        "timings": solved.timings,
        "underconstrained": list(result.underconstrained),
        "written": written,
        "unwritten": [error.message for error in solved.failed],
        **findings,
        "notes": [*report.notes, *_findings(kind, solved), *doubtful(kind, result, written, cures)],
        "peak_rss_mb": peak_rss_mb(),
        "version": nls.__version__,
    }


def _same(entry: object, names: str) -> dict[str, Any]:
    """Fields as they are."""
    return {name: getattr(entry, name) for name in names.split()}


def _additions(kind: GraphFile, solved: Solved) -> dict[str, Any]:
    """Additions of a mission, scales, a choice and a certificate to the report for programs."""
    record = kind.record(solved)
    if (sigmas := solved.sigmas) is not None:
        kinds = [{"kind": c.name, "scale_sigma": c.sigma} | _same(c, OF_KIND) for c in sigmas.components]
        settled = {"settled": sigmas.settled, "rounds": sigmas.rounds, "kinds": kinds}
        record["sigmas"] = settled | {"correlation": sigmas.correlation.tolist()}
    if solved.choice is not None:
        from nls.cli import outliers

        record |= outliers.record(solved.choice, solved.sources)
    if (certificate := solved.certificate) is not None:
        both = [("moved", certificate.moved), ("moved_rms", certificate.moved_rms)]
        pairs = {name: dict(zip(("distance", "angle"), pair, strict=True)) for name, pair in both}
        spectrum = {"eigenvalues": certificate.eigenvalues.tolist(), "refuted": list(solved.refuted)}
        record["certificate"] = _same(certificate, OF_CERTIFICATE) | pairs | spectrum
    return record


def _findings(kind: GraphFile, solved: Solved) -> list[str]:
    """Notes on parts that no measurement joins, and on sigmas that are too large where covariances are written."""
    graph, options, result, notes = solved.graph, solved.options, solved.result, list[nls.Finding]()
    pattern = graph.pattern(result.values)
    if component_labels(pattern).any():  # several parts: the first one begins with the first variable
        from nls.explanation.explanation import separate_parts

        fixed = fixed_variables(graph.fixed, result.values) | ~touched_variables(pattern)  # warned of before
        gauge = choose_gauge("first", pattern, result.values, fixed)
        notes += separate_parts(pattern, gauge)
    shown = result.converged and (options.covariance or options.view or options.report)
    if shown and result.ratio < 1 and not (result.robust or kind.rejects):  # there --sigmas estimate is refused
        from nls.explanation.doubts import large_sigmas

        notes += large_sigmas("all measurements", *result.believed)
    return ["; ".join([finding.says, *listed(finding.advice, shell=True)]) for finding in notes]


def _gnc_applies(kind: GraphFile, solved: Solved) -> list[str]:
    """Graduated non-convexity, or another start, where chi2 is far off and closures may be wrong."""
    if kind.robust is not None or Advice("start") not in solved.result.advice:
        return []
    from nls.explanation.doubts import graduates

    return listed([Advice("gnc"), Advice("start")] * graduates(solved.graph, solved.result.values), shell=True)


def doubtful(kind: GraphFile, result: nls.Result, written: Sequence[str] = (), cures: Sequence[str] = ()) -> list[str]:
    """The note on a chi2 that noise does not explain, by the rule of `nls.optimizers.result`.

    Parameters
    ----------
    kind, result : the input, and its optimization.
    written : files that exist by now.
    cures : what else explains or cures it, in words.
    """
    if not (result.misfit or cures):
        return []
    none = kind.robust is None and kind.options.robust == "none"
    cure = ["leave --robust none out: wrong contacts are then found and rejected"] * none
    cure += cures or listed((piece for piece in result.advice if piece.action != "explain"), shell=True)
    problem = [f"implausible: {result.doubt}" if result.doubt else result.misfit] * bool(result.misfit)
    return ["; ".join([*problem, *cure, f"see: {kind.asking(written)}"])]


def _doubt(report: dict[str, Any]) -> str:
    """The end of the line of the result: reasons not to trust it, and calibrations far from their stated values."""
    doubts = list(report["doubtful"])
    doubts += [
        f"{c['name']} is {c['sigmas_away']:.3g} sigmas from its value in calibration.csv"
        for c in report.get("mission", {}).get("calibrations", ())
        if c["sigmas_away"] > 5
    ]
    return f"; but {'; '.join(doubts)}" if doubts else ""


def input_line(report: nls.LoadReport, variables: int, measurements: int) -> str:
    """The line of the table on what was read: first where somebody waits for it."""
    counts = f"{several(variables, 'variable')}, {several(measurements, 'measurement')}"
    return f"input       {report.path}: {counts}, {report.dimension}"


def table(kind: GraphFile, solved: Solved, report: dict[str, Any]) -> str:
    """The table of a run, from its report for programs."""
    result, options = solved.result, solved.options
    lines = result.steps if options.verbose else []
    file = kind.read_values
    start = ", ".join(f"{name.replace('file', file)} {chi2:.6g}" for name, chi2 in report["starts"].items())
    seconds = report["timings"]
    convention = f", convention {options.convention}" * (options.convention != options.default_of("convention"))
    robust = f", robust kernel {report['robust']}" if report["robust"] and "rejected" not in report else ""
    of = " of the measurements the kernel keeps" if result.shares else ""
    ratio = f" (ratio {result.ratio:.3g}{of}, 1 expected)" if result.believed[1] > 0 else ""
    steps = (
        f"{report['chi2_initial']:.6g} -> {report['chi2_final']:.9g} in {several(report['iterations'], 'iteration')}"
    )
    if kind.rejects:  # which optimizes as well
        more = several(report["iterations"], "more iteration")
        steps = f"{report['chi2_final']:.9g} by the choice of {kind.robust} and {more}"
    lines += [
        f"start       {report['init'].replace('file', file)} (chi2: {start})",
        f"chi2        {steps}, {report['dof']} degrees of freedom{ratio}{convention}{robust}",
        f"solver      {report['method']}, {report['linear_solver']}; gauge: {report['gauge']}",
        f"time        {seconds['solved']:.3f} s from file to optimum, peak {report['peak_rss_mb']:.0f} MB",
        *([f"ignored     by the kernel: {', '.join(map(str, result.shares))}"] if result.shares else []),
        f"result      {report['reason']}{_doubt(report)}",
        *(f"method      {remark}" for remark in result.remarks),
        *_rows(kind, solved, report),
    ]
    lines += [f"fixed       all {kind}" for kind in report["held"]]
    lines += [f"free        {direction}" for direction in report["underconstrained"][:SHOWN]]
    if (left := len(report["underconstrained"]) - SHOWN) > 0:
        lines.append(f"free        and {left} more directions")
    lines += [f"written     {name}" for name in report["written"]]
    lines += [f"note        {note}" for note in report["notes"] if note not in solved.report.warnings]
    if options.verbose:
        lines += [*iteration_table(result.history), *time_table(seconds)]
    return "\n".join(lines)


def _rows(kind: GraphFile, solved: Solved, report: dict[str, Any]) -> list[str]:
    """Rows of a choice, of scales, of a certificate and of a mission."""
    out: list[str] = []
    if solved.choice is not None:
        from nls.cli import outliers

        out += outliers.rows(solved.choice, kind.robust is not None)
    if solved.sigmas is not None:
        out += [f"sigmas      {component}" for component in solved.sigmas.components]
    if solved.certificate is not None:
        out += [f"improved    from chi2 {chi2:.9g}: continued from better poses" for chi2 in solved.refuted]
        text = solved.certificate.report(shell=True).replace("\n", f"\n{'':12}")
        out += f"certificate {text}".splitlines()
    return out + kind.lines(report)


def advice(result: nls.Result, allowed: bool) -> str:
    """Advice by status; an estimate that has not converged may be `allowed` already."""
    name = result.status.name
    if result.rises and not result.attempts:
        return f"chi2 rose in {result.rises} of {result.iterations} steps; try --method levenberg-marquardt"
    if name in ("MAX_ITERATIONS", "MAX_TIME"):
        return "allow more with --max-iterations" + ", or take the estimate with --allow-unconverged" * (not allowed)
    if name in ("STOPPED", "INTERRUPTED"):
        return "the best estimate so far was kept"
    return "the best estimate so far was kept; try another --init"


def write_page(kind: GraphFile, problem: Problem, result: nls.Result | nls.UnderconstrainedError, path: str) -> None:
    """Write the page of a run.

    Parameters
    ----------
    kind, problem : the input, and the run; a `Solved` one with its result.
    result : of the optimization, or the error in its place.
    path : of the page.
    """
    from nls.io.files import write_bytes
    from nls.plot.report import report as page

    of_result: dict[str, Any] = {}
    if isinstance(problem, Solved):
        timings = problem.timings
        of_result = {
            "certificate": problem.certificate,
            "rejected": problem.rejected,
            "doubts": kind.doubts(problem),
            "seconds": {name: timings[name] for name in time_rows(timings) if name != "process"},
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
        "initial guesses": ", ".join(f"{name}: chi2 {chi2:.6g}" for name, chi2 in problem.starts.items()),
        "linear solver": getattr(result, "linear_solver", ""),
        "robust kernel": kind.robust or "",
        "fixed": ", ".join(f"all {kind}" for kind in options.hold),
        "unchecked": unchecked,
        "notes": "; ".join(report.notes),
        "version": f"leadline {nls.__version__}",
    }
    return {name: fact for name, fact in facts.items() if fact}
