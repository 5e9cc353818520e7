"""``nls solve DIR``: the folder of its outputs, its solution, and what that adds to the table."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Position, RangeAzimuth
from factors.keys import Kind, kinds
from models.errors import OptionError, UnderconstrainedError
from models.finite import finite_or_none
from models.listing import some
from nls.cli.covariances import covariances
from nls.io.dialects import SUFFIXES
from nls.io.mission import Elevations, MissionReport, Track, elevations, track_of
from nls.io.mission.determination import position_checks, sigma_at_the_end
from nls.io.mission.results import undetermined
from nls.metrics import cep, drms2

if TYPE_CHECKING:
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.io.charts import Projection
    from nls.io.mission.determination import Determination
    from nls.linear import LinearSolver
    from nls.optimizers import Result
    from nls.values import Values


SIZES = {"heading": "rad", "zero of the depth": "m", "place": "m", "clock": "s", "arm": "m"}
x, l = kinds("x", "l")


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
    if Path(folder).suffix in SUFFIXES and not os.path.isdir(folder):
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
        Where it would have no effect, and as for `nls.io.charts.projection`.
    """
    from nls.io.charts import projection

    if not isinstance(report, MissionReport) or not output:
        raise OptionError("--crs", name, "nothing: it is for the folder that -o writes of a mission")
    return projection(name, report.plane)


