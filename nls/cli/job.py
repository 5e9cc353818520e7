"""One run of ``nls solve``: the record that its stages pass on, each adding what it knows; what missions add to it."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from models.errors import UnderconstrainedError
from nls.cli.formats import mission_of

if TYPE_CHECKING:
    from models.errors import LeadlineError
    from nls.analysis import VarianceComponents
    from nls.certificate import Certificate
    from nls.cli.timing import Clock
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.io.report import Source
    from nls.linear import LinearSolver
    from nls.missions.charts import Projection
    from nls.optimizers import Result, Stop
    from nls.robust import Robustified
    from nls.values import Values

__all__ = ["Content", "Job", "Solution", "covariances"]

Content = Callable[[], Any]  # makes what is written to a file: its bytes, or a figure of matplotlib


class Job:
    """The state of a run.

    Attributes
    ----------
    options, clock, solver, stop : of the command.
    form : format of `graph_file`; empty where no graph is written.
    select : how the matches of a scan mission are selected; None of other inputs.
    projection : of the coordinates in the files of a mission; None for local ones.
    as_read, values, report : of the file; without what was rejected.
    graph : under kernels, with kinds held; with ``--sigmas estimate`` rescaled, and `as_read`, too.
    sources : of the factors as they were read, those that were rejected, too.
    choice : of `nls.gnc`; None where all measurements are believed.
    sigmas : of ``--sigmas estimate``; None where the stated ones are taken.
    start, init, starts : values to begin with, the name of the start, and chi2 of all that were tried.
    chi2_read : chi2 of the values as read; None where it does not exist.
    stages : seconds that the library counts inside reading and starting.
    result, solved, certificate : of the optimization, of a mission, of ``--certify``.
    refuted : chi2 of the solutions that were left for better ones, with ``--improve``.
    failed : outputs that could not be written.
    """

    form = ""
    select: str | None = None
    projection: Projection | None = None
    as_read: FactorGraph
    values: Values
    report: LoadReport
    graph: FactorGraph
    sources: Sequence[Source] = ()
    choice: Robustified | None = None
    sigmas: VarianceComponents | None = None
    start: Values
    init = ""
    chi2_read: float | None = None
    result: Result
    solved: Solution | None = None
    certificate: Certificate | None = None

    def __init__(self, options: argparse.Namespace, clock: Clock, solver: LinearSolver | None, stop: Stop) -> None:
        self.options, self.clock, self.solver, self.stop = options, clock, solver, stop
        self.starts: dict[str, float] = {}
        self.stages: dict[str, float] = {}
        self.refuted: list[float] = []
        self.failed: list[LeadlineError] = []

    @property
    def graph_file(self) -> str:
        """The file of the graph that was solved: that of ``-o``, of a mission that of ``--write-graph``."""
        return str(self.options.write_graph or self.options.output)

    @property
    def before(self) -> Values:
        """The values as read, or the start where these have no chi2: what a picture can show."""
        return self.start if self.chi2_read is None else self.values

    @property
    def timings(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return self.clock.timings(self.result.timings, self.stages)

    @property
    def doubts(self) -> list[str]:
        """Reasons to doubt the result, in words; none where it is as it should be.

        A calibration far from its belief is no reason: the measurements determined it, and the table prints it.
        """
        from nls.cli import sigmas

        out = self._implausible() + [self.result.doubt] * bool(self.result.doubt and self.result.converged)
        out += [] if self.choice is None else map(str, self.choice.doubts)
        out += [] if self.sigmas is None else sigmas.doubts(self.sigmas)
        return out if self.solved is None else out + self.solved.faults()

    @property
    def marks(self) -> list[str]:
        """Words on pictures and charts: the reasons to doubt, and that this is no optimum."""
        return [f"not converged: {self.result.status.value}"] * (not self.result.converged) + self.doubts

    def _implausible(self) -> list[str]:
        """The findings on the tables of a mission, by name; fixes that jump are what a kernel on their table is for."""
        if (mission := mission_of(self.report)) is None:
            return []
        factors = zip(mission.tables, self.graph.factors, strict=True)
        robust = {table for table, factor in factors if factor.kernel is not None}
        left = [
            f"{finding.check} ({finding.file})"
            for finding in mission.findings
            if finding.file not in robust or finding.check != "jumps"
        ]
        if not (left or self.result.doubt):
            errors = sorted((error for error in mission.errors if error.evident), key=lambda error: -error.fall)
            left = [f"{error.quantity} ({error.file})" for error in errors[:1]]
        return [f"implausible: {', '.join(dict.fromkeys(left))}"] if left else []

    def additions(self) -> dict[str, Any]:
        """Additions of a mission, scales, a choice and a certificate to the report for programs."""
        from nls.cli import certificate, outliers, sigmas

        record: dict[str, Any] = {} if self.solved is None else {self.solved.name: self.solved.record()}
        record |= {} if self.sigmas is None else {"sigmas": sigmas.record(self.sigmas)}
        record |= {} if self.choice is None else outliers.record(self.choice, self.sources)
        return record | (
            {} if self.certificate is None else {"certificate": certificate.record(self.certificate, self.refuted)}
        )


class Solution(ABC):
    """A solved mission of any kind: everything that is said of it and written.

    Parameters
    ----------
    job : the run, after the optimization.

    Attributes
    ----------
    name : of its part in the report for programs.
    """

    name = ""

    def __init__(self, job: Job) -> None:
        self.job, self.graph, self.result, self.report = job, job.graph, job.result, job.report
        self.values: Values = job.result.values

    @property
    def doubts(self) -> list[str]:
        """Why it is doubtful: a mark on its charts and pictures."""
        return self.job.marks

    @cached_property
    def covariances(self) -> tuple[Marginals | None, str]:
        """Covariances at the optimum; None and the note where there are none."""
        return covariances(self.graph, self.result, self.job.solver, self.job.options.gauge)

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none, and a note says why."""
        marginals, note = self.covariances
        self.report.notes += [note] * (marginals is None)
        return marginals

    def faults(self) -> list[str]:
        """Why it is no solution, besides what the optimization says."""
        return []

    @abstractmethod
    def record(self) -> dict[str, Any]:
        """The solution in the report for programs."""

    @abstractmethod
    def lines(self, record: dict[str, Any]) -> list[str]:
        """The lines of the table that say what the solution is worth, from its record."""

    @abstractmethod
    def picture(self) -> Any:
        """The picture of ``--plot``."""

    @abstractmethod
    def pictures(self) -> dict[str, Any]:
        """The pictures of the page, by their titles."""

    @abstractmethod
    def files(self) -> dict[str, Content]:
        """The files of the folder, by name."""

    def facts(self) -> dict[str, str]:
        """Facts for the page besides those of the run, by name."""
        return {}

    def figures(self) -> dict[str, str]:
        """Numbers at the head of the page, by name."""
        return {}

    def tum(self) -> bytes:
        """trajectory.tum: the poses in the order of their times or numbers."""
        from nls.io.trajectory import trajectory_text
        from nls.values import Values

        poses = Values.of([self.values.stack("x")])
        return trajectory_text("trajectory.tum", "tum", self.graph, poses, self.report)[0]


def covariances(
    graph: FactorGraph, result: Result, solver: LinearSolver | None = None, gauge: str = "first"
) -> tuple[Marginals | None, str]:
    """Covariances of a result at its optimum; None and the note where there are none.

    Parameters
    ----------
    graph, result : the measurements, and their optimization.
    solver, gauge : as for `nls.Marginals`.
    """
    from nls.covariance import Marginals

    reason = "this is no optimum"
    if result.converged:
        try:
            return Marginals(graph, result.values, solver, gauge), ""
        except UnderconstrainedError as error:
            reason = str(error)
    return None, f"the files have no sigmas: {reason}"
