"""The command line: load, check, start, solve, report. No mathematics of its own."""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from nls.optimizers import Iteration, Result

__all__ = ["main"]

PICTURES = (".png", ".pdf", ".svg")
EXAMPLES = """examples:
  nls solve survey.g2o                                 the table and the sentence
  nls solve survey.g2o -o solved.g2o --plot solved.png
  nls solve survey.g2o --init odometry --verbose
  nls info survey.g2o                                  what is in it, what holds it, what a solve would cost

exit status: 0 converged; 1 not converged or under-constrained; 2 bad input or usage
"""


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"nls: {message}; see '{self.prog} --help'", file=sys.stderr)
        raise SystemExit(2)


def parser() -> Parser:
    """All commands and options."""
    from factors.conventions import CONVENTIONS
    from nls.gauge import GAUGES
    from nls.linear import SOLVERS
    from nls.starts import STARTS

    top = Parser("nls", description="Least squares on factor graphs: solve and inspect pose graphs.", epilog=EXAMPLES)
    top.formatter_class = argparse.RawDescriptionHelpFormatter
    top.add_argument("--version", action="store_true", help="print version and linear solvers, and stop")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    solve = commands.add_parser("solve", help="find the optimum", epilog=EXAMPLES, formatter_class=top.formatter_class)
    solve.add_argument("file", metavar="FILE", help="pose graph, *.g2o or *.g2o.gz")
    solve.add_argument("-o", "--output", metavar="OUT.g2o", help="write the optimum (*.g2o or *.g2o.gz)")
    solve.add_argument("--init", default="auto", choices=["auto", *STARTS], help="start values (default: auto)")
    solve.add_argument("--method", default="auto", choices=["auto", "gauss-newton"], help="optimizer")
    solve.add_argument("--linear-solver", default="auto", choices=["auto", *SOLVERS], help="default: best installed")
    solve.add_argument("--max-iterations", type=int, default=100, metavar="N")
    solve.add_argument("--update-tol", type=float, default=1e-6, metavar="X", help="converged when max|dx| < X")
    solve.add_argument("--convention", default="g2o", choices=CONVENTIONS, help="residual of pose measurements")
    solve.add_argument("--gauge", default="first", choices=GAUGES, help="what holds the free directions")
    solve.add_argument("--allow-unconverged", action="store_true", help="exit 0 at an iteration limit, too")
    solve.add_argument("--json", metavar="REPORT.json", help="write the report for programs ('-': standard output)")
    solve.add_argument("--plot", metavar="OUT.png", help="draw before and after (png, pdf, svg)")
    how = solve.add_mutually_exclusive_group()
    how.add_argument("--quiet", action="store_true", help="print nothing")
    how.add_argument("--verbose", action="store_true", help="print every iteration and where the time went")
    solve.add_argument("--debug", action="store_true", help="show the traceback of an error")
    solve.set_defaults(run=run_solve)

    info = commands.add_parser("info", help="what is in a file", epilog=EXAMPLES, formatter_class=top.formatter_class)
    info.add_argument("file", metavar="FILE", help="pose graph, *.g2o or *.g2o.gz")
    info.add_argument("--json", metavar="REPORT.json", help="write the report for programs ('-': standard output)")
    info.add_argument("--debug", action="store_true", help="show the traceback of an error")
    info.set_defaults(run=run_info)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what the terminal cannot show is escaped
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.showwarning = _one_line_warning
        return _main(argv)


def _main(argv: Sequence[str] | None) -> int:
    from models.errors import LeadlineError, UnderconstrainedError

    debug = False
    try:
        options = parser().parse_args(argv)
        debug = getattr(options, "debug", False)
        if options.version:
            return _version()
        if options.command is None:
            parser().print_help()
            return 2
        return int(options.run(options))
    except SystemExit as stop:
        return int(stop.code or 0)
    except UnderconstrainedError as error:
        status, message = 1, error
    except (LeadlineError, OSError, MemoryError) as error:
        status, message = 2, error  # type: ignore[assignment]
    except KeyboardInterrupt:
        print("nls: interrupted before there was an estimate", file=sys.stderr)
        return 1
    except Exception as error:  # a fault of ours: a user still gets one line, and the way to the traceback
        status, message = 2, f"internal error, please report it (--debug shows where): {error!r}"  # type: ignore[assignment]
    if debug:
        raise message
    if not isinstance(message, BrokenPipeError):
        print(f"nls: {' '.join(str(message).split())}", file=sys.stderr)
    return status


