"""The top of the page, with the result in a sentence and the key figures, and its sections; each from `ReportData`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.advice import listed as listed_advice
from models.errors import UnderconstrainedError
from models.listing import number
from nls.analysis.inspection import inspect
from nls.explanation.findings import FindingKind
from nls.explanation.words import together
from nls.gauge import choose_gauge, fixed_variables
from nls.plot.report.markup import Html, across, bar, joined, listed, picture, section, table, tag
from nls.system import LinearSystem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nls.certificate import Certificate
    from nls.covariance import Marginals
    from nls.explanation import Explanation
    from nls.graph import FactorGraph
    from nls.optimizers import Result
    from nls.robust.graduated import Rejected
    from nls.values import Values

# Findings that one should know; an optimum with them is sound.
NOTED = {FindingKind.REPEATED, FindingKind.UNCHECKED, FindingKind.UNVERIFIED, FindingKind.SEPARATE_PARTS}
MAP = (5.2, 4.6)  # inches: letters of a picture that fills half of a page, or a phone
ROWS = 10  # of a table, and of one that shows nothing remarkable


@dataclass(frozen=True)
class ReportData:
    """Everything the sections take from; the arguments of `nls.plot.report`, and the values they are about."""

    graph: FactorGraph
    start: Values
    outcome: Result | UnderconstrainedError
    explanation: Explanation
    init: str = ""
    marginals: Marginals | None = None
    certificate: Certificate | None = None
    rejected: Sequence[Rejected] = ()
    doubts: Sequence[object] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    pictures: Mapping[str, Figure] = field(default_factory=dict)
    figures: Mapping[str, str] = field(default_factory=dict)
    shell: bool = False

    @property
    def result(self) -> Result | None:
        """Of the optimization; None where it could not be done."""
        return None if isinstance(self.outcome, UnderconstrainedError) else self.outcome

    @property
    def values(self) -> Values:
        """The optimum, or how far one came."""
        values: Values | None = self.outcome.values
        return self.start if values is None else values

    @property
    def size(self) -> int:
        """Variables and measurements, for what a picture of all costs."""
        return len(self.values) + len(self.graph)

    @cached_property
    def system(self) -> LinearSystem:
        """A and b at the values, one variable of every part held that nothing holds."""
        values = self.values
        decided = choose_gauge("first", self.graph.pattern(values), values, fixed_variables(self.graph.fixed, values))
        return LinearSystem.at(decided.pattern.holding(decided.held), values)

    @cached_property
    def covariances(self) -> Marginals | UnderconstrainedError | None:
        """Covariances as given or of the optimum; None where there is none, the error where something is free."""
        from nls.covariance import Marginals

        if self.marginals is not None or self.result is None or not self.result.converged:
            return self.marginals
        try:
            return Marginals(self.graph, self.values)
        except UnderconstrainedError as error:
            return error


def verdict(data: ReportData) -> Html:
    """One word, and why; of an optimum the sentences of its explanation."""
    from nls.plot.trajectory import in_words

    says = data.explanation.summary
    if isinstance(data.outcome, UnderconstrainedError):
        word, grade, says = "Not solved", "bad", data.outcome.message
    elif not data.outcome.converged:
        word, grade, says = "Not converged", "bad", f"{data.outcome.status.value}: {data.outcome.ending}."
    elif data.certificate is not None and data.certificate.verdict == "refuted":
        word, grade, says = "Not the optimum", "bad", f"The certificate found a lower minimum. {says}"
    elif data.doubts:
        word, grade, says = "Doubtful", "bad", "; ".join(map(str, data.doubts)) + "."
    else:
        doubted = [finding for finding in data.explanation.findings if finding.kind not in NOTED]
        word, grade = "Converged", "warn" if doubted else "good"
        says += f" {in_words(data.rejected)}." if data.rejected else ""
    head = tag("h1", tag("span", word, class_=f"verdict {grade}"), f" {says}")
    cures = listed_advice(data.outcome.advice, data.shell)
    return joined([head, tag("p", f"What helps: {'; '.join(cures)}", class_="quiet")], "\n") if cures else head


def key_figures(data: ReportData) -> Html:
    """Sizes, chi2, the gauge, and facts from the caller."""
    result, explained = data.result, data.explanation
    kinds = ", ".join(f"{len(stack):,} {kind}" for kind, stack in data.values.stacks.items())
    figures = [("variables", kinds, ""), ("measurements", f"{len(data.graph):,}", "")]
    before = number(data.graph.chi2(data.start))
    if result is None:
        figures += [("chi2", before, ""), ("start", data.init, "")]
    else:
        expected = f"{number(explained.low)} to {number(explained.high)} expected"
        figures += [
            ("chi2", f"{before} → {number(result.chi2_final)}", "robust cost" if result.robust else expected),
            ("iterations", f"{result.iterations}", result.method),
            ("start", data.init, ""),
            ("gauge", result.gauge, ""),
        ]
    figures += [(name, figure, "") for name, figure in data.figures.items()]
    shown = [(name, joined([figure, tag("small", note)])) for name, figure, note in figures if figure]
    return listed(shown, class_="figures")


def maps(data: ReportData) -> Html | None:
    """Before and after; or the pictures that were given."""
    from nls.plot.trajectory import mark, one_scale, trajectory

    if data.pictures:
        shown = [picture(figure, name, name, data.size) for name, figure in data.pictures.items()]
        return section("maps", "Map", tag("div", *shown, class_="pictures"))
    if not any(stack.manifold.position(stack.X).shape[1] for stack in data.values.stacks.values()):
        return None
    snapshots = [("Before", data.start)]
    if data.values is not data.start:
        snapshots.append(("After" if data.result is not None else "Where it stopped", data.values))
    wrong = data.explanation.suspects
    shown = []
    figures = [trajectory(data.graph, values, rejected=data.rejected) for _, values in snapshots]
    drawn = [(figure.axes[0], values) for figure, (_, values) in zip(figures, snapshots, strict=True)]
    times = one_scale(data.graph, drawn[0], drawn[-1])
    for k, (figure, (name, values)) in enumerate(zip(figures, snapshots, strict=True)):
        chi2 = number(data.graph.chi2(values))
        mark(figure.axes[0], values, [suspect.keys for suspect in wrong], linewidth=2.0)
        alt = f"{name}: positions of {len(values):,} variables and the measurements between them, chi2 {chi2}"
        red = "; red: measurements that do not fit the others" if wrong else ""
        scale = f"; drawn {times:.2g} times smaller" if times > 1 and k == 0 else ""
        shown.append(picture(figure, alt, f"{name}: chi2 is {chi2}{scale}{red}", data.size, MAP))
    return section("maps", "Before and after", tag("div", *shown, class_="pictures"))


def findings(data: ReportData) -> Html:
    """The findings and their cures."""
    items: list[Html] = []
    for first, alike in together(data.explanation.findings):
        texts = [[tag("p", finding.says)] for finding in alike]
        if cures := listed_advice(alike[0].advice, data.shell):
            about = f" with {first} to {first + len(alike) - 1}" if len(alike) > 1 else ""
            texts[-1].append(tag("p", f"What helps{about}: {'; '.join(cures)}", class_="quiet"))
        items += [tag("li", *text) for text in texts]
    return section("findings", "Findings", tag("ol", joined(items, "\n")) if items else tag("p", "Nothing suspicious."))


def kinds(data: ReportData) -> Html | None:
    """chi2 of every kind of measurement against its expectation."""
    parts = [kind for kind in data.explanation.parts if kind.expected > 0]
    if not parts:
        return None
    ratios = [ratio / kind.expected for kind in parts for ratio in (kind.chi2, kind.low, kind.high)]
    rows = [
        (
            kind.name,
            across(kind.low / kind.expected, kind.high / kind.expected, kind.chi2 / kind.expected, ratios),
            f"{kind.chi2 / kind.expected:.3g}",
            number(kind.chi2),
            number(kind.expected),
            f"{kind.measurements:,}",
        )
        for kind in parts
    ]
    note = (
        "The dot is chi2 / expected of this graph, the line is 1. With a right model the dot is in the band in 95 % "
        "of all cases. Right of the band: sigmas too small, or outliers. Left of it: sigmas too large."
    )
    heads = ("kind", "less than expected ← 1 → more", "ratio", "chi2", "expected", "measurements")
    by_kind = table("chi2 by kind of measurement", heads, rows, range(2, 6))
    return section("kinds", "Do the sigmas fit?", by_kind, _note(note))


def worst(data: ReportData) -> Html | None:
    """The measurements that fit worst, and those that were rejected."""
    doubted = data.explanation.worst
    # few rows where nothing is remarkable: no chance below 0.05
    doubted = doubted[: ROWS if doubted and doubted[0].chance < 0.05 else 5]
    rows = [
        (suspect.factor, f"{suspect.normalized:.3g}", f"{suspect.sigmas:.3g}", _chance(suspect.chance))
        for suspect in sorted(doubted, key=lambda suspect: -suspect.normalized)
    ]
    inside = []
    if rows:
        heads = ("measurement", "sigmas from all others", "sigmas", "by chance")
        note = (
            "Sigmas from all others: the distance from the prediction of all other measurements, in sigmas of that "
            "distance. Sigmas: the residual in its stated sigmas. By chance: the probability of one such measurement "
            "among all, if the model is right."
        )
        inside += [table("Measurements that fit worst", heads, rows, range(1, 4)), _note(note)]
    if data.rejected:
        shown = [(wrong.factor, f"{wrong.sigmas:.3g}", _chance(wrong.chance)) for wrong in data.rejected]
        columns = ("measurement", "sigmas", "by chance")
        inside.append(table(f"Rejected measurements: {len(shown):,}", columns, shown[:ROWS], (1, 2)))
        if len(shown) > ROWS:
            remaining = table("All others", columns, shown[ROWS:], (1, 2))
            inside.append(tag("details", tag("summary", f"and {len(shown) - ROWS:,} more"), remaining))
    return section("worst", "Which measurements fit worst?", *inside) if inside else None


def certificate(data: ReportData) -> Html | None:
    """The verdict of the certificate."""
    if data.certificate is None:
        return None
    lines = [tag("p", line, class_="lines") for line in data.certificate.report(data.shell).splitlines()]
    return section("certificate", "Is there a lower minimum?", *lines)


def covariances(data: ReportData) -> Html | None:
    """Ellipses on the map, and the least certain variables."""
    from nls.plot.ellipses import ellipses, visible_scale

    marginals = data.covariances
    inside: list[Html] = []
    if isinstance(marginals, UnderconstrainedError):
        inside.append(_note(f"There are no covariances: {marginals}"))
        marginals = None
    if marginals is not None and marginals.underconstrained is not None:
        inside.append(_note(f"Some variables have no covariance: {marginals.underconstrained}"))
    if marginals is not None and not data.pictures:
        most = max(len(stack) for stack in marginals.values.stacks.values())
        # at most 60 ellipses
        figure = ellipses(marginals, scale=visible_scale(marginals), every=-(-most // 60))
        if figure.axes[0].has_data():
            alt = "Positions from above, with the ellipses that hold them with 95 %"
            caption = f"Where the positions are with 95 %, from above. {marginals.gauge}."
            inside.append(picture(figure, alt, caption, data.size, MAP))
    weak = data.explanation.weakest[: 2 * ROWS]
    if weak:
        rows = [(repr(w.key), w.component, _sigma(w.sigma, w.unit), _sigma(w.typical, w.unit)) for w in weak]
        heads = ("variable", "component", "sigma", "middle of all")
        inside.append(table("The least certain variable of each kind", heads, rows, (2, 3)))
    return section("covariances", "How sure is it?", tag("div", *inside, class_="pictures")) if inside else None


def convergence(data: ReportData) -> Html | None:
    """chi2 and the step by iteration."""
    from nls.plot.trajectory import convergence

    result = data.result
    if result is None:
        return None
    alt = f"chi2 falls from {number(result.chi2_initial)} to {number(result.chi2_final)} in {result.iterations} steps"
    drawn = convergence(result, before=data.graph.chi2(data.start))
    figure = picture(drawn, alt, f"{result.status.name}: {result.ending}", len(result.history), MAP)
    rows = [
        (
            f"{iteration.number}",
            f"{iteration.chi2:.6g}",
            *(("", "") if iteration.number == 0 else (f"{iteration.update:.3g}", f"{iteration.damping:.3g}")),
        )
        for iteration in result.history
    ]
    steps = table("Iterations; lambda is the damping", ("step", "chi2", "max |dx|", "lambda"), rows, range(4))
    if len(rows) > ROWS:
        steps = tag("details", tag("summary", f"all {result.iterations} iterations"), steps)
    return section("convergence", "How did it get there?", tag("div", figure, steps, class_="pictures"))


def sparsity(data: ReportData) -> Html:
    """Nonzeros, and the cost of a factorization."""
    from nls.plot.matrices import spy

    cost = inspect(data.graph, data.values)
    upper = (data.system.H.nnz + cost["columns_of_A"]) // 2
    facts = [
        ("A", f"{cost['rows_of_A']:,} rows, {cost['columns_of_A']:,} columns, {cost['numbers_in_A']:,} numbers"),
        ("H = A'A", f"{upper:,} numbers on the diagonal and above"),
        (
            "R with R'R = H",
            f"{cost['numbers_in_R']:,} numbers, {cost['numbers_in_R'] - upper:,} of them fill-in; "
            f"{cost['factorization_mb']:.3g} MB",
        ),
        ("factorization", f"{cost['factorization_mflop']:,.3g} million multiplications and additions"),
    ]
    try:
        figure = spy(data.system)
    except UnderconstrainedError as error:
        drawn = _note(f"There is no R: {error}")
    else:
        titles = ", ".join(axes.get_title() for axes in figure.axes)
        for axes, name in zip(figure.axes, ("A", "H = A'A", "R, reordered"), strict=True):
            axes.set_title(name)
        caption = "Nonzeros of A, of H = A'A and of its Cholesky factor R. Orange: fill-in, zero in H."
        dots = cost["numbers_in_A"] + 2 * upper + cost["numbers_in_R"]
        drawn = picture(figure, f"Dots where there are numbers: {titles}", caption, dots)
    return section("sparsity", "What does a step cost?", listed(facts, class_="facts"), drawn)


def provenance(data: ReportData) -> Html | None:
    """Where the solution comes from."""
    facts = listed(data.facts.items(), class_="facts")
    return section("provenance", "Where does it come from?", facts) if data.facts else None


def time(data: ReportData) -> Html | None:
    """Seconds by part: all that differs between two runs on the same file."""
    if not data.seconds:
        return None
    most = max(data.seconds.values())
    rows = [(name, f"{1e3 * s:,.1f}", bar(s / most if most > 0 else 0.0)) for name, s in data.seconds.items()]
    note = "Of this run on this machine. All else on this page is the same for the same input."
    by_part = table(f"{sum(data.seconds.values()):.2f} s in all", ("part", "ms", ""), rows, [1])
    return section("time", "Where did the time go?", by_part, _note(note))


SECTIONS: dict[str, Callable[[ReportData], Html | None]] = {  # by the words of the link to each
    "Map": maps,
    "Findings": findings,
    "Sigmas": kinds,
    "Measurements": worst,
    "Certificate": certificate,
    "Covariances": covariances,
    "Convergence": convergence,
    "Sparsity": sparsity,
    "Source": provenance,
    "Time": time,
}


def _note(text: str) -> Html:
    return tag("p", text, class_="quiet")


def _chance(p: float) -> str:
    """A probability as people say it."""
    return "below 0.01 %" if p < 1e-4 else f"{100 * p:.2g} %" if p < 0.095 else f"{100 * p:.0f} %"


def _sigma(sigma: float, unit: str) -> str:
    """A sigma with its unit, angles in degrees."""
    return f"{np.degrees(sigma):.3g}°" if unit == "rad" else f"{sigma:.3g} {unit}".strip()
