"""The folder of a mission, or of several dives, as the input of a command."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import nls
import nls.missions
from nls.cli import formats
from nls.cli.graph_file import NO_FOLDER, GraphFile, Meaningless, Read, Writer
from nls.cli.outliers import choice_of
from nls.cli.run import Problem, Solved
from nls.io.files import new_folder, title_of, write_bytes
from nls.io.formats import format_of, suffixes
from nls.missions import MissionReport
from nls.missions.checks.table_errors import table_errors
from nls.missions.summary import lines, of_tables
from nls.optimizers.result import TWICE, shares

if TYPE_CHECKING:
    from nls.missions.charts import MapProjection
    from nls.missions.files import MissionFiles

MARK = "doubtful.txt"  # beside the files of a doubtful solution: its reasons, one a line


class Folder(GraphFile):
    """A folder whose solution is a folder."""

    MEANINGLESS: Meaningless = (("the solution of a mission is a folder with files of their own", ("to",)),)
    READERS = ("nls.io.graph_files", "nls.missions.folder.read")
    unnumbered = "mission"
    read_values = values_before = "dead reckoning"

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options)
        if self.output_file:
            self.room = new_folder(self.output_file)
        self.output_file = None

    def output_format(self) -> str:
        """The format of ``--write-graph``, once it is known that the folder of the output can hold the solution.

        Raises
        ------
        OptionError
        """
        if (folder := self.options.output) is None:
            return self.graph_format()
        path = Path(folder)
        if path.suffix in suffixes() and not os.path.isdir(folder):
            raise nls.OptionError("-o", folder, "a folder: the solution of a mission is several files")
        existing = next((p for p in (path, *path.absolute().parents) if os.path.exists(p)), path)
        if not folder or folder == "-" or not os.path.isdir(existing):
            raise nls.OptionError("-o", folder, "a folder, or the name of one to be made: the input is a mission")
        if not os.access(existing, os.W_OK | os.X_OK):
            raise nls.OptionError("-o", folder, "a folder you may write to")
        if os.path.exists(path) and any(os.path.samefile(path, mission) for mission in self.files):
            raise nls.OptionError("-o", folder, "another folder than that of the mission")
        return self.graph_format()

    def graph_format(self) -> str:
        """The format of ``--write-graph``; empty without it."""
        file = self.options.write_graph
        return format_of(file, None, "--to FORMAT", "--write-graph") if file else ""

    def outputs(self, solved: Solved) -> dict[str, Writer]:
        """Writers of the files of the folder, and its mark where the solution is doubtful, by their paths."""
        graph = super().outputs(solved)
        if not (folder := self.options.output):
            return graph
        files, doubts = self.contents(solved), self.marks(solved)
        if doubts:
            files[MARK] = lambda: "".join(f"{reason}\n" for reason in doubts).encode()
        else:
            Path(folder, MARK).unlink(missing_ok=True)  # of another solution

        def write(make: Callable[[], Any], path: str) -> None:
            content = make()
            Path(path).parent.mkdir(exist_ok=True)
            if isinstance(content, bytes):
                write_bytes(path, content)
            else:
                from nls.plot.picture import write_picture

                write_picture(path, content, self.marks(solved))

        return {str(Path(folder, name)): partial(write, make) for name, make in files.items()} | graph

    def contents(self, solved: Solved) -> dict[str, Callable[[], Any]]:
        """Makers of the files of the folder, by name: each gives bytes, or a figure of matplotlib."""
        raise NotImplementedError


class Mission(Folder):
    """The folder of a mission."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options)
        if self.robust == "none":  # all contacts are kept
            self.robust = None

    def graph_format(self) -> str:
        """The format of ``--write-graph``, which has lines for the graph of a mission; empty without it."""
        if form := super().graph_format():
            formats.refuse_lines(self.options.write_graph, form)
        return form

    def read_to_solve(self) -> Read:
        """The graph as it was read, with the landmarks that association finds for contacts without names."""

        def with_landmarks(read: Read) -> Read:
            graph, values, report = read
            mission = self.mission(report)
            return read if mission.unnamed is None else nls.missions.associated(graph, values, mission)

        return self.read(with_landmarks)

    def not_drawn(self, report: nls.LoadReport) -> list[str]:
        """The remark on contacts without names."""
        unnamed = self.mission(report).unnamed
        return [] if unnamed is None else [unnamed.note(report.path)]

    def projection(self, report: nls.LoadReport) -> MapProjection | None:
        """The projection of ``--crs``.

        Raises
        ------
        OptionError
            Where it would have no effect, and as for `nls.missions.charts.projection`.
        """
        if (name := self.options.crs) is None:
            return None
        from nls.missions.charts import projection

        if not self.options.output:
            raise nls.OptionError("--crs", name, f"nothing: {NO_FOLDER}")
        return projection(name, self.mission(report).plane)

    def mission(self, report: nls.LoadReport) -> MissionReport:
        """The report as that of a mission, which a folder has."""
        assert isinstance(report, MissionReport)
        return report

    def optimum(self, problem: Problem) -> Solved:
        """The optimum; under a kernel with the ignored measurements of every table."""
        solved = super().optimum(problem)
        if solved.result.shares:
            factors, tables = solved.graph.factors, self.mission(solved.report).tables
            names = [f"{factor.name} ({table})" for factor, table in zip(factors, tables, strict=True)]
            solved.result.shares = shares(factors, solved.result.values, names)
        return solved

    def solved(self, problem: Problem) -> Solved:
        """The optimum, without wrong contacts where the plain optimum shows some, and causes of its chi2."""
        solved = self.optimum(problem)
        if (choice := self.choice((solved.graph, solved.values, solved.report), solved.result)) is not None:
            solved = self.optimum(problem.without(choice, "gnc-tls"))
        problem.clock.lap("optimize")
        as_read = solved.choice is None and solved.sigmas is None
        report = self.with_findings((solved.graph, solved.values, solved.report), solved.result, as_read)
        problem.clock.lap("report")
        return replace(solved, report=report)

    def finished(self, solved: Solved) -> Solved:
        """The solved problem with its solution at the last optimum."""
        from nls.missions.solution import SolvedMission

        return replace(solved, solution=SolvedMission(*solved.optimized))

    def choice(self, read: Read, result: nls.Result) -> nls.Robustified | None:
        """The contacts to keep where some do not fit; None where all are kept, or the user says which."""
        if self.options.robust is not None or getattr(self.options, "sigmas", "stated") != "stated":
            return None
        graph, values, report = read
        return choice_of(graph, values, result, report)

    def with_findings(self, read: Read, result: nls.Result, as_read: bool = True) -> nls.LoadReport:
        """The report with errors of whole tables, and causes of an implausible chi2.

        Nothing is tried of a graph that is not as read. Special values and wrong units of its tables come first: beside
        them nothing is tried.
        """
        (graph, _, report), (chi2, dof) = read, result.believed
        mission = self.mission(report)
        errors = table_errors(graph, result.values, chi2, dof, mission) if result.converged and dof > 0 else []
        if not as_read:
            return replace(mission, errors=[replace(error, evident=False) for error in errors])
        mission = replace(mission, errors=errors)
        implausible = bool(result.doubt) and result.chi2_final > TWICE * result.dof
        if not (implausible or any(error.evident for error in errors)):
            return mission
        from nls.missions.checks.trials import explained, worth_trying
        from nls.missions.folder.folder import read_tables

        if not worth_trying(mission.findings):
            return mission
        elevation = self.options.elevation or "hinge"
        tables = read_tables(mission.path)[0]
        explanation = explained(tables, result.chi2_final, result.dof, errors, elevation)
        tried = explanation.trials or "contacts.csv" not in mission.tags  # the mounting of a sonar is not tried
        return replace(mission, explained=explanation) if tried else mission

    def with_tables(self, explanation: nls.Explanation, report: nls.LoadReport) -> nls.Explanation:
        """The explanation with implausible tables first, no kernel for all, no sigmas of unmeasured components."""
        mission = self.mission(report)
        first = [*mission.findings, *([mission.explained] if mission.explained else ())]
        findings = [nls.Finding(nls.FindingKind.IMPLAUSIBLE, (), finding.numbers) for finding in first]
        rest = [
            replace(finding, advice=tuple(a for a in finding.advice if a.action != "robust"))
            for finding in explanation.findings
        ]
        weakest = tuple(w for w in explanation.weakest if w.key.kind != "x" or w.component not in mission.unmeasured)
        return replace(explanation, findings=(*findings, *rest), weakest=weakest)

    def doubts(self, solved: Solved) -> list[str]:
        """The findings on the tables first, by name; fixes that jump are what a kernel on their table is for."""
        mission = self.mission(solved.report)
        factors = zip(mission.tables, solved.graph.factors, strict=True)
        robust = {table for table, factor in factors if factor.kernel is not None}
        left = [
            f"{finding.check} ({finding.file})"
            for finding in mission.findings
            if finding.file not in robust or finding.check != "jumps"
        ]
        if not (left or solved.result.doubt):
            errors = sorted((error for error in mission.errors if error.evident), key=lambda error: -error.fall)
            left = [f"{error.quantity} ({error.file})" for error in errors[:1]]
        return [f"implausible: {', '.join(dict.fromkeys(left))}"] * bool(left) + super().doubts(solved)

    def findings(self, report: nls.LoadReport) -> dict[str, Any]:
        """Implausible tables, in the report for programs."""
        mission = self.mission(report)
        explained = mission.explained and mission.explained.record()
        return {"findings": [finding.record() for finding in mission.findings], "explained": explained}

    def record(self, solved: Solved) -> dict[str, Any]:
        """The mission in the report for programs."""
        return {"mission": solved.solution.record()}

    def lines(self, record: dict[str, Any]) -> list[str]:
        """The lines of the table about the quality of the solution, from the report for programs."""
        return lines(record["mission"])

    def unmeasured(self, report: nls.LoadReport) -> Sequence[str]:
        """Components of a pose that nothing measures."""
        return self.mission(report).unmeasured

    def plan(self, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport) -> Any:
        """The mission from above and from the side."""
        from nls.missions.pictures.mission import plan

        return plan(graph, values)

    def picture(self, solved: Solved) -> Any:
        """Before and after, from above and from the side."""
        from nls.missions.pictures.mission import plan_before_after

        title = title_of(solved.report.path)
        return plan_before_after(solved.graph, solved.before, solved.result, title, solved.rejected)

    def layers(self, values: nls.Values, report: nls.LoadReport) -> dict[str, Any]:
        """The truth, and the bottom below the track, where the files have them."""
        from nls.missions.charts.chart import bottom

        mission = self.mission(report)
        times, points = bottom(values, mission)
        clouds = {"sea floor below the track": (points, times)} if len(points) else {}
        truth = {"truth": mission.truth} if any(key in values for key in mission.truth) else {}
        return {"tracks": truth, "clouds": clouds, "down": True}

    def made(self, solved: Solved) -> MissionFiles:
        """The files of the solution."""
        from nls.missions.files import MissionFiles

        return MissionFiles(solved.solution, solved.projection, self.marks(solved))

    def contents(self, solved: Solved) -> dict[str, Callable[[], Any]]:
        """Makers of the files of the folder, by name."""
        return self.made(solved)()

    def page(self, solved: Solved) -> dict[str, Any]:
        """Covariances and pictures of the page, and errors of whole tables that nothing shows."""
        made, solution = self.made(solved), solved.solution
        pictures = {"The track": made.track()} | ({"The landmarks": made.landmarks()} if solution.mapped else {})
        return {"marginals": solution.marginals, "pictures": pictures, "unchecked": of_tables(solution.unchecked)}


class Dives(Mission):
    """The folders of several dives, which are solved as one: a track each, landmarks and beacons in common."""

    def finished(self, solved: Solved) -> Solved:
        """The solved problem with its solution at the last optimum, dive by dive."""
        from nls.missions.solution import SolvedDives

        return replace(solved, solution=SolvedDives(*solved.optimized))

    def with_findings(self, read: Read, result: nls.Result, as_read: bool = True) -> nls.LoadReport:
        """The report with errors of whole tables; other readings are not tried of several dives."""
        return super().with_findings(read, result, as_read=False)

    def made(self, solved: Solved) -> MissionFiles:
        """The files of the solution, and those of each dive."""
        from nls.missions.files import DiveFiles

        return DiveFiles(solved.solution, solved.projection, self.marks(solved))
