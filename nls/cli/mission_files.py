"""The files that ``nls solve DIR -o FOLDER`` writes of a mission, each where the mission has what it shows."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from factors.keys import kinds
from nls.io.mission.calibration import NAMES as CALIBRATIONS
from nls.io.mission.results import Extra

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.cli.mission import Solved
    from nls.io.charts import Chart

__all__ = ["MissionFiles"]

x, l = kinds("x", "l")


class MissionFiles:
    """Functions that write the files of a solved mission.

    Parameters
    ----------
    solved : the mission.
    """

    def __init__(self, solved: Solved) -> None:
        self.solved = solved

    def outputs(self, folder: str) -> list[tuple[Callable[[str], None], str]]:
        """Files to write: functions that take the name of the file, and the names."""
        stacks, plane = self.solved.values.stacks, self.solved.report.plane
        if plane is None:
            self.solved.report.notes.append(
                "no latitudes, no track.geojson and no track.kml: the mission has no origin.csv, a row lat_deg,lon_deg "
                "that says where x = y = 0 is"
            )
        mapped = bool(self.solved.contacts) and self.solved.report.sonar is not None
        sounded = self.solved.report.soundings is not None and "x" in self.solved.report.vertex_times
        files = {
            "trajectory.tum": (self._tum, True),
            "trajectory.csv": (self._trajectory, True),
            "map.csv": (self._map, mapped),
            "beacons.csv": (self._beacons, "b" in stacks),
            "calibration.csv": (self._calibration, any(name in CALIBRATIONS for name in stacks)),
            "track.geojson": (self._geojson, plane is not None),
            "track.kml": (self._kml, plane is not None),
            "map.ply": (self._ply, mapped or sounded or "b" in stacks),
            "depth.asc": (self._grid, mapped or sounded),
            "track.png": (self._track, True),
            "landmarks.png": (self._landmarks, mapped),
            "sonar.png": (self._sonar, mapped),
        }
        return [(write, str(Path(folder, name))) for name, (write, there) in files.items() if there]

    @cached_property
    def chart(self) -> Chart:
        """Track and map with their covariances."""
        from nls.io.charts import chart_of

        elevations = self.solved.elevations if self.solved.contacts and self.solved.report.sonar is not None else None
        return chart_of(self.solved.values, self.solved.marginals, self.solved.report, elevations)

    def _extra(self, p: Array, times: Array | None = None) -> Extra:
        """Times and coordinates on the Earth of positions (n, 3), as columns of the tables."""
        from nls.io.charts import extra

        return extra(p, self.solved.report.plane, self.solved.projection, times)

    def _tum(self, path: str) -> None:
        from nls.io.trajectory import write_tum

        stack = self.solved.values.stack("x")
        times = self.solved.report.vertex_times.get("x", stack.numbers.astype(float))
        order = np.argsort(times, kind="stable")
        write_tum(path, times[order], np.asarray(stack.X)[order])

    def _trajectory(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import trajectory_text

        stack = self.solved.values.stack("x")
        extra = self._extra(np.asarray(stack.manifold.position(stack.X)), self.solved.report.vertex_times.get("x"))
        solved = self.solved
        write_bytes(path, trajectory_text(solved.values, solved.marginals, extra, solved.report.unmeasured))

    def _map(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import map_text

        extra = self._extra(self.solved.values[l[self.solved.elevations.landmarks]])
        write_bytes(path, map_text(self.solved.values, self.solved.marginals, self.solved.elevations, extra))

    def _beacons(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import beacons_text

        extra = self._extra(np.asarray(self.solved.values.stack("b").X))
        write_bytes(path, beacons_text(self.solved.values, self.solved.marginals, extra))

    def _calibration(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.mission.results import calibration_text

        write_bytes(path, calibration_text(self.solved.values, self.solved.marginals))

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

        write_bytes(path, points_text(self.chart, self.solved.projection))

    def _grid(self, path: str) -> None:
        from nls.io.charts import depths_text
        from nls.io.files import write_bytes

        write_bytes(path, depths_text(self.chart, self.solved.projection))

    def _track(self, path: str) -> None:
        from nls.plot.mission import track
        from nls.plot.picture import write_picture

        write_picture(
            path,
            track(
                self.solved.values,
                self.solved.dead,
                self.solved.report.truth,
                self.solved.marginals,
                self.solved.tracks,
            ),
        )

    def _landmarks(self, path: str) -> None:
        from nls.plot.mission import landmark_map
        from nls.plot.picture import write_picture

        assert self.solved.report.sonar is not None
        figure = landmark_map(
            self.solved.values, self.solved.elevations, self.solved.report.truth, self.solved.report.sonar.aperture
        )
        write_picture(path, figure)

    def _sonar(self, path: str) -> None:
        """The fan of the pose with the most contacts."""
        from nls.plot.picture import write_picture
        from nls.plot.sonar import arcs

        poses, count = np.unique(self.solved.contacts[0].keys[0].numbers, return_counts=True)
        pose = x[int(poses[np.argmax(count)])]
        assert self.solved.report.sonar is not None
        figure = arcs(self.solved.contacts[0], self.solved.values, pose, self.solved.report.sonar)
        figure.axes[0].set_title(f"{self.solved.report.sonar.name}: what it saw from {pose!r}", fontsize=9)
        write_picture(path, figure)
