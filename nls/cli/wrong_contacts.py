"""``nls solve MISSION``: where its plain solution says that contacts are wrong, the solution without those."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors import RangeAzimuth

if TYPE_CHECKING:
    from factors.base import Factor
    from nls.cli.job import Job
    from nls.graph import FactorGraph
    from nls.robust import Robustified

__all__ = ["choice_of", "contacts_of"]


def contacts_of(graph: FactorGraph) -> list[Factor]:
    """The contacts of a mission."""
    return [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]


def choice_of(job: Job) -> Robustified | None:
    """The choice among the contacts of a mission that was solved with all of them; None where all are believed.

    All are believed where the options say what else is done about outliers, where `nls.robust.misfit` finds nothing,
    and where the choice is doubtful or cannot be made; a note says so.
    """
    import nls
    from models.errors import UnderconstrainedError
    from nls.io.mission import MissionReport
    from nls.robust.misfit import misfit

    options, contacts = job.options, contacts_of(job.graph)
    if options.robust is not None or options.sigmas != "stated" or not isinstance(job.report, MissionReport):
        return None
    if not misfit(job.result, contacts):
        return None
    kept = "all contacts are kept, though some do not fit"
    try:
        choice = nls.gnc(job.graph, job.values, doubted=contacts)
    except UnderconstrainedError as error:
        job.report.notes.append(f"{kept}: without contacts, which judge each other along dead reckoning, {error}")
        return None
    if choice.doubts:
        job.report.notes.append(f"{kept}: the choice among them is doubtful; {'; '.join(map(str, choice.doubts))}")
        return None
    return choice
