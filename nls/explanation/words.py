"""An explanation in words: the verdict first, then what is wrong and what helps, then the numbers behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nls.explanation.findings import number
from nls.observability.report import shown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nls.explanation.findings import Explanation, Finding, Part

__all__ = ["cured", "report", "summary"]

SHOWN = 12  # findings, and rows of a table


def summary(e: Explanation) -> str:
    """One to three sentences: what is determined, whether chi2 is as expected, whether something is suspicious."""
    most = "at least " if e.capped else ""
    if e.nullity:
        free = f"{most}{e.nullity} {'direction is' if e.nullity == 1 else 'directions are'} free"
        determined = f"Of {e.unknowns:,} unknowns {free}."
    else:
        determined = f"{e.unknowns:,} unknowns, all determined."
    kinds = [finding.kind for finding in e.findings]
    if "no optimum" in kinds or "not converged" in kinds:
        return f"{determined} " + (
            "No optimum was found." if "not converged" in kinds else "The values are no optimum."
        )
    if not e.dof > 0:
        fits = "As many measured numbers as unknowns: nothing checks them, chi2 says nothing."
    elif e.chi2 < 1e-6 * e.dof:
        fits = "chi2 is 0: these are numbers without noise."
    elif e.low <= e.chi2 <= e.high:
        fits = f"chi2, {number(e.chi2)}, is as expected."
    else:
        fits = f"chi2 is {number(e.chi2 / e.dof)} times its expectation ({number(e.chi2)}, {e.dof:,} expected)."
    found = []
    if "local minimum" in kinds:
        found.append("This is a local minimum.")
    if closures := kinds.count("wrong closure"):
        found.append(f"{closures} loop {'closure is' if closures == 1 else 'closures are'} probably wrong.")
    if outliers := kinds.count("outlier"):
        found.append(f"{outliers} {'measurement does' if outliers == 1 else 'measurements do'} not fit the others.")
    if "many outliers" in kinds:
        found.append("Many measurements do not fit the others.")
    if not e.findings:
        found.append("Nothing suspicious.")
    return " ".join([determined, fits, *found])


def report(e: Explanation) -> str:
    """Everything in words, as a terminal shows it."""
    lines = [e.summary, ""]
    for first, alike in cured(e.findings[:SHOWN]):
        lines += [f"{first + k}. {_sentence(finding.says)}" for k, finding in enumerate(alike)]
        each = f"{first} to {first + len(alike) - 1}: " if len(alike) > 1 else ""
        lines += [f"   -> {each}{alike[0].cure}"] if alike[0].cure else []
    if (more := len(e.findings) - SHOWN) > 0:
        lines.append(f"and {more} more findings (`findings` has them)")
    lines += [""] if e.findings else []
    parts = f"{len(e.components)} parts" if len(e.components) != 1 else "one part"
    lines.append(
        f"graph       {e.variables:,} variables in {parts}, {e.measurements:,} measurements ({e.rows:,} numbers); "
        f"gauge: {e.gauge}"
    )
    lines.append(
        f"rank        {'at most ' if e.capped else ''}{e.rank:,} of {e.unknowns:,} unknowns"
        + (f", {'at least ' if e.capped else ''}{e.nullity} free" if e.nullity else "")
    )
    if e.dof > 0:
        within = f"{number(e.low)} to {number(e.high)} in 95 % of all cases"
        lines.append(
            f"chi2        {number(e.chi2)}, {e.dof:,} expected ({within})" + (", without kernels" if e.robust else "")
        )
    if e.chi2_without is not None:
        lines.append(
            f"            {number(e.chi2_without[0])} without the suspects, {number(e.chi2_without[1])} expected"
        )
    if e.parts:
        lines += ["", f"{'kind':28s} {'measured':>8s} {'chi2':>10s} {'expected':>10s}   95 %"]
        lines += [_row(part) for part in e.parts]
    if e.worst:
        lines += ["", "farthest from what the others say    sigmas    from the fit      chance"]
        lines += [
            f"{worst.factor:36s} {worst.normalized:6.3g} {worst.sigmas:15.3g} {worst.chance:11.2g}"
            for worst in sorted(e.worst[:5], key=lambda each: -each.normalized)
        ]
    if e.weakest:
        lines += ["", "least certain       sigma        the middle one"]
        lines += [
            f"{f'{weak.key!r} {weak.component}':18s}  {shown(weak.sigma, weak.component):12s} "
            f"{shown(weak.typical, weak.component)}"
            for weak in e.weakest
        ]
    return "\n".join(lines)


def cured(findings: Sequence[Finding]) -> list[tuple[int, list[Finding]]]:
    """Findings that follow each other and have the same cure, together; with the number of the first, from 1."""
    out: list[tuple[int, list[Finding]]] = []
    for count, finding in enumerate(findings, 1):
        if out and out[-1][1][0].cure == finding.cure:
            out[-1][1].append(finding)
        else:
            out.append((count, [finding]))
    return out


def _row(part: Part) -> str:
    within = f"{number(part.low)} - {number(part.high)}" if part.expected > 1e-6 else "-"
    return f"{part.name:28s} {part.measurements:8,d} {number(part.chi2):>10s} {number(part.expected):>10s}   {within}"


def _sentence(text: str) -> str:
    """With a full stop; names of variables keep their small letter."""
    return text if text.endswith((".", "?")) else f"{text}."
