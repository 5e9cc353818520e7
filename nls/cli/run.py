"""One run of ``nls solve``: the records that its stages pass on, and where each of its milliseconds went.

No record is changed: a stage makes the next one. The rows of the time add up to the whole process.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import nls
from models.listing import several
from nls.io.report import Source

if TYPE_CHECKING:
    from nls.missions.charts import MapProjection
    from nls.robust.graduated import Rejected

PARTS = ("linearize", "assemble", "factorize", "solve", "retract")  # of an iteration
BEFORE = ("startup", "imports", "read", "init", "check", "build", "analyze", *PARTS)
AFTER = ("other", "write", "certify", "report", "process")
SUMS = ("solved", "total", "process")
MEANINGS = {
    "startup": "interpreter, up to the command line; processor time",
    "imports": "NumPy, SciPy, the library, the linear solver",
    "read": "file, numbers, graph",
    "init": "initial guesses, and chi2 of each",
    "check": "whether the output can hold the graph",
    "build": "gauge and pattern",
    "analyze": "elimination order, symbolic factorization",
    "other": "stop rules, degrees of freedom; of scans the matching; solutions that --improve left",
    "write": "files asked for",
    "certify": "optimum and eigenvalues in the SE-Sync cost, chi2 from there",
    "report": "explanation, covariances and pictures of the page",
}


class Clock:
    """Seconds by stage, one after the other.

    Parameters
    ----------
    began : `perf_counter` of the beginning.
    startup : seconds before that.
    """

    def __init__(self, began: float, startup: float) -> None:
        self.seconds = {"startup": startup}
        self._last = began

    def lap(self, name: str) -> None:
        """End of a stage, or of a part of it."""
        now = perf_counter()
        self.seconds[name], self._last = self.seconds.get(name, 0.0) + now - self._last, now

    def timings(self, optimize: dict[str, float], stages: dict[str, float]) -> dict[str, float]:
        """All stages for the report: the parts of the optimization in the place of its lap, and what they left over.

        ``solved`` is from the file to the optimum, ``total`` adds the outputs, ``process`` the start-up.
        """
        seconds, process = dict(self.seconds), sum(self.seconds.values())
        whole = seconds.pop("optimize")
        out = {**seconds, **optimize, "other": whole - sum(optimize.values())}
        out |= {"solved": seconds["read"] + seconds["init"] + whole, "process": process}
        out["total"] = process - seconds["startup"] - seconds["imports"]
        return out | stages


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run whose outputs can be written.

    Attributes
    ----------
    options, clock, solver, stop : of the command.
    form : format of `graph_file`; empty where no graph is written.
    failed : outputs that could not be written so far.
    """

    options: argparse.Namespace
    clock: Clock
    solver: nls.LinearSolver | None
    stop: nls.Stop
    form: str
    failed: list[nls.LeadlineError] = field(default_factory=list)

    @property
    def graph_file(self) -> str:
        """The file of the solved graph: that of ``-o``, of a mission that of ``--write-graph``; empty: none."""
        return str(self.options.write_graph or self.options.output) if self.form else ""


@dataclass(frozen=True, kw_only=True)
class Problem(Run):
    """A graph that was read, and where its optimization begins.

    Attributes
    ----------
    as_read, values, report : of the file; without what was rejected.
    graph : under kernels, with kinds held; with ``--sigmas estimate`` rescaled, and `as_read`, too.
    start, init, starts : values to begin with, the name of the start, and chi2 of all that were tried.
    chi2_read : chi2 of the values as read; None where it does not exist.
    stages : seconds that the library counts inside reading and starting.
    projection : of the coordinates in the files of a mission; None for local ones.
    sources : of the factors as they were read, those that were rejected, too.
    choice : of `nls.gnc`; None where all measurements are kept.
    sigmas : of ``--sigmas estimate``; None where the stated ones are taken.
    """

    as_read: nls.FactorGraph
    values: nls.Values
    report: nls.LoadReport
    graph: nls.FactorGraph
    start: nls.Values
    init: str = ""
    starts: Mapping[str, float] = field(default_factory=dict)
    chi2_read: float | None = None
    stages: Mapping[str, float] = field(default_factory=dict)
    projection: MapProjection | None = None
    sources: Sequence[Source] = ()
    choice: nls.Robustified | None = None
    sigmas: nls.VarianceComponents | None = None

    @property
    def rejected(self) -> Sequence[Rejected]:
        """The measurements that `choice` rejects."""
        return () if self.choice is None else self.choice.rejected

    @property
    def before(self) -> nls.Values:
        """The values as read, or the start where these have no chi2: what a picture can show."""
        return self.start if self.chi2_read is None else self.values

    def without(self, choice: nls.Robustified, name: str) -> Problem:
        """The graph without what was rejected, to begin with at its optimum, which has this name."""
        from nls.cli.outliers import without_left, without_rejected

        as_read, report = without_rejected(self.as_read, choice, self.report)
        if self.form and (count := len(choice.rejected)):
            report.notes.append(f"{self.graph_file} leaves out {several(count, 'rejected measurement')}")
        return replace(
            self,
            as_read=as_read,
            values=without_left(self.values, choice.result.values),
            report=report,
            sources=self.report.sources,
            choice=choice,
            graph=choice.graph,
            start=choice.result.values,
            init=name,
            starts={name: choice.result.chi2_final},
        )