class Solved:
    """A solved mission: everything that is said of it and written.

    Parameters
    ----------
    graph, dead, result, report : the mission, its dead reckoning, its solution, and what its folder holds.
    solver, gauge : for the covariances.
    projection : of the coordinates of points and grid; east and north of the origin when omitted.

    Attributes
    ----------
    doubts : why the solution is doubtful; a mark on its charts and pictures.
    """

    def __init__(
        self,
        graph: FactorGraph,
        dead: Values,
        result: Result,
        report: MissionReport,
        solver: LinearSolver | None,
        gauge: str,
        projection: Projection | None = None,
    ) -> None:
        self.graph, self.dead, self.result, self.report = graph, dead, result, report
        self.solver, self.gauge = solver, gauge
        self.values, self.projection = result.values, projection
        self.contacts = [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]
        self.doubts: list[str] = []

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """Dead reckoning and solution against the truth; dead reckoning against the solution where there is none.

        None where there is no truth and nothing checks dead reckoning: the solution is dead reckoning then.
        """
        if "x" in self.report.truth.stacks:
            estimates, judge = {"dead reckoning": self.dead, "solution": self.values}, "truth"
        elif self.checks and "motion.csv" not in self.report.tags:
            estimates, judge = {"dead reckoning": self.dead}, "solution"
        else:
            return {}
        against = self.report.truth if judge == "truth" else self.values
        return {name: track_of(values, against, self.report, judge) for name, values in estimates.items()}

    @cached_property
    def checks(self) -> int:
        """Measured numbers that check the position of dead reckoning."""
        return position_checks(self.graph, self.values, self.result.dof)

    @cached_property
    def unchecked(self) -> list[dict[str, Any]]:
        """Errors of whole tables that nothing shows; none where nothing checks dead reckoning, or at no optimum."""
        errors = [error for error in self.report.errors if error.hidden] if self.checks else []
        return [finite_or_none({"file": e.file, "quantity": e.quantity, "below": e.below}) for e in errors]

    @cached_property
    def end_sigma(self) -> float | None:
        """Standard deviation of the last position, m; None where it has none."""
        marginals, _ = self._covariances
        try:
            return None if marginals is None else sigma_at_the_end(marginals, self.report)
        except UnderconstrainedError:
            return None

    @cached_property
    def _covariances(self) -> tuple[Marginals | None, str]:
        """Covariances at the optimum; None and the note where there are none."""
        return covariances(self.graph, self.result, self.solver, self.gauge)

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none. Notes say why, and which variables have none."""
        marginals, note = self._covariances
        if marginals is None:
            self.report.notes.append(note)
            return None
        seen_once = (
            l[[]] if self.report.sonar is None or l.name not in self.values.stacks else undetermined(marginals, l)
        )
        if len(seen_once):
            self.report.notes.append(
                f"nothing measures the elevation of {some(list(seen_once))}: no sigmas there, all others are given; a "
                "contact from elsewhere measures it, and --elevation prior takes the aperture of the sonar for it"
            )
        kinds_of = [Kind(name) for name in self.values.stacks if name != l.name or not len(seen_once)]
        if free := [key for kind in kinds_of for key in undetermined(marginals, kind)]:
            cause = marginals.underconstrained
            reason = "no measurement touches them" if cause is None else str(cause)
            self.report.notes.append(f"no sigmas of {some(free)}, all others are given: {reason}")
        return marginals

    @cached_property
    def elevations(self) -> Elevations:
        """Elevations of the landmarks at their first view, with sigmas where there are covariances."""
        return elevations(self.graph, self.values, self.marginals is not None, self.solver, self.gauge)

    @cached_property
    def calibrations(self) -> list[Determination]:
        """The calibrations by the measurements."""
        from nls.io.mission.determination import determinations

        marginals = self._covariances[0] if self.report.calibrations else None
        return determinations(self.values, self.report, marginals)

    @property
    def judge(self) -> str | None:
        """The reference of the tracks; None where nothing checks dead reckoning."""
        return next((track.against for track in self.tracks.values()), None)

    @cached_property
    def distance(self) -> float:
        """Distance travelled, m."""
        tracks = [*self.tracks.values(), track_of(self.values, self.values, self.report, "solution")]
        return tracks[0].distance

    def record(self) -> dict[str, Any]:
        """The mission in the report for programs."""
        distance = self.distance
        anchors = [repr(factor.keys[0]) for factor in self.graph.factors if isinstance(factor, Position)]
        out: dict[str, Any] = {
            "poses": len(self.values.stack("x")),
            "landmarks": len(self.values.stacks.get("l", ())),
            "contacts": sum(map(len, self.contacts)),
            "sonar": None if self.report.sonar is None else self.report.sonar.name,
            "anchor": ", ".join(self.report.world or anchors),
            "judge": self.judge,
            "distance_m": distance,
            "checks": self.checks,
            "unchecked": self.unchecked,
        }
        if not self.checks:
            end = self.end_sigma
            out["end_sigma_m"] = end
            out["end_sigma_percent"] = None if end is None or not distance > 0 else 100 * end / distance
        out |= drift_record(self.tracks)
        if self.contacts and "l" in self.report.truth.stacks:
            known = self.report.truth.stack("l").numbers
            landmarks = l[known[np.isin(known, self.values.stack("l").numbers)]]
            away = self.values[landmarks] - self.report.truth[landmarks]
            out["landmark_rmse_m"] = float(np.sqrt(np.square(away).sum(axis=1).mean())) if len(landmarks) else None
        if "elevations" in vars(self) and (known := np.isfinite(self.elevations.sigma)).any():  # with files
            sigma = np.degrees(self.elevations.sigma[known])
            out["elevation_sigma_deg"] = {"median": float(np.median(sigma)), "largest": float(sigma.max())}
            out["at_limit"] = int(self.elevations.pushed.sum())
            out["mirrored"] = int(self.elevations.mirrored.sum())
        if self.report.calibrations:
            out["calibrations"] = [
                {
                    **{"name": c.name, "value": c.value, "sigma": c.sigma, "sigma_before": c.sigma_before},
                    **{"sigmas_away": c.sigmas_away, "share": c.share, "determined": c.determined},
                }
                for c in self.calibrations
            ]
        return out


def drift_record(tracks: Mapping[str, Track]) -> dict[str, Any]:
    """Tracks in the report for programs, by their name."""
    return {
        name.replace(" ", "_"): {
            "drift_percent": 100 * track.drift,
            "end_error_m": track.end,
            "ate_rmse_m": track.ate.rmse,
            "ate_alignment": track.ate.align,
            "cep50_m": cep(track.ate.errors),
            "cep95_m": cep(track.ate.errors, 0.95),
            "drms2_m": drms2(track.ate.errors),
        }
        for name, track in tracks.items()
    }


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
