"""Graphs broken on purpose: what is wrong, the lines that do it, what the library has to say, and the cure.

`test_gallery.py` runs every case and its cure; the page *Broken on purpose* of the site is made from the same list by
running it, so the two cannot disagree.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nls
from models.errors import LeadlineError
from nls import Finding

__all__ = ["FILE", "PRELUDE", "Case", "Outcome", "problems", "run"]

FILE = "survey.g2o"
PRELUDE = """
import numpy as np
import nls
from factors import (
    ZPR, Bearing, Between, BetweenSensors, Cauchy, Covariance, Diagonal, Factor, Heading, Information, Isotropic,
    Landmark, Prior, Projection, Range, RangeAzimuth, Robust, Tukey, check_jacobians
)
from models import SE2, SE3, R
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, Values

x, l, p = nls.kinds("x", "l", "p")
noise = Diagonal(x=0.1, y=0.1, yaw=0.02)
i = np.arange(4)
chain = Between(x[i], x[i + 1], [1.0, 0.0, 0.0], noise)  # x0 - x1 - x2 - x3 - x4
values = Values({x: (SE2, SE2.identity(5))})
"""


@dataclass(frozen=True)
class Case:
    """One broken graph.

    Parameters
    ----------
    title : what is wrong, in a few words.
    broken : the lines that build it; the last assigns `said` where nothing is raised.
    error : name of the exception or warning; empty where `said` is what the library says.
    words : what its sentence must contain: names, places, what to do.
    cure : the lines that put it right; they end in a result or an assertion. Empty where there is nothing to run.
    file, cured_file : content of the file that `broken` and `cure` read.
    explained : kind, keys and advice of a finding of `nls.explain` of `graph`, at the values of error or result.
    """

    title: str
    broken: str
    error: str
    words: tuple[str, ...]
    cure: str = ""
    file: str | bytes = ""
    cured_file: str = ""
    explained: tuple[str, str, str] | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of a case: the name of the exception or warning, its sentence, what the cure left behind, a finding."""

    error: str
    sentence: str
    cured: dict[str, Any]
    finding: Finding | None = None


def run(case: Case) -> Outcome:
    """Run a case, then its cure, in an empty folder. Anything but an error or warning of the library comes through."""
    with _folder(case.file):
        namespace, values = _executed(PRELUDE, {}), None
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                _executed(case.broken, namespace)
            except LeadlineError as error:
                name, sentence, values = type(error).__name__, str(error), getattr(error, "values", None)
            else:
                name, sentence = "", str(namespace.get("said", ""))
                if warned and not sentence:
                    name, sentence = warned[0].category.__name__, str(warned[0].message)
    finding = _finding(case, namespace["graph"], values or namespace["result"].values) if case.explained else None
    with _folder(case.cured_file or case.file), warnings.catch_warnings():
        warnings.simplefilter("error")
        cured = _executed(case.cure, namespace) if case.cure else {}
    return Outcome(name, sentence, cured, finding)


def problems(case: Case, outcome: Outcome) -> list[str]:
    """In what the library did not do what the case says; empty when all is well."""
    found = []
    if outcome.error != case.error:
        found.append(f"expected {case.error or 'no error'}, came {outcome.error or 'no error'}: {outcome.sentence}")
    found += [f"{word!r} is not in: {outcome.sentence}" for word in case.words if word not in outcome.sentence]
    if case.explained and outcome.finding is None:
        found.append(f"no finding of nls.explain is {case.explained}")
    result = outcome.cured.get("result") if case.cure else None
    if result is not None and not result.converged:
        found.append(f"the cure does not converge: {result!r}")
    return found


def _finding(case: Case, graph: nls.FactorGraph, values: nls.Values) -> Finding | None:
    """The finding of this kind, about these variables, with this advice; None where there is none."""
    for finding in nls.explain(graph, values).findings:
        keys, advice = (" ".join(map(str, names)) for names in (finding.keys, (a.action for a in finding.advice)))
        if (finding.kind.value, keys, advice) == case.explained:
            return finding
    return None


def _executed(code: str, namespace: dict[str, Any]) -> dict[str, Any]:
    exec(compile(code, "<gallery>", "exec"), namespace)
    return namespace


@contextlib.contextmanager
def _folder(content: str | bytes) -> Iterator[None]:
    """A folder with the file, as the current one."""
    with tempfile.TemporaryDirectory() as folder:
        before = Path.cwd()
        Path(folder, FILE).write_bytes(content.encode() if isinstance(content, str) else content)
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)
