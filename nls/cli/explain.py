"""``nls explain``: solve, and say in plain words what is free, what does not fit, and what helps."""

import argparse
from dataclasses import replace

import nls
from models.advice import Advice
from models.listing import several
from nls.cli.choices import GNC, ROBUST
from nls.cli.graph_file import GraphFile, Read
from nls.cli.inputs import input_of
from nls.cli.outputs import Color, refuse_unwritable, say, say_notes, write_json
from nls.cli.phase import INTERRUPTED
from nls.explanation.doubts import graduates
from nls.optimizers import default_optimizer
from nls.stages import stage


def explain(options: argparse.Namespace) -> int:
    """Read, start, optimize, explain; returns the exit status, 0 whatever was found, 130 after Ctrl-C."""
    kind = input_of(options)
    refuse_unwritable({"--json": options.json}, *kind.files)
    if kind.rejects:
        raise nls.OptionError("--robust", options.robust, f"{ROBUST}; nls solve has {' and '.join(GNC)}")
    kind.check_explainable()
    as_read, values, report = kind.read_to_solve()
    options.phase.now(f"while computing the initial guess of {options.file}")
    graph = kind.prepared(as_read, values, report)
    start, init, _ = nls.initialize(graph, values, kind.init)
    options.phase.now(f"while explaining {options.file}")
    options.phase.outcome = "no findings yet; nls solve -o OUT writes its best values at Ctrl-C, for nls explain OUT"
    with stage("solve"):
        explanation, how, report = _explained(kind, (graph, values, report), start)
    explanation = kind.with_tables(explanation, report)
    head = {"input": report.path, "format": report.format, "init": init, "optimum": how}
    options.phase.now("while writing the report")
    write_json(head | {"notes": report.notes} | explanation.record(), options.json)
    if options.json != "-":
        color = Color.DOUBTFUL if explanation.findings else Color.GOOD
        say(f"{report.path}, {how}\n\n{explanation.report(shell=True)}", verdict=(explanation.summary, color))
        say_notes(report.notes, report.warnings)
    return INTERRUPTED * any(f.kind is nls.FindingKind.INTERRUPTED for f in explanation.findings)


def _without_wrong_contacts(
    kind: GraphFile, graph: nls.FactorGraph, choice: nls.Robustified, report: nls.LoadReport
) -> tuple[nls.Explanation, str]:
    """The explanation of a mission without its wrong contacts, which it names, and what it is of."""
    from nls.cli import outliers
    from nls.explanation.causes import wrong_contacts

    kept, kept_report = outliers.without_rejected(graph, choice, report)
    explanation = kind.explanation(kept, choice.result.values, kept_report)
    wrong = replace(explanation, findings=wrong_contacts(graph, choice)).placed(report.place)
    first, *exchanged = wrong.findings
    how = f"at its optimum: {outliers.sentence(choice)}"
    return replace(explanation, findings=(first, *explanation.findings, *exchanged)), how


def _explained(kind: GraphFile, read: Read, start: nls.Values) -> tuple[nls.Explanation, str, nls.LoadReport]:
    """The explanation of the optimum, or of where a damped method ended, or of the start; which of them; the report.

    That of a mission whose contacts do not fit is of its optimum without the wrong ones, but with ``--robust``.
    """
    graph, values, report = read
    best, how, why = start, "at the initial guess", ""
    first = default_optimizer(graph.factors)
    damped = nls.LevenbergMarquardt()
    tries = (("file", first), ("file", damped), ("odometry", damped))
    for init, method in tries:  # closures may have spoiled the start
        try:
            result = graph.optimize(nls.initialize(graph, start, init)[0], method)
        except nls.UnderconstrainedError:
            why = why or "something is free"
            continue
        except (nls.EvaluationError, nls.GraphError, nls.SingularGeometryError) as error:
            why = error.message
            continue
        if (choice := kind.choice((graph, values, report), result)) is not None:
            return *_without_wrong_contacts(kind, graph, choice, report), report
        report = kind.with_findings((graph, values, report), result)
        if result.converged:
            how = f"at its optimum ({result.method}, {several(result.iterations, 'iteration')})"
            return kind.explanation(graph, result.values, report), how, report
        best, why = result.values, f"{result.status.value}: {result.reason}"
        how = f"at the lowest chi2 found ({result.method}, {several(result.iterations, 'iteration')})"
    explanation = kind.explanation(graph, best, report)
    advice = (Advice("start"), *(Advice("gnc"),) * graduates(graph, best))
    finding = nls.Finding(nls.FindingKind.NOT_CONVERGED, (), {"reason": why, "values": how}, advice)
    findings = tuple(entry for entry in explanation.findings if entry.kind is not nls.FindingKind.NO_OPTIMUM)
    return replace(explanation, findings=(finding, *findings)), how, report
