"""One run of ``nls solve``: the records that its stages pass on. None is changed: a stage makes the next one."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import nls
from nls.io.report import Source

if TYPE_CHECKING:
    from nls.cli.timing import Clock
    from nls.missions.charts import Projection


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
    choice : of `nls.gnc`; None where all measurements are believed.
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
    projection: Projection | None = None
    sources: Sequence[Source] = ()
    choice: nls.Robustified | None = None
    sigmas: nls.VarianceComponents | None = None

    @property
    def before(self) -> nls.Values:
        """The values as read, or the start where these have no chi2: what a picture can show."""
        return self.start if self.chi2_read is None else self.values

    def without(self, choice: nls.Robustified, name: str) -> Problem:
        """The graph without what was rejected, to begin with at its optimum, which has this name."""
        from nls.cli.outliers import without_left, without_rejected

        as_read, report = without_rejected(self.as_read, choice, self.report)
        if self.form and (count := len(choice.rejected)):
            report.notes.append(f"{self.graph_file} holds the graph without the {count} rejected measurements")
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

    @property
    def timings(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return self.clock.timings(self.result.timings, dict(self.stages))
