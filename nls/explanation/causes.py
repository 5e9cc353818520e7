"""Findings that name a cause: a calibration, a reading, exchanged landmarks, a clock, a number beyond all others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.advice import Advice
from models.listing import SOME
from nls.analysis.clock import clock_offsets
from nls.analysis.exchanged_contacts import Exchanged, exchanged_contacts
from nls.analysis.misread_kinds import misread_kinds
from nls.analysis.misread_measurements import misread_measurements
from nls.analysis.scales import outsized
from nls.analysis.swapped_landmarks import swapped_landmarks
from nls.explanation.findings import Finding, FindingKind
from nls.linear.singular import SingularSystemError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nls.analysis.calibrations import Calibration
    from nls.analysis.leave_one_out import Tested
    from nls.analysis.linearization import Checked
    from nls.analysis.suspects import Suspects
    from nls.graph import FactorGraph
    from nls.robust import Robustified
    from nls.sparse.pattern import Pattern
    from nls.values import Values


def beyond_all_others(graph: FactorGraph, pattern: Pattern) -> list[Finding]:
    """Lengths and informations a million times those of all others of their kind."""
    findings = []
    for outlier in outsized(pattern):
        numbers = {
            "factor": graph.factors[outlier.place[0]].describe(outlier.place[1]),
            "quantity": outlier.quantity,
            "component": outlier.component,
            "value": outlier.value,
            "others": outlier.reference,
        }
        advice = (Advice("inspect", ("it",)), Advice("units"))
        findings.append(Finding(FindingKind.OUTSIZED, outlier.keys, numbers, advice, (outlier.place,)))
    return findings


def misread(graph: FactorGraph, values: Values) -> list[Finding]:
    """One finding for all readings of kinds of measurements that explain chi2; nothing tells several apart."""
    kinds = misread_kinds(graph, values)
    if not kinds:
        return []
    numbers = {
        "readings": tuple((alternative.kind, alternative.reading) for alternative in kinds),
        "chi2": kinds[0].standing,
        "chi2_otherwise": kinds[0].chi2,
        "dof": kinds[0].dof,
    }
    places = tuple((k, int(i)) for k, indices in kinds[0].places for i in indices[:SOME])[:SOME]
    return [Finding(FindingKind.MISREAD, (), numbers, (Advice("frames"),), places)]


def exchanged_landmarks(graph: FactorGraph, values: Values, tests: list[Tested]) -> list[Finding]:
    """Pairs of landmarks that are one another in some of their sightings."""
    return [_swapped(pair, pair.dof) for pair in swapped_landmarks(graph, values, tests)]


def _swapped(pair: Exchanged, dof: int) -> Finding:
    """Two landmarks that were taken for one another."""
    numbers = {"sightings": len(pair.places), "chi2": pair.standing, "chi2_otherwise": pair.chi2, "dof": dof}
    advice = (Advice("exchange", (repr(pair.first), repr(pair.second))),)
    return Finding(FindingKind.SWAPPED, (pair.first, pair.second), numbers, advice, pair.places[:SOME])


def readings(checked: Checked, suspects: Suspects) -> dict[tuple[int, int], tuple[str, ...]]:
    """Readings under which a suspect fits the others, by its place; empty where they are many or hold something."""
    if suspects.many:
        return {}
    by_place: dict[tuple[int, int], tuple[str, ...]] = {}
    try:
        misreadings = misread_measurements(checked.linear.pattern, suspects.values, suspects.places)
    except SingularSystemError:  # without the suspects something is free: nothing tells their readings apart
        return {}
    for misreading in misreadings:
        by_place[misreading.place] = (*by_place.get(misreading.place, ()), misreading.reading)
    return by_place


def shifted_clocks(checked: Checked, values: Values, count: int) -> list[Finding]:
    """Kinds of measurements whose clock is before or behind that of the poses."""
    return [
        Finding(
            FindingKind.CLOCK,
            (),
            {"kind": offset.kind, "dt": offset.dt, "sigma": offset.sigma, "chance": offset.chance, "fall": offset.fall},
            (Advice("clock"),),
        )
        for offset in clock_offsets(checked, values, count)
    ]


def calibrated(wrong: Sequence[Calibration]) -> list[Finding]:
    """One finding for all calibrations that explain chi2; nothing tells several apart."""
    if not wrong:
        return []
    numbers = {
        "calibrations": tuple(
            {
                "kind": calibration.kind,
                "quantity": calibration.quantity,
                "components": calibration.components,
                "correction": calibration.correction.tolist(),
                "sigma": calibration.sigma.tolist(),
            }
            for calibration in wrong
        ),
        "chi2": wrong[0].standing,
        "chi2_otherwise": wrong[0].chi2,
        "dof": wrong[0].dof,
    }
    advice = tuple(Advice(f"calibrate {quantity}") for quantity in dict.fromkeys(c.quantity for c in wrong))
    return [Finding(FindingKind.CALIBRATION, (), numbers, advice)]


def wrong_contacts(graph: FactorGraph, choice: Robustified) -> tuple[Finding, ...]:
    """The contacts of a mission that were rejected, all in one, then the pairs of landmarks with exchanged contacts.

    Parameters
    ----------
    graph : with all contacts.
    choice : among them.
    """
    out = [weight == 0 for weight in choice.weights]
    where = {
        factor.describe(i): (k, i) for k, factor in enumerate(graph.factors) for i in np.flatnonzero(out[k]).tolist()
    }
    names = [rejection.factor for rejection in choice.rejected]
    worst = tuple(where[name] for name in names[:SOME] if name in where)
    inspect = (Advice("inspect", ("them",)), Advice("remove", ("them",)))
    many = Finding(FindingKind.MANY_OUTLIERS, (), {"factors": names}, inspect, worst)
    exchanged = exchanged_contacts(graph, choice.result.values, out)
    return (many, *(_swapped(pair, 2 * len(pair.places)) for pair in exchanged))
