"""The page as a whole."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from models.errors import GraphWarning, UnderconstrainedError
from nls.io.files import write_bytes
from nls.plot.report.markup import Html, joined, tag
from nls.plot.report.sections import SECTIONS, ReportData, key_figures, verdict
from nls.values import Values, refuse_other

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nls.certificate import Certificate
    from nls.covariance import Marginals
    from nls.explanation import Explanation
    from nls.graph import FactorGraph
    from nls.optimizers import Result
    from nls.robust.graduated import Rejected

# Every rule is about the inside of the page, so that it changes nothing else in a notebook that shows it. Pictures are
# drawn for a white page; in the dark they are turned over, with their hues kept.
STYLE = Path(__file__).with_name("style.css").read_text(encoding="utf-8")


class Page(str):
    """HTML of a whole page; a notebook shows it."""

    __slots__ = ()

    def save(self, path: str | Path) -> None:
        """Write the page to a file, whole or not at all."""
        write_bytes(path, self.encode())

    def _repr_html_(self) -> str:
        frame = "width: 100%; height: 40em; border: 0"  # a frame of its own: its style is for a whole page
        return tag("iframe", srcdoc=self, style=frame)


def report(
    graph: FactorGraph,
    start: Values,
    result: Result | UnderconstrainedError,
    explanation: Explanation | None = None,
    *,
    title: str = "",
    init: str = "",
    marginals: Marginals | None = None,
    certificate: Certificate | None = None,
    rejected: Sequence[Rejected] = (),
    doubts: Sequence[object] = (),
    facts: Mapping[str, str] | None = None,
    seconds: Mapping[str, float] | None = None,
    pictures: Mapping[str, Figure] | None = None,
    figures: Mapping[str, str] | None = None,
    shell: bool = False,
) -> Page:
    """A solution on one page of HTML, with everything in it: no network and no scripts.

    The same arguments give the same bytes, but for `seconds`.

    Parameters
    ----------
    graph : what was solved.
    start : the values as they came; they can be evaluated.
    result : of the optimization, or the error it ended with: the page then tells what is known.
    explanation : of the graph at the result; made when omitted.
    title : heads the page, such as the name of a file.
    init : how the start was found, such as ``chordal``.
    marginals : covariances at the optimum; computed when omitted.
    certificate : of `nls.certify`.
    rejected : measurements that robust estimation has left out, each with its `factor` and `sigmas`.
    doubts : why the choice of these may be wrong, `nls.gnc`.
    facts : where it comes from, by name.
    seconds : where the time went, by part; only this differs between two runs.
    pictures : figures by caption, in the place of the maps before and after and of the ellipses.
    figures : further key figures by name, such as the error against a truth.
    shell : whether advice is for the command line, not for Python.

    Returns
    -------
    Page
        The text of a file; `Page.save` writes it, and a notebook shows it.

    Raises
    ------
    EvaluationError, SingularGeometryError
        `start` has no chi2.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.plot import report
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=8)
    >>> page = report(world.graph, world.start, world.graph.optimize(world.start), title="two laps")
    >>> page[:15], "two laps" in page, "<script" in page
    ('<!DOCTYPE html>', True, False)
    """
    refuse_other("report", graph, start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)  # they were given when it was solved
        final = start if result.values is None else result.values
        if explanation is None:
            from nls.explanation import explain

            explanation = explain(graph, final)
        known = init, marginals, certificate, rejected, doubts
        by_name = facts or {}, seconds or {}, pictures or {}, figures or {}
        data = ReportData(graph, start, result, explanation, *known, *by_name, shell)
        body = {link: element for link, make in SECTIONS.items() if (element := make(data)) is not None}
        head = [
            tag("p", title, class_="file"),
            verdict(data),
            key_figures(data),
            tag("nav", joined([tag("a", link, href=f"#{SECTIONS[link].__name__}") for link in body], " ")),
        ]
        page = [tag("header", joined(head, "\n")), tag("main", joined(body.values(), "\n"))]
        return _document(title or "Report", page)


def _document(title: str, body: Sequence[Html]) -> Page:
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        tag("style", Html(f"\n{STYLE}")),
    ]
    inside = tag("div", joined(body, "\n"), class_="leadline")
    page = tag("html", tag("head", joined(head, "\n")), tag("body", inside), lang="en")
    return Page(f"<!DOCTYPE html>\n{page}\n")
