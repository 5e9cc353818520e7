"""Findings in words: one sentence a kind; then a report with the verdict first, what helps, and the numbers behind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from models.advice import listed
from models.listing import some
from models.manifolds.units import unit
from nls.analysis.observable import in_unit
from nls.explanation.findings import Explanation, Finding, FindingKind, Part, number
from nls.explanation.rejections import unverified

__all__ = ["sentence", "together"]

SHOWN = 12  # findings, and rows of a table
FEW = 3  # of a list of measurements
Numbers = dict[str, Any]


def sentence(finding: Finding) -> str:
    """A finding in words, without what helps."""
    lines = f" [{some(list(dict.fromkeys(finding.places)), FEW)}]" if finding.places else ""
    return SENTENCES[finding.kind](finding) + lines


def _implausible(f: Finding) -> str:
    from nls.missions.checks import Explained, Implausible, Reading, Trial
    from nls.missions.checks.words import sentence as of_table

    if "trials" in f.numbers:
        trials = (Trial(**{**trial, "reading": Reading(**trial["reading"])}) for trial in f.numbers["trials"])
        return of_table(Explained(**{**f.numbers, "trials": tuple(trials)}))
    readings = tuple(Reading(**reading) for reading in f.numbers["readings"])
    return of_table(Implausible(**{**f.numbers, "readings": readings}))


def _not_converged(f: Finding) -> str:
    n = f.numbers
    return f"no optimum was found ({n['reason']}); the other findings are about the values {n['values']}"


def _no_optimum(f: Finding) -> str:
    return (
        f"these values are no optimum: one Gauss-Newton step lowers chi2 by {number(f.numbers['fall'])}, from "
        f"{number(f.numbers['chi2'])}; measurements are judged as after that step"
    )


def _local_minimum(f: Finding) -> str:
    return (
        f"these values are a local minimum: chi2 is {number(f.numbers['chi2'])} here and {number(f.numbers['lower'])} "
        "at another minimum, found without the suspects; the findings below are about that one"
    )


def _ill_conditioned(_: Finding) -> str:
    return "weights or scales of the measurements differ too much for A'A, which keeps 13 digits"


def directions(f: Finding) -> list[str]:
    """Every free direction of a finding in words; none of a finding of another kind."""
    if f.kind is not FindingKind.FREE:
        return []
    n = f.numbers
    if n["moved"] == "as one":
        scope = f"of all {n['variables']} variables joined to" if n["variables"] > 1 else "of"
        return [f"{name} {scope} {f.keys[0]!r}" for name in n["directions"]]
    if n["moved"] == "together":
        return [_free(f)]
    poses = n["seen_from"] or [""] * len(f.keys)
    return [
        f"{key!r}: {name}" + (f" as seen from {pose}" if pose else "")
        for key, pose in zip(f.keys, poses, strict=True)
        for name in n["directions"]
    ]


def _free(f: Finding) -> str:
    n = f.numbers
    if n["moved"] == "together":
        several = len(f.keys) > 1
        comma = ", " if several else " and "
        moved = [f"{comma.join(names)} of {key!r}" for key, names in zip(f.keys, n["components"], strict=True)]
        unknowns = sum(map(len, n["components"]))
        how = "can move" if unknowns == 1 else "can move together" if several else "cannot be told apart"
        return f"{some(moved)} {how}"
    names = ", ".join(n["directions"])
    if n["moved"] == "as one":
        scope = f"of all {n['variables']} variables joined to" if n["variables"] > 1 else "of"
        return f"{names} {scope} {f.keys[0]!r}, moved as one"
    pronoun = "it" if len(f.keys) == 1 else "them"
    if not n["seen_from"]:
        return f"{names} of {some(f.keys)}: no measurement reacts to a change of {pronoun}"
    points = some([f"{key!r} (from {pose})" for key, pose in zip(f.keys, n["seen_from"], strict=True)])
    count = "this point is" if len(f.keys) == 1 else f"these {len(f.keys)} points are"
    how = "seen once" if n["seen_once"] else "seen more than once, but only from where that does not show"
    return f"{names} of {points}, as seen by the sensor: {count} {how}"


def _unmeasured(f: Finding) -> str:
    return f"{some(f.keys)}: no measurement; the value is the initial guess"


def _separate_parts(f: Finding) -> str:
    sizes = f.numbers["variables"]
    parts = some([f"{size} with {key!r}" for size, key in zip(sizes, f.keys, strict=True)])
    return (
        f"the graph has {len(sizes)} parts that no measurement joins ({parts}); their relative position is the initial "
        "guess"
    )


READINGS = {
    "exchanged": "with its two variables exchanged",
    "transposed": "with its rotation transposed",
    "mirrored": "with the other sign of its angle",
    "y flipped": "with the y axis flipped",
    "z flipped": "with the z axis flipped",
    "x, y exchanged": "with x and y exchanged",
}


def _misread(f: Finding) -> str:
    n = f.numbers
    ways = " or ".join(f"{kind} {READINGS[reading]}" for kind, reading in n["readings"])
    return (
        f"chi2 falls from {number(n['chi2'])} to {number(n['chi2_otherwise'])}, {number(n['dof'])} expected, when "
        f"measurements are read otherwise: {ways}"
    )


def _swapped(f: Finding) -> str:
    n, (first, second) = f.numbers, f.keys
    return (
        f"{first!r} and {second!r} are one another in {n['sightings']} sightings: exchanged, chi2 falls from "
        f"{number(n['chi2'])} to {number(n['chi2_otherwise'])}, {number(n['dof'])} expected"
    )


def _clock(f: Finding) -> str:
    n = f.numbers
    when = "after" if n["dt"] > 0 else "before"
    return (
        f"{n['kind']} was measured {abs(n['dt']):.3g} +- {n['sigma']:.2g} steps {when} its poses: chi2 falls by "
        f"{number(n['fall'])} with that offset, the chance of which is {n['chance']:.1g}"
    )


def _calibration(f: Finding) -> str:
    n, ways = f.numbers, [_calibrated(**calibration) for calibration in f.numbers["calibrations"]]
    several = " (nothing tells these apart)" if len(ways) > 1 else ""
    fall = f"from {number(n['chi2'])} to {number(n['chi2_otherwise'])}, {number(n['dof'])} expected"
    return f"{', or '.join(ways)}{several}; with that chi2 falls {fall}"


def _calibrated(kind: str, quantity: str, components: list[str], correction: list[float], sigma: list[float]) -> str:
    columns = zip(components, correction, sigma, strict=True)
    off = ", ".join(f"{name} {in_unit(c, unit(name))} +- {in_unit(s, unit(name))}" for name, c, s in columns)
    return f"{'the sensor of' if quantity == 'mounting' else 'odometry of'} {kind} is off by {off}"


def _outsized(f: Finding) -> str:
    n = f.numbers
    unit, comparison = (" m", "the median is") if n["quantity"] == "length" else ("", "the largest of the others is")
    quantity = f"{n['quantity']} of {n['component']}" if n["component"] else n["quantity"]
    return f"{n['factor']}: its {quantity} is {n['value']:.3g}{unit}, {comparison} {n['others']:.3g}{unit}"


def _systematic(f: Finding) -> str:
    kinds = some([f"{name} (the middle one {typical:.2g} times too far)" for name, typical in f.numbers["kinds"]])
    return (
        f"most measurements are off alike: {kinds}. Causes: a wrong sign, unit or frame; sigmas much too small; a "
        "local minimum; or most are outliers"
    )


def _doubtful(f: Finding) -> str:
    n, closure = f.numbers, f.kind is FindingKind.WRONG_CLOSURE
    text = f"{n['factor']}{', a loop closure,' if closure else ''} is probably wrong: "
    text += f"{n['sigmas']:.3g} sigmas from the prediction of all others"
    if n["rival"]:
        rival = f"one of {n['rivals']} others, such as {n['rival']}" if n["rivals"] > 1 else n["rival"]
        text += f"; or {rival}, as nothing tells them apart"
    if "removed" in n:
        pronoun = "it" if n["removed"] == 1 else f"these {n['removed']}"
        text += f"; without {pronoun} chi2 is {number(n['chi2_without'])}, {number(n['dof_without'])} expected"
    if n["readings"]:
        text += f". It fits {' or '.join(READINGS[reading] for reading in n['readings'])}"
    return text


def _many_outliers(f: Finding) -> str:
    factors = f.numbers["factors"]
    return f"at least {len(factors)} measurements do not fit the others, the worst: {some(factors)}"


def _sigmas(f: Finding) -> str:
    n = f.numbers
    ratio = n["chi2"] / n["expected"]
    without = ("", ", without the suspect", ", without the suspects")[min(n["without"], 2)]
    text = (
        f"{n['kind']}{without}: chi2 {number(n['chi2'])} is {number(float(f'{ratio:.2g}'))} times its expectation of "
    )
    text += number(n["expected"])
    return (
        text
        + {
            "small": f"; the middle one is {n['typical']:.2g} times too far off: sigmas about that much too small",
            "few": "; the middle one is as expected: a few are far off",
            "unknown": "; wrong sigmas, an outlier, or a local minimum",
            "large": f"; sigmas about {ratio**-0.5:.2g} times too large",
        }[n["cause"]]
    )


def _rejected(f: Finding) -> str:
    n = f.numbers
    return f"{n['kernel']} rejects {n['off']} of {n['of']} measurements of {n['factor']} at these values"


def _turn(f: Finding) -> str:
    n = f.numbers
    companions = ("", ", and so is another", f", and so are {n['others']} others")[min(n["others"], 2)]
    return f"{n['factor']}: its error is {n['error']:.3g}, nearly a turn{companions}; is it an angle?"


def _twins(f: Finding) -> str:
    a, b = f.keys
    return (
        f"{a!r} and {b!r} are {f.numbers['distance']:.2g} m apart, {f.numbers['sigmas']:.2g} sigmas, and never seen "
        "from one pose: the same point under two numbers?"
    )


def _unverified(f: Finding) -> str:
    n = f.numbers
    return f"accepted, not verified: {unverified(n['factors'], n['redundancy'], n['meters'], n['sigmas'])}"


def _repeated(f: Finding) -> str:
    n = f.numbers
    are = "measurement is" if n["count"] == 1 else "measurements are"
    return f"{n['count']} {are} in the graph again with the same numbers: {some(n['factors'], FEW)}"


def _unchecked(f: Finding) -> str:
    n = f.numbers
    if n["count"] == n["of"]:
        return "no measurement is checked by another: each fits whatever its number, and chi2 shows no error"
    few = n["count"] <= len(n["factors"])
    names = some(n["factors"]) if few else f"{n['count']} measurements, such as {', '.join(n['factors'][:FEW])}"
    if n["believed"]:
        return f"{names}: believed as stated, no other measurement checks {'it' if n['count'] == 1 else 'them'}"
    return f"no other measurement checks {names}: an error there cannot be seen"


SENTENCES: dict[FindingKind, Callable[[Finding], str]] = {
    FindingKind.IMPLAUSIBLE: _implausible,
    FindingKind.NOT_CONVERGED: _not_converged,
    FindingKind.NO_OPTIMUM: _no_optimum,
    FindingKind.LOCAL_MINIMUM: _local_minimum,
    FindingKind.ILL_CONDITIONED: _ill_conditioned,
    FindingKind.FREE: _free,
    FindingKind.UNMEASURED: _unmeasured,
    FindingKind.SEPARATE_PARTS: _separate_parts,
    FindingKind.MISREAD: _misread,
    FindingKind.SWAPPED: _swapped,
    FindingKind.CLOCK: _clock,
    FindingKind.CALIBRATION: _calibration,
    FindingKind.OUTSIZED: _outsized,
    FindingKind.SYSTEMATIC: _systematic,
    FindingKind.WRONG_CLOSURE: _doubtful,
    FindingKind.OUTLIER: _doubtful,
    FindingKind.MANY_OUTLIERS: _many_outliers,
    FindingKind.SIGMAS: _sigmas,
    FindingKind.REJECTED: _rejected,
    FindingKind.TURN: _turn,
    FindingKind.TWINS: _twins,
    FindingKind.UNVERIFIED: _unverified,
    FindingKind.REPEATED: _repeated,
    FindingKind.UNCHECKED: _unchecked,
}


def summary(e: Explanation) -> str:
    """One to three sentences: what is determined, whether chi2 is as expected, whether something is suspicious."""
    most = "at least " if e.capped else ""
    if e.nullity:
        free = f"{most}{e.nullity} {'direction is' if e.nullity == 1 else 'directions are'} free"
        determined = f"Of {e.unknowns:,} unknowns {free}."
    else:
        determined = f"{e.unknowns:,} unknowns, all determined."
    kinds = [finding.kind for finding in e.findings]
    if FindingKind.IMPLAUSIBLE in kinds:
        determined = f"Tables of the mission are implausible. {determined}"
    if FindingKind.NOT_CONVERGED in kinds:
        return f"{determined} No optimum was found."
    if FindingKind.NO_OPTIMUM in kinds:
        return f"{determined} The values are no optimum."
    if not e.dof > 0:
        fits = "As many measured numbers as unknowns: nothing checks them, chi2 says nothing."
    elif e.chi2 < 1e-6 * e.dof:
        fits = "chi2 is 0: these are numbers without noise."
    elif e.low <= e.chi2 <= e.high:
        fits = f"chi2, {number(e.chi2)}, is as expected."
    else:
        fits = f"chi2 is {number(e.chi2 / e.dof)} times its expectation ({number(e.chi2)}, {e.dof:,} expected)."
    remarks = []
    if FindingKind.LOCAL_MINIMUM in kinds:
        remarks.append("This is a local minimum.")
    if FindingKind.CALIBRATION in kinds:
        remarks.append("A calibration is off.")
    if closures := kinds.count(FindingKind.WRONG_CLOSURE):
        remarks.append(f"{closures} loop {'closure is' if closures == 1 else 'closures are'} probably wrong.")
    if outliers := kinds.count(FindingKind.OUTLIER):
        remarks.append(f"{outliers} {'measurement does' if outliers == 1 else 'measurements do'} not fit the others.")
    if FindingKind.MANY_OUTLIERS in kinds:
        remarks.append("Many measurements do not fit the others.")
    if not e.findings:
        remarks.append("Nothing suspicious.")
    return " ".join([determined, fits, *remarks])


def report(e: Explanation, shell: bool = False) -> str:
    """Everything in words, as a terminal shows it; advice for Python, or for the command line."""
    lines = [e.summary, ""]
    for first, findings in together(e.findings[:SHOWN]):
        lines += [f"{first + k}. {_stopped(sentence(finding))}" for k, finding in enumerate(findings)]
        about = f"{first} to {first + len(findings) - 1}: " if len(findings) > 1 else ""
        lines += [f"   -> {about}{words}" for words in listed(findings[0].advice, shell)]
    if (more := len(e.findings) - SHOWN) > 0:
        lines.append(f"and {more} more findings")
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
        lines += ["", "largest residuals                 normalized  residual/sigma     p-value"]
        lines += [
            f"{worst.factor:36s} {worst.normalized:6.3g} {worst.sigmas:15.3g} {worst.chance:11.2g}"
            for worst in sorted(e.worst[:5], key=lambda measurement: -measurement.normalized)
        ]
    if e.weakest:
        lines += ["", "least certain       sigma        median"]
        lines += [
            f"{f'{weak.key!r} {weak.component}':18s}  {in_unit(weak.sigma, weak.unit):12s} "
            f"{in_unit(weak.typical, weak.unit)}"
            for weak in e.weakest
        ]
    return "\n".join(lines)


def together(findings: Sequence[Finding]) -> list[tuple[int, list[Finding]]]:
    """Findings that follow each other and have the same advice, together; with the number of the first, from 1."""
    groups: list[tuple[int, list[Finding]]] = []
    for count, finding in enumerate(findings, 1):
        if groups and groups[-1][1][0].advice == finding.advice:
            groups[-1][1].append(finding)
        else:
            groups.append((count, [finding]))
    return groups


def _row(part: Part) -> str:
    within = f"{number(part.low)} - {number(part.high)}" if part.expected > 1e-6 else "-"
    return f"{part.name:28s} {part.measurements:8,d} {number(part.chi2):>10s} {number(part.expected):>10s}   {within}"


def _stopped(text: str) -> str:
    """With a full stop; names of variables keep their small letter."""
    return text if text.endswith((".", "?")) else f"{text}."
