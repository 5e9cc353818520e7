"""Reports of ``nls solve``: for programs, and the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nls.cli.formats import mission_of

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.io import LoadReport
    from nls.optimizers import Iteration, Result

__all__ = ["table"]

SCHEMA = "solve 1"  # name and version of schema.json, which describes the report for programs
SHOWN = 12  # free directions in the table
# fields of the report for programs that are as in the result
OF_RESULT = "method linear_solver chi2_initial chi2_final gauge dof ratio doubt iterations converged rule reused"
FAR = 5.0  # sigmas of a calibration before the measurements


def record_of(job: Job) -> dict[str, Any]:
    """The report for programs, without the names of the files that are written."""
    import nls
    from nls.cli.hint import doubts, gnc_applies, separate_parts
    from nls.cli.timing import peak_rss_mb

    options, result, report, additions = job.options, job.result, job.report, job.additions()
    parts, findings = separate_parts(job.graph, result.values), _findings(report)
    explained = findings.get("explained")
    cures = [explained["sentence"]] if explained else gnc_applies(job.graph, result, options)
    cures = cures or ["first do what the warnings on its tables say"] * bool(findings.get("findings"))
    return {
        "schema": SCHEMA,
        "input": report.path,
        "format": report.format,
        "dimension": report.dimension,
        "variables": len(job.values),
        "factors": len(job.graph) + len(additions.get("rejected", ())),
        "convention": report.convention,
        "robust": options.robust,
        "held": options.hold,
        "init": job.init,
        "starts": job.starts,
        "chi2_file": job.chi2_read if report.vertices_given else None,
        **{name: getattr(result, name) for name in OF_RESULT.split()},
        "fit": result.fit.name,
        "ignored": [{"table": s.name, "ignored": s.ignored, "total": s.total} for s in result.shares],
        "doubtful": job.doubts,
        "status": result.status.name,
        "reason": f"{result.status.value}: {result.ending}",
        "attempts": [attempt._asdict() | {"status": attempt.status.name} for attempt in result.attempts],
        **additions,
        "history": [_record(iteration) for iteration in result.history],
        "timings": job.timings,
        "underconstrained": list(result.underconstrained),
        "written": options.phase.written,
        "unwritten": [error.message for error in job.failed],
        **findings,
        "notes": report.notes + parts + doubts(result, options, options.phase.written, cures),
        "peak_rss_mb": peak_rss_mb(),
        "version": nls.__version__,
    }


def _findings(report: LoadReport) -> dict[str, Any]:
    """What is implausible in the tables of a mission."""
    if (mission := mission_of(report)) is None:
        return {}
    explained = mission.explained and mission.explained.record()
    return {"findings": [finding.record() for finding in mission.findings], "explained": explained}


def _doubt(report: dict[str, Any]) -> str:
    """What the line of the result adds: what is doubtful, and calibrations far from their belief."""
    doubts = list(report["doubtful"])
    doubts += [
        f"{c['name']} is {c['sigmas_away']:.3g} sigmas from what calibration.csv believes"
        for c in report.get("mission", {}).get("calibrations", ())
        if c["sigmas_away"] > FAR
    ]
    return f"; but {'; '.join(doubts)}" if doubts else ""


def _record(iteration: Iteration) -> dict[str, Any]:
    """One iteration for programs."""
    same = {name: getattr(iteration, name) for name in ("chi2", "update", "gradient", "seconds", "reused")}
    return {"iteration": iteration.number, "lambda": iteration.damping, **same}


def table(report: dict[str, Any], result: Result, findings: list[str], warned: list[str], verbose: bool) -> str:
    """The table of a run, from its report for programs.

    Parameters
    ----------
    report, result : of the run.
    findings : rows of a choice, of a certificate and of a solved mission.
    warned : notes that were printed already.
    verbose : whether iterations and seconds follow.
    """
    from models.listing import several

    lines = result.steps if verbose else []
    file = "dead reckoning" if {"mission", "scans"} & report.keys() else "file"  # a mission has no start in a file
    start = ", ".join(f"{name.replace('file', file)} {chi2:.6g}" for name, chi2 in report["starts"].items())
    seconds = report["timings"]
    robust = f", robust kernel {report['robust']}" if report["robust"] and "rejected" not in report else ""
    of = " of what the kernel believes" if result.shares else ""
    ratio = f" (ratio {result.ratio:.3g}{of}, 1 expected)" if result.believed[1] > 0 else ""
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
        *([f"ignored     by the kernel: {', '.join(map(str, result.shares))}"] if result.shares else []),
        f"result      {report['reason']}{_doubt(report)}",
        *(f"method      {remark}" for remark in result.remarks),
        *findings,
    ]
    lines += [f"held        all {kind}" for kind in report["held"]]
    lines += [f"free        {direction}" for direction in report["underconstrained"][:SHOWN]]
    if (more := len(report["underconstrained"]) - SHOWN) > 0:
        lines.append(f"free        and {more} more directions")
    lines += [f"written     {name}" for name in report["written"]]
    lines += [f"note        {note}" for note in report["notes"] if note not in warned]
    if verbose:
        from nls.cli.timing import iterations
        from nls.cli.timing import table as timing_table

        lines += [*iterations(result.history), *timing_table(seconds)]
    return "\n".join(lines)


def advice(result: Result, allowed: bool) -> str:
    """Advice by status; an estimate that has not converged may be `allowed` already."""
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
