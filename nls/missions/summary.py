"""The lines of a table about the quality of the solution of a mission, from its record in the report for programs."""

from typing import Any

import numpy as np

SIZES = {"heading": "rad", "zero of the depth": "m", "scale": "of it", "place": "m", "clock": "s", "arm": "m"}


def lines(mission: dict[str, Any]) -> list[str]:
    """Lines of a mission, or of several dives."""
    out = [
        f"mission     {mission['poses']} poses over {mission['distance_m']:.4g} m, {mission['landmarks']} landmarks, "
        f"{mission['contacts']} contacts" + (f" by the sonar {mission['sonar']}" if mission["sonar"] else "")
    ]
    out += _unchecked(mission)
    if mission["judge"] is not None:
        drift, ate = _drift(mission)
        anchor = mission["anchor"]  # poses, or files
        held = f"anchored by {anchor}" if anchor.endswith(".csv") else f"{anchor} is anchored"
        out += [f"drift       {drift}", f"ATE         {ate} rmse (no alignment: {held})"]
    for dive in mission.get("dives", []):
        out.append(
            f"dive        {dive['name']}: {dive['poses']} poses over {dive['distance_m']:.4g} m, from x{dive['first']}"
        )
        if dive["judge"] is not None:
            drift, ate = _drift(dive)
            out.append(f"drift       {dive['name']}: {drift}; ATE {ate} rmse")
    if mission.get("landmark_rmse_m") is not None:
        out.append(f"landmarks   {mission['landmark_rmse_m']:.3g} m rmse, against landmarks.csv")
    if "elevation_sigma_deg" in mission:
        s = mission["elevation_sigma_deg"]
        edge = f"; {mission['at_limit']} landmarks at the edge of the aperture" if mission["at_limit"] else ""
        out.append(
            f"elevation   known to {s['median']:.2g} deg (median) and {s['largest']:.2g} deg (largest sigma){edge}"
        )
    if mission.get("mirrored"):
        out.append(
            f"mirrored    {mission['mirrored']} of {mission['landmarks']} landmarks fit as well on the other side of "
            "the plane of the sonar, see mirrored in map.csv; a view after heave or roll of the sonar decides"
        )
    out += [f"calibration {_calibrated(c)}" for c in mission.get("calibrations", [])]
    return out


def scan_lines(scans: dict[str, Any]) -> list[str]:
    """Lines of a map from scans."""
    out = [
        f"scans       {scans['keyframes']:,} keyframes over {scans['distance_m']:.4g} m, {scans['points']:,} "
        f"points in {scans['with_points']:,} of them"
    ]
    out += [
        f"round {number:<5d} {r['candidates']} candidates, {r['accepted']} accepted, {r['kept']} kept; chi2/dof "
        f"{r['chi2_dof']:.2f}; track moved {r['moved_m']:.2f} m rms"
        for number, r in enumerate(scans["rounds"], 1)
    ]
    if not scans["closures"]:
        nothing, rejected = "no two parts of the track show the same place", "no candidate is a closure"
        why = rejected if scans["rounds"][-1]["candidates"] else nothing
        out.append(f"unchecked   {why}: the solution is dead reckoning and matches of consecutive scans")
        if (sigma := scans.get("end_sigma_m")) is not None:
            out.append(f"end         1 sigma of the position at the end: {sigma:.3g} m, if nothing is wrong")
    elif scans["settled"]:
        out.append(f"settled     after {len(scans['rounds'])} rounds")
    else:
        out.append(f"settled     no: the last round moved the track by {scans['rounds'][-1]['moved_m']:.2f} m rms")
    if "solution" in scans:
        dead, solved = (scans[name]["ate_rmse_m"] for name in ("dead_reckoning", "solution"))
        out.append(
            f"ATE         dead reckoning {dead:.3g} m, solution {solved:.3g} m rmse of "
            f"{scans['judged_keyframes']:,} keyframes against the truth ({scans['alignment']} alignment)"
        )
    return out


def _calibrated(calibration: dict[str, Any]) -> str:
    """The words of an estimated calibration."""
    c = calibration
    if c["sigma"] is None:
        return f"{c['name']} {c['value']:.4g}, its sigma is not known"
    verdict = f"{100 * c['share']:.3g} % of its sigma before" if c["determined"] else "not determined by these data"
    return f"{c['name']} {c['value']:.4g}, sigma {c['sigma']:.2g} ({verdict})"


def of_tables(errors: list[dict[str, Any]]) -> str:
    """Which errors of whole tables are hidden, in words; empty where none is."""
    by_file: dict[str, list[str]] = {}
    for error in errors:
        size = "" if error["below"] is None else f" (below {error['below']:.2g} {SIZES[error['quantity']]})"
        by_file.setdefault(error["file"], []).append(f"the {error['quantity']}{size}")
    tables = [f"{', '.join(names)} of {file}" for file, names in by_file.items()]
    return f"{'; '.join(tables)}: no other measurement would show an error" if tables else ""


def _unchecked(mission: dict[str, Any]) -> list[str]:
    """Lines of what nothing checks: dead reckoning, else single tables."""
    if mission["checks"]:
        tables = of_tables(mission["unchecked"])
        return [f"unchecked   {tables}"] if tables else []
    known = mission["end_sigma_m"] is not None
    sigma = f"{_short(mission['end_sigma_m'])} m" if known else "not known"
    if mission["end_sigma_percent"] is not None:
        sigma += f" ({_percent(mission['end_sigma_percent'])} of the distance)"
    return [
        "unchecked   nothing checks dead reckoning: no fix, range, closure or contact; the solution is dead reckoning",
        f"end         1 sigma of the position at the end: {sigma}, by the stated noise alone",
    ]


def _drift(mission: dict[str, Any]) -> tuple[str, str]:
    """Errors at the end and on average of dead reckoning, and of the solution where there is a truth, in words."""
    judge = "the truth" if mission["judge"] == "truth" else "the solution (there is no truth.csv)"
    named = {key.replace("_", " "): mission[key] for key in ("dead_reckoning", "solution") if key in mission}
    drift = ", ".join(
        f"{name} {_percent(s['drift_percent'])} ({_short(s['end_error_m'])} m)" for name, s in named.items()
    )
    ate = ", ".join(f"{name} {_short(s['ate_rmse_m'])} m" for name, s in named.items())
    return f"{drift} of the distance at the end, against {judge}", ate


def _percent(number: float) -> str:
    """Percent of the distance; a dash where there is none."""
    return "-" if np.isnan(number) else f"{_short(number)} %"


def _short(number: float) -> str:
    """Three digits; what is below a millionth is rounding."""
    return f"{round(number, 6):.3g}"
