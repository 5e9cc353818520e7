"""The words of findings: one sentence a kind, advice once, data for programs; what nothing else checks."""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factors as f
import nls
from factors import XYH, ZPR, BearingRange, Between, Cauchy, Diagonal, Factor, Isotropic, Position, Prior, Shifted
from models import SE2, SE3, R
from models.advice import ACTIONS, Advice
from nls import FactorGraph, Values
from nls.analysis.misread import READINGS
from nls.analysis.suspects import Suspects
from nls.explanation import Finding, FindingKind, Measurement, words
from nls.explanation.doubts import CURES, certifies, graduates, of_suspects
from nls.explanation.naming import _loose
from nls.explanation.words import together
from nls.plot import report as page
from tests.combinations import for_all
from tests.nls.explanation.sentences import SNAPSHOT, sentences

ROOT = Path(__file__).parents[3]
x, l, c = nls.kinds("x", "l", "c")
STEPS = Between(x[0:5], x[1:6], [1.0, 0.0, 0.2], Isotropic(0.1))
CLOSURES = Between(x[[0, 1]], x[[4, 5]], [3.5, 1.6, 0.8], Isotropic(0.1))
SEEN = f.Landmark(x[0:6], l[0], np.ones((6, 2)), Isotropic(0.1))
VALUES = Values({x: (SE2, np.zeros((6, 3))), l: (R(2), np.zeros((1, 2)))})


@for_all(
    case=[
        ([STEPS, CLOSURES], True, True),
        ([STEPS], True, False),
        ([STEPS, SEEN], False, False),
        ([STEPS, CLOSURES, SEEN], False, True),
        ([STEPS[:2], STEPS[3:], CLOSURES], True, False),
        ([STEPS, CLOSURES.robust(Cauchy(1))], False, True),
        ([SEEN], False, False),
    ]
)
def test_what_is_offered_works(case: tuple[list[Factor], bool, bool]) -> None:
    factors, certified, graduated = case
    graph = FactorGraph(factors)
    values = VALUES if SEEN in factors else Values.of([VALUES.stacks["x"]])
    assert certifies(graph, values) == certified
    assert graduates(graph, values) == graduated
    for offered, solve in ((certified, nls.certify), (graduated, nls.gnc)):
        if not offered:
            with pytest.raises(nls.GraphError):
                solve(graph, values)  # type: ignore[operator]


def test_many_outliers_are_offered_what_works() -> None:
    for factors, actions in (
        ([STEPS, CLOSURES], ["gnc", "robust"]),
        ([STEPS, SEEN], ["robust"]),
        ([STEPS, CLOSURES.robust(Cauchy(1))], ["gnc", "inspect", "remove"]),
    ):
        graph = FactorGraph(factors)  # type: ignore[arg-type]
        suspects = Suspects([(0, 0)], {}, [], [], [], VALUES, 100.0, 30.0, many=True)
        (many,) = of_suspects(suspects, graph, graph.pattern(VALUES), {})
        assert [advice.action for advice in many.advice] == actions


def test_advice_stands_once_and_the_farthest_come_first() -> None:
    """Advice below the findings that share it; in the report for a terminal and in the page."""
    graph = FactorGraph([STEPS, CLOSURES, Prior(x[0], [0.0, 0, 0], Isotropic(0.1))])
    result = graph.optimize(Values.of([VALUES.stacks["x"]]))
    look, measure = (Advice("inspect", ("it",)), Advice.robust("Cauchy", 1)), (Advice("measure", ("it",)),)
    findings = tuple(Finding(FindingKind.UNMEASURED, (x[k],), {}, a) for k, a in enumerate((look, look, measure, look)))
    assert [(first, len(alike)) for first, alike in together(findings)] == [(1, 2), (3, 1), (4, 1)]
    worst = tuple(Measurement(f"Between({k})", (), 1.0, 1.0, sigmas, 0.5) for k, sigmas in enumerate((3.1, 9.0, 4.2)))
    explanation = replace(nls.explain(graph, result.values), findings=findings, worst=worst)
    lines = [line for line in explanation.report(shell=True).splitlines() if line[:5] == "   ->"]
    cures = ["look at it", "use a robust kernel: --robust cauchy:1"]
    assert lines == [*(f"   -> 1 to 2: {cure}" for cure in cures), "   -> measure it", *(f"   -> {c}" for c in cures)]
    assert "graph.robust(Cauchy(1))" in explanation.report()
    assert re.findall(r"^Between\((\d)\)", explanation.report(), flags=re.MULTILINE) == ["1", "2", "0"]
    shown = page(graph, result.values, result, explanation, shell=True)
    for where in (" with 1 to 2", ""):
        assert shown.count(f"What helps{where}: look at it; use a robust kernel: --robust") == 1
    assert re.findall(r">Between\((\d)\)<", shown)[:3] == ["1", "2", "0"]


