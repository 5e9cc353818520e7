"""A solved map from scans: its errors, its setup, and its files: keyframes, points in the world, closures.

trajectory.csv has every keyframe with its standard deviations and correlations along the axes of the world, empty where
they are not known. map.csv has every point with its keyframe, and its intensity where there is one. closures.csv has
every candidate of the last round and what became of it.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from factors import Between, Covariance
from factors.keys import kinds
from models.algebra import distance_along
from models.errors import SingularGeometryError
from nls.metrics import TrajectoryError, circles
from nls.missions.charts.writers import ply_text
from nls.missions.checks.findings import SetupFinding
from nls.missions.checks.scan_setup import BENDING
from nls.missions.determination import or_empty
from nls.missions.folder.columns import LEVEL, suffixed
from nls.missions.folder.table import csv_text
from nls.missions.scans import Closing, Matches, Verdict
from nls.missions.scans.folder import ScanReport
from nls.missions.scans.scans import in_world
from nls.missions.solution import Solution
from nls.robust.graduated import Rejected

GRAPH = "graph.npz"
WILD = 1.0  # m rms by which the last round may still change the track, above which the solution is none
SIGMAS = suffixed(LEVEL)
TRAJECTORY = ("keyframe", "time_s", *LEVEL, *SIGMAS, "correlation_x_y", "correlation_x_yaw", "correlation_y_yaw")
MAP = ("x_m", "y_m", "keyframe", "intensity")
CLOSURES = ("keyframe_i", "keyframe_j", *LEVEL, *SIGMAS, "score", "ratio", "edge", "spread_m", "verdict")
x = kinds("x")[0]


class SolvedScans(Solution):
    """A map from scans; parameters as for `Solution`, whose graph has the closures, and three more.

    Parameters
    ----------
    select : how the matches were selected.
    closing : the rounds.
    findings : what is set up wrongly.
    """

    report: ScanReport

    def __init__(self, select: str, closing: Closing, findings: Sequence[SetupFinding], *arguments: Any) -> None:
        super().__init__(*arguments)
        self.select, self.closing, self.findings = select, closing, findings
        self.reckoned, self.poses = self.dead[x], self.values[x]

    @property
    def matches(self) -> Matches:
        """Candidates of the last round."""
        return self.closing.matches

    @property
    def rejected(self) -> list[Rejected]:
        """Accepted candidates that the others contradict."""
        m, wrong = self.matches, self.matches.accepted & ~self.matches.kept
        if not wrong.any():
            return []
        closures = Between(x[m.i[wrong]], x[m.j[wrong]], m.pose[wrong], Covariance(m.covariance[wrong]))
        sigmas = np.sqrt(closures.chi2(self.values)).tolist()
        parts = zip(closures, sigmas, strict=True)
        return [Rejected(part.describe(0), off, 0, k, part.keys, 0.0) for k, (part, off) in enumerate(parts)]

    @property
    def verdicts(self) -> list[str]:
        """The fate of every candidate: kept, contradicted by the others, or why it was no closure."""
        accepted = ["kept" if kept else "contradicted" for kept in self.matches.kept.tolist()]
        verdicts = zip(map(Verdict, self.matches.verdict.tolist()), accepted, strict=True)
        return [word if verdict is Verdict.ACCEPTED else verdict.words for verdict, word in verdicts]

    @cached_property
    def errors(self) -> dict[str, TrajectoryError]:
        """Dead reckoning and solution against the truth; none without one."""
        if (truth := self.report.truth) is None:
            return {}
        try:
            return {"dead_reckoning": truth.ate(self.reckoned), "solution": truth.ate(self.poses)}
        except SingularGeometryError as error:
            self.report.notes.append(f"no error against the truth: {error}")
            return {}

    def record(self) -> dict[str, Any]:
        """The map in the report for programs."""
        scans, words = self.report.scans, self.verdicts
        out: dict[str, Any] = {
            "keyframes": len(self.poses),
            "with_points": int(scans.with_points.sum()),
            "points": len(scans.points),
            "distance_m": float(distance_along(self.poses[:, :2])[-1]),
            "select": self.select,
            "rounds": [
                {"candidates": len(r.matches), "accepted": int(r.matches.accepted.sum())}
                | {"kept": int(r.matches.kept.sum()), "chi2_dof": r.chi2_dof, "moved_m": r.moved}
                for r in self.closing.rounds
            ],
            "settled": self.closing.settled,
            "setup": [finding.record() for finding in self.findings],
            "closures": (kept := int(self.matches.kept.sum())),
            "verdicts": {word: words.count(word) for word in sorted(set(words))},
        }
        if not kept and (marginals := self.marginals) is not None:
            last = marginals.covariance(x[len(self.poses) - 1], view="position")
            out["end_sigma_m"] = float(np.sqrt(np.trace(last)))
        if self.errors:
            out["judged_keyframes"] = len(self.errors["solution"].distances)
            out["alignment"] = self.errors["solution"].align
        for name, error in self.errors.items():
            out[name] = {"ate_rmse_m": error.rmse, "ate_mean_m": error.mean, "ate_largest_m": error.largest}
            out[name] |= circles(error.errors)
        return out

    def faults(self) -> list[str]:
        """Why the map is no solution: a setup that bends it, or a track that still moves."""
        if bent := [finding.kind.value.replace("_", " ") for finding in self.findings if finding.kind in BENDING]:
            return [f"no solution: the setup is wrong ({', '.join(bent)}), see the warning"]
        if self.closing.settled or (moved := self.closing.rounds[-1].moved) <= WILD:
            return []
        return [
            f"not settled: the last of {len(self.closing.rounds)} rounds moved the track by {moved:.2f} m rms; state "
            "the noise of dead reckoning in [drift] of mission.toml"
        ]

    def picture(self) -> Any:
        """The map from above."""
        from nls.missions.pictures.scan_map import scan_map

        truth = self.report.truth if self.errors else None
        return scan_map(self.poses, self.report.scans, self.reckoned, self.matches, truth)

    def files(self) -> dict[str, Callable[[], Any]]:
        """Makers of the files by name: each gives bytes, or a figure of matplotlib."""
        from nls.io import rendered

        files: dict[str, Callable[[], Any]] = {
            "trajectory.csv": self.trajectory,
            "trajectory.tum": self.tum,
            "map.csv": self.map,
            "map.ply": self.points,
            GRAPH: lambda: rendered(GRAPH, self.graph, self.values)[0],
            "map.png": self.picture,
        }
        return files | ({"closures.csv": self.closures} if len(self.matches) else {})

    def trajectory(self) -> bytes:
        """trajectory.csv."""
        known = np.full((len(self.poses), 6), np.nan)
        if self.marginals is not None:
            covariance = self.marginals.all(x, frame="world")
            sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
            one = np.where(sigma > 0, sigma, 1.0)
            correlation = (covariance / (one[:, :, None] * one[:, None, :]))[:, [0, 0, 1], [1, 2, 2]]
            known = np.column_stack([sigma, correlation])
        report = self.report
        return csv_text(TRAJECTORY, report.numbers, report.vertex_times["x"], self.poses, or_empty(known))

    def map(self) -> bytes:
        """map.csv."""
        report = self.report
        columns = [in_world(self.poses, report.scans), report.numbers[report.scans.keyframe]]
        columns += [] if report.intensity is None else [report.intensity]
        return csv_text(MAP[: len(columns) + 1], *columns)

    def points(self) -> bytes:
        """map.ply: the keyframes and the points, at z = 0."""
        report = self.report
        points, numbers = in_world(self.poses, report.scans), report.numbers[report.scans.keyframe]
        parts = [("keyframe", report.numbers, self.poses[:, :2]), ("point", numbers, points)]
        return ply_text(parts, "x, y and z = 0 of the world, m", "; number: of the keyframe")

    def closures(self) -> bytes:
        """closures.csv."""
        matches, numbers = self.matches, self.report.numbers
        sigma = np.sqrt(np.diagonal(matches.covariance, axis1=1, axis2=2))
        quality = np.column_stack([matches.score, matches.ratio, matches.edge, matches.spread])
        ends = numbers[matches.i], numbers[matches.j]
        return csv_text(CLOSURES, *ends, matches.pose, sigma, quality, self.verdicts)
