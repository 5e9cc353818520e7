"""Findings in words: one sentence a kind; then a report with the verdict first, the cures, and the numbers behind."""

from collections.abc import Mapping, Sequence
from itertools import accumulate, groupby
from math import isfinite
from typing import Any

from models.advice import listed
from models.findings import Sentences
from models.listing import number, several, some
from models.manifolds.units import unit
from nls.analysis.observable import in_unit
from nls.explanation.findings import ChoiceKind, Explanation, Finding, FindingKind, Part

FEW = 3  # of a list of measurements, or landmarks
READINGS = {
    "exchanged": "with its two variables exchanged",
    "transposed": "with its rotation transposed",
    "mirrored": "with the other sign of its angle",
    "y flipped": "with the y axis flipped",
    "z flipped": "with the z axis flipped",
    "x, y exchanged": "with x and y exchanged",
}


def directions(f: Finding) -> list[str]:
    """Every free direction of a finding in words; none of a finding of another kind."""
    if f.kind is not FindingKind.FREE:
        return []
    n = f.numbers
    if n["moved"] == "together":
        return [_together(f)]
    if n["moved"] == "as one":
        return [f"{name} {_scope(f)}" for name in n["directions"]]
    poses = n["seen_from"] or [""] * len(f.keys)
    return [
        f"{key!r}: {name}" + (f" as seen from {pose}" if pose else "")
        for key, pose in zip(f.keys, poses, strict=True)
        for name in n["directions"]
    ]


def _together(f: Finding) -> str:
    moved, several = f.numbers["components"], len(f.keys) > 1
    names = [f"{(', ' if several else ' and ').join(own)} of {key!r}" for key, own in zip(f.keys, moved, strict=True)]
    alone = sum(map(len, moved)) == 1
    return f"{some(names)} {'can move' if alone else 'can move together' if several else 'cannot be distinguished'}"


def _scope(f: Finding) -> str:
    count = f.numbers["variables"]
    return f"of {f'all {count} variables connected to ' if count > 1 else ''}{f.keys[0]!r}"


def _free(f: Finding) -> str:
    n = f.numbers
    if n["moved"] == "together":
        return _together(f)
    names = ", ".join(n["directions"])
    if n["moved"] == "as one":
        return f"{names} {_scope(f)}, moved as one"
    if not n["seen_from"]:
        return f"{names} of {some(f.keys)}: no measurement depends on {_pronoun(len(f.keys))}"
    points = some([f"{key!r} (from {pose})" for key, pose in zip(f.keys, n["seen_from"], strict=True)])
    count = "this point is" if len(f.keys) == 1 else f"these {len(f.keys)} points are"
    how = "observed " + ("once" if n["seen_once"] else "only along directions that do not determine it")
    return f"{names} of {points}, as seen by the sensor: {count} {how}"


def _pronoun(count: int) -> str:
    return "it" if count == 1 else "them"


def _separate_parts(f: Finding) -> str:
    sizes = f.numbers["variables"]
    parts = some([f"{size} with {key!r}" for size, key in zip(sizes, f.keys, strict=True)])
    parted = f"the graph has {len(sizes)} parts that no measurement connects ({parts})"
    return f"{parted}; their relative position is the initial guess"


def _fall(n: Mapping[str, Any]) -> str:
    return f"chi2 falls from {number(n['chi2'])} to {number(n['chi2_otherwise'])}, {number(n['dof'])} expected"


def _misread(f: Finding) -> str:
    ways = " or ".join(f"{kind} {READINGS[reading]}" for kind, reading in f.numbers["readings"])
    return f"{_fall(f.numbers)}, if measurements are read differently: {ways}"


def _swapped(f: Finding) -> str:
    count = f.numbers["sightings"]
    return f"{f.keys[0]!r} and {f.keys[1]!r} are exchanged in {count} sightings: corrected, {_fall(f.numbers)}"


def _clock(f: Finding) -> str:
    n = f.numbers
    when = "after" if n["dt"] > 0 else "before"
    return (
        f"{n['kind']} was measured {abs(n['dt']):.3g} +- {n['sigma']:.2g} steps {when} its poses: that offset lowers "
        f"chi2 by {number(n['fall'])} (probability by chance {n['chance']:.1g})"
    )


def _calibration(f: Finding) -> str:
    ways = [_calibrated(**calibration) for calibration in f.numbers["calibrations"]]
    several = " (the data do not distinguish them)" if len(ways) > 1 else ""
    return f"{', or '.join(ways)}{several}; with that {_fall(f.numbers)}"


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
    kinds = some([f"{name} (median residual {typical:.2g} times too large)" for name, typical in f.numbers["kinds"]])
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
        text += f"; or {rival}: the data do not distinguish them"
    if "removed" in n:
        without = "it" if n["removed"] == 1 else f"these {n['removed']}"
        text += f"; without {without} chi2 is {number(n['chi2_without'])}, {number(n['dof_without'])} expected"
    if n["readings"]:
        text += f". It fits {' or '.join(READINGS[reading] for reading in n['readings'])}"
    return text


