"""Wrong loop closures and contacts: which are rejected, and how ``nls solve`` reports them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import nls
from factors import RangeAzimuth
from models.options import did_you_mean
from nls.cli.choices import GNC, PROBABILITIES

if TYPE_CHECKING:
    from factors.base import Factor
    from nls.io.report import Source
    from nls.robust.graduated import Rejected

PREFIX = "gnc-"
SHOWN = 6  # rejected measurements in the table
OF_CHOICE = ("doubted", "probability", "expected_by_chance", "sigma0", "strain")
OF_GROUP = ("redundancy", "meters", "rms", "sigmas")  # numbers of closures that nothing verifies


def chosen(robust: str, init: str, graph: nls.FactorGraph, values: nls.Values) -> nls.Robustified:
    """The measurements to keep, by ``gnc-LOSS[:PROBABILITY]``: loop closures, and contacts where there are some.

    Raises
    ------
    OptionError
        No such loss, no probability, or a start that would not be used.
    """
    from nls.posegraph import closures
    from nls.robust.kernels import LOSSES

    loss, colon, number = robust.removeprefix(PREFIX).partition(":")
    allowed = f"{PROBABILITIES}, such as gnc-tls:0.99"
    try:
        probability = float(number) if colon else 0.99
    except ValueError as error:
        raise nls.OptionError("--robust", robust, allowed) from error
    if loss not in LOSSES or not 0 < probability < 1:
        raise nls.OptionError("--robust", robust, allowed + did_you_mean(robust.partition(":")[0], GNC))
    if init != "auto":
        raise nls.OptionError("--init", init, f"auto with --robust {robust}, which begins with odometry")
    if not (contacts := contacts_of(graph)):
        return nls.gnc(graph, values, loss, probability)
    masks = zip(graph.factors, closures(graph.pattern(values)), strict=True)
    return nls.gnc(graph, values, loss, probability, [*contacts, *(factor for factor, mask in masks if mask.all())])


def contacts_of(graph: nls.FactorGraph) -> list[Factor]:
    """The contacts of a mission."""
    return [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]


def choice_of(
    graph: nls.FactorGraph, values: nls.Values, result: nls.Result, report: nls.LoadReport
) -> nls.Robustified | None:
    """The choice among the contacts of a mission that was solved with all of them; None where all are kept.

    All are kept where `nls.robust.contacts.misfit` is False. They are kept with a note where a calibration
    explains most of the misfit. The same holds where the choice cannot be trusted or made.

    Parameters
    ----------
    graph, values, report : of the mission, its start by dead reckoning.
    result : with all contacts, without robust kernels.
    """
    from nls.analysis.calibrations import calibrations
    from nls.explanation.causes import calibrated
    from nls.robust.contacts import misfit

    contacts = contacts_of(graph)
    if not contacts or not misfit(result, contacts):
        return None
    kept = "all contacts are kept, though some do not fit"
    if result.converged and (wrong := calibrated(calibrations(graph, result.values))):
        report.notes.append(f"{kept}: {wrong[0].says}")
        return None
    try:
        choice = nls.gnc(graph, values, doubted=contacts)
    except nls.UnderconstrainedError as error:
        report.notes.append(f"{kept}: they are tested against dead reckoning, which is incomplete: {error.message}")
        return None
    if choice.doubts:
        report.notes.append(f"{kept}: no selection among them can be trusted; {'; '.join(map(str, choice.doubts))}")
        return None
    return choice


def record(choice: nls.Robustified, sources: Sequence[Source]) -> dict[str, Any]:
    """For programs; with the file and the line of what was rejected, where the factors as read have some."""

    def rejected(r: Rejected) -> dict[str, Any]:
        path, lines = sources[r.number]
        return {"factor": r.factor, "sigmas": r.sigmas, "file": path, "line": int(lines[r.measurement]) or None}

    return {
        **{name: getattr(choice, name) for name in OF_CHOICE},
        "sigma0_between_neighbors": choice.local,
        "left": [vars(landmark) for landmark in choice.left],
        "rejected": [rejected(r) for r in choice.rejected],
        "doubts": [doubt.record() for doubt in choice.doubts],
        "unverified": [
            {"factors": list(group.names)} | {name: getattr(group, name) for name in OF_GROUP}
            for group in choice.unverified
        ],
    }


def rows(choice: nls.Robustified, asked: bool) -> list[str]:
    """For the table: all that is known where the choice was asked for, else one line of contacts."""
    if not asked:
        return [f"outliers    {sentence(choice)}"]
    first, *lines = choice.report(SHOWN)
    return [f"outliers    {first}", *(f"          {line}" for line in lines)]


def sentence(choice: nls.Robustified) -> str:
    """How many contacts were rejected, and which landmarks left."""
    from nls.explanation.doubts import of_choice

    return "; ".join(finding.says for finding in of_choice(choice, contacts=True))


def without_rejected(
    as_read: nls.FactorGraph, choice: nls.Robustified, report: nls.LoadReport
) -> tuple[nls.FactorGraph, nls.LoadReport]:
    """The graph as read without the rejected measurements, and its report: the times and lines of the rest.

    The given report stays that of the whole graph; both have one list of notes.
    """
    masks = [weight > 0 for weight in choice.weights]
    graph, left = as_read.only(masks), [k for k, mask in enumerate(masks) if mask.any()]
    parts = [(k, masks[k], new) for k, new in zip(left, graph.factors, strict=True)]
    return graph, report.of_parts(as_read.factors, parts)


def without_left(values: nls.Values, kept: nls.Values) -> nls.Values:
    """The values of the variables that were kept."""
    kinds = ((stack, kept.stack(stack.kind).numbers) for stack in values.stacks.values())
    return nls.Values.of(stack.only(np.isin(stack.numbers, numbers)) for stack, numbers in kinds)
