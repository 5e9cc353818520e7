"""``nls solve MISSION``: where its plain solution says that contacts are wrong, the solution without those."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors import RangeAzimuth

if TYPE_CHECKING:
    from factors.base import Factor
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.optimizers import Result
    from nls.robust import Robustified
    from nls.values import Values

__all__ = ["choice_of", "contacts_of"]


def contacts_of(graph: FactorGraph) -> list[Factor]:
    """The contacts of a mission."""
    return [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]


def choice_of(graph: FactorGraph, values: Values, result: Result, report: LoadReport) -> Robustified | None:
    """The choice among the contacts of a mission that was solved with all of them; None where all are believed.

    All are believed where `nls.robust.contacts.misfit` is False. They are believed with a note where a calibration
    explains most of the misfit. The same holds where the choice is doubtful or cannot be made.

    Parameters
    ----------
    graph, values, report : of the mission, its start by dead reckoning.
    result : with all contacts, without robust kernels.
    """
    contacts = contacts_of(graph)
    if report.format != "mission" or not contacts:
        return None
    import nls
    from models.errors import UnderconstrainedError
    from nls.analysis.calibrations import calibrations
    from nls.explanation.causes import calibrated
    from nls.robust.contacts import misfit

    if not misfit(result, contacts):
        return None
    kept = "all contacts are kept, though some do not fit"
    if result.converged and (wrong := calibrated(calibrations(graph, result.values))):
        report.notes.append(f"{kept}: {wrong[0].says}")
        return None
    try:
        choice = nls.gnc(graph, values, doubted=contacts)
    except UnderconstrainedError as error:
        report.notes.append(f"{kept}: without contacts, which are judged along dead reckoning, {error.message}")
        return None
    if choice.doubts:
        report.notes.append(f"{kept}: the choice among them is doubtful; {'; '.join(map(str, choice.doubts))}")
        return None
    return choice
