"""``nls solve DIR``: a solved mission, and the files of its folder, each where the mission has what it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import Position, RangeAzimuth
from factors.keys import Kind, kinds
from models.errors import UnderconstrainedError
from models.finite import finite_or_none
from models.listing import some
from nls.cli.evaluate import circles
from nls.cli.job import Content, Job, Solution
from nls.cli.mission import lines, of_tables
from nls.missions import Elevations, MissionReport, Track, elevations, track_of
from nls.missions.determination import position_checks, sigma_at_the_end
from nls.missions.folder.calibration import NAMES as CALIBRATIONS
from nls.missions.results import beacons_text, calibration_text, map_text, trajectory_text, undetermined

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.missions.charts import Chart
    from nls.missions.determination import Determination

__all__ = ["SolvedMission", "drift_record"]

CALIBRATION = ("name", "value", "sigma", "sigma_before", "sigmas_away", "share", "determined")  # of the report
x, l = kinds("x", "l")


class SolvedMission(Solution):
    """A solved mission; parameters and attributes as for `Solution`.

    Attributes
    ----------
    dead : its dead reckoning.
    contacts : the factors of its contacts.
    """

    name = "mission"
    report: MissionReport

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self.dead = job.values
        self.contacts = [factor for factor in job.graph.factors if isinstance(factor, RangeAzimuth)]

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
        marginals, _ = self.covariances
        try:
            return None if marginals is None else sigma_at_the_end(marginals, self.report)
        except UnderconstrainedError:
            return None

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none. Notes say why, and which variables have none."""
        marginals = super().marginals
        if marginals is None:
            return None
        seen_once = undetermined(marginals, l) if self.report.sonar and l.name in self.values.stacks else l[[]]
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
        return elevations(self.graph, self.values, self.marginals is not None, self.job.solver, self.job.options.gauge)

    @cached_property
    def calibrations(self) -> list[Determination]:
        """The calibrations by the measurements."""
        from nls.missions.determination import determinations

        marginals = self.covariances[0] if self.report.calibrations else None
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
            out["calibrations"] = [{name: getattr(c, name) for name in CALIBRATION} for c in self.calibrations]
        return out

    def lines(self, record: dict[str, Any]) -> list[str]:
        """The lines of the table that say what the solution is worth, from its record."""
        return lines(record)

    def facts(self) -> dict[str, str]:
        """Facts for the page: the errors of whole tables that nothing shows."""
        return {"unchecked": of_tables(self.unchecked)}

    # --- pictures and files -------------------------------------------------------------------------------------------

    @property
    def mapped(self) -> bool:
        """Whether a sonar saw landmarks."""
        return bool(self.contacts) and self.report.sonar is not None

    def picture(self) -> Any:
        """Before and after, from above and from the side."""
        from nls.io.files import title_of
        from nls.missions.pictures.mission import plan_before_after

        return plan_before_after(self.graph, self.job.before, self.result, title=title_of(self.report.path))

    def pictures(self) -> dict[str, Any]:
        """The track, and the landmarks where a sonar saw some."""
        return {"The track": self._track()} | ({"The landmarks": self._landmarks()} if self.mapped else {})

    def files(self) -> dict[str, Content]:
        """The files of the folder, by name."""
        from nls.missions.charts import depths_text, geojson_text, kml_text, points_text

        stacks, plane, projection = self.values.stacks, self.report.plane, self.job.projection
        if plane is None:
            self.report.notes.append(
                "no latitudes, no track.geojson and no track.kml: the mission has no origin.csv, a row lat_deg,lon_deg "
                "that says where x = y = 0 is"
            )
        sounded = self.report.soundings is not None and "x" in self.report.vertex_times
        files: dict[str, tuple[Content, bool]] = {
            "trajectory.tum": (self.tum, True),
            "trajectory.csv": (self._trajectory, True),
            "map.csv": (self._map, self.mapped),
            "beacons.csv": (self._beacons, "b" in stacks),
            "calibration.csv": (
                lambda: calibration_text(self.values, self.marginals),
                any(name in CALIBRATIONS for name in stacks),
            ),
            "track.geojson": (lambda: geojson_text(self.chart), plane is not None),
            "track.kml": (lambda: kml_text(self.chart), plane is not None),
            "map.ply": (lambda: points_text(self.chart, projection), self.mapped or sounded or "b" in stacks),
            "depth.asc": (lambda: depths_text(self.chart, projection), self.mapped or sounded),
            "track.png": (self._track, True),
            "landmarks.png": (self._landmarks, self.mapped),
            "sonar.png": (self._fan, self.mapped),
        }
        return {name: make for name, (make, there) in files.items() if there}

    @cached_property
    def chart(self) -> Chart:
        """Track and map with their covariances."""
        from nls.missions.charts import chart_of

        chart = chart_of(self.values, self.marginals, self.report, self.elevations if self.mapped else None)
        doubts = "; ".join(self.doubts)
        return replace(chart, name=f"{chart.name}, doubtful: {doubts}") if doubts else chart

    def _extra(self, p: Array, times: Array | None = None) -> dict[str, Array]:
        """Times and coordinates on the Earth of positions (n, 3), as columns of the tables."""
        from nls.missions.charts import extra

        return extra(p, self.report.plane, self.job.projection, times)

    def _trajectory(self) -> bytes:
        stack = self.values.stack("x")
        extra = self._extra(np.asarray(stack.manifold.position(stack.X)), self.report.vertex_times.get("x"))
        return trajectory_text(self.values, self.marginals, extra, self.report.unmeasured)

    def _map(self) -> bytes:
        extra = self._extra(self.values[l[self.elevations.landmarks]])
        return map_text(self.values, self.marginals, self.elevations, extra)

    def _beacons(self) -> bytes:
        return beacons_text(self.values, self.marginals, self._extra(np.asarray(self.values.stack("b").X)))

    def _track(self) -> Any:
        from nls.missions.pictures.mission import track

        return track(self.values, self.dead, self.report.truth, self.marginals, self.tracks)

    def _landmarks(self) -> Any:
        from nls.missions.pictures.mission import landmark_map

        assert self.report.sonar is not None
        return landmark_map(self.values, self.elevations, self.report.truth, self.report.sonar.aperture)

    def _fan(self) -> Any:
        """The fan of the pose with the most contacts."""
        from nls.missions.pictures.sonar import arcs

        assert self.report.sonar is not None
        poses, count = np.unique(self.contacts[0].keys[0].numbers, return_counts=True)
        pose = x[int(poses[np.argmax(count)])]
        figure = arcs(self.contacts[0], self.values, pose, self.report.sonar)
        figure.axes[0].set_title(f"{self.report.sonar.name}: what it saw from {pose!r}", fontsize=9)
        return figure


def drift_record(tracks: Mapping[str, Track]) -> dict[str, Any]:
    """Tracks in the report for programs, by their name."""
    return {
        name.replace(" ", "_"): {
            "drift_percent": 100 * track.drift,
            "end_error_m": track.end,
            "ate_rmse_m": track.ate.rmse,
            "ate_alignment": track.ate.align,
            **circles(track.ate.errors),
        }
        for name, track in tracks.items()
    }
