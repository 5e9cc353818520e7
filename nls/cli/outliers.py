"""``nls solve --robust gnc-tls``: the graph without wrong measurements, and what table and report say of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.robust import Robustified
    from nls.values import Values

__all__ = ["record", "without_rejected"]

PREFIX = "gnc-"
NAME = PREFIX[:-1]
SHOWN = 6  # rejected measurements in the table
NUMBERS = ("count", "total", "number", "meters", "radians", "sigmas")  # of a doubt


def is_gnc(robust: str | None) -> bool:
    """Whether the option asks for graduated non-convexity, not for a kernel."""
    return bool(robust and robust.rpartition("=")[2].startswith(NAME))


def chosen(robust: str, init: str, graph: FactorGraph, values: Values) -> Robustified:
    """The measurements to believe, by ``gnc-LOSS[:PROBABILITY]``: loop closures, and contacts where there are some.

    Raises
    ------
    OptionError
        No such loss, no probability, or a start that would not be used.
    """
    import nls
    from models.options import did_you_mean
    from nls.cli.choices import GNC, PROBABILITIES
    from nls.cli.wrong_contacts import contacts_of
    from nls.posegraph import closures
    from nls.robust.kernels import LOSSES

    loss, colon, number = robust.removeprefix(PREFIX).partition(":")
    allowed = f"{PROBABILITIES}, such as gnc-tls:0.99"
    try:
        probability = float(number) if colon else 0.99
    except ValueError as error:
        raise nls.OptionError("--robust", robust, allowed) from error
    if loss not in LOSSES or not 0 < probability < 1:
        raise nls.OptionError("--robust", robust, allowed + did_you_mean(f"{PREFIX}{loss}", GNC))
    if init != "auto":
        raise nls.OptionError("--init", init, f"auto with --robust {robust}, which begins with odometry")
    if not (contacts := contacts_of(graph)):
        return nls.gnc(graph, values, loss, probability)
    masks = zip(graph.factors, closures(graph.pattern(values)), strict=True)
    return nls.gnc(graph, values, loss, probability, [*contacts, *(factor for factor, mask in masks if mask.all())])


def record(choice: Robustified) -> dict[str, Any]:
    """For programs."""
    return {
        "doubted": choice.doubted,
        "probability": choice.probability,
        "expected_by_chance": choice.expected_by_chance,
        "sigma0": choice.sigma0,
        "sigma0_between_neighbors": choice.local,
        "strain": choice.strain,
        "left": [{"variable": landmark.variable, "measurements": landmark.measurements} for landmark in choice.left],
        "rejected": [{"factor": measurement.factor, "sigmas": measurement.sigmas} for measurement in choice.rejected],
        "doubts": [
            {"kind": d.kind.name, "part": d.fraction, "sentence": str(d)} | {name: getattr(d, name) for name in NUMBERS}
            for d in choice.doubts
        ],
        "unverified": [
            {
                "factors": list(group.names),
                "redundancy": group.redundancy,
                "meters": group.meters,
                "rms": group.rms,
                "sigmas": group.sigmas,
            }
            for group in choice.unverified
        ],
    }


def rows(choice: Robustified, asked: bool) -> list[str]:
    """For the table: all that is known where the choice was asked for, else one line of contacts."""
    if not asked:
        return [f"rejected    {sentence(choice)}"]
    first, *lines = choice.report(SHOWN)
    return [f"rejected    {first}", *(f"          {line}" for line in lines)]


def sentence(choice: Robustified) -> str:
    """How many contacts were rejected, and which landmarks left."""
    from nls.explanation.rejections import left, rejected_contacts

    numbers = len(choice.rejected), choice.doubted, choice.expected_by_chance, choice.probability
    names, count = [x.variable for x in choice.left], sum(x.measurements for x in choice.left)
    return "; ".join([rejected_contacts(*numbers), *[left(names, count)] * bool(names)])


def without_rejected(as_read: FactorGraph, choice: Robustified, report: LoadReport) -> tuple[FactorGraph, LoadReport]:
    """The graph as read without the rejected measurements, and its report: the times and lines of the rest.

    The given report stays that of the whole graph; both have one list of notes.
    """
    from nls.io.mission import DivesReport

    masks = [weight > 0 for weight in choice.weights]
    graph, times = as_read.only(masks), {id(factor): times for factor, times in report.factor_times}
    if isinstance(report, DivesReport):
        of_dive = zip(report.dive_of, masks, strict=True)
        report = replace(report, dive_of=[name for name, mask in of_dive if mask.any()])
    known = {id(statement.noise): statement for statement in report.statements}
    left = [(factor, mask) for factor, mask in zip(as_read.factors, masks, strict=True) if mask.any()]
    factor_times = [
        (new, times[id(old)][mask]) for (old, mask), new in zip(left, graph.factors, strict=True) if id(old) in times
    ]
    statements = [
        known[id(old.noise)].only(mask, new.noise)
        for (old, mask), new in zip(left, graph.factors, strict=True)
        if id(old.noise) in known
    ]
    sources = [
        source._replace(lines=source.lines[mask])
        for source, mask in zip(report.sources, masks, strict=True)
        if mask.any()
    ]
    return graph, replace(report, factor_times=factor_times, statements=statements, sources=sources)


def without_left(values: Values, kept: Values) -> Values:
    """The values of the variables that were kept."""
    from nls.values import Values

    stacks = []
    for stack in values.stacks.values():
        there = np.isin(stack.numbers, kept.stack(stack.kind).numbers)
        stacks.append(stack if there.all() else stack.only(there))
    return Values.of(stacks)


def left_out(choice: Robustified, output: str | None) -> list[str]:
    """The note on what the output does not hold."""
    count = len(choice.rejected)
    return [f"{output} holds the graph without the {count} rejected measurements"] if output and count else []
