"""A solved scan mission: the numbers of its report, its picture and its files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import kinds
from models.algebra import distance_along
from models.errors import SingularGeometryError
from nls.cli.covariances import covariances
from nls.io.scan_mission import ScanReport
from nls.io.scan_mission.results import verdict_words
from nls.metrics import cep, drms2
from nls.sonar.scans.setup.words import record as finding_record

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.metrics import TrajectoryError
    from nls.optimizers import Result
    from nls.sonar.scans import Closing, Matches, SetupFinding
    from nls.values import Values

__all__ = ["GRAPH", "SolvedScans"]

GRAPH = "graph.npz"
x = kinds("x")[0]


class SolvedScans:
    """A map from scans: everything that is said of it and written.

    Parameters
    ----------
    graph, dead, result, report : with its closures, dead reckoning (count, 3), the solution, and what the folder holds.
    closing : the rounds.
    select : how matches were selected.
    findings : what is set up wrongly.

    Attributes
    ----------
    doubts : why the map is doubtful; a mark on its picture.
    """

    def __init__(
        self,
        graph: FactorGraph,
        dead: Array,
        result: Result,
        report: ScanReport,
        closing: Closing,
        select: str,
        findings: Sequence[SetupFinding] = (),
    ) -> None:
        self.graph, self.dead, self.result, self.report = graph, dead, result, report
        self.closing, self.select, self.findings = closing, select, findings
        self.values: Values = result.values
        self.poses: Array = result.values[x]
        self.doubts: list[str] = []

    @property
    def matches(self) -> Matches:
        """Candidates of the last round."""
        return self.closing.matches

    @property
    def kept(self) -> int:
        """Closures in the graph."""
        return int(self.matches.kept.sum())

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none, and a note says why."""
        marginals, note = covariances(self.graph, self.result)
        if marginals is None:
            self.report.notes.append(note)
        return marginals

    @cached_property
    def errors(self) -> dict[str, TrajectoryError]:
        """Dead reckoning and solution against the truth; none without one."""
        if self.report.truth is None:
            return {}
        try:
            return {"dead_reckoning": self.report.truth.ate(self.dead), "solution": self.report.truth.ate(self.poses)}
        except SingularGeometryError as error:
            self.report.notes.append(f"no error against the truth: {error}")
            return {}

    def record(self) -> dict[str, Any]:
        """The map in the report for programs."""
        scans, rounds = self.report.scans, self.closing.rounds
        words = verdict_words(self.matches)
        out: dict[str, Any] = {
            "keyframes": len(self.poses),
            "with_points": int(scans.with_points.sum()),
            "points": len(scans.points),
            "distance_m": float(distance_along(self.poses[:, :2])[-1]),
            "select": self.select,
            "rounds": [
                {"candidates": len(r.matches), "accepted": int(r.matches.accepted.sum())}
                | {"kept": int(r.matches.kept.sum()), "chi2_dof": r.chi2_dof, "moved_m": r.moved}
                for r in rounds
            ],
            "settled": self.closing.settled,
            "setup": [finding_record(finding) for finding in self.findings],
            "closures": self.kept,
            "verdicts": {word: words.count(word) for word in sorted(set(words))},
        }
        if not self.kept and (marginals := self.marginals) is not None:
            last = marginals.covariance(x[len(self.poses) - 1], view="position")
            out["end_sigma_m"] = float(np.sqrt(np.trace(last)))
        if self.errors:
            out["judged_keyframes"] = len(self.errors["solution"].distances)
            out["alignment"] = self.errors["solution"].align
        for name, error in self.errors.items():
            out[name] = {"ate_rmse_m": error.rmse, "ate_mean_m": error.mean, "ate_largest_m": error.largest}
            out[name] |= {"cep50_m": cep(error.errors), "cep95_m": cep(error.errors, 0.95)}
            out[name] |= {"drms2_m": drms2(error.errors)}
        return out

    def picture(self) -> Any:
        """The map from above, a figure of matplotlib."""
        from nls.plot.scan_map import scan_map

        return scan_map(
            self.poses, self.dead, self.report.scans, self.matches, self.report.truth if self.errors else None
        )

    def outputs(self, folder: str) -> list[tuple[Callable[[str], None], str]]:
        """Files to write: functions that take the name of the file, and the names."""
        files: dict[str, Callable[[str], None]] = {
            "trajectory.csv": self._trajectory,
            "trajectory.tum": self._tum,
            "map.csv": self._map,
            "map.ply": self._points,
            GRAPH: self._graph,
            "map.png": self.draw,
        }
        if len(self.matches):
            files["closures.csv"] = self._closures
        return [(write, str(Path(folder, name))) for name, write in files.items()]

    def draw(self, path: str) -> None:
        """Write the map as a picture."""
        from nls.plot.picture import write_picture

        write_picture(path, self.picture(), self.doubts)

    def _trajectory(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.scan_mission.results import trajectory_text

        covariance = None if self.marginals is None else self.marginals.all(x, frame="world")
        write_bytes(path, trajectory_text(self.poses, self.report, covariance))

    def _tum(self, path: str) -> None:
        from models import SE3, euler
        from nls.io.trajectory import write_tum

        state = np.zeros((len(self.poses), 6))
        state[:, [3, 4, 2]] = self.poses
        write_tum(path, self.report.vertex_times["x"], SE3.stack(euler.to_se3(state)))

    def _map(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.scan_mission.results import map_text

        write_bytes(path, map_text(self.poses, self.report))

    def _points(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.scan_mission.results import points_text

        write_bytes(path, points_text(self.poses, self.report))

    def _graph(self, path: str) -> None:
        from nls.io import rendered
        from nls.io.files import write_bytes

        write_bytes(path, rendered(path, self.graph, self.values)[0])

    def _closures(self, path: str) -> None:
        from nls.io.files import write_bytes
        from nls.io.scan_mission.results import closures_text

        write_bytes(path, closures_text(self.matches, self.report.numbers))
