"""``nls solve DIR``: the folder of its outputs, and what the table says of a mission."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.errors import OptionError
from nls.cli.formats import mission_of
from nls.io.formats import suffixes

if TYPE_CHECKING:
    from nls.io import LoadReport
    from nls.missions.charts import Projection

SIZES = {"heading": "rad", "zero of the depth": "m", "scale": "of it", "place": "m", "clock": "s", "arm": "m"}


def refuse_unwritable_folder(folder: str | None, mission: str, form: str | None) -> None:
    """Find out before the work that a folder cannot hold the solution of a mission; one that is not there is made.

    Raises
    ------
    OptionError
    """
    if form is not None:
        raise OptionError("--to", form, "nothing: the solution of a mission is a folder with files of their own")
    if folder is None:
        return
    if Path(folder).suffix in suffixes() and not os.path.isdir(folder):
        raise OptionError("-o", folder, "a folder: the solution of a mission is several files")
    path = Path(folder)
    existing = next((p for p in (path, *path.absolute().parents) if os.path.exists(p)), path)
    if not folder or folder == "-" or not os.path.isdir(existing):
        raise OptionError("-o", folder, "a folder, or the name of one to be made: the input is a mission")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OptionError("-o", folder, "a folder you may write to")
    if os.path.exists(path) and os.path.samefile(path, mission):
        raise OptionError("-o", folder, "another folder than that of the mission")


def chosen_projection(name: str, output: str | None, report: LoadReport) -> Projection:
    """The projection of ``--crs``.

    Raises
    ------
    OptionError
        Where it would have no effect, and as for `nls.missions.charts.projection`.
    """
    from nls.missions.charts import projection

    if (mission := mission_of(report)) is None or not output:
        raise OptionError("--crs", name, "nothing: it is for the folder that -o writes of a mission")
    return projection(name, mission.plane)


def lines(mission: dict[str, Any]) -> list[str]:
    """The lines of the table that say what a mission's solution is worth."""
    out = [
        f"mission     {mission['poses']} poses over {mission['distance_m']:.4g} m, {mission['landmarks']} landmarks, "
        f"{mission['contacts']} contacts" + (f" by the sonar {mission['sonar']}" if mission["sonar"] else ""),
    ]
    out += _unchecked(mission)
    if mission["judge"] is not None:
        drift, ate = _drift(mission)
        out += [f"drift       {drift}", f"ATE         {ate} rmse (no alignment: {_held(mission['anchor'])})"]
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
            "the plane of the sonar, see mirrored in map.csv; a view after heave or roll of the sonar tells the side"
        )
    out += [f"calibration {_calibrated(c)}" for c in mission.get("calibrations", [])]
    return out


def _calibrated(calibration: dict[str, Any]) -> str:
    """The words of an estimated calibration."""
    c = calibration
    if c["sigma"] is None:
        return f"{c['name']} {c['value']:.4g}, its sigma is not known"
    verdict = f"{100 * c['share']:.3g} % of its sigma before" if c["determined"] else "not determined by these data"
    return f"{c['name']} {c['value']:.4g}, sigma {c['sigma']:.2g} ({verdict})"


def _held(anchor: str) -> str:
    """What holds the track in the world: poses, or files."""
    return f"held in the world by {anchor}" if anchor.endswith(".csv") else f"{anchor} is anchored"


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
