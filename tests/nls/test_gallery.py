"""Broken on purpose: every case of the gallery says what its page shows, and its cure cures."""

from __future__ import annotations

import re

import pytest

import nls
from models.errors import LeadlineError
from nls import Cholesky
from tests.nls.gallery import Case, Outcome, problems, run
from tests.nls.gallery_cases import CHAPTERS

CASES = [case for cases in CHAPTERS.values() for case in cases]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_a_broken_graph_says_why_and_its_cure_cures(case: Case) -> None:
    if "'qr'" in case.words and Cholesky.missing() is not None:
        pytest.skip("SuperLU draws the line between weak and singular elsewhere")
    assert problems(case, run(case)) == []


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_a_case_is_short_and_checks_something(case: Case) -> None:
    assert case.words
    assert case.title[0].isupper()
    assert not case.title.endswith(".")
    assert len(case.broken.strip().splitlines()) < 15
    assert len(case.cure.strip().splitlines()) < 10
    assert max(len(line) for line in f"{case.broken}\n{case.cure}".splitlines()) <= 120
    if case.error:
        kind = getattr(nls, case.error)
        assert issubclass(kind, LeadlineError | nls.GraphWarning)
    if case.cure:
        assert re.search(r"^(result =|assert |.*\nresult =)", case.cure, flags=re.MULTILINE) or "result =" in case.cure


def test_the_gallery_is_large_and_titles_differ() -> None:
    assert len(CASES) >= 40
    assert len({case.title for case in CASES}) == len(CASES)


def test_problems_are_seen() -> None:
    """A case that says something else than the library is found out, and so is a cure that does not cure."""

    class Stuck:
        converged = False

    case = Case("A case", "", "GraphError", ("x7",), "result = 1")
    assert problems(case, Outcome("GraphError", "x7 has no value", {})) == []
    assert len(problems(case, Outcome("GraphError", "x8 has no value", {}))) == 1
    assert len(problems(case, Outcome("", "", {"result": Stuck()}))) == 3
    with pytest.raises(ZeroDivisionError):
        run(Case("A mistake of the gallery itself", "1 / 0", "GraphError", ()))
    with pytest.raises(nls.GraphWarning):
        run(Case("A cure that warns", "", "", (), "import warnings; warnings.warn('x5', nls.GraphWarning)"))
