"""Covariances for the files of a mission, or a note that says why they have none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from models.errors import UnderconstrainedError

if TYPE_CHECKING:
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.linear import LinearSolver
    from nls.optimizers import Result

__all__ = ["covariances"]


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
