"""``nls explain``: solve, and say in plain words what is free, what does not fit, and what helps."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from typing import TYPE_CHECKING

from nls.cli.formats import mission_of, read
from nls.cli.outputs import refuse_unwritable, say, write_json

if TYPE_CHECKING:
    from nls.cli.progress import Progress
    from nls.explanation import Explanation
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.robust import Robustified
    from nls.values import Values

__all__ = ["explain", "explanation_of", "with_tables"]


def explain(options: argparse.Namespace) -> int:
    """Read, find the landmarks of contacts without names, start, optimize, explain; returns the exit status, 0."""
    import nls
    from nls.cli import outliers
    from nls.cli.choices import GNC, ROBUST
    from nls.cli.preparation import believes_all, prepare
    from nls.cli.progress import Progress

    refuse_unwritable({"--json": options.json}, options.file, *options.dives)
    if outliers.is_gnc(options.robust):
        raise nls.OptionError("--robust", options.robust, f"{ROBUST}; nls solve has {' and '.join(GNC)}")
    for file in (options.file, *options.dives):
        if os.path.isdir(file):
            from nls.cli.scan_mission import refuse_explanation

            refuse_explanation(file)
    as_read, values, report = read(options, to_solve=True)
    options.phase.doing = f"while explaining {options.file}"
    judges = not believes_all(options, report) and options.robust is None
    graph = prepare(as_read, values, report, options)
    start, init, _ = nls.initialize(graph, values, options.init)
    with Progress("solve") as progress:
        explanation, how = _explained(graph, start, values, progress, report, options, judges)
        explanation = with_tables(explanation, report)
    head = {"input": report.path, "format": report.format, "init": init, "optimum": how}
    options.phase.now("while writing the report")
    write_json(head | {"notes": report.notes} | explanation.record(), options.json)
    if options.json != "-":
        say(f"{report.path}, {how}\n\n{explanation.report(shell=True)}")
        for note in report.notes:
            if note not in report.warnings:
                say(f"note        {note}")
    return 0


def with_tables(explanation: Explanation, report: LoadReport) -> Explanation:
    """With what is implausible in the tables of a mission first, no kernel for all, no sigmas of what is unmeasured."""
    if (mission := mission_of(report)) is None:
        return explanation
    from nls.explanation.findings import Finding, FindingKind

    first = [*mission.findings, *([mission.explained] if mission.explained else ())]
    findings = [Finding(FindingKind.IMPLAUSIBLE, (), finding.numbers) for finding in first]
    rest = [
        replace(finding, advice=tuple(a for a in finding.advice if a.action != "robust"))
        for finding in explanation.findings
    ]
    weakest = tuple(w for w in explanation.weakest if w.key.kind != "x" or w.component not in mission.unmeasured)
    return replace(explanation, findings=(*findings, *rest), weakest=weakest)


def explanation_of(graph: FactorGraph, values: Values, report: LoadReport) -> Explanation:
    """The explanation of a graph that was read, with the lines of the measurements where its file has them."""
    import nls

    mission = mission_of(report)
    dives = mission.dive_of if mission else []
    explanation = nls.explain(graph, values, dives or None, report.assumed)
    return explanation.placed(report.place) if report.has_lines else explanation


def _without_wrong_contacts(graph: FactorGraph, choice: Robustified, report: LoadReport) -> tuple[Explanation, str]:
    """The explanation of a mission without its wrong contacts, which it names, and what it is of."""
    from nls.cli import outliers
    from nls.explanation.causes import wrong_contacts

    kept, kept_report = outliers.without_rejected(graph, choice, report)
    explanation = explanation_of(kept, choice.result.values, kept_report)
    wrong = replace(explanation, findings=wrong_contacts(graph, choice)).placed(report.place)
    first, *exchanged = wrong.findings
    how = f"at its optimum without {outliers.sentence(choice)}"
    return replace(explanation, findings=(first, *explanation.findings, *exchanged)), how


def _explained(
    graph: FactorGraph,
    start: Values,
    values: Values,
    progress: Progress,
    report: LoadReport,
    options: argparse.Namespace,
    judges: bool,
) -> tuple[Explanation, str]:
    """The explanation of the optimum, or of where a damped method ended, or of the start; and which of them it is.

    Where `judges`, that of a mission whose contacts do not fit is of its optimum without the wrong ones.
    """
    import nls
    from models.advice import Advice
    from models.errors import EvaluationError, GraphError, SingularGeometryError, UnderconstrainedError
    from models.listing import several
    from nls.cli.hint import explain_misfit
    from nls.cli.outliers import choice_of
    from nls.explanation.doubts import graduates
    from nls.explanation.findings import FindingKind
    from nls.optimizers import default_optimizer

    best, how, why = start, "at the start", ""
    first = default_optimizer(graph.factors, callback=progress.show)
    damped = nls.LevenbergMarquardt(callback=progress.show)
    tries = (("file", first), ("file", damped), ("odometry", damped))
    for init, method in tries:  # closures may have spoiled the start
        try:
            result = graph.optimize(nls.initialize(graph, start, init)[0], method)
        except UnderconstrainedError:
            why = why or "something is free"
            continue
        except (EvaluationError, GraphError, SingularGeometryError) as error:
            why = error.message
            continue
        if judges and (choice := choice_of(graph, values, result, report)) is not None:
            progress.next("explain")
            return _without_wrong_contacts(graph, choice, report)
        explain_misfit(report, graph, result, options)
        if result.converged:
            how = f"at its optimum ({result.method}, {several(result.iterations, 'iteration')})"
            progress.next("explain")
            return explanation_of(graph, result.values, report), how
        best, why = result.values, f"{result.status.value}: {result.reason}"
        how = f"at the best values found ({result.method}, {several(result.iterations, 'iteration')})"
    progress.next("explain")
    explanation = explanation_of(graph, best, report)
    advice = (Advice("start"), *(Advice("gnc"),) * graduates(graph, best))
    finding = nls.Finding(FindingKind.NOT_CONVERGED, (), {"reason": why, "values": how}, advice)
    findings = tuple(entry for entry in explanation.findings if entry.kind is not FindingKind.NO_OPTIMUM)
    return replace(explanation, findings=(finding, *findings)), how
