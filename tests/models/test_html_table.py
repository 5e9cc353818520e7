"""What a notebook shows: well-formed HTML with the numbers that the text has."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

import nls
import sim
from models import SE2, R
from models.html_table import html_table
from nls import Values, kinds
from nls.plot.report.page import Page

x, l = kinds("x", "l")


def cells(html: str) -> list[list[str]]:
    """The rows of the table; every element is closed."""
    root = ElementTree.fromstring(f"<div>{html}</div>")
    return [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]


def test_text_is_escaped() -> None:
    assert cells(html_table("<b>", ["a & b"], [["<i>"]], ["x < y"])) == [["a & b"], ["<i>"]]


def test_values_by_kind() -> None:
    values = Values({x: (SE2, [[0, 0, 0], [1.25, 2, 0.5]]), l: (R(2), np.zeros((0, 2)))})
    assert cells(values._repr_html_())[1:] == [
        ["x", "2", "SE2", "x, y, yaw", "[0. 0. 0.]", "[1.25 2.   0.5 ]"],
        ["l", "0", "R(2)", "x, y", "", ""],
    ]


def test_results_and_their_explanation() -> None:
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=10)
    result = world.graph.optimize(world.start)
    html = result._repr_html_()
    rows = cells(html)[1:]
    assert [row[0] for row in rows] == [str(i.number) for i in result.history]
    assert rows[-1][1] == f"{result.history[-1].chi2:.6g}"
    assert "CONVERGED" in html
    assert f"{result.dof} degrees of freedom" in html
    explanation = nls.explain(world.graph, result.values)
    (pre,) = ElementTree.fromstring(f"<div>{explanation._repr_html_()}</div>")
    assert pre.text == explanation.report()


def test_a_page_is_saved_and_shown_in_a_frame(tmp_path: Path) -> None:
    page = Page("<html><h1>a &lt; b</h1></html>")
    page.save(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == page
    frame = ElementTree.fromstring(page._repr_html_())
    assert (frame.tag, frame.get("srcdoc")) == ("iframe", page)
