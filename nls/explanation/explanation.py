"""`explain`: the contents of a graph, its free directions, whether its measurements agree, and cures."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from factors.keys import Keys
from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_interval, chi2_tail
from models.errors import EvaluationError, GraphError, SingularGeometryError
from nls.analysis.alternatives import WORK, SpentError, bounded, expected
from nls.analysis.calibrations import Calibration, calibrations
from nls.analysis.freedom import Freedom, freedom
from nls.analysis.leave_one_out import Checked, Tested, checks, kinds_of, spoiled
from nls.analysis.redundancy import unverified_groups
from nls.analysis.suspects import Suspects, suspects
from nls.covariance.frames import axes, turned
from nls.explanation import causes, doubts
from nls.explanation.findings import Explanation, Finding, FindingKind, Measurement, Part, Weak
from nls.explanation.naming import named_directions
from nls.gauge import Gauge, choose_gauge, component_labels, fixed_variables, moving_variables, touched_variables
from nls.graph import FactorGraph
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.stages import announce, stage
from nls.values import Values, refuse_other

WORST = 10  # measurements that are named
Kinds = dict[str, list[tuple[int, Index]]]  # by name: number of the batch, indices of its measurements


@single_thread()
def explain(
    graph: FactorGraph, values: Values, groups: Sequence[str] | None = None, assumed: Sequence[int] = ()
) -> Explanation:
    """Determined and free directions, agreement of the measurements, and cures.

    Parameters
    ----------
    graph : as for `FactorGraph.optimize`; not changed. Measurements under a robust kernel count with their weight.
    values : usually the optimum, ``graph.optimize(...).values``. Elsewhere the findings begin with that.
    groups : a name for each factor, such as its dive: chi2 is counted for each kind of measurement and name.
    assumed : numbers of factors that nobody measured, such as an anchor: none is listed as unchecked.

    Returns
    -------
    Explanation

    Raises
    ------
    GraphError
        Nothing to explain; another number of names than of factors; a factor's variable without a value.
    EvaluationError
        The values cannot be evaluated.
    ResourceLimitError
        The graph is so large that its covariances would need more than half of the memory.

    Notes
    -----
    Ctrl-C ends the search for outliers: a finding says so, and all numbers that were there are in the explanation. At
    most 100 measurements, or groups of them, are taken out. Calibrations, other readings and exchanged landmarks are
    tried for half a minute at most, counted in iterations; a finding names those that were not tried to their end.
    The statistics are those of geodetic networks, see the theory page on explanations.

    Examples
    --------
    A square whose diagonal was measured as 5 m and not as 2.8:

    >>> import numpy as np
    >>> import nls
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> (x,) = nls.kinds("x")
    >>> sides = Between(x[[0, 1, 2, 3]], x[[1, 2, 3, 0]], [2, 0, np.pi / 2], Isotropic(0.05))
    >>> graph = nls.FactorGraph([sides, Between(x[0], x[2], [3.5, 3.5, np.pi], Isotropic(0.05))])
    >>> corners = [[0, 0, 0], [2, 0, np.pi / 2], [2, 2, np.pi], [0, 2, -np.pi / 2]]
    >>> result = graph.optimize(nls.Values({x: (SE2, corners)}))
    >>> explanation = nls.explain(graph, result.values)
    >>> explanation.rank, explanation.suspects[0].factor
    (9, 'Between(x0, x2)')
    """
    refuse_other("explain", graph, values)
    if not len(graph):
        raise GraphError("the graph has no factors: nothing to explain")
    if groups is not None and len(groups) != len(graph.factors):
        raise GraphError(
            f"explain: {len(groups)} names of groups; expected one for each of {len(graph.factors)} factors"
        )
    whole = graph.pattern(values)
    fixed, touched = fixed_variables(graph.fixed, values), touched_variables(whole)
    idle = ~touched & ~fixed
    gauge = choose_gauge("first", whole, values, fixed | idle)
    pattern = whole.holding(gauge.held)
    squares = [factor.chi2(values) for factor in graph.factors]
    chi2 = sum(float(s.sum()) for s in squares)
    announce(f"chi2 {chi2:.6g}, free directions")
    free = freedom(pattern, values)
    findings = doubts.switched_off(graph, values) + doubts.turns(graph, values)
    if unmeasured := tuple(pattern.key(int(v)) for v in np.flatnonzero(idle)):
        advice = (Advice("factors"), Advice("drop", ("it" if len(unmeasured) == 1 else "them",)))
        findings.append(Finding(FindingKind.UNMEASURED, unmeasured, {}, advice))
    findings += named_directions(free, pattern, values)
    findings += separate_parts(pattern, gauge) + causes.beyond_all_others(graph, whole)
    dof = pattern.measured_rows - (pattern.n - free.count)
    robust = any(factor.kernel is not None for factor in graph.factors)
    outliers: Suspects | None = None
    grouped: tuple[Part, ...] = ()
    worst: tuple[Measurement, ...] = ()
    weakest: tuple[Weak, ...] = ()
    promised, little = float("nan"), 0.01 + 1e-5 * chi2  # a fall of chi2 that makes no difference
    if free.checked is None:
        findings.append(Finding(FindingKind.ILL_CONDITIONED, (), {}, (Advice("units"), Advice("qr"))))
    else:
        promised = free.checked.promised
        tests = checks(free.checked, len(graph.factors))
        kinds = kinds_of(pattern, len(tests))
        parts = _parts(kinds, squares, tests)
        grouped = parts if groups is None else _parts(_by_group(kinds, groups), squares, tests)
        worst = _worst(pattern, values, tests)
        weakest = _weakest(free, pattern, values, idle)
        fall = _fall(graph, values, pattern.expand(free.checked.dx)) if promised > little else 0.0
        if fall > little:
            findings.insert(0, Finding(FindingKind.NO_OPTIMUM, (), {"fall": fall, "chi2": chi2}, (Advice("solve"),)))
        else:
            held = FactorGraph(graph.factors, [*graph.fixed, *unmeasured])
            try:
                with stage("outliers"), bounded(WORK):
                    disagreement, outliers = _disagreement(held, whole, pattern, values, free, tests, parts)
                    findings += disagreement
                    alike = FindingKind.SYSTEMATIC in {finding.kind for finding in disagreement}
                    if outliers is not None and not (outliers.many or free.count or alike):
                        for group in unverified_groups(held, values):
                            findings.append(doubts.unverified(group, doubts.keys_of(held.factors, group.closures)))
            except KeyboardInterrupt:
                findings.insert(0, Finding(FindingKind.INTERRUPTED))
            lower, here = np.inf if outliers is None else graph.chi2(outliers.values), graph.chi2(values)
            if lower < here - little:
                cures = (Advice("start"), *(Advice("certify"),) * doubts.certifies(graph, values))
                findings.insert(0, Finding(FindingKind.LOCAL_MINIMUM, (), {"lower": lower, "chi2": here}, cures))
        findings += doubts.unchecked(tests, whole, assumed)
    findings += doubts.repeated(graph, values)
    low, high = chi2_interval(dof)
    sizes = np.bincount(component_labels(pattern)[moving_variables(pattern)])  # variables of every connected part
    return Explanation(
        variables=len(values),
        unknowns=pattern.n,
        measurements=len(graph),
        rows=pattern.measured_rows,
        components=tuple(np.sort(sizes[sizes > 0])[::-1].tolist()),
        gauge=gauge.description,
        nullity=free.count,
        capped=free.more,
        chi2=chi2,
        dof=dof,
        low=low,
        high=high,
        promised=promised,
        robust=robust,
        findings=tuple(findings),
        parts=grouped,
        worst=worst,
        suspects=() if outliers is None else doubts.taken_out(outliers, graph, values),
        chi2_without=None if outliers is None or not outliers.places else (outliers.chi2, outliers.dof),
        weakest=weakest,
    )


def _disagreement(
    graph: FactorGraph,
    whole: Pattern,
    pattern: Pattern,
    values: Values,
    free: Freedom,
    tests: list[Tested],
    parts: tuple[Part, ...],
) -> tuple[list[Finding], Suspects | None]:
    """Misfits at an optimum, with their causes, and the suspects; None where a calibration explains all of it.

    Parameters
    ----------
    graph : with unmeasured variables fixed.
    whole, pattern, values, free, tests, parts : of the explanation.
    """
    assert free.checked is not None
    findings = [] if free.count else causes.duplicate_points(free.checked, pattern, values)
    spent: list[str] = []
    wrong: tuple[Calibration, ...] = ()
    with _tried("calibrations", spent):
        wrong = calibrations(graph, values, free)
    calibrated = causes.calibrated(wrong)
    if wrong and expected(wrong[0]):
        return findings + calibrated, None
    announce("outliers")
    outliers = suspects(graph, free.checked.linear.pattern, values, free.checked)
    without = _parts(kinds_of(pattern, len(tests)), outliers.s, outliers.tests, outliers.accepted)
    kinds = doubts.of_parts(without, outliers, graph)
    if not outliers.many and any(kind.kind is FindingKind.SYSTEMATIC for kind in kinds):
        outliers = replace(outliers, places=[])  # where most are off, it is not these
        kinds = doubts.of_parts(parts, outliers, graph)
    alike = [kind for kind in kinds if kind.kind is FindingKind.SYSTEMATIC]
    findings += _causes(graph, values, free.checked, tests, outliers, alike, spent) or calibrated
    findings += alike + doubts.of_suspects(outliers, graph, whole, causes.readings(free.checked, outliers))
    if spent and (kinds or outliers.places):
        findings.append(Finding(FindingKind.NOT_TRIED, (), {"causes": spent, "measurements": len(graph)}))
    return findings + [kind for kind in kinds if kind not in alike], outliers


@contextmanager
def _tried(cause: str, spent: list[str]) -> Iterator[None]:
    """Search for a cause; its name is added where the work of the explanation was spent before the end."""
    announce(cause)
    try:
        yield
    except SpentError:
        spent.append(cause)


def _causes(
    graph: FactorGraph,
    values: Values,
    checked: Checked,
    tests: list[Tested],
    outliers: Suspects,
    alike: list[Finding],
    spent: list[str],
) -> list[Finding]:
    """The explanation of a chi2 that noise does not explain: a reading, else an exchange of landmarks, else a clock."""
    findings: list[Finding] = []
    if alike or outliers.many:
        with _tried("other readings", spent):
            findings = causes.misread(graph, values)
    if not findings and (alike or outliers.places):
        with _tried("exchanged landmarks", spent):
            findings = causes.exchanged_landmarks(graph, values, tests)
    return findings or causes.clocks_by_residuals(checked, values, len(graph.factors))


def _fall(graph: FactorGraph, values: Values, step: Array) -> float:
    """By how much chi2 falls in a step (dim,) or in a fraction of it, at most; 0 where it does not."""
    chi2, falls = graph.chi2(values), [0.0]
    for fraction in (1.0, 0.5, 0.1, 0.01):
        try:
            falls.append(chi2 - graph.chi2(values.retract(fraction * step)))
        except (EvaluationError, SingularGeometryError):
            continue
    return max(falls)


def separate_parts(pattern: Pattern, gauge: Gauge) -> list[Finding]:
    """Parts that nothing joins, where not all of them have a place of their own; the largest first.

    Parameters
    ----------
    pattern : the graph.
    gauge : the fixed variables; a part that the gauge fixes has no place of its own.
    """
    moved = moving_variables(pattern)
    names, first, sizes = np.unique(component_labels(pattern)[moved], return_index=True, return_counts=True)
    if len(names) < 2 or not (gauge.held & ~gauge.fixed).any():
        return []
    order = np.argsort(-sizes, kind="stable")
    keys = tuple(pattern.key(int(v)) for v in np.flatnonzero(moved)[first[order]])
    numbers = {"variables": tuple(sizes[order].tolist())}
    return [Finding(FindingKind.SEPARATE_PARTS, keys, numbers, (Advice("join"), Advice("split")))]


def _by_group(kinds: Kinds, groups: Sequence[str]) -> Kinds:
    """Kinds of measurements, each by the groups of its factors, in the order of the groups."""
    out: Kinds = {}
    for kind, batches in kinds.items():
        for name in dict.fromkeys(groups):
            if chosen := [batch for batch in batches if groups[batch[0]] == name]:
                out[f"{kind}, {name}"] = chosen
    return out


def _parts(kinds: Kinds, s: list[Array], tests: list[Tested], accepted: list[Array] | None = None) -> tuple[Part, ...]:
    """chi2 by kind of measurement from squared residuals s by batch; of those accepted, 1 and not 0, where given."""
    out = []
    for name, kind in kinds.items():
        if accepted is not None:
            kind = [(k, indices[accepted[k][indices] > 0]) for k, indices in kind]
        dof = round(float(sum(tests[k].dof[indices].sum() for k, indices in kind)), 6) + 0.0
        count = sum(len(indices) for _, indices in kind)
        rows = int(sum(tests[k].rows[indices].sum() for k, indices in kind))
        low, high = chi2_interval(dof)
        chi2 = float(sum(s[k][indices].sum() for k, indices in kind))
        out.append(Part(name, count, rows, chi2, dof, low, high, spoiled(tests, kind)))
    return tuple(out)


def _worst(pattern: Pattern, values: Values, tests: list[Tested]) -> tuple[Measurement, ...]:
    """The most doubtful measurements."""
    n = sum(int((test.m > 0).sum()) for test in tests)
    rows: list[tuple[float, float, int, int]] = []
    for k, test in enumerate(tests):
        if pattern.batches[k].model.factor.limit_only:
            continue
        chance = chi2_tail(test.t, test.m)
        order = np.lexsort((-test.t, chance))[:WORST]
        rows += [(float(chance[i]), -float(test.t[i]), k, i) for i in order.tolist() if test.m[i] > 0]
    return tuple(
        doubts.measurement(pattern.batches[k].model.factor, i, values, -minus, min(1.0, chance * n))
        for chance, minus, k, i in sorted(rows)[:WORST]
    )


def _weakest(free: Freedom, pattern: Pattern, values: Values, idle: Mask) -> tuple[Weak, ...]:
    """Per kind and component the variable of the largest sigma, of those that are not free; axes of the world."""
    assert free.checked is not None
    moved = np.zeros(pattern.n, dtype=bool)
    moved[free.singles.indices] = True
    scaled = np.abs(free.combinations) * free.norms[:, None]
    moved |= (scaled > 1e-6 * scaled.max(axis=0, initial=0.0)).any(axis=1)
    owner, _ = pattern.column_owner()
    known = ~pattern.held & ~idle
    known[owner[moved]] = False
    number, sizes = np.cumsum(~pattern.held) - 1, pattern.dims[~pattern.held] ** 2
    begin = np.cumsum(sizes) - sizes
    out = []
    for name, stack in values.stacks.items():
        rows = np.flatnonzero(known[pattern.offsets[name] + np.arange(len(stack))])
        if not len(rows):
            continue
        d, keys = stack.manifold.dim, Keys(name, stack.numbers[rows])
        at = begin[number[pattern.offsets[name] + rows], None] + np.arange(d * d)
        frame = "world" if stack.manifold.body_axes else None
        J, names = axes(keys, stack.manifold, np.asarray(stack.X)[rows], frame, None)
        Sigma = turned(J, free.checked.diagonal[at].reshape(-1, d, d))
        sigma = np.sqrt(np.maximum(np.diagonal(Sigma, axis1=1, axis2=2), 0.0))
        for c, (component, unit) in enumerate(zip(names, stack.manifold.units, strict=True)):
            k = int(np.argmax(sigma[:, c]))
            out.append(Weak(keys[k], component, float(sigma[k, c]), float(np.median(sigma[:, c])), unit))
    return tuple(out)
