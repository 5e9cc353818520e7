"""One run of ``nls solve``: the record that its stages pass on, each adding what it knows."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from models.errors import LeadlineError
    from nls.analysis import VarianceComponents
    from nls.certificate import Certificate
    from nls.cli.scan_mission import SolvedScans
    from nls.cli.solved_mission import SolvedMission
    from nls.cli.timing import Clock
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.io.charts import Projection
    from nls.linear import LinearSolver
    from nls.optimizers import Result, Stop
    from nls.robust import Robustified
    from nls.values import Values


class Job:
    """The state of a run.

    Attributes
    ----------
    options, clock, solver, stop : of the command.
    form : format of the output; empty where none is written, or a mission.
    select : how the matches of a scan mission are selected; None of other inputs.
    projection : of the coordinates in the files of a mission; None for local ones.
    as_read, values, report : of the file; without what was rejected.
    graph : under kernels, with kinds held; with ``--sigmas estimate`` rescaled, and `as_read`, too.
    choice : of `nls.gnc`; None where all measurements are believed.
    judge_contacts : whether contacts of a mission that do not fit may be left out.
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
    choice: Robustified | None = None
    judge_contacts = True
    sigmas: VarianceComponents | None = None
    start: Values
    init = ""
    chi2_read: float | None = None
    result: Result
    solved: SolvedMission | SolvedScans | None = None
    certificate: Certificate | None = None

    def __init__(self, options: argparse.Namespace, clock: Clock, solver: LinearSolver | None, stop: Stop) -> None:
        self.options, self.clock, self.solver, self.stop = options, clock, solver, stop
        self.starts: dict[str, float] = {}
        self.stages: dict[str, float] = {}
        self.refuted: list[float] = []
        self.failed: list[LeadlineError] = []

    @property
    def before(self) -> Values:
        """The values as read, or the start where these have no chi2: what a picture can show."""
        return self.start if self.chi2_read is None else self.values

    @property
    def timings(self) -> dict[str, float]:
        """Seconds by stage so far."""
        return self.clock.timings(self.result.timings, self.stages)

    def additions(self) -> dict[str, Any]:
        """Additions of a mission, scales, a choice and a certificate to the report for programs."""
        from nls.cli import certificate, outliers, sigmas

        record: dict[str, Any] = {} if self.solved is None else {self.solved.name: self.solved.record()}
        record |= {} if self.sigmas is None else {"sigmas": sigmas.record(self.sigmas)}
        record |= {} if self.choice is None else outliers.record(self.choice)
        return record | (
            {} if self.certificate is None else {"certificate": certificate.record(self.certificate, self.refuted)}
        )
