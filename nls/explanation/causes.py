"""Findings that name a cause: a calibration, a reading, landmarks exchanged or doubled, a clock, a number too large."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Sighting
from factors.keys import Keys
from models import R
from models.advice import Advice
from models.chi_squared import chi2_gate
from models.listing import SOME
from nls.analysis.clock import clock_offsets
from nls.analysis.misread import misread_kinds, misread_measurements
from nls.analysis.scales import outsized
from nls.analysis.swapped_landmarks import Exchanged, exchanged_contacts, swapped_landmarks
from nls.explanation.doubts import REMOVAL
from nls.explanation.findings import Finding, FindingKind
from nls.linear.factorization import SingularSystemError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from models.algebra import Index
    from nls.analysis.calibrations import Calibration
    from nls.analysis.leave_one_out import Checked, Tested
    from nls.analysis.misread import MisreadKind
    from nls.analysis.suspects import Suspects
    from nls.graph import FactorGraph
    from nls.robust import Robustified
    from nls.sparse.pattern import Pattern
    from nls.values import Values

SAME_POINT = 0.999  # of the pairs of points that are one are found


def beyond_all_others(graph: FactorGraph, pattern: Pattern) -> list[Finding]:
    """Lengths and informations a million times those of all others of their kind."""
    findings = []
    for outlier in outsized(pattern):
        factor, index = outlier.place
        numbers: dict[str, Any] = {"factor": graph.factors[factor].describe(index)}
        numbers |= {name: getattr(outlier, name) for name in ("quantity", "component", "value")}
        numbers["others"] = outlier.reference
        advice = (Advice("inspect", ("it",)), Advice("units"))
        findings.append(Finding(FindingKind.OUTSIZED, outlier.keys, numbers, advice, (outlier.place,)))
    return findings


def misread(graph: FactorGraph, values: Values) -> list[Finding]:
    """One finding for all readings of kinds of measurements that explain chi2 equally well."""
    kinds = misread_kinds(graph, values)
    if not kinds:
        return []
    readings = tuple((alternative.kind, alternative.reading) for alternative in kinds)
    numbers = {"readings": readings} | _fall(kinds[0], kinds[0].dof)
    places = tuple((k, int(i)) for k, indices in kinds[0].places for i in indices[:SOME])[:SOME]
    return [Finding(FindingKind.MISREAD, (), numbers, (Advice("frames"),), places)]


def _fall(better: MisreadKind | Calibration | Exchanged, dof: int) -> dict[str, Any]:
    """chi2 as it stands and otherwise, as numbers of a finding."""
    return {"chi2": better.standing, "chi2_otherwise": better.chi2, "dof": dof}


def exchanged_landmarks(graph: FactorGraph, values: Values, tests: list[Tested]) -> list[Finding]:
    """Pairs of landmarks that are one another in some of their sightings."""
    return [_swapped(pair, pair.dof) for pair in swapped_landmarks(graph, values, tests)]


def _swapped(pair: Exchanged, dof: int) -> Finding:
    """Two landmarks that were taken for one another."""
    numbers = {"sightings": len(pair.places)} | _fall(pair, dof)
    advice = (Advice("exchange", (repr(pair.first), repr(pair.second))),)
    return Finding(FindingKind.SWAPPED, (pair.first, pair.second), numbers, advice, pair.places[:SOME])


def readings(checked: Checked, suspects: Suspects) -> dict[tuple[int, int], tuple[str, ...]]:
    """Readings under which a suspect fits the others, by its place; empty where they are many or hold something."""
    if suspects.many:
        return {}
    by_place: dict[tuple[int, int], tuple[str, ...]] = {}
    try:
        misreadings = misread_measurements(checked.linear.pattern, suspects.values, suspects.places)
    except SingularSystemError:  # without the suspects something is free: the data do not distinguish their readings
        return {}
    for misreading in misreadings:
        by_place[misreading.place] = (*by_place.get(misreading.place, ()), misreading.reading)
    return by_place


def clocks_by_residuals(checked: Checked, values: Values, count: int) -> list[Finding]:
    """Kinds of measurements whose clock is before or behind that of the poses."""
    names = ("kind", "dt", "sigma", "chance", "fall")
    numbers = [{name: getattr(offset, name) for name in names} for offset in clock_offsets(checked, values, count)]
    return [Finding(FindingKind.CLOCK, (), offset, (Advice("clock"),)) for offset in numbers]


def calibrated(wrong: Sequence[Calibration]) -> list[Finding]:
    """One finding for all calibrations that explain chi2 equally well."""
    if not wrong:
        return []
    ways = tuple(
        {"kind": way.kind, "quantity": way.quantity, "components": way.components}
        | {"correction": way.correction.tolist(), "sigma": way.sigma.tolist()}
        for way in wrong
    )
    numbers = {"calibrations": ways} | _fall(wrong[0], wrong[0].dof)
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
    many = Finding(FindingKind.MANY_OUTLIERS, (), {"factors": names}, REMOVAL, worst)
    exchanged = exchanged_contacts(graph, choice.result.values, out)
    return (many, *(_swapped(pair, 2 * len(pair.places)) for pair in exchanged))


def duplicate_points(checked: Checked, pattern: Pattern, values: Values) -> list[Finding]:
    """Pairs of points that the data do not distinguish, by kind: nearer than their uncertainty, never seen together.

    For d = l_a - l_b of one point t = d' (P_aa + P_bb - P_ab - P_ba)^-1 d is chi2 distributed.

    Parameters
    ----------
    checked : of a graph in which nothing is free.
    pattern : with the gauge held.
    """
    out = []
    for name, stack in values.stacks.items():
        points = pattern.offsets[name] + np.arange(len(stack))
        points = points[~pattern.held[points]]
        if stack.manifold not in (R(2), R(3)) or len(points) < 3:
            continue
        for a, b, distance, sigmas in _nearest(checked, pattern, values, name, points, _poses(pattern, points)):
            numbers = {"distance": distance, "sigmas": sigmas}
            out.append(Finding(FindingKind.TWINS, (pattern.key(a), pattern.key(b)), numbers, (Advice("merge"),)))
    return out


def _poses(pattern: Pattern, points: Index) -> dict[int, set[int]]:
    """From which variables each point is seen."""
    poses: dict[int, set[int]] = {int(v): set() for v in points}
    for batch in pattern.batches:
        if isinstance(batch.model.factor, Sighting):
            mask = np.isin(batch.variables[1], points)
            for v, pose in zip(batch.variables[1][mask].tolist(), batch.variables[0][mask].tolist(), strict=True):
                poses[v].add(pose)
    return poses


def _nearest(
    checked: Checked, pattern: Pattern, values: Values, name: str, points: Index, poses: dict[int, set[int]]
) -> list[tuple[int, int, float, float]]:
    """Pairs of points (a, b) never seen together, how far apart and in how many sigmas, where that is no difference."""
    from scipy.spatial import cKDTree

    p = values[Keys(name, pattern.numbers[name][points - pattern.offsets[name]])]
    d = p.shape[1]
    distance, neighbor = cKDTree(p).query(p, k=2)
    spacing, ids = float(np.quantile(distance[:, 1], 0.75)), points.tolist()  # of most: twins are near each other
    near = {(float(distance[i, 1]), min(i, j), max(i, j)) for i, j in enumerate(neighbor[:, 1].tolist()) if i != j}
    from_poses = [(pair, poses[ids[pair[1]]], poses[ids[pair[2]]]) for pair in sorted(near)]
    apart = [pair for pair, a, b in from_poses if a and b and not a & b][:20]
    out: list[tuple[int, int, float, float]] = []
    if not apart:
        return out
    involved = np.unique([pair[1:] for pair in apart])
    columns = pattern.starts[points[involved], None] + np.arange(d)  # (q, d)
    E = np.zeros((pattern.n, columns.size))
    E[columns.reshape(-1), np.arange(columns.size)] = 1.0
    P = checked.factorization.solve(E)[columns.reshape(-1)].reshape(len(involved), d, len(involved), d)
    for r, i, j in apart:
        a, b = np.searchsorted(involved, [i, j])
        Sigma = P[a, :, a] + P[b, :, b] - P[a, :, b] - P[b, :, a]
        sharp = np.sqrt(np.trace(Sigma)) < 0.25 * spacing  # sigmas above that make neighbors of any two
        if sharp and np.linalg.matrix_rank(Sigma, hermitian=True) == d:
            t = float((p[i] - p[j]) @ np.linalg.solve(Sigma, p[i] - p[j]))
            if t < chi2_gate(d, SAME_POINT):
                out.append((ids[i], ids[j], r, t**0.5))
    return out
