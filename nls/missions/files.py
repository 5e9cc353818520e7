"""The files of a solved mission, each where the mission has what it shows: tables, charts and pictures.

trajectory.csv has the Euler 6-vector of every pose and its standard deviations, empty where nothing measures them. In
map.csv the covariance of a landmark is along the axes of the world. Its elevation is the one in the frame of the sonar
at the first view; at_limit is 1 where a hinge pushes it back into the aperture, mirrored is 1 where the other sign of
the elevation fits as well. beacons.csv and calibration.csv have the columns of the files of a mission. Times and
coordinates on the Earth are further columns.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from factors.keys import Kind, kinds
from models import euler
from models.algebra import Array
from nls.missions import charts
from nls.missions.determination import covariances, or_empty
from nls.missions.folder.calibration import NAMES
from nls.missions.folder.columns import COLUMNS, PLACE, POSE, suffixed
from nls.missions.folder.table import csv_text
from nls.missions.solution import SolvedDives, SolvedMission

x, l, b = kinds("x", "l", "b")
TRAJECTORY = (*POSE, *suffixed(POSE[1:]))
UPPER = np.triu_indices(3)
MAP = (
    *("landmark", *PLACE),
    *(f"cov_{'xyz'[row]}_{'xyz'[column]}_m2" for row, column in zip(*UPPER, strict=True)),
    *("views", "first_i", "elevation_rad", "sigma_elevation_rad", "at_limit", "mirrored"),
)
OF_ALL = ("map.csv", "beacons.csv", "map.ply", "landmarks.png")  # files of the map, which the dives share
OF_EACH = (
    *("trajectory.tum", "trajectory.csv", "calibration.csv", "track.geojson", "track.kml", "track.png"),
    *("map.ply", "depth.asc"),  # with the bottom below the track
)


class MissionFiles:
    """The files of a solved mission.

    Parameters
    ----------
    solution : of the mission.
    projection : of the coordinates; None for local ones.
    doubts : why it is doubtful, in words: a mark on its charts.
    """

    def __init__(
        self, solution: SolvedMission, projection: charts.MapProjection | None = None, doubts: Sequence[str] = ()
    ) -> None:
        self.solution, self.projection, self.doubts = solution, projection, doubts
        self.values, self.report = solution.values, solution.report

    def __call__(self) -> dict[str, Callable[[], Any]]:
        """Makers of the files by name: each gives bytes, or a figure of matplotlib."""
        stacks, plane, mapped = self.values.stacks, self.report.plane, self.solution.mapped
        if plane is None:
            cure = "the mission has no origin.csv, a row lat_deg,lon_deg that says where x = y = 0 is"
            self.report.notes.append(f"no latitudes, no track.geojson and no track.kml: {cure}")
        sounded = self.report.soundings is not None and "x" in self.report.vertex_times
        files = {
            "trajectory.tum": (self.solution.tum, True),
            "trajectory.csv": (self.trajectory, True),
            "map.csv": (self.map, mapped),
            "beacons.csv": (self.beacons, "b" in stacks),
            "calibration.csv": (self.calibration, any(name in NAMES for name in stacks)),
            "track.geojson": (lambda: charts.geojson_text(self.chart), plane is not None),
            "track.kml": (lambda: charts.kml_text(self.chart), plane is not None),
            "map.ply": (lambda: charts.points_text(self.chart, self.projection), mapped or sounded or "b" in stacks),
            "depth.asc": (lambda: charts.depths_text(self.chart, self.projection), mapped or sounded),
            "track.png": (self.track, True),
            "landmarks.png": (self.landmarks, mapped),
            "sonar.png": (self.fan, mapped),
        }
        return {name: make for name, (make, there) in files.items() if there}

    @cached_property
    def chart(self) -> charts.Chart:
        """Track and map with their covariances."""
        elevations = self.solution.elevations if self.solution.mapped else None
        chart = charts.chart_of(self.values, self.solution.marginals, self.report, elevations)
        return replace(chart, name=f"{chart.name}, doubtful: {'; '.join(self.doubts)}") if self.doubts else chart

    def trajectory(self) -> bytes:
        """trajectory.csv; a pose at gimbal lock raises SingularGeometryError."""
        stack = self.values.stack("x")
        more = self._extra(np.asarray(stack.manifold.position(stack.X)), self.report.vertex_times.get("x"))
        state = np.hstack([euler.from_se3(stack.X), self._sigmas(x, "euler")])
        state[:, [name.split("_")[0] in self.report.unmeasured for name in POSE[1:]] * 2] = np.nan
        return csv_text((*TRAJECTORY, *more), stack.numbers, or_empty(state), *more.values())

    def map(self) -> bytes:
        """map.csv: landmarks, their covariance, their views, and their elevation."""
        elevations, marginals = self.solution.elevations, self.solution.marginals
        p = self.values[l[elevations.landmarks]]
        Sigma = np.full((len(p), 3, 3), np.nan) if marginals is None else elevations.covariances(marginals)
        more = self._extra(p)
        return csv_text(
            (*MAP, *more),
            *(elevations.landmarks, p, or_empty(Sigma[:, *UPPER]), elevations.views, elevations.poses),
            *(elevations.elevation[:, None], or_empty(elevations.sigma[:, None]), elevations.pushed.astype(int)),
            np.where(np.isnan(elevations.sigma), "", elevations.mirrored.astype(int).astype(str)),
            *more.values(),
        )

    def beacons(self) -> bytes:
        """beacons.csv: the estimated beacons ``b``."""
        stack = self.values.stack("b")
        p = np.asarray(stack.X)
        more = self._extra(p)
        names = ("beacon", *PLACE, *suffixed(PLACE), *more)
        return csv_text(names, stack.numbers, p, or_empty(self._sigmas(b)), *more.values())

    def calibration(self) -> bytes:
        """calibration.csv: the estimated calibrations."""
        names = [name for name in self.values.stacks if name in NAMES]
        rows = [[float(self.values.stack(name).X[0, 0]), self._sigmas(Kind(name))[0, 0]] for name in names]
        return csv_text(COLUMNS["calibration"], names, or_empty(np.array(rows)))

    def track(self) -> Any:
        """track.png: dead reckoning, solution and truth from above, and how far each is off."""
        from nls.missions.pictures.mission import track

        own = self.solution
        return track(self.values, own.dead, self.report.truth, own.marginals, own.tracks)

    def landmarks(self) -> Any:
        """landmarks.png: the map, and how well the elevations are known."""
        from nls.missions.pictures.mission import landmark_map

        assert self.report.sonar is not None
        return landmark_map(self.values, self.solution.elevations, self.report.truth, self.report.sonar.aperture)

    def fan(self) -> Any:
        """sonar.png: the contacts of the pose that has most."""
        from nls.missions.pictures.sonar import arcs

        assert self.report.sonar is not None
        contacts = self.solution.contacts[0]
        poses, count = np.unique(contacts.keys[0].numbers, return_counts=True)
        pose = x[int(poses[np.argmax(count)])]
        figure = arcs(contacts, self.values, pose, self.report.sonar)
        figure.axes[0].set_title(f"{self.report.sonar.name}: what it saw from {pose!r}", fontsize=9)
        return figure

    def _sigmas(self, kind: Kind, view: str | None = None) -> Array:
        """Standard deviations (n, k) of the variables of a kind, nan where there are none."""
        Sigma = covariances(self.values, self.solution.marginals, kind, view)
        return np.asarray(np.sqrt(np.diagonal(Sigma, axis1=1, axis2=2)))

    def _extra(self, p: Array, times: Array | None = None) -> dict[str, Array]:
        """Times and coordinates on the Earth of positions (n, 3), as columns of the tables."""
        return charts.extra(p, self.report.plane, self.projection, times)


class DiveFiles(MissionFiles):
    """Files of several dives: those of the map, and those of each track in a folder with the name of its dive."""

    solution: SolvedDives

    def __call__(self) -> dict[str, Callable[[], Any]]:
        """Makers of the files by name, those of a dive below its folder."""
        out = {name: make for name, make in super().__call__().items() if name in OF_ALL}
        for part in self.solution.dives:
            own = MissionFiles(part, self.projection, self.doubts)()
            out |= {f"{part.dive.name}/{name}": own[name] for name in own if name in OF_EACH}
        return out