def run_solve(options: argparse.Namespace) -> int:
    """``nls solve``."""
    import nls
    from nls.linear import SOLVERS, default_solver

    started = perf_counter()
    solver = default_solver() if options.linear_solver == "auto" else SOLVERS[options.linear_solver]()
    for name in (options.output, options.plot, options.json):
        _refuse_unwritable(name)
    if options.plot and Path(options.plot).suffix.lower() not in PICTURES:
        raise nls.OptionError("--plot", options.plot, "a file name ending in " + ", ".join(PICTURES))
    stop = nls.Stop(update_tol=options.update_tol, max_iterations=options.max_iterations)
    graph, values, read = nls.load(options.file, convention=options.convention)
    t_read = perf_counter() - started
    start, init, tried = nls.initialize(graph, values, options.init)
    t_init = perf_counter() - started - t_read
    with _Progress(options) as progress:
        optimizer = nls.GaussNewton(stop, callback=progress.show)
        result = graph.optimize(start, optimizer, solver, options.gauge)
    solved = perf_counter()
    timings = {"read": t_read, "init": t_init, **result.timings, "solved": solved - started}
    if options.output:
        nls.save(options.output, graph, result.values, read.ignored)
    if options.plot:
        from nls.plot import before_after

        before_after(graph, values, result, title=Path(options.file).name).savefig(options.plot, dpi=150)
    timings["write"] = perf_counter() - solved
    timings["total"] = perf_counter() - started

    report: dict[str, Any] = {
        "input": options.file,
        "dimension": read.dimension,
        "variables": len(values),
        "factors": len(graph),
        "convention": read.convention,
        "init": init,
        "starts": tried,
        "method": result.method,
        "linear_solver": result.linear_solver,
        "chi2_file": tried.get("file", graph.chi2(values)) if read.vertices_given else None,
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
        "written": [name for name in (options.output, options.plot, options.json) if name and name != "-"],
        "notes": read.notes,
        "peak_rss_mb": _peak_rss_mb(),
        "version": nls.__version__,
    }
    _write_json(report, options.json)
    if not options.quiet and options.json != "-":
        print(_table(report, result if options.verbose else None))
    if not result.converged and not options.quiet:
        print(f"nls: {report['reason']}; {_advice(result)}", file=sys.stderr)
    allowed = options.allow_unconverged and result.status in (nls.Status.MAX_ITERATIONS, nls.Status.MAX_TIME)
    return 0 if result.converged or allowed else 1


def run_info(options: argparse.Namespace) -> int:
    """``nls info``."""
    import nls
    from nls.inspect import inspect

    _refuse_unwritable(options.json)
    graph, values, read = nls.load(options.file)
    found = inspect(graph, values)
    _write_json(
        {"input": options.file, "dimension": read.dimension, "tags": read.tags, "notes": read.notes} | found,
        options.json,
    )
    if options.json != "-":
        print(read)
        print("\n".join(f"  {name:22s} {value}" for name, value in found.items()))
    return 0


def _table(report: dict[str, Any], verbose: Result | None) -> str:
    lines = [str(verbose)] if verbose else []
    start = ", ".join(f"{name} {chi2:.6g}" for name, chi2 in report["starts"].items())
    seconds = report["timings"]
    lines += [
        f"input       {report['input']}: {report['variables']} variables, {report['factors']} measurements, "
        f"{report['dimension']}",
        f"start       {report['init']} (chi2: {start})",
        f"chi2        {report['chi2_initial']:.6g} -> {report['chi2_final']:.9g} in {report['iterations']} iterations, "
        f"{report['dof']} degrees of freedom, convention {report['convention']}",
        f"solver      {report['method']}, {report['linear_solver']}; gauge: {report['gauge']}",
        f"time        {seconds['solved']:.3f} s from file to optimum, peak {report['peak_rss_mb']:.0f} MB",
        f"result      {report['reason']}",
    ]
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


def _finite(item: Any) -> Any:
    """A report with null for every number that is not finite: JSON has no other word for it."""
    if isinstance(item, dict):
        return {name: _finite(value) for name, value in item.items()}
    if isinstance(item, list):
        return [_finite(value) for value in item]
    return None if isinstance(item, float) and not math.isfinite(item) else item


def _write_json(report: dict[str, Any], where: str | None) -> None:
    from nls.io.files import write_bytes

    if where is None:
        return
    text = json.dumps(_finite(report), indent=1, allow_nan=False)
    if where == "-":
        print(text)
    else:
        write_bytes(where, (text + "\n").encode())


def _refuse_unwritable(name: str | None) -> None:
    """Find out before the work, not after it, that an output cannot be written."""
    from models.errors import OptionError

    if not name or name == "-":
        return
    path = Path(name)
    folder = Path(os.path.realpath(name)).parent
    if path.is_dir() or not folder.is_dir():
        raise OptionError("output file", name, "a file in a folder that exists")
    special = path.exists() and not path.is_file()  # a pipe or device is written to, a file is replaced
    if not os.access(path if special else folder, os.W_OK):
        raise OptionError("output file", name, "a file in a folder you may write to")


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


def _one_line_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"nls: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _version() -> int:
    import nls

    print(f"leadline {nls.__version__}")
    for name, state in nls.backends().items():
        print(f"  {name:16s} {state}")
    return 0


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