def test_what_moves_is_named_by_its_unknowns() -> None:
    graph = FactorGraph([Prior(l[0:3], np.zeros((3, 2)), Isotropic(1.0))])
    pattern = graph.pattern(Values({l: (R(2), np.zeros((3, 2)))}))
    for moved, keys, components in (
        ([0, 0, 1, -1, 0, 0], (l[1],), (("x", "y"),)),
        ([1, 0, 1, -1, 0, 0], (l[0], l[1]), (("x",), ("x", "y"))),
        ([0, 0, 0, 0, 0, 1], (l[2],), (("y",),)),
    ):
        (finding,) = _loose(np.array([moved], dtype=float).T, np.arange(6), pattern)
        assert (finding.keys, finding.numbers["components"]) == (keys, components)


def test_the_sentences_are_those_of_the_snapshot() -> None:
    """Every kind of finding and every action once; `python -m tests.nls.explanation.sentences` writes the file anew."""
    assert SNAPSHOT.read_text(encoding="utf-8") == sentences()


def test_no_sentence_is_made_outside_the_words() -> None:
    """Findings are made of names and numbers: whoever makes one has no text of more than two words in it."""
    for path in sorted((ROOT / "nls" / "explanation").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
                texts = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
                assert all(len(text.split()) < 3 for text in texts), f"{path.name}:{node.lineno}"


def test_a_finding_for_programs_has_data_and_the_words_of_the_shell() -> None:
    numbers = {"distance": 0.1, "sigmas": np.inf}
    finding = Finding(FindingKind.TWINS, (l[1], l[2]), numbers, (Advice("merge"),), ((0, 3),))
    explanation = nls.explain(FactorGraph([STEPS, CLOSURES]), Values.of([VALUES.stacks["x"]]))
    placed = replace(explanation, findings=(finding,)).placed(lambda factor, index: f"a.g2o:{10 * factor + index}")
    (record,) = placed.record()["findings"]
    assert json.loads(json.dumps(record)) == {
        "kind": "twins",
        "keys": ["l1", "l2"],
        "numbers": {"distance": 0.1, "sigmas": None},
        "places": ["a.g2o:3"],
        "advice": [{"action": "merge", "about": []}],
        "sentence": placed.findings[0].says,
        "cures": ["merge them if they are the same: give both one number"],
    }
    assert record["sentence"].endswith(" [a.g2o:3]")


def test_every_reading_has_its_words_and_its_action() -> None:
    assert set(READINGS) == set(words.READINGS) == set(CURES)
    assert set(CURES.values()) <= set(ACTIONS)


N = 6
I = np.arange(N)
LEGS = XYH(x[I[:-1]], x[I[1:]], np.tile([1.0, 0, 0], (N - 1, 1)), Diagonal([0.1, 0.1, 0.01]))
CLOSURE = XYH(x[0], x[N - 1], [N - 1.0, 0, 0], Diagonal([0.1, 0.1, 0.01]))
DEPTHS = ZPR(x[I], np.zeros((N, 3)), Diagonal([0.1, 0.01, 0.01]))
AGAIN = ZPR(x[I], np.full((N, 3), 0.005), Diagonal([0.1, 0.01, 0.01]))  # by a second sensor
ANCHOR = (
    Position(x[0], [0.0, 0.0], Diagonal([0.01, 0.01]), components=("x", "y")),
    f.Heading(x[0], 0.0, Diagonal([0.001])),
)


def values(**more: np.ndarray) -> Values:
    X = SE3.identity(N)
    X[:, 0] = I
    return Values({x: (SE3, X)} | {nls.kinds(name)[0]: (R(z.shape[1]), z) for name, z in more.items()})


def unchecked(start: Values, *factors: Factor) -> dict[str, Finding]:
    """The findings about what nothing checks, by the only cure of each; empty of what is believed."""
    found = [f for f in nls.explain(FactorGraph(factors), start).findings if f.kind == "unchecked"]
    assert all(f.numbers["believed"] == (not f.advice) for f in found)
    assert all(len(f.advice) <= 1 for f in found)
    return {f.advice[0].action if f.advice else "": f for f in found}


def test_an_anchor_is_believed_and_a_second_depth_sensor_checks_depth_rows() -> None:
    found = unchecked(values(), LEGS, CLOSURE, DEPTHS, *ANCHOR)
    assert found.keys() == {"", "second sensor"}
    assert found[""].numbers["factors"] == ("Position(x0)", "Heading(x0)")
    assert found["second sensor"].numbers["count"] == N
    assert unchecked(values(), LEGS, CLOSURE, DEPTHS, AGAIN, *ANCHOR).keys() == {""}


def test_priors_of_all_poses_are_believed() -> None:
    """As those of a vehicle whose attitude nothing measures."""
    level = Prior(x[I], SE3.identity(), Diagonal([0.1, 0.01, 0.01]), components=("z", "roll", "pitch"))
    found = unchecked(values(), LEGS, CLOSURE, level, *ANCHOR)
    assert found.keys() == {""}
    assert found[""].numbers["count"] == N + 2


def test_a_lone_fix_is_believed_and_two_fixes_check_each_other() -> None:
    fix = Position(x[3], [3.0, 0.0], Diagonal([1.0, 1.0]), components=("x", "y"))
    found = unchecked(values(), LEGS, CLOSURE, DEPTHS, fix, ANCHOR[1])
    assert found[""].numbers["factors"] == ("Position(x3)", "Heading(x0)")
    fixes = Position(x[[1, 3]], [[1.0, 0.0], [3.0, 0.0]], Diagonal([1.0, 1.0]), components=("x", "y"))
    assert unchecked(values(), LEGS, CLOSURE, DEPTHS, fixes, ANCHOR[1]).keys() == {"second sensor"}


def test_the_anchor_of_every_part_is_believed() -> None:
    i, j = np.array([0, 1, 2, 10, 11, 12]), np.array([1, 2, 0, 11, 12, 10])
    ring = Between(x[i], x[j], np.tile([[1, 0, 2 * np.pi / 3]], (6, 1)), Isotropic(0.1))
    graph = FactorGraph([ring, Prior(x[[0, 10]], np.zeros((2, 3)), Isotropic(0.01))])
    start = Values({x: (SE2, np.zeros((6, 3)), [0, 1, 2, 10, 11, 12])})
    (finding,) = (f for f in nls.explain(graph, graph.optimize(start).values).findings if f.kind == "unchecked")
    assert finding.numbers["believed"]
    assert finding.numbers["count"] == 2


@pytest.mark.parametrize("count", [1, 2])
def test_the_prior_of_a_calibration_that_nothing_tells_is_believed(count: int) -> None:
    slope = np.tile([[1.0], [0.0], [0.0]], (N - 1, 1, 1))
    steps = Shifted(LEGS, slope, c[np.arange(N - 1) % count])
    prior = Prior(c[np.arange(count)], np.zeros((count, 1)), Isotropic(0.01))
    found = unchecked(values(c=np.zeros((count, 1))), steps, DEPTHS, AGAIN, *ANCHOR, prior)
    assert set(found[""].numbers["factors"]) >= {f"Prior(c{k})" for k in range(count)}


def test_a_point_is_checked_from_another_place_and_a_loose_end_by_a_closure() -> None:
    point, noise = np.array([[2.0, 3.0, 0.0]]), Diagonal([0.01, 0.01, 0.1])
    z = np.array([[np.arctan2(3, 2 - k), 0, np.hypot(3, 2 - k)] for k in (1, 4)])
    found = unchecked(values(l=point), LEGS, DEPTHS, AGAIN, *ANCHOR, BearingRange(x[1], l[0], z[0], noise))
    assert found["view"].numbers["factors"] == ("BearingRange(x1, l0)",)
    assert found["close"].numbers["count"] == N - 1
    both = BearingRange(x[[1, 4]], l[[0, 0]], z, noise)
    assert "view" not in unchecked(values(l=point), LEGS, DEPTHS, AGAIN, *ANCHOR, both)
    assert "close" not in unchecked(values(), LEGS, CLOSURE, DEPTHS, AGAIN, *ANCHOR)
