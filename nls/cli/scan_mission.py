"""The folder of a scan mission as the input of a command."""

from __future__ import annotations

import argparse
import os
import shlex
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import nls
from factors.keys import kinds
from models.options import did_you_mean
from nls.cli.graph_file import named
from nls.cli.mission import Folder
from nls.cli.run import Problem, Solved
from nls.missions.checks.findings import SetupFinding
from nls.missions.checks.scan_setup import check_setup
from nls.missions.scans import close
from nls.missions.scans.closing import ROUNDS, SELECTIONS
from nls.missions.scans.folder import ScanReport, is_scan_mission
from nls.missions.scans.scans import in_world
from nls.missions.scans.solution import GRAPH, SolvedScans
from nls.missions.summary import scan_lines
from nls.stages import announce

if TYPE_CHECKING:
    from nls.missions.scans import Round
    from nls.robust.graduated import Rejected

x = kinds("x")[0]


class ScanMission(Folder):
    """The folder of a scan mission."""

    MEANINGLESS = (
        ("a scan mission is of the plane", ("elevation",)),
        ("a scan mission has coordinates of its own", ("crs",)),
        ("a scan mission starts from dead reckoning", ("init",)),
        ("a scan mission chooses its own in each round", ("method", "linear_solver")),
        ("rounds of a scan mission stop by themselves", ("max_iterations", "update_sigmas", "update_tol", "chi2_rtol")),
        ("a scan mission has only its keyframes and their drift", ("hold",)),
        ("the sigmas of a scan mission are those of [drift] in mission.toml and of its matches", ("sigmas",)),
        ("the first keyframe of a scan mission is fixed", ("gauge",)),
        ("the drifts of a scan mission are no poses", ("certify", "improve")),
        ("a scan mission has its own residuals", ("convention",)),
        *Folder.MEANINGLESS,
    )
    explains = False  # closures between scans have no lines

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options)
        self.select = SELECTIONS[0] if self.robust is None else self.robust  # how matches are selected, by ``--robust``
        self.robust, self.init = None, "file"

    def check_options(self) -> None:
        """Refuse several folders, and options that mean nothing here."""
        if self.options.dives:
            raise nls.OptionError("DIVE", self.options.dives[0], "one folder: a scan mission is solved alone")
        super().check_options()
        if self.select not in SELECTIONS:
            near = did_you_mean(self.select.partition(":")[0], SELECTIONS)
            allowed = f"for a scan mission one of {', '.join(SELECTIONS)}: how its matches are selected"
            raise nls.OptionError("--robust", self.select, allowed + near)

    def check_explainable(self) -> None:
        """Refuse a scan mission, which has no closures before it is solved."""
        folder = next(filter(is_scan_mission, self.files))
        way = f"nls solve {folder} -o OUT, then nls explain OUT/{GRAPH}"
        raise nls.OptionError("input", folder, f"a graph: this scan mission has no closures yet; {way}")

    def asking(self, written: Sequence[str] = ()) -> str:
        """The command that explains the graph with the closures, or writes it."""
        graph = next((name for name in written if os.path.basename(name) == GRAPH), None)
        words = ["explain", graph] if graph else ["solve", named(self.options.file), "-o", "OUT"]
        return shlex.join(["nls", *words])

    def solved(self, problem: Problem) -> Solved:
        """Match the scans and solve, round by round; dead reckoning where no two submaps overlap."""
        report, graph, values = problem.report, problem.graph, problem.values
        assert isinstance(report, ScanReport)
        self.options.phase.now(f"while matching the scans of {self.options.file}")

        def show(after: Round) -> None:
            announce(f"{int(after.matches.kept.sum())} closures, moved {after.moved:.2f} m")

        closing = close(graph, values, report.scans, ROUNDS, self.select, report=show)
        findings: list[SetupFinding] = []
        try:
            findings = check_setup(graph, values, report.scans, closing, report.vertex_times["x"])
        except nls.LeadlineError as error:
            report.notes.append(f"the setup was not checked: {error}")
        for finding in findings:
            report.warn(finding.says)
            warnings.warn(f"{self.options.file}: {finding.says}", nls.GraphWarning, stacklevel=2)
        closed = {**vars(problem), "graph": closing.graph, "as_read": closing.graph}
        solved = Solved(**closed, result=closing.result)
        solved = replace(solved, solution=SolvedScans(self.select, closing, findings, *solved.optimized))
        problem.clock.lap("optimize")
        return solved

    def doubts(self, solved: Solved) -> list[str]:
        """Doubts of any graph, and why the map is no solution."""
        return [*super().doubts(solved), *solved.solution.faults()]

    def record(self, solved: Solved) -> dict[str, Any]:
        """The map in the report for programs."""
        return {"scans": solved.solution.record()}

    def lines(self, record: dict[str, Any]) -> list[str]:
        """The lines of the table about the quality of the map, from the report for programs."""
        return scan_lines(record["scans"])

    def plan(self, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport) -> Any:
        """The scans where dead reckoning has them."""
        from nls.missions.pictures.scan_map import scan_map

        assert isinstance(report, ScanReport)
        return scan_map(values[x], report.scans)

    def picture(self, solved: Solved) -> Any:
        """The map from above."""
        return solved.solution.picture()

    def contents(self, solved: Solved) -> dict[str, Callable[[], Any]]:
        """Makers of the files of the folder, by name."""
        return {**solved.solution.files()}

    def layers(self, values: nls.Values, report: nls.LoadReport) -> dict[str, Any]:
        """The points of the scans, and the truth, moved onto the track by the rigid motion of least squares."""
        assert isinstance(report, ScanReport)
        poses, scans = values[x], report.scans
        clouds = {"scans": (in_world(poses, scans), report.vertex_times["x"][scans.keyframe])}
        return {"tracks": {} if report.truth is None else {"truth": report.truth.onto(poses)}, "clouds": clouds}

    def rejected(self, solved: Solved) -> Sequence[Rejected]:
        """The closures that the others contradict."""
        rejected: Sequence[Rejected] = solved.solution.rejected
        return rejected

    def page(self, solved: Solved) -> dict[str, Any]:
        """The map, and errors of positions against the truth, rmse, before and after."""
        solution, errors = solved.solution, solved.solution.errors
        ate = {"ATE": f"{errors['dead_reckoning'].rmse:.3g} → {errors['solution'].rmse:.3g} m"} if errors else {}
        return {"marginals": solution.marginals, "pictures": {"The map": solution.picture()}, "figures": ate}
