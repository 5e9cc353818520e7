"""Findings about measurements: outliers, kinds with wrong sigmas, measurements without checks, and copies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Cauchy, Huber, Prior
from factors.base import Factor
from factors.keys import Keys
from models.advice import Advice
from models.algebra import Index
from models.chi_squared import chi2_tail
from models.errors import GraphError
from models.listing import SOME
from nls.analysis.leave_one_out import Tested
from nls.analysis.redundancy import Unverified
from nls.analysis.suspects import Suspects
from nls.explanation.findings import ChoiceKind, Finding, FindingKind, Measurement, Part
from nls.gauge import component_labels
from nls.graph import FactorGraph
from nls.posegraph import closures
from nls.sparse.pattern import Batch, Pattern
from nls.values import Values

if TYPE_CHECKING:
    from nls.robust import Robustified

SIZEABLE = 1.2  # ratio of sigmas that is worth a word
REMOVAL: tuple[Advice, ...] = (Advice("inspect", ("them",)), Advice("remove", ("them",)))
CURES = {  # action by reading
    "exchanged": "swap",
    "transposed": "transpose",
    "mirrored": "mirror",
    "y flipped": "flip",
    "z flipped": "flip",
    "x, y exchanged": "flip",
}


def certifies(graph: FactorGraph, values: Values) -> bool:
    """Whether `nls.certify` takes this graph."""
    from nls.certificate.problem import certifiable

    try:
        certifiable(graph, values)
    except GraphError:
        return False
    return True


def graduates(graph: FactorGraph, values: Values) -> bool:
    """Whether a graph has loop closures that `nls.gnc` tests, and odometry to test them against."""
    from nls.robust.loop_graph import loop_graph

    try:
        return len(loop_graph(graph, values).closures) > 0
    except GraphError:
        return False


def measurement(factor: Factor, index: int, values: Values, t: float, chance: float) -> Measurement:
    """One measurement, t its squared distance from the prediction of the others."""
    chi2 = float(factor.chi2(values)[index])  # of all: a factor made from a function has no parts
    keys = tuple(keys[[index]] for keys in factor.keys)
    return Measurement(factor.describe(index), keys, chi2, chi2**0.5, max(t, 0.0) ** 0.5, chance)


def taken_out(suspects: Suspects, graph: FactorGraph, values: Values) -> tuple[Measurement, ...]:
    """The suspects: chi2 where they are in, distance and chance where they are not."""
    n = sum(int((test.m > 0).sum()) for test in suspects.tests)
    out = []
    for k, i in suspects.places:
        t, m = suspects.tests[k].t[i], suspects.tests[k].m[i]
        out.append(measurement(graph.factors[k], i, values, float(t), min(1.0, float(chi2_tail(t, m)) * n)))
    return tuple(out)


def of_suspects(
    suspects: Suspects, graph: FactorGraph, pattern: Pattern, readings: Mapping[tuple[int, int], tuple[str, ...]]
) -> list[Finding]:
    """One finding for every measurement that was taken out, or one for all where they are many.

    Parameters
    ----------
    suspects, graph, pattern : the suspects, of which graph.
    readings : under which a suspect fits the others, by its place.
    """
    if not suspects.places:
        return []
    names = _names(graph.factors, suspects.places)
    graduated = graduates(graph, suspects.values)
    if suspects.many:
        keys = keys_of(graph.factors, suspects.places)
        robust = any(factor.kernel is not None for factor in graph.factors)
        cures = REMOVAL if robust else (Advice.robust("Cauchy", 1),)
        cures = (Advice("gnc"),) * graduated + cures
        places = tuple(suspects.places[:SOME])
        return [Finding(FindingKind.MANY_OUTLIERS, keys, {"factors": names}, cures, places)]
    out, closing = [], closures(pattern)
    for (k, i), name in zip(suspects.places, names, strict=True):
        factor, rivals = graph.factors[k], suspects.rivals[k, i]
        closure, read = bool(closing[k][i]), readings.get((k, i), ())
        numbers: dict[str, Any] = {
            "factor": name,
            "sigmas": float(np.sqrt(suspects.tests[k].t[i])),
            "rivals": rivals[0],
            "rival": "" if rivals[1] is None else graph.factors[rivals[1][0]].describe(rivals[1][1]),
            "readings": read,
        }
        if (k, i) == suspects.places[-1]:
            numbers |= {"removed": len(names), "chi2_without": suspects.chi2, "dof_without": suspects.dof}
        kind = FindingKind.WRONG_CLOSURE if closure else FindingKind.OUTLIER
        without = Advice("gnc") if closure and graduated else Advice.robust("Cauchy", 1)
        doubtful = (Advice("inspect", ("it",)), Advice("remove", ("it",)), without)
        keys = tuple(keys[[i]] for keys in factor.keys)
        cures = tuple(Advice(CURES[reading]) for reading in read)
        out.append(Finding(kind, keys, numbers, cures or doubtful, ((k, i),)))
    return out


def large_sigmas(name: str, chi2: float, expected: float, typical: float = np.nan, without: int = 0) -> list[Finding]:
    """A finding on measurements of this name whose chi2 is so far below its expectation that sigmas are too large.

    Parameters
    ----------
    name, chi2, expected : of these measurements, and their degrees of freedom.
    typical, without : their median residual, and how many suspects are not among them.
    """
    times = (expected / chi2) ** 0.5 if chi2 > 1e-6 * expected > 0 else 0.0
    if times <= SIZEABLE or chi2_tail(np.array(chi2), np.array(expected)) < 1 - 1e-3:
        return []
    numbers = {"kind": name, "without": without, "chi2": chi2, "expected": expected, "typical": typical}
    advice = (Advice("smaller sigmas"), *(Advice("squares"),) * (times > 3))
    return [Finding(FindingKind.SIGMAS, (), numbers | {"cause": "large"}, advice)]


def of_parts(parts: tuple[Part, ...], suspects: Suspects, graph: FactorGraph) -> list[Finding]:
    """Kinds of measurements whose chi2 no chance explains; with many outliers only those that are off as a whole.

    Parameters
    ----------
    parts : without the suspects.
    suspects : these.
    """
    out, alike = [], []
    robust = any(factor.kernel is not None for factor in graph.factors)
    for part in parts:
        if not part.chi2 > 1e-6 * part.expected > 0:  # numbers without noise are no fault
            continue
        above, typical = float(chi2_tail(np.array(part.chi2), np.array(part.expected))), part.typical**0.5
        if 1e-3 < above < 1 - 1e-3:
            continue
        ratio, many = part.chi2 / part.expected, part.measurements >= 6  # the median speaks for the kind
        if typical > 5.0 and ratio > 1 and many:  # no outlier does that to the median
            alike.append((part.name, typical))
            continue
        if suspects.many:
            continue
        if typical > SIZEABLE and ratio > 1 and many:
            cause, advice = "small", [Advice("larger sigmas")] + [Advice("squares")] * (typical > 3)
        elif ratio > 1 and typical <= SIZEABLE:
            if robust:
                continue
            cause, advice = "few", [Advice("inspect", ("the worst ones",)), Advice.robust("Cauchy", 1)]
        elif ratio > 1:
            cause, advice = "unknown", [Advice("inspect", ("the worst ones",))]
        else:
            out += large_sigmas(part.name, part.chi2, part.expected, typical, len(suspects.places))
            continue
        numbers = {"kind": part.name, "without": len(suspects.places), "chi2": part.chi2, "expected": part.expected}
        out.append(Finding(FindingKind.SIGMAS, (), numbers | {"typical": typical, "cause": cause}, tuple(advice)))
    if alike:
        advice = [Advice("frames"), Advice("start")]
        advice += [Advice("certify")] * certifies(graph, suspects.values)
        advice += [Advice("gnc")] * graduates(graph, suspects.values)
        out.insert(0, Finding(FindingKind.SYSTEMATIC, (), {"kinds": tuple(alike)}, tuple(advice)))
    return out


def switched_off(graph: FactorGraph, values: Values) -> list[Finding]:
    """Robust kernels that have rejected most of their measurements."""
    out = []
    for k, factor in enumerate(graph.factors):
        off = np.flatnonzero(factor.weights(values) < 0.01)
        if factor.kernel is not None and len(off) > len(factor) / 2:
            gentle = isinstance(factor.kernel, Huber | Cauchy)
            advice = (Advice("start"), Advice("wider kernel"), *(() if gentle else (Advice("gentle kernel"),)))
            places = tuple((k, i) for i in off[:SOME].tolist())
            numbers = {"kernel": repr(factor.kernel), "off": len(off), "of": len(factor), "factor": repr(factor)}
            out.append(Finding(FindingKind.REJECTED, keys_of(graph.factors, places), numbers, advice, places))
    return out


def turns(graph: FactorGraph, values: Values) -> list[Finding]:
    """Residuals of functions that are off by nearly a turn: an angle that nobody wrapped."""
    out = []
    for k, factor in enumerate(graph.factors):
        if not factor.opaque:
            continue
        model, X = values.gather(factor)
        e = -model.space.local(np.zeros(model.dim), model.factor.predict(model.manifolds, *X)[0])
        near = np.flatnonzero((np.abs(np.abs(e) - 2 * np.pi) < 0.6).any(axis=1))
        if len(near):
            i = int(near[0])
            off = float(e[i][np.argmin(np.abs(np.abs(e[i]) - 2 * np.pi))])
            numbers = {"factor": factor.describe(i), "error": off, "others": len(near) - 1}
            keys = tuple(keys[[i]] for keys in factor.keys)
            out.append(Finding(FindingKind.TURN, keys, numbers, (Advice("wrap"),), ((k, i),)))
    return out


def unchecked(tests: list[Tested], pattern: Pattern, assumed: Sequence[int]) -> list[Finding]:
    """Measurements that nothing else checks, without factors that are assumed, by what would check them.

    Where that is all measurements, it is one finding.
    """
    groups: dict[tuple[Advice, ...], list[tuple[int, Index]]] = {}
    total, label = 0, component_labels(pattern)
    for k, (test, batch) in enumerate(zip(tests, pattern.batches, strict=False)):
        if batch.model.factor.limit_only or k in assumed:
            continue
        total += len(batch)
        if len(alone := np.flatnonzero((test.m == 0) & (test.rows > 0))):
            groups.setdefault(_checked_by(batch, alone, label), []).append((k, alone))
    every = [group for several in groups.values() for group in several]
    if every and sum(len(alone) for _, alone in every) == total:
        groups = {tuple(dict.fromkeys(cure for cures in groups for cure in cures)): every}
    factors, out = [batch.model.factor for batch in pattern.batches], []
    for advice, members in groups.items():
        count = sum(len(alone) for _, alone in members)
        places = tuple((k, i) for k, alone in members for i in alone[:SOME].tolist())
        numbers = {"count": count, "of": total, "factors": _names(factors, places), "believed": not advice}
        out.append(Finding(FindingKind.UNCHECKED, keys_of(factors, places), numbers, advice, places))
    return out


def _checked_by(batch: Batch, alone: Index, label: Index) -> tuple[Advice, ...]:
    """The measurements that would check some unchecked ones of a factor; nothing for a belief.

    A belief is a prior, or the one such measurement in its part of the graph, as an anchor is: the part lies where it
    says.
    """
    factor, manifolds = batch.model.factor, batch.model.manifolds
    placed = [slot for slot in range(len(manifolds)) if slot not in factor.unmoved]
    if len(placed) < 2:
        parts = label[batch.variables[0][alone]]
        believed = isinstance(factor, Prior) or len(np.unique(parts)) == len(parts)
        return () if believed else (Advice("second sensor"),)
    of_point = manifolds[placed[0]].body_axes and not manifolds[placed[-1]].body_axes
    return (Advice("view", ("the same point",)) if of_point else Advice("close"),)


def unverified(group: Unverified, keys: tuple[Keys, ...] = ()) -> Finding:
    """A group of closures about variables that carries the map and that nothing verifies."""
    numbers = {"factors": group.names} | {n: getattr(group, n) for n in ("redundancy", "meters", "rms", "sigmas")}
    advice = (Advice("inspect", ("the group",)), Advice("close"))
    return Finding(FindingKind.UNVERIFIED, keys, numbers, advice, group.closures[:SOME])


def of_choice(choice: Robustified, contacts: bool = False) -> list[Finding]:
    """How many measurements, or contacts, a robust choice rejected, and which landmarks left with them."""
    names = ("doubted", "probability", "sigma0")
    # one of 20 choices has a right measurement so far off
    far = [rejected.sigmas for rejected in choice.rejected if rejected.chance < 0.05]
    numbers = {"count": len(choice.rejected), "by_chance": choice.expected_by_chance, "far": len(far)}
    numbers |= {"most": max(far, default=0.0)} | {name: getattr(choice, name) for name in names}
    out = [Finding(ChoiceKind.CONTACTS if contacts else ChoiceKind.REJECTED, (), numbers)]
    if choice.left:
        count = sum(landmark.measurements for landmark in choice.left)
        landmarks = [landmark.variable for landmark in choice.left]
        out.append(Finding(ChoiceKind.LEFT, (), {"landmarks": landmarks, "count": count}))
    return out


def repeated(graph: FactorGraph, values: Values) -> list[Finding]:
    """Measurements that are in the graph more than once, with the same numbers."""
    like: dict[tuple[str, ...], list[int]] = {}
    for k, factor in enumerate(graph.factors):
        if not factor.limit_only and not factor.opaque and len(factor):  # data are in the function
            like.setdefault((factor.name, *(keys.kind for keys in factor.keys)), []).append(k)
    count, places = 0, []
    for alike in like.values():
        factors = [graph.factors[k] for k in alike]
        tables = [
            np.column_stack([*(keys.numbers.view(float) for keys in factor.keys), values.gather(factor)[0].z])
            for factor in factors
        ]
        if len({table.shape[1] for table in tables}) != 1:
            continue
        of = np.repeat(alike, [len(factor) for factor in factors])
        within = np.concatenate([np.arange(len(factor)) for factor in factors])
        bits = np.ascontiguousarray(np.concatenate(tables)).view(np.int64)
        _, first, inverse = np.unique(bits, axis=0, return_index=True, return_inverse=True)
        again = np.flatnonzero(first[inverse] != np.arange(len(inverse)))
        count += len(again)
        places += [(int(of[row]), int(within[row])) for row in again[:SOME].tolist()]
    if not count:
        return []
    numbers = {"count": count, "factors": _names(graph.factors, places)}
    keys = keys_of(graph.factors, places)
    return [Finding(FindingKind.REPEATED, keys, numbers, (Advice("remove copies"),), tuple(places))]


def keys_of(factors: Sequence[Factor], places: Iterable[tuple[int, int]]) -> tuple[Keys, ...]:
    """The variables of some measurements, each once."""
    return tuple(dict.fromkeys(keys[[i]] for k, i in places for keys in factors[k].keys))


def _names(factors: Sequence[Factor], places: Iterable[tuple[int, int]]) -> tuple[str, ...]:
    """The names of some measurements."""
    return tuple(factors[k].describe(i) for k, i in places)
