"""Findings about measurements: what does not fit, kinds with wrong sigmas, what nothing checks, what is repeated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors import Between, BetweenSensors, Cauchy, Huber
from factors.base import Factor
from factors.function import FunctionFactor
from nls.chi_squared import chi2_tail
from nls.explanation.findings import Finding, Measurement, Part, number, some
from nls.explanation.offers import certifies, graduates
from nls.explanation.statistics import Tested, measuring
from nls.track import closures

if TYPE_CHECKING:
    from nls.explanation.suspects import Suspects
    from nls.graph import FactorGraph
    from nls.sparse.pattern import Pattern
    from nls.values import Values

__all__ = [
    "local_minimum",
    "measurement",
    "no_optimum",
    "of_parts",
    "of_suspects",
    "repeated",
    "switched_off",
    "taken_out",
    "turns",
    "unchecked",
]

UNLIKELY = 1e-3  # chance of a chi2 so far from its expectation, on either side
SIZEABLE = 1.2  # ratio of sigmas that is worth a word
ALIKE = 5.0  # times too far: no outlier does that to the middle one
MANY = 6  # measurements of which the middle one speaks for the kind
EXACT = 1e-6  # chi2 per degree of freedom of measurements that somebody made up
TURN = 0.6  # rad
OFF = 0.01  # weight of a measurement that counts no more
SQUARES = "; or sigmas, variances and informations were mixed up: Isotropic and Diagonal take sigmas"


def measurement(factor: Factor, index: int, values: Values, t: float, chance: float) -> Measurement:
    """One measurement, t its squared distance from what the others say."""
    chi2 = float(factor.chi2(values)[index])  # of all: a factor made from a function has no parts
    keys = tuple(keys[[index]] for keys in factor.keys)
    return Measurement(factor.describe(index), keys, chi2, chi2**0.5, max(t, 0.0) ** 0.5, chance)


def no_optimum(fall: float, chi2: float) -> Finding:
    """The values are not where chi2 is lowest."""
    says = (
        f"these values are no optimum: one Gauss-Newton step takes {number(fall)} off chi2, which is {number(chi2)}. "
        "Of the measurements this says what it would say after that step if the problem were linear"
    )
    return Finding("no optimum", (), says, "solve first: nls.explain(graph, graph.optimize(values).values)")


def local_minimum(lower: float, chi2: float, graph: FactorGraph, values: Values) -> Finding:
    """chi2 is lower elsewhere."""
    says = (
        f"these values are a local minimum: chi2 is {number(chi2)} here and {number(lower)} at another one, found by "
        "taking measurements out and putting them back. What follows is about that one"
    )
    cure = "nls.initialize(graph, values) looks for a better start"
    cure += "; nls.certify(graph, values) proves whether there is a lower one" * certifies(graph, values)
    return Finding("local minimum", (), says, cure)


def taken_out(found: Suspects, graph: FactorGraph, pattern: Pattern, values: Values) -> tuple[Measurement, ...]:
    """The suspects: chi2 where they are in, distance and chance where they are not."""
    n = sum(int((test.m > 0).sum()) for test in found.tests)
    out = []
    for k, i in found.places:
        t, m = found.tests[k].t[i], found.tests[k].m[i]
        out.append(measurement(graph.factors[k], i, values, float(t), min(1.0, float(chi2_tail(t, m)) * n)))
    return tuple(out)


def of_suspects(found: Suspects, graph: FactorGraph, pattern: Pattern) -> list[Finding]:
    """One finding for every measurement that was taken out, or one for all where they are many."""
    if not found.places:
        return []
    named = [graph.factors[k].describe(i) for k, i in found.places]
    if found.many:
        keys = tuple(dict.fromkeys(keys[[i]] for k, i in found.places for keys in graph.factors[k].keys))
        says = f"at least {len(named)} measurements do not fit the others, the worst: {some(named)}"
        gnc = "find them by graduated non-convexity, nls.gnc(graph, values), or " * graduates(graph, found.values)
        robust = any(factor.kernel is not None for factor in graph.factors)
        cure = gnc + ("look at them and remove them" if robust else "use a kernel, graph.robust(Cauchy(1))")
        return [Finding("many outliers", keys, says, cure)]
    out = []
    for (k, i), one in zip(found.places, named, strict=True):
        factor, sigmas = graph.factors[k], float(np.sqrt(found.tests[k].t[i]))
        close = bool(closures(pattern.batches[k], pattern)[i])
        head = f"{one}, a loop closure," if close else one
        says = f"{head} is probably wrong: {sigmas:.3g} sigmas from what all others say"
        count, other = found.rivals[k, i]
        if other is not None:
            rival = graph.factors[other[0]].describe(other[1])
            says += (
                f"; or {f'one of {count} others, such as ' if count > 1 else ''}{rival}, as nothing tells them apart"
            )
        if (k, i) == found.places[-1]:
            without = "it" if len(named) == 1 else f"these {len(named)}"
            says += f"; without {without} chi2 is {number(found.chi2)}, {number(found.dof)} expected"
        turned = _turned(factor, i, found)
        says, cure = (
            says + turned,
            "exchange its two variables" if turned else "look at it; remove it, or give it a kernel",
        )
        keys = tuple(keys[[i]] for keys in factor.keys)
        out.append(Finding("wrong closure" if close else "outlier", keys, says, cure))
    return out


def _turned(factor: Factor, index: int, found: Suspects) -> str:
    """A remark where the measurement fits with its variables exchanged."""
    if not isinstance(factor, Between | BetweenSensors) or len(factor.keys) != 2:
        return ""
    one = factor[[index]]
    one.keys = one.keys[::-1]
    if chi2_tail(one.chi2(found.values), np.array([measuring(found.values.gather(one)[0])[0]]))[0] < UNLIKELY:
        return ""
    i, j = (repr(keys[[index]]) for keys in factor.keys)
    return f". It fits when it is read from {j} to {i}: are i and j swapped?"


def of_parts(parts: tuple[Part, ...], found: Suspects, graph: FactorGraph) -> list[Finding]:
    """Kinds of measurements whose chi2 no chance explains; with many outliers only those that are off as a whole.

    Parameters
    ----------
    parts : without the suspects.
    found : these.
    """
    out, alike = [], []
    robust = any(factor.kernel is not None for factor in graph.factors)
    without = ", without " + ("the suspect" if len(found.places) == 1 else "the suspects") if found.places else ""
    for part in parts:
        if not part.chi2 > EXACT * part.expected > 0:  # numbers without noise are no fault
            continue
        above, typical = float(chi2_tail(np.array(part.chi2), np.array(part.expected))), part.typical**0.5
        if UNLIKELY < above < 1 - UNLIKELY:
            continue
        ratio = part.chi2 / part.expected
        times = number(float(f"{ratio:.2g}"))
        head = f"{part.name}{without}: chi2 {number(part.chi2)} is {times} times its expectation of "
        head += number(part.expected)
        if typical > ALIKE and ratio > 1 and part.measurements >= MANY:
            alike.append(f"{part.name} (the middle one {typical:.2g} times too far)")
            continue
        if found.many:
            continue
        if typical > SIZEABLE and ratio > 1 and part.measurements >= MANY:
            says = f"{head}; the middle one is {typical:.2g} times too far off: sigmas about that much too small"
            cure = "larger sigmas" + (SQUARES if typical > 3 else "")
        elif ratio > 1 and typical <= SIZEABLE:
            if robust:
                continue
            says = f"{head}; the middle one is as it should be: a few that are far off make it"
            cure = "look at the worst ones, or use a robust kernel"
        elif ratio > 1:
            says, cure = head, "look at the worst of them; wrong sigmas, an outlier, or a local minimum"
        elif ratio**-0.5 > SIZEABLE:
            says = f"{head}; sigmas about {ratio**-0.5:.2g} times too large"
            cure = "smaller sigmas, if these are real measurements" + (SQUARES if ratio**-0.5 > 3 else "")
        else:
            continue
        out.append(Finding("sigmas", (), says, cure))
    if alike:
        says = (
            f"most measurements are off alike: {some(alike)}. That is a wrong sign, unit or frame, or sigmas much too "
            "small (variances given as sigmas? information in another order?), or a local minimum; or most are outliers"
        )
        cure = "check these first; nls.initialize(graph, values) gives another start"
        cure += ", nls.certify(graph, values) says whether there is a lower minimum" * certifies(graph, found.values)
        cure += ", nls.gnc(graph, values) stands many outliers" * graduates(graph, found.values)
        out.insert(0, Finding("systematic", (), says, cure))
    return out


def switched_off(graph: FactorGraph, values: Values) -> list[Finding]:
    """Robust kernels that have rejected most of their measurements."""
    out = []
    for factor in graph.factors:
        off = np.flatnonzero(factor.weights(values) < OFF)
        if factor.kernel is not None and len(off) > len(factor) / 2:
            says = f"{factor.kernel!r} rejects {len(off)} of {len(factor)} measurements of {factor!r} at these values"
            cure = "start nearer, or use a wider kernel"
            cure += "" if isinstance(factor.kernel, Huber | Cauchy) else " or one that forgets nothing, such as Cauchy"
            keys = tuple(dict.fromkeys(keys[[i]] for i in off[:5].tolist() for keys in factor.keys))
            out.append(Finding("rejected", keys, says, cure))
    return out


def turns(graph: FactorGraph, values: Values) -> list[Finding]:
    """Residuals of functions that are off by nearly a turn: an angle that nobody wrapped."""
    out = []
    for factor in graph.factors:
        if not isinstance(factor, FunctionFactor):
            continue
        model, X = values.gather(factor)
        e = -model.space.local(np.zeros(model.dim), model.factor.predict(model.manifolds, *X)[0])
        near = np.flatnonzero((np.abs(np.abs(e) - 2 * np.pi) < TURN).any(axis=1))
        if len(near):
            k = int(near[0])
            off = float(e[k][np.argmin(np.abs(np.abs(e[k]) - 2 * np.pi))])
            says = f"{factor.describe(k)}: its error is {off:.3g}, nearly a turn"
            says += (
                f", and so {'is another' if len(near) == 2 else f'are {len(near) - 1} others'}" if len(near) > 1 else ""
            )
            cure = "if that is an angle, wrap the difference, models.algebra.wrap(z - h)"
            out.append(Finding("a turn", tuple(keys[[k]] for keys in factor.keys), says, cure))
    return out


def unchecked(tests: list[Tested], pattern: Pattern) -> list[Finding]:
    """Measurements that nothing else checks."""
    named: list[str] = []
    count = total = 0
    keys = []
    for k, test in enumerate(tests):
        factor = pattern.batches[k].model.factor
        if factor.limit_only:
            continue
        total += len(factor)
        alone = np.flatnonzero((test.m == 0) & (test.rows > 0))
        count += len(alone)
        named += [factor.describe(i) for i in alone[:5].tolist()]
        keys += [q[[i]] for i in alone[:5].tolist() for q in factor.keys]
    if not count:
        return []
    if count == total:
        says = "no measurement is checked by another: each fits whatever it says, and chi2 says nothing"
    else:
        them = some(named) if count <= 5 else f"{count} measurements, such as {', '.join(named[:3])}"
        says = f"no other measurement checks {them}: an error there cannot be seen"
    return [
        Finding("unchecked", tuple(dict.fromkeys(keys)), says, "a loop closure, or another measurement of the same")
    ]


def repeated(graph: FactorGraph, values: Values) -> list[Finding]:
    """Measurements that are in the graph more than once, with the same numbers."""
    like: dict[tuple[str, ...], list[Factor]] = {}
    for factor in graph.factors:
        if not factor.limit_only and not isinstance(factor, FunctionFactor):  # whose data are in the function
            like.setdefault((factor.name, *(keys.kind for keys in factor.keys)), []).append(factor)
    count, named, keys = 0, [], []
    for factors in like.values():
        tables = [
            np.column_stack([*(k.numbers.view(float) for k in factor.keys), values.gather(factor)[0].z])
            for factor in factors
            if len(factor)
        ]
        of = np.repeat(np.arange(len(factors)), [len(factor) for factor in factors])
        within = np.concatenate([np.arange(len(factor)) for factor in factors])
        if len({table.shape[1] for table in tables}) != 1:
            continue
        bits = np.ascontiguousarray(np.concatenate(tables)).view(np.int64)
        _, first, inverse = np.unique(bits, axis=0, return_index=True, return_inverse=True)
        again = np.flatnonzero(first[inverse] != np.arange(len(inverse)))
        count += len(again)
        for k in again[:5].tolist():
            named.append(factors[of[k]].describe(int(within[k])))
            keys += [q[[int(within[k])]] for q in factors[of[k]].keys]
    if not count:
        return []
    says = f"{count} {'measurement is' if count == 1 else 'measurements are'} in the graph again with the same numbers"
    cure = "leave them out if they are copies: each counts again, and the covariances come out too small"
    return [Finding("repeated", tuple(dict.fromkeys(keys)), f"{says}: {some(named, 3)}", cure)]