def _many_outliers(f: Finding) -> str:
    factors = f.numbers["factors"]
    return f"at least {len(factors)} measurements do not fit the others, the worst: {some(factors)}"


def _sigmas(f: Finding) -> str:
    n = f.numbers
    ratio, without = n["chi2"] / n["expected"], ("", ", without the suspect", ", without the suspects")
    cause = {
        "small": f"the median residual is {n['typical']:.2g} times too large: sigmas about that much too small",
        "few": "the median residual is as expected: a few are outliers",
        "unknown": "wrong sigmas, an outlier, or a local minimum",
        "large": f"sigmas about {ratio**-0.5:.2g} times too large",
    }[n["cause"]]
    times = f"{number(float(f'{ratio:.2g}'))} times its expectation of {number(n['expected'])}"
    return f"{n['kind']}{without[min(n['without'], 2)]}: chi2 {number(n['chi2'])} is {times}; {cause}"


def _turn(f: Finding) -> str:
    n = f.numbers
    companions = ("", ", and so is another", f", and so are {n['others']} others")[min(n["others"], 2)]
    return f"{n['factor']}: its error is {n['error']:.3g}, nearly a turn{companions}; is it an angle?"


def _unverified(f: Finding) -> str:
    n, (first, *others) = f.numbers, f.numbers["factors"]
    accepted = f"and {several(len(others), 'more closure')} join the same stretches" if others else "is accepted"
    moves = f"the map moves {n['meters']:.3g} m ({n['sigmas']:.2g} sigmas)"
    motion = moves if isfinite(n["meters"]) else "the graph falls apart"
    which = _pronoun(len(n["factors"]))
    unchecked = f"but nothing else checks {which} (redundancy {n['redundancy']:.2f})"
    return f"{first} {accepted}, {unchecked}; without {which} {motion}"


def _repeated(f: Finding) -> str:
    n = f.numbers
    are = "measurement is" if n["count"] == 1 else "measurements are"
    return f"{n['count']} {are} in the graph again with the same numbers: {some(n['factors'], FEW)}"


def _unchecked(f: Finding) -> str:
    n = f.numbers
    if n["count"] == n["of"]:
        return "no measurement checks another: each fits whatever its value, so chi2 cannot show an error"
    few = n["count"] <= len(n["factors"])
    names = some(n["factors"]) if few else f"{n['count']} measurements, such as {', '.join(n['factors'][:FEW])}"
    if n["believed"]:
        return f"{names}: taken as stated, no other measurement checks {_pronoun(n['count'])}"
    return f"no other measurement checks {names}: an error there cannot be seen"


def _rejected(f: Finding) -> str:
    n = f.numbers
    scaled = "" if f"{n['sigma0']:.3g}" == "1" else f" (sigmas times {n['sigma0']:.3g})"
    which = "all of them" if n["far"] == n["count"] else f"{n['far']:,} of them"
    far = f", {which} far off, by up to {n['most']:.3g} sigmas" if n["far"] else ""
    right = "less than one is" if n["by_chance"] < 1 else f"about {n['by_chance']:.0f} are"
    expected = f"; {right} expected by chance at {100 * n['probability']:.6g} %" if n["far"] < n["count"] else ""
    return f"{n['count']:,} of {n['doubted']:,} tested measurements rejected{scaled}{far}{expected}"


def _left(f: Finding) -> str:
    n = f.numbers
    return f"{some(n['landmarks'], FEW)} removed with them: too few of their {n['count']} tested measurements agree"


SENTENCES: Sentences = {
    FindingKind.INTERRUPTED: (
        "interrupted: the search for outliers and their causes has not ended; the tables below are complete"
    ),
    FindingKind.NOT_CONVERGED: "no optimum was found ({reason}); the other findings describe the values {values}",
    FindingKind.NO_OPTIMUM: (
        "these values are no optimum: one Gauss-Newton step lowers chi2 by {fall!n}, from {chi2!n}; residuals are "
        "those after that step"
    ),
    FindingKind.LOCAL_MINIMUM: (
        "these values are a local minimum: chi2 is {chi2!n} here and {lower!n} at another minimum, found without the "
        "suspects; the findings below are about that one"
    ),
    FindingKind.ILL_CONDITIONED: (
        "weights or scales of the measurements differ too much for A'A, which keeps 13 digits"
    ),
    FindingKind.FREE: _free,
    FindingKind.UNMEASURED: "{keys!l}: no measurement; the value is the initial guess",
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
    FindingKind.REJECTED: "{kernel} rejects {off} of {of} measurements of {factor} at these values",
    FindingKind.TURN: _turn,
    FindingKind.TWINS: (
        "{0!r} and {1!r} are {distance:.2g} m apart, {sigmas:.2g} sigmas, and never seen from one pose: the same point "
        "under two numbers?"
    ),
    FindingKind.UNVERIFIED: _unverified,
    FindingKind.NOT_TRIED: lambda f: (
        f"{' and '.join(f.numbers['causes'])} were not tried to their end as causes: that takes dozens of "
        f"optimizations of {f.numbers['measurements']:,} measurements"
    ),
    FindingKind.REPEATED: _repeated,
    FindingKind.UNCHECKED: _unchecked,
    ChoiceKind.REJECTED: _rejected,
    ChoiceKind.CONTACTS: (
        "{count:,} of {doubted:,} contacts rejected; {by_chance:.0f} expected by chance at {probability!p:.6g} %"
    ),
    ChoiceKind.LEFT: _left,
}


