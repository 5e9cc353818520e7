"""``nls solve``: load, start, optimize, write, report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from nls.cli.outputs import refuse_no_picture, refuse_unwritable, write_json

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.optimizers import Iteration, Optimizer, Result, Stop
    from nls.values import Values

__all__ = ["solve"]


def solve(options: argparse.Namespace) -> int:
    """Solve and report; returns the exit status."""
    import nls
    from nls.cli.formats import format_of, read, write
    from nls.linear import SOLVERS, default_solver

    started = perf_counter()
    solver = default_solver() if options.linear_solver == "auto" else SOLVERS[options.linear_solver]()
    refuse_unwritable(options.output, options.covariance, options.plot, options.json)
    refuse_no_picture("--plot", options.plot)
    stop = nls.Stop(update_tol=options.update_tol, max_iterations=options.max_iterations)
    as_read, values, report = read(options)
    graph = _prepared(as_read, values, options)
    t_read = perf_counter() - started
    start, init, tried = nls.initialize(graph, values, options.init)
    t_init = perf_counter() - started - t_read
    with _Progress(options) as progress:
        result = graph.optimize(start, _optimizer(options.method, graph, stop, progress), solver, options.gauge)
    solved = perf_counter()
    timings = {"read": t_read, "init": t_init, **result.timings, "solved": solved - started}
    if options.output:
        form = format_of(options.output) or report.format  # a name that says nothing: as it was read
        report.notes += write(options.output, form, as_read, result.values, report)
    if options.covariance and result.converged:
        from nls.io.covariance_csv import write_covariances

        write_covariances(options.covariance, nls.Marginals(graph, result.values, solver, options.gauge))
    elif options.covariance:
        report.notes.append(f"no covariances were written to {options.covariance}: this is no optimum")
    if options.plot:
        from nls.plot import before_after

        before_after(graph, values, result, title=Path(options.file).name).savefig(options.plot, dpi=150)
    written = [options.output, options.covariance if result.converged else None, options.plot, options.json]
    timings["write"] = perf_counter() - solved
    timings["total"] = perf_counter() - started

    record: dict[str, Any] = {
        "input": options.file,
        "format": report.format,
        "dimension": report.dimension,
        "variables": len(values),
        "factors": len(graph),
        "convention": report.convention,
        "robust": options.robust,
        "held": options.hold,
        "init": init,
        "starts": tried,
        "method": result.method,
        "linear_solver": result.linear_solver,
        "chi2_file": tried.get("file", graph.chi2(values)) if report.vertices_given else None,
        "chi2_initial": result.chi2_initial,
        "chi2_final": result.chi2_final,
        "gauge": result.gauge,
        "dof": result.dof,
        "iterations": result.iterations,
        "converged": result.converged,
        "status": result.status.name,
        "reason": f"{result.status.value}: {result.reason}",
        "history": [_record(iteration) for iteration in result.history],
        "timings": timings,
        "underconstrained": list(result.underconstrained),
        "written": [name for name in written if name and name != "-"],
        "notes": report.notes,
        "peak_rss_mb": _peak_rss_mb(),
        "version": nls.__version__,
    }
    write_json(record, options.json)
    if not options.quiet and options.json != "-":
        print(_table(record, result if options.verbose else None))
    if not result.converged and not options.quiet:
        print(f"nls: {record['reason']}; {_advice(result)}", file=sys.stderr)
    allowed = options.allow_unconverged and result.status in (nls.Status.MAX_ITERATIONS, nls.Status.MAX_TIME)
    return 0 if result.converged or allowed else 1


def _prepared(graph: FactorGraph, values: Values, options: argparse.Namespace) -> FactorGraph:
    """The graph that is solved: under the robust kernel, with the kinds held that were asked for."""
    import nls
    from factors.robust import kernel_from_text

    kernel = kernel_from_text(options.robust) if options.robust else None
    prepared = nls.FactorGraph([f if kernel is None else f.robust(kernel) for f in graph.factors])
    for keys in graph.fixed:
        prepared.fix(keys)
    for kind in options.hold:
        if kind not in values.stacks:
            raise nls.OptionError("--hold", kind, "one of the kinds " + ", ".join(values.stacks))
        prepared.fix(nls.Keys(kind, values.stack(kind).numbers))
    return prepared


def _optimizer(name: str, graph: FactorGraph, stop: Stop, progress: _Progress) -> Optimizer:
    """The optimizer by name; auto damps where a factor says that undamped steps are known to fail."""
    from nls.optimizers import OPTIMIZERS, GaussNewton, LevenbergMarquardt

    if name == "auto":
        name = (LevenbergMarquardt if any(f.damped for f in graph.factors) else GaussNewton).name
    return OPTIMIZERS[name](stop, callback=progress.show)


def _table(report: dict[str, Any], verbose: Result | None) -> str:
    lines = [str(verbose)] if verbose else []
    start = ", ".join(f"{name} {chi2:.6g}" for name, chi2 in report["starts"].items())
    seconds = report["timings"]
    robust = f", robust kernel {report['robust']}" if report["robust"] else ""
    lines += [
        f"input       {report['input']}: {report['variables']} variables, {report['factors']} measurements, "
        f"{report['dimension']}",
        f"start       {report['init']} (chi2: {start})",
        f"chi2        {report['chi2_initial']:.6g} -> {report['chi2_final']:.9g} in {report['iterations']} iterations, "
        f"{report['dof']} degrees of freedom, convention {report['convention']}{robust}",
        f"solver      {report['method']}, {report['linear_solver']}; gauge: {report['gauge']}",
        f"time        {seconds['solved']:.3f} s from file to optimum, peak {report['peak_rss_mb']:.0f} MB",
        f"result      {report['reason']}",
    ]
    lines += [f"held        all {kind}" for kind in report["held"]]
    lines += [f"free        {direction}" for direction in report["underconstrained"]]
    lines += [f"written     {name}" for name in report["written"]]
    lines += [f"note        {note}" for note in report["notes"]]
    if verbose:
        lines += [f"  {part:12s} {1e3 * s:9.1f} ms" for part, s in seconds.items()]
    return "\n".join(lines)


def _advice(result: Result) -> str:
    """What to try next, by status."""
    name = result.status.name
    if name in ("MAX_ITERATIONS", "MAX_TIME"):
        return "allow more with --max-iterations, or take the estimate with --allow-unconverged"
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
    }


def _peak_rss_mb() -> float:
    try:  # Linux hands the peak of the parent process down to ru_maxrss, but not to VmHWM
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    except (OSError, IndexError):
        pass
    try:
        import resource
    except ImportError:  # no such count on Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


class _Progress:
    """A progress line while the solve runs, on a terminal only."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.bar: Any = None
        self.wanted = sys.stderr.isatty() and not options.quiet
        self.total = options.max_iterations

    def __enter__(self) -> _Progress:
        if self.wanted:
            from tqdm import tqdm

            self.bar = tqdm(total=self.total, desc="solve", unit="it", leave=False)
        return self

    def show(self, iteration: Iteration) -> None:
        if self.bar is not None:
            self.bar.set_postfix_str(f"chi2 {iteration.chi2:.6g}")
            self.bar.update()

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
