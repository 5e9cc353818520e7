"""``nls solve DIR``: what the solution of a mission adds to the table, and the files it is written to."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Position, RangeAzimuth
from factors.keys import Kind, kinds
from models.errors import OptionError, UnderconstrainedError
from models.listing import some
from nls.io.dialects import SUFFIXES
from nls.io.mission import Elevations, MissionReport, Track, elevations, track_of
from nls.io.mission.calibration import NAMES as CALIBRATIONS
from nls.io.mission.results import Extra, undetermined
from nls.metrics import cep, drms2

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.io.charts import Chart, Projection
    from nls.linear import LinearSolver
    from nls.optimizers import Result
    from nls.values import Values


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
        raise OptionError("output folder", folder, "a folder: the solution of a mission is several files")
    path = Path(folder)
    existing = next((p for p in (path, *path.absolute().parents) if os.path.exists(p)), path)
    if not folder or folder == "-" or not os.path.isdir(existing):
        raise OptionError("output folder", folder, "a folder, or the name of one to be made: the input is a mission")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OptionError("output folder", folder, "a folder you may write to")
    if os.path.exists(path) and os.path.samefile(path, mission):
        raise OptionError("output folder", folder, "another folder than that of the mission")


def refuse_crs(name: str | None, output: str | None, report: LoadReport) -> Projection | None:
    """The projection of ``--crs``; None where there is none.

    Raises
    ------
    OptionError
        Where it would have no effect, and as for `nls.io.charts.projection`.
    """
    from nls.io.charts import projection

    if name is None:
        return None
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
    """

    def __init__(
        self,
        graph: FactorGraph,
        dead: Values,
        result: Result,
        report: MissionReport,
        solver: LinearSolver,
        gauge: str,
        projection: Projection | None = None,
    ) -> None:
        self.graph, self.dead, self.result, self.report = graph, dead, result, report
        self.solver, self.gauge = solver, gauge
        self.values, self.projection = result.values, projection
        self.contacts = [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """Dead reckoning and solution against the truth; dead reckoning against the solution where there is none."""
        if "x" in self.report.truth.stacks:
            estimates, judge = {"dead reckoning": self.dead, "solution": self.values}, "truth"
        else:
            estimates, judge = {"dead reckoning": self.dead}, "solution"
        against = self.report.truth if judge == "truth" else self.values
        return {name: track_of(values, against, self.report, judge) for name, values in estimates.items()}

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none. Notes say why, and which variables have none."""
        from nls.covariance import Marginals

        if not self.result.converged:
            self.report.notes.append("the files have no sigmas: this is no optimum")
            return None
        try:
            marginals = Marginals(self.graph, self.values, self.solver, self.gauge)
        except UnderconstrainedError as error:
            self.report.notes.append(f"the files have no sigmas: {error}")
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

    def outputs(self, folder: str) -> list[tuple[Callable[[str], None], str]]:
        """What to write where: functions that take the name of the file, and the names."""
        stacks, plane = self.values.stacks, self.report.plane
        if plane is None:
            self.report.notes.append(
                "no latitudes, no track.geojson and no track.kml: the mission has no origin.csv, a row lat_deg,lon_deg "
                "that says where x = y = 0 is"
            )
        mapped = bool(self.contacts) and self.report.sonar is not None
        files = {
            "trajectory.tum": (self._tum, True),
            "trajectory.csv": (self._trajectory, True),
            "map.csv": (self._map, mapped),
            "beacons.csv": (self._beacons, "b" in stacks),
            "calibration.csv": (self._calibration, any(name in CALIBRATIONS for name in stacks)),
            "track.geojson": (self._geojson, plane is not None),
            "track.kml": (self._kml, plane is not None),
            "map.ply": (self._ply, mapped or "b" in stacks),
            "depth.asc": (self._grid, mapped),
            "track.png": (self._track, True),
            "landmarks.png": (self._landmarks, mapped),
            "sonar.png": (self._sonar, mapped),
        }
        return [(write, str(Path(folder, name))) for name, (write, there) in files.items() if there]

    @cached_property
    def chart(self) -> Chart:
        """Track and map with their covariances."""
        from nls.io.charts import chart_of

        elevations = self.elevations if self.contacts and self.report.sonar is not None else None
        return chart_of(self.values, self.marginals, self.report, elevations)

    def _extra(self, p: Array, times: Array | None = None) -> Extra:
        """Times and coordinates on the Earth of positions (n, 3), as columns of the tables."""
        from nls.io.charts import extra

        return extra(p, self.report.plane, self.projection, times)

    def _tum(self, path: str) -> None:
        from nls.io.trajectory import write_tum

        stack = self.values.stack("x")
        times = self.report.vertex_times.get("x", stack.numbers.astype(float))
        order = np.argsort(times, kind="stable")
        write_tum(path, times[order], np.asarray(stack.X)[order])

    def _trajectory(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import trajectory_text

        stack = self.values.stack("x")
        extra = self._extra(np.asarray(stack.manifold.position(stack.X)), self.report.vertex_times.get("x"))
        write_bytes(path, trajectory_text(self.values, self.marginals, extra))

    def _map(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import map_text

        extra = self._extra(self.values[l[self.elevations.landmarks]])
        write_bytes(path, map_text(self.values, self.marginals, self.elevations, extra))

    def _beacons(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import beacons_text

        extra = self._extra(np.asarray(self.values.stack("b").X))
        write_bytes(path, beacons_text(self.values, self.marginals, extra))

    def _calibration(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import calibration_text

        write_bytes(path, calibration_text(self.values, self.marginals))

    def _geojson(self, path: str) -> None:
        from nls.io.charts import geojson_text
        from nls.io.files import write_bytes

        write_bytes(path, geojson_text(self.chart))

    def _kml(self, path: str) -> None:
        from nls.io.charts import kml_text
        from nls.io.files import write_bytes

        write_bytes(path, kml_text(self.chart))

    def _ply(self, path: str) -> None:
        from nls.io.charts import points_text
        from nls.io.files import write_bytes

        write_bytes(path, points_text(self.chart, self.projection))

    def _grid(self, path: str) -> None:
        from nls.io.charts import depths_text
        from nls.io.files import write_bytes

        write_bytes(path, depths_text(self.chart, self.projection))

    def _track(self, path: str) -> None:
        from nls.plot.mission import track
        from nls.plot.picture import write_picture

        write_picture(path, track(self.values, self.dead, self.report.truth, self.marginals, self.tracks))

    def _landmarks(self, path: str) -> None:
        from nls.plot.mission import landmark_map
        from nls.plot.picture import write_picture

        assert self.report.sonar is not None
        figure = landmark_map(self.values, self.elevations, self.report.truth, self.report.sonar.aperture)
        write_picture(path, figure)

    def _sonar(self, path: str) -> None:
        """The fan of the pose with the most contacts."""
        from nls.plot.picture import write_picture
        from nls.plot.sonar import arcs

        poses, count = np.unique(self.contacts[0].keys[0].numbers, return_counts=True)
        pose = x[int(poses[np.argmax(count)])]
        assert self.report.sonar is not None
        figure = arcs(self.contacts[0], self.values, pose, self.report.sonar)
        figure.axes[0].set_title(f"{self.report.sonar.name}: what it saw from {pose!r}", fontsize=9)
        write_picture(path, figure)

    def record(self) -> dict[str, Any]:
        """What the report for programs says of the mission."""
        first = next(iter(self.tracks.values()))
        anchors = [factor.keys[0] for factor in self.graph.factors if isinstance(factor, Position)]
        out: dict[str, Any] = {
            "poses": len(self.values.stack("x")),
            "landmarks": len(self.values.stacks.get("l", ())),
            "contacts": sum(map(len, self.contacts)),
            "sonar": None if self.report.sonar is None else self.report.sonar.name,
            "anchor": ", ".join(map(repr, anchors)),
            "judge": first.against,
            "distance_m": first.distance,
        }
        for name, track in self.tracks.items():
            out[name.replace(" ", "_")] = {
                "drift_percent": 100 * track.drift,
                "end_error_m": track.end,
                "ate_rmse_m": track.ate.rmse,
                "ate_alignment": track.ate.align,
                "cep50_m": cep(track.ate.errors),
                "cep95_m": cep(track.ate.errors, 0.95),
                "drms2_m": drms2(track.ate.errors),
            }
        if self.contacts and "l" in self.report.truth.stacks:
            known = self.report.truth.stack("l").numbers
            landmarks = l[known[np.isin(known, self.values.stack("l").numbers)]]
            away = self.values[landmarks] - self.report.truth[landmarks]
            out["landmark_rmse_m"] = float(np.sqrt(np.square(away).sum(axis=1).mean())) if len(landmarks) else None
        if "elevations" in vars(self) and (known := np.isfinite(self.elevations.sigma)).any():  # with files
            sigma = np.degrees(self.elevations.sigma[known])
            out["elevation_sigma_deg"] = {"median": float(np.median(sigma)), "largest": float(sigma.max())}
            out["at_limit"] = int(self.elevations.pushed.sum())
        return out


def lines(mission: dict[str, Any]) -> list[str]:
    """The lines of the table that say what a mission's solution is worth."""
    judge = "the truth" if mission["judge"] == "truth" else "the solution, as there is no truth.csv"
    named = {key.replace("_", " "): mission[key] for key in ("dead_reckoning", "solution") if key in mission}
    drift = ", ".join(
        f"{name} {_percent(s['drift_percent'])} ({_short(s['end_error_m'])} m)" for name, s in named.items()
    )
    ate = ", ".join(f"{name} {_short(s['ate_rmse_m'])} m" for name, s in named.items())
    out = [
        f"mission     {mission['poses']} poses over {mission['distance_m']:.4g} m, {mission['landmarks']} landmarks, "
        f"{mission['contacts']} contacts" + (f" of a {mission['sonar']}" if mission["sonar"] else ""),
        f"drift       {drift} of the distance at the end, against {judge}",
        f"ATE         {ate} rmse (no alignment: {mission['anchor']} is anchored)",
    ]
    if mission.get("landmark_rmse_m") is not None:
        out.append(f"landmarks   {mission['landmark_rmse_m']:.3g} m rmse, against landmarks.csv")
    if "elevation_sigma_deg" in mission:
        s = mission["elevation_sigma_deg"]
        edge = f"; {mission['at_limit']} landmarks at the edge of the aperture" if mission["at_limit"] else ""
        out.append(
            f"elevation   known to {s['median']:.2g} deg (median) and {s['largest']:.2g} deg (largest sigma){edge}"
        )
    return out


def _percent(number: float) -> str:
    """Percent of the distance; a dash where there is none."""
    return "-" if np.isnan(number) else f"{_short(number)} %"


def _short(number: float) -> str:
    """Three digits; what is below a millionth is rounding."""
    return f"{round(number, 6):.3g}"