def summary(e: Explanation) -> str:
    """One to three sentences: undetermined unknowns, chi2 against its expectation, suspicious findings."""
    kinds = [finding.kind for finding in e.findings]
    determined = "Tables of the mission are implausible. " if FindingKind.IMPLAUSIBLE in kinds else ""
    if e.nullity:
        free = f"{e.nullity} {'direction is' if e.nullity == 1 else 'directions are'} free"
        determined += f"Of {e.unknowns:,} unknowns {'at least ' if e.capped else ''}{free}."
    else:
        determined += f"{e.unknowns:,} unknowns, all determined."
    if FindingKind.NOT_CONVERGED in kinds:
        return f"{determined} No optimum was found."
    if FindingKind.NO_OPTIMUM in kinds:
        return f"{determined} The values are no optimum."
    if not e.dof > 0:
        fits = "There are as many measured numbers as unknowns: without redundancy, chi2 says nothing."
    elif e.chi2 < 1e-6 * e.dof:
        fits = "chi2 is 0: the data have no noise."
    elif e.low <= e.chi2 <= e.high:
        fits = f"chi2, {number(e.chi2)}, is as expected."
    else:
        fits = f"chi2 is {number(e.chi2 / e.dof)} times its expectation ({number(e.chi2)}, {e.dof:,} expected)."
    closures, outliers = kinds.count(FindingKind.WRONG_CLOSURE), kinds.count(FindingKind.OUTLIER)
    remarks = {
        "This is a local minimum.": FindingKind.LOCAL_MINIMUM in kinds,
        "A calibration is off.": FindingKind.CALIBRATION in kinds,
        f"{closures} loop {'closure is' if closures == 1 else 'closures are'} probably wrong.": closures,
        f"{outliers} {'measurement does' if outliers == 1 else 'measurements do'} not fit the others.": outliers,
        "Many measurements do not fit the others.": FindingKind.MANY_OUTLIERS in kinds,
        "Nothing suspicious.": not kinds,
    }
    return " ".join([determined, fits, *(remark for remark, due in remarks.items() if due)])


def report(e: Explanation, shell: bool = False) -> str:
    """Everything in words, as a terminal shows it; advice for Python, or for the command line."""
    lines, shown = [e.summary, ""], 12
    for first, findings in together(e.findings[:shown]):
        lines += [f"{k}. {f.says}{'' if f.says.endswith(('.', '?')) else '.'}" for k, f in enumerate(findings, first)]
        about = f"{first} to {first + len(findings) - 1}: " if len(findings) > 1 else ""
        lines += [f"   -> {about}{words}" for words in listed(findings[0].advice, shell)]
    if (more := len(e.findings) - shown) > 0:
        lines.append(f"and {more} more findings")
    lines += [""] if e.findings else []
    parts = f"{len(e.components)} parts" if len(e.components) != 1 else "one part"
    size = f"{e.variables:,} variables in {parts}, {e.measurements:,} measurements ({e.rows:,} numbers)"
    free = f", {'at least ' if e.capped else ''}{e.nullity} free" if e.nullity else ""
    lines += [
        f"graph       {size}; gauge: {e.gauge}",
        f"rank        {'at most ' if e.capped else ''}{e.rank:,} of {e.unknowns:,} unknowns{free}",
    ]
    if e.dof > 0:
        within = f"{number(e.low)} to {number(e.high)} in 95 % of all cases"
        kernels = ", without kernels" if e.robust else ""
        lines.append(f"chi2        {number(e.chi2)}, {e.dof:,} expected ({within}){kernels}")
    if e.chi2_without is not None:
        chi2, dof = map(number, e.chi2_without)
        lines.append(f"            {chi2} without the suspects, {dof} expected")
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
    groups = [list(alike) for _, alike in groupby(findings, key=lambda finding: finding.advice)]
    return [(end - len(alike) + 1, alike) for end, alike in zip(accumulate(map(len, groups)), groups, strict=True)]


def _row(part: Part) -> str:
    within = f"{number(part.low)} - {number(part.high)}" if part.expected > 1e-6 else "-"
    return f"{part.name:28s} {part.measurements:8,d} {number(part.chi2):>10s} {number(part.expected):>10s}   {within}"
