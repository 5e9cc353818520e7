"""The words of an explanation: what they are about, what helps said once, tables in order, advice as it is typed."""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Between, Cauchy, Factor, Isotropic, Landmark, Prior
from models import SE2, R
from nls.cli.outputs import TYPED, typed, write_json
from nls.explanation import Finding, Measurement, Part
from nls.explanation.doubts import of_parts, of_suspects
from nls.explanation.naming import _loose
from nls.explanation.offers import certifies, graduates
from nls.explanation.suspects import Suspects
from nls.explanation.words import cured
from nls.plot import report as page

ROOT = Path(__file__).parents[2]
x, l = nls.kinds("x", "l")
STEPS = Between(x[0:5], x[1:6], [1.0, 0.0, 0.2], Isotropic(0.1))
CLOSURES = Between(x[[0, 1]], x[[4, 5]], [3.5, 1.6, 0.8], Isotropic(0.1))
SEEN = Landmark(x[0:6], l[0], np.ones((6, 2)), Isotropic(0.1))
VALUES = nls.Values({x: (SE2, np.zeros((6, 3))), l: (R(2), np.zeros((1, 2)))})


@pytest.mark.parametrize(
    ("factors", "certified", "graduated"),
    [
        ([STEPS, CLOSURES], True, True),
        ([STEPS], True, False),
        ([STEPS, SEEN], False, False),
        ([STEPS, CLOSURES, SEEN], False, True),
        ([STEPS[:2], STEPS[3:], CLOSURES], True, False),
        ([STEPS, CLOSURES.robust(Cauchy(1))], False, True),
        ([SEEN], False, False),
    ],
)
def test_what_is_offered_works(factors: list[Factor], certified: bool, graduated: bool) -> None:
    graph = nls.FactorGraph(factors)
    values = VALUES if SEEN in factors else nls.Values.of([VALUES.stacks["x"]])
    assert certifies(graph, values) == certified
    assert graduates(graph, values) == graduated
    if not certified:
        with pytest.raises(nls.GraphError):
            nls.certify(graph, values)
    if not graduated:
        with pytest.raises(nls.GraphError):
            nls.gnc(graph, values)


def found(graph: nls.FactorGraph, places: list[tuple[int, int]], many: bool = False) -> Suspects:
    rivals = dict.fromkeys(places, (0, None))
    return Suspects(places, rivals, [], [], [], VALUES, 100.0, 30.0, many)  # type: ignore[arg-type]


def test_kinds_without_the_suspects_say_so() -> None:
    part = Part("Between, steps", 10, 30, 300.0, 30.0, 17.0, 47.0, 9.0)
    graph = nls.FactorGraph([STEPS, CLOSURES])
    for places, said in (
        ([], "Between, steps: chi2 300 is 10 times"),
        ([(0, 0)], "Between, steps, without the suspect: chi2 300 is 10 times"),
        ([(0, 0), (1, 1)], "Between, steps, without the suspects: chi2 300 is 10 times"),
    ):
        (one,) = of_parts((part,), found(graph, places), graph)
        assert one.says.startswith(said)


def test_many_outliers_are_offered_what_works() -> None:
    for factors, gnc, kernel in (
        ([STEPS, CLOSURES], True, True),
        ([STEPS, SEEN], False, True),
        ([STEPS, CLOSURES.robust(Cauchy(1))], True, False),
    ):
        graph = nls.FactorGraph(factors)  # type: ignore[arg-type]
        (many,) = of_suspects(found(graph, [(0, 0)], many=True), graph, graph.pattern(VALUES))
        assert ("nls.gnc(graph, values)" in many.cure, "graph.robust(Cauchy(1))" in many.cure) == (gnc, kernel)


def test_what_helps_is_said_once() -> None:
    graph = nls.FactorGraph([STEPS, CLOSURES, Prior(x[0], [0.0, 0, 0], Isotropic(0.1))])
    result = graph.optimize(nls.Values.of([VALUES.stacks["x"]]))
    says = [("a is off", "look at it"), ("b is off", "look at it"), ("c is free", "measure it"), ("d", "look at it")]
    findings = tuple(Finding("outlier", (), *each) for each in says)
    assert [(first, len(alike)) for first, alike in cured(findings)] == [(1, 2), (3, 1), (4, 1)]
    explanation = replace(nls.explain(graph, result.values), findings=findings)
    lines = explanation.report().splitlines()[2:9]
    once = ["1. a is off.", "2. b is off.", "   -> 1 to 2: look at it", "3. c is free.", "   -> measure it", "4. d."]
    assert lines == [*once, "   -> look at it"]
    shown = page(graph, result.values, result, explanation)
    assert [shown.count(f"What helps{where}: look at it") for where in (" with 1 to 2", "")] == [1, 1]


def test_the_farthest_come_first() -> None:
    graph = nls.FactorGraph([STEPS, CLOSURES])
    result = graph.optimize(nls.Values.of([VALUES.stacks["x"]]))
    worst = tuple(Measurement(f"Between({k})", (), 1.0, 1.0, sigmas, 0.5) for k, sigmas in enumerate((3.1, 9.0, 4.2)))
    explanation = replace(nls.explain(graph, result.values), worst=worst)
    names = re.findall(r"^Between\((\d)\)", explanation.report(), flags=re.MULTILINE)
    assert names == ["1", "2", "0"]
    shown = page(graph, result.values, result, explanation)
    assert re.findall(r">Between\((\d)\)<", shown)[:3] == names


def test_what_cannot_be_told_apart_is_named() -> None:
    graph = nls.FactorGraph([Prior(l[0:3], np.zeros((3, 2)), Isotropic(1.0))])
    pattern = graph.pattern(nls.Values({l: (R(2), np.zeros((3, 2)))}))
    for moved, said in (
        ([0, 0, 1, -1, 0, 0], "x and y of l1 cannot be told apart"),
        ([1, 0, 1, -1, 0, 0], "x of l0, x, y of l1 can move together"),
        ([0, 0, 0, 0, 0, 1], "y of l2 can move"),
    ):
        ((text, keys),) = _loose(np.array([moved], dtype=float).T, np.arange(6), pattern)
        assert text == said
        assert all(repr(key) in said for key in keys)


def test_no_advice_of_python_reaches_the_command_line() -> None:
    """Every text of a finding, certificate or error that names a call has its option; none is left behind."""
    call = re.compile(r"\b(?:nls|graph|values|result)\.\w+\(|\b\w+=(?:True|\[|')|Isotropic|ElevationHinge|in Python")
    folders = ("explanation", "certificate", "robust")
    files = [p for name in folders for p in (ROOT / "nls" / name).glob("*.py")]
    files += [ROOT / "nls" / name for name in ("diagnose.py", "io/dialects.py", "io/read.py", "optimizers/result.py")]
    named = 0
    for path in files:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        documented = (ast.Module, ast.FunctionDef, ast.ClassDef)
        docs = {ast.get_docstring(node, clean=False) for node in ast.walk(tree) if isinstance(node, documented)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value not in docs:
                named += bool(call.search(node.value))
                assert not call.search(typed(node.value)), f"{path.name}:{node.lineno}"
    assert named > 8


def test_advice_is_typed_in_reports_for_programs_and_pages(tmp_path: Path) -> None:
    for named, option in TYPED.items():
        assert typed(f"a {named} b") == f"a {option} b"
    where = tmp_path / "r.json"
    write_json({"says": ["choose gauge='first', or linear solver 'qr' \"so\""]}, str(where))
    assert json.loads(where.read_text()) == {"says": ['choose --gauge first, or --linear-solver qr "so"']}
