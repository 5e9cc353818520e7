"""The result of `nls.explain`: numbers, findings and advice; `nls.explanation.words` makes sentences of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from html import escape
from typing import Any

from factors.keys import Keys
from models.advice import Advice, listed
from models.findings import Stated, plain, register
from models.listing import some

SCHEMA = "explain 1"  # name and version of schema.json, which describes the report for programs
RECORDED = "summary variables unknowns measurements rows gauge rank nullity chi2 dof robust"  # fields of the record


class FindingKind(StrEnum):
    """The subject of a finding, the identifier that programs get; ``implausible`` ones come from `nls.missions`."""

    INTERRUPTED = "interrupted"
    IMPLAUSIBLE = "implausible"
    NOT_CONVERGED = "not_converged"
    NO_OPTIMUM = "no_optimum"
    LOCAL_MINIMUM = "local_minimum"
    ILL_CONDITIONED = "ill_conditioned"
    FREE = "free"
    UNMEASURED = "unmeasured"
    SEPARATE_PARTS = "separate_parts"
    MISREAD = "misread"
    SWAPPED = "swapped"
    CLOCK = "clock"
    CALIBRATION = "calibration"
    OUTSIZED = "outsized"
    SYSTEMATIC = "systematic"
    WRONG_CLOSURE = "wrong_closure"
    OUTLIER = "outlier"
    MANY_OUTLIERS = "many_outliers"
    SIGMAS = "sigmas"
    REJECTED = "rejected"
    TURN = "turn"
    TWINS = "twins"
    UNVERIFIED = "unverified"
    NOT_TRIED = "not_tried"
    REPEATED = "repeated"
    UNCHECKED = "unchecked"


class ChoiceKind(StrEnum):
    """The subject of a finding about a robust choice."""

    REJECTED = "rejected_measurements"
    CONTACTS = "rejected_contacts"
    LEFT = "left_landmarks"


register("nls.explanation.words", *(set(FindingKind) - {FindingKind.IMPLAUSIBLE}), *ChoiceKind)


@dataclass(frozen=True)
class Finding(Stated):
    """One thing that is wrong, or that one should know.

    Attributes
    ----------
    kind : of the finding.
    keys : the variables it is about.
    numbers : by name: how many, how far, which factors; the theory page on explanations lists them by kind.
    advice : what helps.
    measurements : (factor of the graph, measurement of that factor) of those it is about, the first few.
    places : their lines, ``survey.g2o:17``, where the graph came from a file.
    """

    kind: FindingKind | ChoiceKind
    keys: tuple[Keys, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    advice: tuple[Advice, ...] = ()
    measurements: tuple[tuple[int, int], ...] = ()
    places: tuple[str, ...] = ()

    @property
    def says(self) -> str:
        """The finding in a sentence, without cures."""
        return super().says + (f" [{some(list(dict.fromkeys(self.places)), 3)}]" if self.places else "")

    def record(self) -> dict[str, Any]:
        """The finding for programs, and in words as the command line has them."""
        names = ("kind", "keys", "numbers", "places", "advice")
        data = {name: plain(getattr(self, name)) for name in names}
        return data | {"sentence": self.says, "cures": listed(self.advice, shell=True)}


@dataclass(frozen=True)
class Part:
    """chi2 of one kind of measurement.

    Attributes
    ----------
    name : factor type; relative poses in two, steps and closures, where there are both.
    measurements, rows : how many, and how many numbers.
    chi2 : sum of squared whitened errors at the values, before any robust kernel.
    expected : degrees of freedom: rows less what the kind has spent on the unknowns.
    low, high : within which chi2 is in 95 % of all cases.
    typical : variance of the middle measurement of the kind, 1 expected; outliers do not move it. nan of one or two.
    """

    name: str
    measurements: int
    rows: int
    chi2: float
    expected: float
    low: float
    high: float
    typical: float


@dataclass(frozen=True)
class Measurement:
    """One measurement against the prediction of all others.

    Attributes
    ----------
    factor : ``Between(x3, x90)``.
    keys : its variables.
    chi2, sigmas : |b_i|^2 at the values, and its root.
    normalized : distance from the prediction of all others, in sigmas of the difference.
    chance : of one such measurement among all of them, if the model is right.
    """

    factor: str
    keys: tuple[Keys, ...]
    chi2: float
    sigmas: float
    normalized: float
    chance: float


@dataclass(frozen=True)
class Weak:
    """The least certain component of a variable among its like.

    Attributes
    ----------
    key, component : ``x40``, ``yaw``; along the axes of the world.
    sigma : of it, in `unit`.
    typical : the middle sigma of its like.
    unit : ``m``, ``rad`` or empty.
    """

    key: Keys
    component: str
    sigma: float
    typical: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """A graph at some values, explained; ``print(explanation.report())``.

    Attributes
    ----------
    variables, unknowns, measurements, rows : how many; unknowns without what is fixed or held by the gauge.
    components : variables of every connected part, the largest first.
    gauge : what is held, in words.
    nullity : free directions besides; `capped` where there may be more.
    chi2, dof, low, high : before robust kernels; expected value and 95 % of it.
    promised : by how much chi2 would fall in one more Gauss-Newton step.
    robust : whether a measurement has a robust kernel: it counts with its weight, chi2 is the one without.
    findings : the important first.
    parts : chi2 by kind of measurement.
    worst : the most doubtful measurements, the worst first.
    suspects : those that do not fit what is left without them, in the order in which they were taken out.
    chi2_without : chi2 and degrees of freedom without the suspects; None where there are none.
    weakest : per kind and component the least certain variable.
    """

    variables: int
    unknowns: int
    measurements: int
    rows: int
    components: tuple[int, ...]
    gauge: str
    nullity: int
    capped: bool
    chi2: float
    dof: int
    low: float
    high: float
    promised: float
    robust: bool
    findings: tuple[Finding, ...]
    parts: tuple[Part, ...]
    worst: tuple[Measurement, ...]
    suspects: tuple[Measurement, ...]
    chi2_without: tuple[float, float] | None
    weakest: tuple[Weak, ...]

    @property
    def rank(self) -> int:
        """Directions that are determined; where `capped`, at most."""
        return self.unknowns - self.nullity

    @property
    def free(self) -> tuple[str, ...]:
        """Every free direction, in words."""
        from nls.explanation.words import directions

        return tuple(text for finding in self.findings for text in directions(finding))

    @property
    def summary(self) -> str:
        """One or two sentences."""
        from nls.explanation.words import summary

        return summary(self)

    def placed(self, place: Callable[[int, int], str]) -> Explanation:
        """The explanation with the lines of all measurements, from the function that gives the line of one."""
        findings = tuple(replace(f, places=tuple(place(*pair) for pair in f.measurements)) for f in self.findings)
        return replace(self, findings=findings)

    def report(self, shell: bool = False) -> str:
        """Everything in words, the verdict first; advice for Python or for the command line."""
        from nls.explanation.words import report

        return report(self, shell)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.report())}</pre>"

    def record(self) -> dict[str, Any]:
        """Everything for programs: numbers, texts, lists and dictionaries of these; m and rad."""
        return {
            "schema": SCHEMA,
            **{name: getattr(self, name) for name in RECORDED.split()},
            **{name: plain(getattr(self, name)) for name in ("parts", "worst", "suspects", "weakest")},
            "components": list(self.components),
            "nullity_is_at_least": self.capped,
            "quantiles": [self.low, self.high],
            "promised": plain(self.promised),
            "findings": [finding.record() for finding in self.findings],
            "free": list(self.free),
            "chi2_without": plain(self.chi2_without),
        }

    def __str__(self) -> str:
        return self.report()
