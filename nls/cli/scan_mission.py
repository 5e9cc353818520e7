"""``nls solve DIR`` of a folder of keyframes and scans: its options, its rounds, and what is said and written of it."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import kinds
from models.algebra import distance_along
from models.errors import GraphWarning, LeadlineError, OptionError, SingularGeometryError
from models.options import did_you_mean
from nls.cli.evaluate import circles
from nls.cli.job import Content, Job, Solution
from nls.missions.checks.findings import SetupFinding
from nls.missions.checks.scan_setup import BENDING, check_setup
from nls.missions.scans import close
from nls.missions.scans.closing import ROUNDS, SELECTIONS
from nls.missions.scans.folder import ScanReport, is_scan_mission
from nls.missions.scans.results import closures_text, map_text, points_text, trajectory_text, verdict_words

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.metrics import TrajectoryError
    from nls.missions.scans import Closing, Matches, Round

__all__ = ["GRAPH", "SolvedScans", "close_loops", "refuse_explanation", "selection_of"]

GRAPH = "graph.npz"
WILD = 1.0  # m rms by which the last round may still change the track, above which the solution is none
REFUSED = {  # why options of `solve` have no effect here, and which
    "a scan mission is of the plane": ["elevation"],
    "a scan mission has coordinates of its own": ["crs"],
    "a scan mission starts from dead reckoning": ["init"],
    "the rounds of a scan mission choose their own": ["method", "linear_solver"],
    "the rounds of a scan mission stop by themselves": ["max_iterations", "update_tol", "chi2_rtol"],
    "a scan mission has only its keyframes and their drift": ["hold"],
    "the sigmas of a scan mission are those of [drift] in mission.toml and of its matches": ["sigmas"],
    "the first keyframe of a scan mission is held": ["gauge"],
    "the drifts of a scan mission are no poses": ["certify", "improve"],
    "a scan mission has its own residuals": ["convention"],
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
    for name, reason in [(name, reason) for reason, names in REFUSED.items() for name in names]:
        if (value := getattr(options, name)) != options.default_of(name):
            raise OptionError(f"--{name.replace('_', '-')}", value, f"nothing: {reason}")
    select = SELECTIONS[0] if options.robust is None else options.robust
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
        raise OptionError("input", folder, allowed)


def close_loops(job: Job) -> None:
    """Match the scans and solve, round by round; dead reckoning where no two submaps overlap."""
    from nls.cli.progress import Progress

    assert isinstance(job.report, ScanReport)
    assert job.select is not None
    job.options.phase.now(f"while matching the scans of {job.options.file}")
    with Progress("match scans", ROUNDS, job.options.quiet) as progress:

        def show(after: Round) -> None:
            progress.say(f"{int(after.matches.kept.sum())} closures, moved {after.moved:.2f} m")

        closing = close(job.graph, job.values, job.report.scans, ROUNDS, job.select, report=show)
    findings: list[SetupFinding] = []
    try:
        findings = check_setup(job.graph, job.values, job.report.scans, closing, job.report.vertex_times["x"])
    except LeadlineError as error:
        job.report.notes.append(f"the setup was not checked: {error}")
    for finding in findings:
        job.report.warn(finding.says)
        warnings.warn(f"{job.options.file}: {finding.says}", GraphWarning, stacklevel=2)
    job.graph = job.as_read = closing.graph
    job.result = closing.result
    job.solved = SolvedScans(job, closing, findings)
    job.clock.lap("optimize")


class SolvedScans(Solution):
    """A map from scans.

    Parameters
    ----------
    job : as for `Solution`; its graph has the closures.
    closing : the rounds.
    findings : what is set up wrongly.

    Attributes
    ----------
    dead, poses : (count, 3) of dead reckoning and of the solution.
    """

    name = "scans"
    report: ScanReport

    def __init__(self, job: Job, closing: Closing, findings: Sequence[SetupFinding]) -> None:
        super().__init__(job)
        self.closing, self.findings = closing, findings
        self.dead: Array = job.values[x]
        self.poses: Array = self.values[x]

    @property
    def matches(self) -> Matches:
        """Candidates of the last round."""
        return self.closing.matches

    @property
    def kept(self) -> int:
        """Closures in the graph."""
        return int(self.matches.kept.sum())

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
            "select": self.job.select,
            "rounds": [
                {"candidates": len(r.matches), "accepted": int(r.matches.accepted.sum())}
                | {"kept": int(r.matches.kept.sum()), "chi2_dof": r.chi2_dof, "moved_m": r.moved}
                for r in rounds
            ],
            "settled": self.closing.settled,
            "setup": [finding.record() for finding in self.findings],
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
            out[name] |= circles(error.errors)
        return out

    def lines(self, scans: dict[str, Any]) -> list[str]:
        """The lines of the table that say what the map is worth, from its record."""
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
            why = (
                "no candidate is a closure"
                if scans["rounds"][-1]["candidates"]
                else "no two parts of the track show the same place"
            )
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

    def figures(self) -> dict[str, str]:
        """Of positions against the truth, rmse, before and after."""
        if not self.errors:
            return {}
        return {"ATE": f"{self.errors['dead_reckoning'].rmse:.3g} → {self.errors['solution'].rmse:.3g} m"}

    def picture(self) -> Any:
        """The map from above."""
        from nls.missions.pictures.scan_map import scan_map

        truth = self.report.truth if self.errors else None
        return scan_map(self.poses, self.dead, self.report.scans, self.matches, truth)

    def pictures(self) -> dict[str, Any]:
        """The map."""
        return {"The map": self.picture()}

    def files(self) -> dict[str, Content]:
        """The files of the folder, by name."""
        from nls.io import rendered

        files: dict[str, Content] = {
            "trajectory.csv": self._trajectory,
            "trajectory.tum": self.tum,
            "map.csv": lambda: map_text(self.poses, self.report),
            "map.ply": lambda: points_text(self.poses, self.report),
            GRAPH: lambda: rendered(GRAPH, self.graph, self.values)[0],
            "map.png": self.picture,
        }
        if len(self.matches):
            files["closures.csv"] = lambda: closures_text(self.matches, self.report.numbers)
        return files

    def _trajectory(self) -> bytes:
        covariance = None if self.marginals is None else self.marginals.all(x, frame="world")
        return trajectory_text(self.poses, self.report, covariance)