@dataclass(frozen=True, kw_only=True)
class Solved(Problem):
    """A graph that was optimized.

    Attributes
    ----------
    result : of the optimization.
    solution : of a mission: a `nls.missions.solution.Solution`; None of a graph file.
    certificate : of ``--certify``.
    refuted : chi2 of the solutions that were left for better ones, with ``--improve``.
    """

    result: nls.Result
    solution: Any = None
    certificate: nls.Certificate | None = None
    refuted: tuple[float, ...] = ()

    @property
    def optimized(self) -> tuple[nls.FactorGraph, nls.Values, nls.Result, nls.LoadReport, nls.LinearSolver | None, str]:
        """Graph, values before, result, report, and solver and gauge of the covariances."""
        return self.graph, self.values, self.result, self.report, self.solver, self.options.gauge

    @cached_property
    def marginals(self) -> nls.Marginals:
        """Covariances of the optimum."""
        known: nls.Marginals | None = None if self.solution is None else self.solution.marginals
        return known or nls.Marginals(self.graph, self.result.values, self.solver, self.options.gauge)

    @property
    def timings(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return self.clock.timings(self.result.timings, dict(self.stages))


def time_rows(timings: dict[str, float]) -> list[str]:
    """Names of the stages, one after the other, and of the whole."""
    more = [name for name in timings if name not in (*BEFORE, *AFTER, *SUMS) and " " not in name]  # of other solvers
    return [row for row in (*BEFORE, *more, *AFTER) if row in timings]


def time_table(timings: dict[str, float]) -> list[str]:
    """Lines: milliseconds and share of every stage, with what it consists of, and their sum."""
    whole = timings["process"]
    lines = ["time               ms       %"]
    for row in time_rows(timings):
        lines.append(f"{row:11s} {_shares(timings[row], whole)}   {MEANINGS.get(row, '')}".rstrip())
        inside = [(name, s) for name, s in timings.items() if name.startswith(f"{row} ")]
        lines += [f"  {name.removeprefix(row):9s} {_shares(s, whole)}" for name, s in inside]
    return lines


def iteration_table(history: Sequence[nls.Iteration]) -> list[str]:
    """Lines: milliseconds of the parts of every iteration; the start is only linearized."""
    parts = dict.fromkeys((*PARTS, *(stage for iteration in history for stage in iteration.seconds)))
    lines = ["iteration " + "".join(f"{stage:>11s}" for stage in parts) + "          ms"]
    for iteration in history:
        seconds = [iteration.seconds.get(stage, 0.0) for stage in parts]
        columns = "".join(f"{1e3 * s:11.2f}" for s in seconds)
        lines.append(f"{iteration.number:9d} {columns}{1e3 * sum(seconds):12.2f}")
    return lines


def _shares(seconds: float, whole: float) -> str:
    return f"{1e3 * seconds:9.1f} {100 * seconds / whole:7.1f}"


def peak_rss_mb() -> float:
    """The most memory this process has held, MB; 0 where the system does not count it."""
    with suppress(OSError, IndexError):  # Linux hands the peak of the parent down to ru_maxrss, but not to VmHWM
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    try:
        import resource
    except ImportError:  # no such count on Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
