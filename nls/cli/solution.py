"""A solved mission, whatever it was solved from: everything that is said of it and written."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

from models.errors import UnderconstrainedError
from nls.cli.doubtful import marks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from models.algebra import Array
    from nls.cli.job import Job
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.linear import LinearSolver
    from nls.optimizers import Result
    from nls.values import Values

__all__ = ["Content", "Solution", "circles", "covariances"]

Content = Callable[[], "bytes | Figure"]  # makes what is written to a file


class Solution:
    """What missions of every kind have in common; each kind adds record, lines, files, picture and pictures.

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
        return marks(self.job)

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

    def facts(self) -> dict[str, str]:
        """Facts for the page besides those of the run, by name."""
        return {}

    def figures(self) -> dict[str, str]:
        """Numbers at the head of the page, by name."""
        return {}

    def tum(self) -> bytes:
        """trajectory.tum: the poses in the order of their times or numbers."""
        from nls.io.trajectory import trajectory_text

        return trajectory_text("trajectory.tum", "tum", self.graph, self.values, self.report)[0]


def circles(errors: Array) -> dict[str, float]:
    """Radii about the truth that hold half and 95 % of the horizontal errors (n, 3), and twice their rms, m."""
    from nls.metrics import cep, drms2

    return {"cep50_m": cep(errors), "cep95_m": cep(errors, 0.95), "drms2_m": drms2(errors)}


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
