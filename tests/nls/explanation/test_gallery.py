"""Broken on purpose: every case of the gallery says what its page shows, and its cure cures."""

from __future__ import annotations

import re

import pytest

import nls
from models.errors import LeadlineError
from nls import Cholesky
from tests.nls.explanation.gallery import Case, Outcome, problems, run
from tests.nls.explanation.gallery_cases import CHAPTERS

CASES = [case for cases in CHAPTERS.values() for case in cases]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_a_broken_graph_says_why_and_its_cure_cures(case: Case) -> None:
    if "nls.QR()" in case.words and Cholesky.missing() is not None:
        pytest.skip("SuperLU draws the line between weak and singular elsewhere")
    assert problems(case, run(case)) == []


def test_cases_are_short_and_check_something() -> None:
    assert len(CASES) >= 65
    assert len({case.title for case in CASES}) == len(CASES)
    for case in CASES:
        assert case.words, case.title
        assert case.title[0].isupper()
        assert not case.title.endswith(".")
        assert len(case.broken.strip().splitlines()) < 15, case.title
        assert len(case.cure.strip().splitlines()) < 10, case.title
        assert max(len(line) for line in f"{case.broken}\n{case.cure}".splitlines()) <= 120, case.title
        assert not case.error or issubclass(getattr(nls, case.error), LeadlineError | nls.GraphWarning)
        assert not case.cure or re.search(r"result =|^assert ", case.cure, flags=re.MULTILINE), case.title


def test_problems_are_seen() -> None:
    """A case that says something else than the library is found out, and so is a cure that does not cure."""

    class Stuck:
        converged = False

    case = Case("A case", "", "GraphError", ("x7",), "result = 1")
    assert problems(case, Outcome("GraphError", "x7 has no value", {})) == []
    assert len(problems(case, Outcome("GraphError", "x8 has no value", {}))) == 1
    assert len(problems(case, Outcome("", "", {"result": Stuck()}))) == 3
    asked = Case("A case", "", "", ("x7",), explained=("free", "x9", "fix"))
    assert problems(asked, Outcome("", "x7", {}, nls.Finding(nls.FindingKind.FREE))) == []
    assert problems(asked, Outcome("", "x7", {})) == ["no finding of nls.explain is ('free', 'x9', 'fix')"]
    with pytest.raises(ZeroDivisionError):
        run(Case("A mistake of the gallery itself", "1 / 0", "GraphError", ()))
    with pytest.raises(nls.GraphWarning):
        run(Case("A cure that warns", "", "", (), "import warnings; warnings.warn('x5', nls.GraphWarning)"))
