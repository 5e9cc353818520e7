"""``nls solve DIR`` of a folder of keyframes and scans: its options, its rounds, its files, and what is said of it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import kinds
from models.errors import OptionError, SingularGeometryError, UnderconstrainedError
from models.options import did_you_mean
from nls.io.scan_mission import ScanReport, is_scan_mission
from nls.io.scan_mission.results import verdict_words
from nls.metrics import cep, drms2
from nls.sonar.scans import close
from nls.sonar.scans.candidates import centers, pairs
from nls.sonar.scans.closing import SELECTIONS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from models.algebra import Array
    from nls.cli.job import Job
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.metrics import TrajectoryError
    from nls.optimizers import Result
    from nls.sonar.scans import Closing, Matches
    from nls.values import Values

__all__ = ["GRAPH", "SolvedScans", "close_loops", "lines", "refuse_explanation", "selection_of", "unsettled"]

GRAPH = "graph.npz"
WILD = 1.0  # m rms by which the last round may still change the track, above which the solution is none
ROUNDS = 8
REFUSED: dict[str, tuple[object, str]] = {  # options, with their defaults and why others have no effect
    "elevation": (None, "a scan mission is of the plane"),
    "crs": (None, "a scan mission has coordinates of its own"),
    "init": ("auto", "a scan mission starts from dead reckoning"),
    "method": ("auto", "the rounds of a scan mission choose their own"),
    "linear_solver": ("auto", "the rounds of a scan mission choose their own"),
    "max_iterations": (100, "the rounds of a scan mission stop by themselves"),
    "update_tol": (None, "the rounds of a scan mission stop by themselves"),
    "chi2_rtol": (None, "the rounds of a scan mission stop by themselves"),
    "hold": ([], "a scan mission has only its keyframes and their drift"),
    "sigmas": ("stated", "the sigmas of a scan mission are those of [drift] in mission.toml and of its matches"),
    "gauge": ("first", "the first keyframe of a scan mission is held"),
    "certify": (False, "the drifts of a scan mission are no poses"),
    "convention": ("g2o", "a scan mission has its own residuals"),
    "allow_doubtful": (False, "it goes with --robust gnc-tls, of graph files"),
}
x = kinds("x")[0]


def selection_of(options: argparse.Namespace) -> str | None:
    """How matches are selected, by ``--robust``; None where the input is no scan mission.

    Raises
    ------
    OptionError
        Several folders, or an option that does nothing here.
    """
    folders = [options.file, *options.dives]
    if not any(map(is_scan_mission, folders)):
        return None
    if options.dives:
        raise OptionError("DIVE", options.dives[0], "one folder: a scan mission is solved alone")
    for name, (default, reason) in REFUSED.items():
        if (value := getattr(options, name)) != default:
            raise OptionError(f"--{name.replace('_', '-')}", value, f"nothing: {reason}")
    select = options.robust or SELECTIONS[0]
    if select not in SELECTIONS:
        allowed = f"for a scan mission one of {', '.join(SELECTIONS)}: how its matches are selected"
        raise OptionError("--robust", select, allowed + did_you_mean(select.partition(":")[0], SELECTIONS))
    return str(select)


def refuse_explanation(folder: str) -> None:
    """Refuse to explain a scan mission, which has no closures before it is solved.

    Raises
    ------
    OptionError
    """
    if is_scan_mission(folder):
        allowed = (
            f"a graph: this scan mission has no closures yet; nls solve {folder} -o OUT, then nls explain OUT/{GRAPH}"
        )
        raise OptionError("FILE", folder, allowed)


def close_loops(job: Job) -> None:
    """Match the scans and solve, round by round; dead reckoning where no two submaps overlap."""
    from nls.cli.progress import Progress

    assert isinstance(job.report, ScanReport)
    assert job.select is not None
    job.options.phase.now(f"while matching the scans of {job.options.file}")
    scans, closing = job.report.scans, None
    middle = centers(scans)
    with Progress("match scans", ROUNDS, job.options.quiet) as progress:
        if len(middle) and len(pairs(job.values[x], scans, middle)[0]):
            closing = close(job.graph, job.values, scans, ROUNDS, job.select, report=progress.say)
            job.graph = job.as_read = closing.graph
            job.result = closing.result
        else:
            job.result = job.graph.optimize(job.values)
    job.solved = SolvedScans(job.graph, job.values[x], job.result, job.report, closing)
    job.clock.lap("optimize")


class SolvedScans:
    """A map from scans: everything that is said of it and written.

    Parameters
    ----------
    graph, dead, result, report : with its closures, dead reckoning (count, 3), the solution, and what the folder holds.
    closing : the rounds; None where no two submaps overlap.
    """

    def __init__(
        self, graph: FactorGraph, dead: Array, result: Result, report: ScanReport, closing: Closing | None
    ) -> None:
        self.graph, self.dead, self.result, self.report, self.closing = graph, dead, result, report, closing
        self.values: Values = result.values
        self.poses: Array = result.values[x]

    @property
    def matches(self) -> Matches | None:
        """Candidates of the last round."""
        return None if self.closing is None else self.closing.matches

    @property
    def kept(self) -> int:
        """Closures in the graph."""
        return 0 if self.matches is None else int(self.matches.kept.sum())

    @cached_property
    def marginals(self) -> Marginals | None:
        """Covariances at the optimum; None where there are none, and a note says why."""
        from nls.covariance import Marginals

        if self.result.converged:
            try:
                return Marginals(self.graph, self.values)
            except UnderconstrainedError as error:
                reason = str(error)
        else:
            reason = "this is no optimum"
        self.report.notes.append(f"the files have no sigmas: {reason}")
        return None

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
        """What the report for programs says of the map."""
        scans, rounds = self.report.scans, () if self.closing is None else self.closing.rounds
        words = [] if self.matches is None else verdict_words(self.matches)
        out: dict[str, Any] = {
            "keyframes": len(self.poses),
            "with_points": int(scans.with_points.sum()),
            "points": len(scans.points),
            "distance_m": float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum()),
            "rounds": [
                {"candidates": len(r.matches), "accepted": int(r.matches.accepted.sum())}
                | {"kept": int(r.matches.kept.sum()), "chi2_dof": r.chi2_dof, "moved_m": r.moved}
                for r in rounds
            ],
            "settled": self.closing is not None and self.closing.settled,
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

    def picture(self) -> Figure:
        """The map from above."""
        from nls.plot.scan_map import scan_map

        return scan_map(
            self.poses, self.dead, self.report.scans, self.matches, self.report.truth if self.errors else None
        )

    def outputs(self, folder: str) -> list[tuple[Callable[[str], None], str]]:
        """What to write where: functions that take the name of the file, and the names."""
        files: dict[str, Callable[[str], None]] = {
            "trajectory.csv": self._trajectory,
            "trajectory.tum": self._tum,
            "map.csv": self._map,
            "map.ply": self._points,
            GRAPH: self._graph,
            "map.png": self.draw,
        }
        if self.matches is not None:
            files["closures.csv"] = self._closures
        return [(write, str(Path(folder, name))) for name, write in files.items()]

    def draw(self, path: str) -> None:
        """Write the map as a picture."""
        from nls.plot.picture import write_picture

        write_picture(path, self.picture())

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

        assert self.matches is not None
        write_bytes(path, closures_text(self.matches, self.report.numbers))


def lines(scans: dict[str, Any]) -> list[str]:
    """The lines of the table that say what a map from scans is worth."""
    out = [
        f"scans       {scans['keyframes']:,} keyframes over {scans['distance_m']:.4g} m, {scans['points']:,} points in "
        f"{scans['with_points']:,} of them"
    ]
    out += [
        f"round {number:<5d} {r['candidates']} candidates, {r['accepted']} accepted, {r['kept']} kept; chi2/dof "
        f"{r['chi2_dof']:.2f}; track moved {r['moved_m']:.2f} m rms"
        for number, r in enumerate(scans["rounds"], 1)
    ]
    if not scans["closures"]:
        why = "no candidate is a closure" if scans["rounds"] else "no two parts of the track show the same place"
        out.append(f"unchecked   {why}: the solution is dead reckoning")
        if (sigma := scans.get("end_sigma_m")) is not None:
            out.append(f"end         1 sigma of the position at the end: {sigma:.3g} m, by the stated noise alone")
    elif scans["settled"]:
        out.append(f"settled     after {len(scans['rounds'])} rounds")
    else:
        out.append(f"settled     no: the last round moved the track by {scans['rounds'][-1]['moved_m']:.2f} m rms")
    if "solution" in scans:
        out.append(
            f"ATE         dead reckoning {scans['dead_reckoning']['ate_rmse_m']:.3g} m, solution "
            f"{scans['solution']['ate_rmse_m']:.3g} m rmse of {scans['judged_keyframes']:,} keyframes against the truth "
            f"({scans['alignment']} alignment)"
        )
    return out


def unsettled(solved: object) -> bool:
    """Whether the last round still moved the track so far that it is no solution; said on standard error."""
    if not isinstance(solved, SolvedScans) or solved.closing is None or not solved.kept or solved.closing.settled:
        return False
    if (moved := solved.closing.rounds[-1].moved) <= WILD:
        return False
    print(
        f"nls: not settled: the last of {len(solved.closing.rounds)} rounds moved the track by {moved:.2f} m rms; "
        "state the noise of dead reckoning in [drift] of mission.toml",
        file=sys.stderr,
    )
    return True
