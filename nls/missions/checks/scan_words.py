"""Findings about the setup of a scan mission, and what the scans tell of the mounting, in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import degrees, isnan
from typing import Any

from models.finite import finite_or_none
from nls.missions.checks.scan_mounting import COMPONENTS, Mounting
from nls.missions.checks.scan_setup import SetupFinding, SetupKind

__all__ = ["observable", "record", "sentence"]

SONAR, DRIFT = "in the section [sonar] of mission.toml", "in the section [drift] of mission.toml"
ABSORBED = 0.8  # correlation of yaw with the drift to the side
SHOWN_BY = {  # a component that is not determined
    "x": "it shows in steps that turn",
    "y": "it shows in steps that turn",
    "yaw": "it shows where the drift to the side is known",
    "time": "it shows where speed or rate of turn change",
}
Numbers = Mapping[str, Any]


def sentence(finding: SetupFinding) -> str:
    """A finding in words: the thing, its number, what to do."""
    return SENTENCES[finding.kind](finding.numbers)


def record(finding: SetupFinding) -> dict[str, Any]:
    """A finding for programs, and in words."""
    return {
        "kind": finding.kind.value,
        "numbers": finite_or_none(dict(finding.numbers)),
        "sentence": sentence(finding),
    }


def observable(estimate: Mounting) -> list[str]:
    """One line for every component of the mounting, and for the clock: value and sigma, or why it is not determined."""
    lines = []
    for name, value, sigma, determined in zip(
        COMPONENTS, estimate.value, estimate.sigma, estimate.determined, strict=True
    ):
        if isnan(value):
            continue
        line = f"{LABELS[name]}: not determined by {estimate.steps} pairs of scans; {SHOWN_BY[name]}"
        if determined:
            line = f"{LABELS[name]}: {_shown(name, value)} +- {_shown(name, sigma)} from the assumed value"
        if name == "yaw" and abs(estimate.drift) > ABSORBED:
            line += f" (correlation {estimate.drift:.2f} with the drift to the side)"
        lines.append(line)
    return lines


def _shown(name: str, value: float) -> str:
    return f"{degrees(value):.2g} deg" if name == "yaw" else f"{value:.2g} {'s' if name == 'time' else 'm'}"


def _unrepeated(n: Numbers) -> str:
    return (
        f"scans do not show the same things from keyframe to keyframe: {n['fit']} of {n['scans']} fit those just "
        "before them. Closures of such points are chance: detect fewer and stronger echoes, or check the units of "
        "ranges and azimuths"
    )


def _mirrored(n: Numbers) -> str:
    return (
        f"azimuths look mirrored: {n['mirrored']} steps that turn fit the other sign better, {n['given']} fit this one."
        f' Change the positive side, azimuth = "left" or "right", {SONAR}'
    )


def _mounting(n: Numbers) -> str:
    name = n["component"]
    key, k = {"x": ("x_m", 0), "y": ("y_m", 1), "yaw": ("yaw_rad", 2)}[name]
    return (
        f"{LABELS[name]} looks wrong by {_shown(name, n['value'])} +- {_shown(name, n['sigma'])}. Write {key} = "
        f"{n['mount'][k]:.3g} {SONAR}, or measure it on the vehicle"
    )


def _turned(n: Numbers) -> str:
    return (
        f"the sonar looks turned by {_shown('yaw', n['value'])} +- {_shown('yaw', n['sigma'])} from the assumed yaw. A "
        f"drift of the vehicle to the side by {abs(n['value']):.2g} m per meter looks the same in scans. If nothing "
        f"drifts, write yaw_rad = {n['mount'][2]:.3g} {SONAR}; the map turns with it"
    )


def _time_offset(n: Numbers) -> str:
    late, act = ("late", "subtract") if n["value"] > 0 else ("early", "add")
    return (
        f"times of the scans look {abs(n['value']):.3g} +- {n['sigma']:.2g} s {late} against the track: {act} "
        f"{abs(n['value']):.3g} s, or set both clocks. Then choose the scans of the keyframes again"
    )


def _sigmas(n: Numbers) -> str:
    scale = n["scale"]
    size, act = (
        (f"{1 / scale:.2g} times too large", "smaller") if scale < 1 else (f"{scale:.2g} times too small", "larger")
    )
    names = {"steps": "step and yaw", "drifts": "mean and stretch"}.get(n["measurements"])
    cure = CLOSURES[act] if names is None else f"State a {act} {names} {DRIFT}"
    return (
        f"sigmas of the {n['measurements']} look {size}: chi2 {n['chi2']:.0f}, {n['dof']:.0f} expected, chi2/dof "
        f"{n['chi2'] / n['dof']:.2f}. {cure}"
    )


CLOSURES = {
    "smaller": "Covariances of the map are too wide by as much",
    "larger": "Covariances of the map are too narrow by as much: look at the mounting and at the noise of the points",
}
LABELS = {
    "x": "place of the sonar ahead",
    "y": "place of the sonar to the side",
    "yaw": "yaw of the sonar",
    "time": "time by which scans are late",
}
SENTENCES: dict[SetupKind, Callable[[Numbers], str]] = {
    SetupKind.UNREPEATED: _unrepeated,
    SetupKind.MIRRORED: _mirrored,
    SetupKind.MOUNTING: _mounting,
    SetupKind.TURNED: _turned,
    SetupKind.TIME_OFFSET: _time_offset,
    SetupKind.SIGMAS_TOO_LARGE: _sigmas,
    SetupKind.SIGMAS_TOO_SMALL: _sigmas,
}
