"""Every kind of finding and every action in words, for a snapshot that shows in a diff how the library speaks.

python -m tests.nls.explanation.sentences          writes sentences.txt anew
"""

from __future__ import annotations

from pathlib import Path

import nls
from models.advice import ACTIONS, Advice
from models.findings import Stated
from nls import Finding
from nls import FindingKind as Kind
from nls.explanation.findings import ChoiceKind
from nls.missions.checks.findings import Cause, Explained, Reading, SetupFinding, SetupKind, Trial
from nls.robust import Doubt, DoubtKind

__all__ = ["SNAPSHOT", "sentences"]

SNAPSHOT = Path(__file__).with_name("sentences.txt")
x, l = nls.kinds("x", "l")
FREE = {"moved": "alone", "directions": ("range",), "seen_from": ("x0",), "seen_once": True}
DOUBT = {"factor": "Between(x3, x9)", "sigmas": 12.3, "rivals": 0, "rival": "", "readings": ()}
REMOVED = {"removed": 2, "chi2_without": 31.4, "dof_without": 30.0}
PART = {"kind": "Between", "without": 0, "chi2": 400.0, "expected": 100.0, "typical": 2.1}
GROUP = ("Between(x3, x9)", "Between(x4, x10)")
CARRIED = {"factors": GROUP, "redundancy": 0.01, "meters": 12.0, "rms": 4.0, "sigmas": 40.0}
FALL = {"chi2": 4000.0, "chi2_otherwise": 110.0, "dof": 100}
TURNED = {"quantity": "mounting", "components": ("x", "yaw"), "correction": (-0.5, 0.52), "sigma": (0.01, 0.004)}
SCALED = {"quantity": "odometry", "components": ("scale",), "correction": (1.14,), "sigma": (0.003,)}
OUT = {"factor": "Between(x3, x4)", "value": 1e9, "others": 1.0}
SPEED = {"check": "speed", "file": "dvl.csv", "line": 2, "column": "vx_m_s", "measured": 1400.0, "limit": 10.0}
MM = {"cause": "unit", "file": "dvl.csv", "column": "vx_m_s", "factor": 1000.0}
FINDINGS = (
    Finding(Kind.IMPLAUSIBLE, (), SPEED | {"unit": "m/s", "readings": (MM,)}),
    Finding(Kind.NOT_CONVERGED, (), {"reason": "something is free", "values": "at the initial guess"}),
    Finding(Kind.NO_OPTIMUM, (), {"fall": 12.3, "chi2": 45.6}),
    Finding(Kind.LOCAL_MINIMUM, (), {"lower": 12.3, "chi2": 45.6}),
    Finding(Kind.ILL_CONDITIONED),
    Finding(Kind.INTERRUPTED),
    Finding(Kind.FREE, (x[0],), {"moved": "as one", "directions": ("x", "yaw about x0"), "variables": 5}),
    Finding(Kind.FREE, (x[0], x[1]), {"moved": "together", "components": (("x",), ("x", "yaw"))}),
    Finding(Kind.FREE, (x[0],), {"moved": "together", "components": (("x", "yaw"),)}),
    Finding(Kind.FREE, (l[0],), FREE),
    Finding(Kind.FREE, (l[0], l[1]), FREE | {"seen_from": ("x0", "x4"), "seen_once": False}),
    Finding(Kind.FREE, (l[0],), FREE | {"seen_from": ()}),
    Finding(Kind.UNMEASURED, (x[5], x[7])),
    Finding(Kind.SEPARATE_PARTS, (x[0], x[10]), {"variables": (10, 4)}),
    Finding(Kind.MISREAD, (), FALL | {"readings": (("BearingRange", "mirrored"), ("Between", "y flipped"))}),
    Finding(Kind.SWAPPED, (l[3], l[7]), FALL | {"sightings": 4}),
    Finding(Kind.CLOCK, (), {"kind": "Position", "dt": -0.3, "sigma": 0.02, "chance": 1e-9, "fall": 123.0}),
    Finding(Kind.CALIBRATION, (), FALL | {"calibrations": ({"kind": "RangeAzimuth"} | TURNED,)}),
    Finding(Kind.CALIBRATION, (), FALL | {"calibrations": ({"kind": "Range"} | TURNED, {"kind": "Between"} | SCALED)}),
    Finding(Kind.OUTSIZED, (x[3], x[4]), OUT | {"quantity": "length", "component": ""}),
    Finding(Kind.OUTSIZED, (x[3], x[4]), OUT | {"quantity": "information", "component": "yaw"}),
    Finding(Kind.SYSTEMATIC, (), {"kinds": (("Between, steps", 29.0), ("Heading", 8.0))}),
    Finding(Kind.WRONG_CLOSURE, (x[3], x[9]), DOUBT, (), ((1, 4),), ("survey.g2o:17",)),
    Finding(Kind.WRONG_CLOSURE, (x[3], x[9]), DOUBT | REMOVED | {"readings": ("exchanged",)}),
    Finding(Kind.OUTLIER, (x[3], x[9]), DOUBT | {"rivals": 3, "rival": "Between(x1, x2)"}),
    Finding(Kind.MANY_OUTLIERS, (), {"factors": ("Between(x3, x9)", "Between(x4, x8)")}),
    *(Finding(Kind.SIGMAS, (), PART | {"cause": cause}) for cause in ("small", "few", "unknown")),
    Finding(Kind.SIGMAS, (), PART | {"cause": "large", "chi2": 10.0, "without": 2}),
    Finding(Kind.REJECTED, (x[0],), {"kernel": "Tukey(3)", "off": 4, "of": 5, "factor": "Between(x[0:5], x[1:6])"}),
    Finding(Kind.TURN, (x[1], l[0]), {"factor": "minus(x1, l0)", "error": -6.27, "others": 2}),
    Finding(Kind.TWINS, (l[1], l[2]), {"distance": 0.12, "sigmas": 0.8}),
    Finding(Kind.UNVERIFIED, (x[3], x[9]), CARRIED),
    Finding(Kind.UNVERIFIED, (x[3], x[9]), CARRIED | {"meters": float("inf"), "sigmas": float("inf")}),
    Finding(Kind.NOT_TRIED, (), {"causes": ["other readings", "exchanged landmarks"], "measurements": 96_000}),
    Finding(Kind.REPEATED, (x[0], x[4]), {"count": 1, "factors": ("Between(x0, x4)",)}),
    Finding(Kind.UNCHECKED, (x[0],), {"count": 1, "of": 9, "factors": ("Prior(x0)",), "believed": True}),
    Finding(Kind.UNCHECKED, (x[3],), {"count": 1, "of": 9, "factors": ("ZPR(x3)",), "believed": False}),
    Finding(Kind.UNCHECKED, (x[0],), {"count": 9, "of": 9, "factors": ("Prior(x0)",), "believed": False}),
)
CHOICE = {"count": 17, "doubted": 2450, "by_chance": 24.6, "probability": 0.99, "sigma0": 1.01, "far": 3, "most": 291.2}
FEW = {"count": 2, "doubted": 30, "by_chance": 0.028, "probability": 0.999, "sigma0": 1.0, "far": 0, "most": 0.0}
OFF = {"value": 0.2, "sigma": 0.01, "mount": [0.5, 0.0, 0.2]}
CHI2 = {"chi2": 360.0, "dof": 90.0, "scale": 2.0}
DECLINATION = Trial(Reading(Cause.CALIBRATION, "calibration.csv", "declination_rad", -0.22), 0.003, 95.0, 100)
FIXES = Trial(Reading(Cause.CALIBRATION, "calibration.csv", "fixes_clock_s", 3.1), 0.2, 95.0, 100)
ARM = Trial(Reading(Cause.ARM, "dvl_mount.csv", "x_m", -3.0), 0.2, 95.0, 100)
KERNEL = Trial(Reading(Cause.KERNEL, "fixes.csv", "Position", 0.07), 0.0, 95.0, 100)
ROOMS: tuple[Stated, ...] = (  # of choices, doubts, scan setups and missions
    Finding(ChoiceKind.REJECTED, (), CHOICE),
    Finding(ChoiceKind.REJECTED, (), FEW),
    Finding(ChoiceKind.CONTACTS, (), CHOICE),
    Finding(ChoiceKind.LEFT, (), {"landmarks": ["l1", "l2", "l3", "l4"], "count": 9}),
    *(Doubt(kind, 3, 9, 1.234, 0.0567, 1.5, 0.02, 4.3) for kind in DoubtKind),
    SetupFinding(SetupKind.UNREPEATED, {"scans": 150, "fit": 12}),
    SetupFinding(SetupKind.MIRRORED, {"given": 3, "mirrored": 60}),
    *(SetupFinding(SetupKind.MOUNTING, OFF | {"component": name}) for name in ("x", "y", "yaw")),
    SetupFinding(SetupKind.TURNED, OFF),
    *(SetupFinding(SetupKind.TIME_OFFSET, OFF | {"value": late}) for late in (1.0, -1.0)),
    SetupFinding(SetupKind.SIGMAS_TOO_LARGE, CHI2 | {"measurements": "drifts", "scale": 0.5}),
    SetupFinding(SetupKind.SIGMAS_TOO_SMALL, CHI2 | {"measurements": "steps"}),
    SetupFinding(SetupKind.SIGMAS_TOO_SMALL, CHI2 | {"measurements": "closures"}),
    Explained(4000.0, 100, ()),
    *(Explained(4000.0, 100, trials) for trials in ((DECLINATION,), (FIXES, ARM), (KERNEL,))),
)


def sentences() -> str:
    """All of them, one a line; of an action how Python writes it and how the command line does."""
    assert {finding.kind for finding in FINDINGS} == set(Kind)
    assert {room.kind for room in ROOMS} >= {*ChoiceKind, *DoubtKind, *SetupKind}
    lines = [f"{finding.record().get('kind', finding.kind)}: {finding.says}" for finding in (*FINDINGS, *ROOMS)]
    for action in ACTIONS:
        advice = Advice(action, ("A", "B", "c"))
        both = list(dict.fromkeys([advice.words(), advice.words(shell=True)]))
        lines += [f"{action}: {both[0]}", *(f"    shell: {words or '-'}" for words in both[1:])]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    SNAPSHOT.write_text(sentences(), encoding="utf-8")
