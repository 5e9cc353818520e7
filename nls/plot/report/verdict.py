"""The top of the page: what came out in a sentence, and the key figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from models.advice import listed as listed_advice
from models.errors import UnderconstrainedError
from nls.explanation.findings import FindingKind, number
from nls.plot.report.markup import Html, joined, listed, tag

if TYPE_CHECKING:
    from nls.plot.report.data import ReportData


# Findings that one should know; an optimum with them is sound.
NOTED = {FindingKind.REPEATED, FindingKind.UNCHECKED, FindingKind.UNVERIFIED, FindingKind.SEPARATE_PARTS}


def verdict(data: ReportData) -> Html:
    """One word, and why; of an optimum the sentences of its explanation."""
    refuted = data.certificate is not None and data.certificate.verdict == "refuted"
    says = data.explanation.summary
    if isinstance(data.outcome, UnderconstrainedError):
        word, grade, says = "Not solved", "bad", data.outcome.message
    elif not data.outcome.converged:
        word, grade, says = "Not converged", "bad", f"{data.outcome.status.value}: {data.outcome.ending}."
    elif refuted:
        word, grade, says = "Not the optimum", "bad", f"The certificate found a lower minimum. {says}"
    elif data.doubts:
        word, grade, says = "Doubtful", "bad", "; ".join(map(str, data.doubts)) + "."
    else:
        doubted = [finding for finding in data.explanation.findings if finding.kind not in NOTED]
        word, grade = "Converged", "warn" if doubted else "good"
    head = tag("h1", tag("span", word, class_=f"verdict {grade}"), f" {says}")
    cures = listed_advice(data.outcome.advice, data.shell)
    return joined([head, tag("p", f"What helps: {'; '.join(cures)}", class_="quiet")], "\n") if cures else head


def key_figures(data: ReportData) -> Html:
    """Sizes, chi2, what holds the graph, and what the caller knows besides."""
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
    return listed(
        [(name, joined([figure, tag("small", note)])) for name, figure, note in figures if figure], class_="figures"
    )
