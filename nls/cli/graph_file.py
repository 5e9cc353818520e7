"""A graph file as the input of a command: how it is read, solved, drawn, written and reported."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import nls
from factors.robust import kernel_from_text
from models.listing import number
from models.options import did_you_mean
from nls.cli import formats
from nls.cli.choices import GNC, KERNELS, ROBUST, ROBUST_OF_SOLVE
from nls.cli.outputs import input_name, refuse_loss
from nls.cli.run import Problem, Solved
from nls.io.files import title_of, write_bytes
from nls.io.formats import FORMATS, Reading, check_renumber, format_of, refuse_needless, suffix_of, suffixes
from nls.optimizers import OPTIMIZERS, default_optimizer

if TYPE_CHECKING:
    from nls.missions.charts import MapProjection
    from nls.plot.report.page import Page
    from nls.robust.graduated import Rejected

Read = tuple["nls.FactorGraph", "nls.Values", "nls.LoadReport"]
NO_FOLDER = "it is for the folder that -o writes of a mission"
Meaningless = tuple[tuple[str, tuple[str, ...]], ...]  # reasons, and the options of `solve` that do nothing
Writer = Callable[[str], None]  # of the file of this path


class GraphFile:
    """A graph file, a file of poses, or standard input; other kinds differ in what they override.

    Parameters
    ----------
    options : of the command.

    Attributes
    ----------
    files : all that is read.
    robust : the kernel of ``--robust``, or the way to reject measurements; None where all are kept.
    init : the name of the start.
    output_file : of the output; None where there is none, or a folder.
    room : the place of the output, where it is to be made.
    """

    MEANINGLESS: Meaningless = (
        (NO_FOLDER, ("crs",)),
        ("-o writes another graph than that of a mission", ("write_graph",)),
    )
    READERS: tuple[str, ...] = ("nls.io.graph_files",)  # modules that read it
    explains = True  # whether measurements have lines to explain
    unnumbered = "no output"  # for which --renumber is refused
    read_values = "file"  # the name of the start where it was read
    values_before = "as read"  # how they are called beside a solution

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, given = options, vars(options)
        self.files: list[str] = [options.file, *given.get("dives", [])]
        self.robust: str | None = given.get("robust")
        self.init: str = given.get("init", "auto")
        self.output_file: str | None = given.get("output")
        self.room: AbstractContextManager[None] = nullcontext()

    @property
    def rejects(self) -> bool:
        """Whether ``--robust`` asks for graduated non-convexity, not for a kernel."""
        return bool(self.robust and self.robust.rpartition("=")[2].startswith("gnc"))

    # --- before the work

    def check_options(self) -> None:
        """Refuse options of ``nls solve`` that mean nothing here.

        Raises
        ------
        OptionError
        """
        for name, reason in ((name, reason) for reason, names in self.MEANINGLESS for name in names):
            if (value := getattr(self.options, name)) != self.options.default_of(name):
                raise nls.OptionError(f"--{name.replace('_', '-')}", value, f"nothing: {reason}")

    def check_explainable(self) -> None:
        """Refuse what ``nls explain`` cannot explain."""

    def output_format(self) -> str:
        """The format of the output of ``nls solve``; empty where none is written, or a folder.

        Raises
        ------
        OptionError
            A format without values, or less than was read over the input.
        """
        options = self.options
        if not options.output:
            return ""
        form = format_of(options.output, options.to, "--to FORMAT", "-o")
        if form and not FORMATS[form].values:
            allowed = f"a format that holds the optimum, such as g2o: {form} files hold measurements only"
            raise nls.OptionError("-o", options.output, allowed)
        if options.sigmas != "stated":
            refuse_loss("-o", options, f"--sigmas {options.sigmas} replaces the stated sigmas")
        if self.rejects:
            refuse_loss("-o", options, f"{self.robust} leaves out the measurements it rejects")
        return form

    def check_renumber(self, form: str) -> None:
        """Refuse new numbers for what needs none."""
        if self.options.renumber:
            check_renumber(form or self.unnumbered)

    # --- reading

    def import_modules(self) -> None:
        """Import what reads and solves the input, so that the clocks of both count their work alone."""
        modules = [*self.READERS, "nls.starts"] + ["scipy.special"] * (self.robust is not None)
        modules += ["nls.cli.outliers", "nls.robust"] * self.rejects
        modules += ["nls.analysis"] * (self.options.sigmas != "stated")
        for module in modules:
            import_module(module)

    def read(self, stage: Callable[[Read], Read] = lambda read: read) -> Read:
        """The graph, start and report of the file, folder or stream; a trajectory has no measurements.

        Reading solves nothing. A command that solves may add a stage, which is shown as part of the reading.
        """
        options = self.options
        options.phase.begin(f"while reading {options.file}")
        graph, values, report = stage(self._read())
        options.phase.as_read = graph, report
        return graph, values, report

    def _read(self) -> Read:
        options, file = self.options, self.options.file
        given: Any = vars(options)
        how = Reading(*map(given.get, Reading._fields))  # not all commands have --elevation
        if len(self.files) > 1:
            return nls.load(self.files, *how)
        if file == "-":
            if sys.stdin is None:
                raise nls.GraphFileError("cannot be read: standard input is closed", input_name(file))
            return nls.io.load_stream(sys.stdin.buffer, input_name(file), *how)
        row = suffixes().get(suffix_of(file))
        if row is None or not row.poses_alone or options.dialect != "auto" or os.path.isdir(file):
            return nls.load(file, *how)
        refuse_needless(file, row.name, how)
        return row.read(how, file)

    def read_to_solve(self) -> Read:
        """The graph that `solve` and `explain` take: as it was read, and the landmarks of contacts without names."""
        return self.read()

    def check_format(self, option: str, form: str, report: nls.LoadReport) -> None:
        """Refuse to replace the input by a file of another format; none is written where the format is empty."""
        if form and form != report.format:
            refuse_loss(option, self.options, f"{form} files do not hold all that {report.format} files do")

    def prepared(self, as_read: nls.FactorGraph, values: nls.Values, report: nls.LoadReport) -> nls.FactorGraph:
        """The graph under the robust kernel, with the kinds fixed that were asked for; the one read does not change.

        Parameters
        ----------
        as_read, values, report : of the file; the report gets a note on a number that was left out.

        Raises
        ------
        GraphFileError
            A file without a measurement.
        OptionError
            No such kernel, type of factor or kind of variable.
        """
        if not as_read.factors:
            raise nls.GraphFileError(
                "has no measurement: nothing to optimize; add edges, or see the variables with nls plot",
                input_name(self.options.file),
            )
        graph = nls.FactorGraph(as_read.factors, as_read.fixed)
        if (robust := self.robust) is not None and not self.rejects:
            name, separator, kernel = robust.rpartition("=")
            names = list(dict.fromkeys(factor.name for factor in graph.factors))
            if separator and name not in names:
                allowed = "no type, or one of those in the graph: " + ", ".join(names) + did_you_mean(name, names)
                raise nls.OptionError("--robust", name, allowed)
            if (kind := kernel.partition(":")[0]) not in KERNELS:
                more, near = (ROBUST_OF_SOLVE, GNC) if self.options.command == "solve" else (ROBUST, ())
                raise nls.OptionError("--robust", robust, more + did_you_mean(kind, [*KERNELS, *near]))
            made = kernel_from_text(kernel)
            if ":" not in kernel:
                report.notes.append(f"--robust {robust}: taken as {kernel}:{made.c:g}, 95 % efficient without outliers")
            graph.factors = [f.robust(made) if name in ("", f.name) else f for f in graph.factors]
        for kind in self.options.hold:
            if kind not in values.stacks:
                allowed = "one of the kinds " + ", ".join(values.stacks) + did_you_mean(kind, values.stacks)
                raise nls.OptionError("--hold", kind, allowed)
            graph.fix(nls.Keys(kind, values.stack(kind).numbers))
        return graph

    def projection(self, report: nls.LoadReport) -> MapProjection | None:
        """The projection of the coordinates in the files; None for local ones."""
        return None

    # --- solving

    def optimum(self, problem: Problem) -> Solved:
        """The optimum from the start of a problem; with ``--sigmas estimate`` of the graph with rescaled noise."""
        options = self.options
        options.phase.now(f"while solving {options.file}")
        named = OPTIMIZERS.get(options.method)
        optimizer = named(problem.stop) if named else default_optimizer(problem.graph.factors, problem.stop)
        if options.sigmas != "stated":
            return _rescaled(problem, optimizer)
        result = problem.graph.optimize(problem.start, optimizer, problem.solver, options.gauge)
        return Solved(**{**vars(problem), "result": result})

    def solved(self, problem: Problem) -> Solved:
        """The optimum, and the findings about the input there."""
        solved = self.optimum(problem)
        problem.clock.lap("optimize")
        return solved

    def finished(self, solved: Solved) -> Solved:
        """The solved problem, with the solution of a mission at the last optimum."""
        return solved

    def choice(self, read: Read, result: nls.Result) -> nls.Robustified | None:
        """The measurements to keep where nothing was asked for and some do not fit; None: all."""
        return None

    def with_findings(self, read: Read, result: nls.Result, as_read: bool = True) -> nls.LoadReport:
        """The report with the findings of an optimum about the tables."""
        return read[2]

    def explanation(self, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport) -> nls.Explanation:
        """The explanation of a graph, with the lines of the measurements where its file has them."""
        dives = getattr(report, "dive_of", None) or None  # of every factor
        explanation = nls.explain(graph, values, dives, report.assumed)
        return explanation.placed(report.place) if report.has_lines else explanation

    def with_tables(self, explanation: nls.Explanation, report: nls.LoadReport) -> nls.Explanation:
        """The explanation with the findings about the tables of a mission."""
        return explanation

    def asking(self, written: Sequence[str] = ()) -> str:
        """The command that explains the graph: as it was read, or without what was rejected if that is written.

        Parameters
        ----------
        written : files that exist by now.
        """
        options = self.options
        of_lines = ["--drop-absent"] * options.drop_absent
        of_lines += ["--ignore-tags", options.ignore_tags] if options.ignore_tags else []
        if self.rejects and options.output in written and options.to is None:
            same = os.path.splitext(options.file)[1] == os.path.splitext(options.output)[1]  # lines left out are in it
            return shlex.join(["nls", "explain", named(options.output), *of_lines * same])
        words = ["nls", "explain", *map(named, self.files)]
        names = ["dialect", "convention", "elevation", "init", *["robust"] * (not self.rejects)]
        changed = [name for name in names if getattr(options, name) != options.default_of(name)]
        words += [word for name in changed for word in (f"--{name}", getattr(options, name))]
        words += ["--repair-information"] * options.repair_information + of_lines
        words += [word for kind in options.hold for word in ("--hold", kind)]
        return shlex.join(words)

    # --- what is said, drawn and written

    def doubts(self, solved: Solved) -> list[str]:
        """Reasons not to trust the result, in words; none where there are none.

        A calibration far from its belief is no reason: the measurements determined it, and the table prints it.
        """
        result, choice, sigmas = solved.result, solved.choice, solved.sigmas
        out = [result.doubt] * bool(result.doubt and result.converged)
        out += [] if choice is None else map(str, choice.doubts)
        if sigmas is not None and not sigmas.settled:
            out.append(
                f"the scales of the sigmas did not converge in {sigmas.rounds} rounds; take a better initial guess, "
                "--init, or estimate fewer scales with --sigmas estimate"
            )
        return out

    def marks(self, solved: Solved) -> list[str]:
        """Words on pictures and charts: reasons not to trust the result, and that this is no optimum."""
        return [f"not converged: {solved.result.status.value}"] * (not solved.result.converged) + self.doubts(solved)

    def record(self, solved: Solved) -> dict[str, Any]:
        """The solution in the report for programs."""
        return {}

    def findings(self, report: nls.LoadReport) -> dict[str, Any]:
        """Implausible tables, in the report for programs."""
        return {}

    def lines(self, record: dict[str, Any]) -> list[str]:
        """The lines of the table about the quality of the solution, from the report for programs."""
        return []

    def unmeasured(self, report: nls.LoadReport) -> Sequence[str]:
        """Components of a pose that nothing measures."""
        return ()

    def outputs(self, solved: Solved) -> dict[str, Writer]:
        """Writers of the files of the output, by their paths."""
        return {solved.graph_file: partial(self.write_optimum, solved)} if solved.graph_file else {}

    def write_optimum(self, solved: Solved, path: str) -> None:
        """Write the graph that was solved, at its optimum."""
        kept = solved.form, solved.as_read, solved.result.values, solved.report
        data, notes = formats.rendered(path, *kept, self.options.renumber)
        write_bytes(path, data)
        solved.report.notes.extend(notes)

    def plan(self, graph: nls.FactorGraph, values: nls.Values, report: nls.LoadReport) -> Any:
        """The picture of ``nls plot``."""
        from nls.plot import trajectory

        return trajectory(graph, values)

    def not_drawn(self, report: nls.LoadReport) -> list[str]:
        """Remarks on what was read and is not in the picture of ``nls plot``."""
        return []

    def picture(self, solved: Solved) -> Any:
        """The picture of ``--plot``."""
        from nls.plot import before_after

        return before_after(solved.graph, solved.before, solved.result, title_of(solved.report.path), solved.rejected)

    def layers(self, values: nls.Values, report: nls.LoadReport) -> dict[str, Any]:
        """Tracks and clouds of the files, as `nls.plot.view` takes them."""
        return {"tracks": {}, "clouds": {}}

    def view(self, read: Read, remark: str, before: nls.Values | None = None, **more: Any) -> Page:
        """The page of ``nls view``, with another track before; ``more`` as for `nls.plot.view`."""
        from nls.plot import view, view_page

        graph, values, report = read
        layers = self.layers(values, report)
        layers["tracks"] |= {} if before is None else {self.values_before: before}
        return view_page(view(graph, values, report, title=title_of(report.path), remark=remark, **layers, **more))

    def view_solved(self, solved: Solved) -> Page:
        """The page of ``--view``: the solution with its sigmas, the values before it, and what was rejected."""
        result, marginals = solved.result, solved.marginals if solved.result.converged else None
        as_read = replace(solved.report, sources=list(solved.sources))
        lines = [as_read.place(r.number, r.measurement) for r in solved.rejected]
        remark = f"{result.status.value}: chi2 {number(result.chi2_final)}, {number(result.dof)} expected"
        remark = "; ".join([remark, *self.doubts(solved)])
        about: dict[str, Any] = {"marginals": marginals, "rejected": self.rejected(solved), "lines": lines}
        return self.view((solved.graph, result.values, solved.report), remark, solved.before, **about)

    def rejected(self, solved: Solved) -> Sequence[Rejected]:
        """The measurements that were rejected."""
        return solved.rejected

    def page(self, solved: Solved) -> dict[str, Any]:
        """Parts of the page that other kinds of input do not have, as `nls.plot.report.report` takes them."""
        return {}


def named(file: str) -> str:
    """A file name that is not taken for an option; standard input is none."""
    return f"./{file}" if file.startswith("-") and file != "-" else file


def _rescaled(problem: Problem, optimizer: nls.Optimizer) -> Solved:
    """The scales of the sigmas, and the optimum of the graph with rescaled noise; lines of its file do not hold it."""
    options, report, old = problem.options, problem.report, problem.as_read
    groups: Any = options.sigmas.partition(":")[2] or "kinds"
    sigmas = nls.variance_components(problem.graph, problem.start, groups, optimizer, problem.solver, options.gauge)
    as_read = sigmas.rescaled(old)
    times = {id(factor): times for factor, times in report.factor_times}
    pairs = zip(old.factors, as_read.factors, strict=True)
    factor_times = [(new, times[id(factor)]) for factor, new in pairs if id(factor) in times]
    if problem.form:
        report.notes.append(f"{problem.graph_file} holds the estimated sigmas, not the stated ones")
    problem = replace(problem, as_read=as_read, report=replace(report, factor_times=factor_times, statements=[]))
    return Solved(**vars(replace(problem, graph=sigmas.graph, sigmas=sigmas)), result=sigmas.result)
