"""The page of a solution: complete in itself, harmless whatever the names are, the same every time, and true."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import nls
from factors import Between, Cauchy, Diagonal, Isotropic, Range
from models import SE2, SE3, SO3, LieGroup, R
from models.errors import UnderconstrainedError
from nls import Values
from nls.plot import report
from nls.plot.report.markup import SMALL, Html, across, picture
from nls.plot.report.page import STYLE
from nls.plot.report.sections import number
from nls.plot.style import REJECTED
from nls.robust.graduated import Rejected
from tests.nls.graphs import l, mixed, pose_graph, x
from tests.nls.plot.html_page import Page, undrawn

EVIL = "<script>alert('x')</script> & \"$x$.g2o"


def solved(group: LieGroup = SE2, **options: Any) -> tuple[nls.FactorGraph, nls.Values, nls.Result]:
    sample = pose_graph(group, start=0.2)
    return sample.graph, sample.values, sample.graph.optimize(sample.values, **options)


def test_the_page_says_what_the_result_says() -> None:
    """Every time with the same bytes; only the time differs."""
    graph, start, result = solved()
    options: dict[str, Any] = {"title": "a survey", "init": "chordal", "facts": {"convention": "log"}}
    text, again = (report(graph, start, result, **options, seconds={"solve": s, "read": 1.0}) for s in (0.5, 0.25))
    assert text != again
    assert len({re.sub(r'(?s)<section id="time">.*?</section>', "", page) for page in (text, again)}) == 1
    page = Page(text)
    chi2 = f"{number(graph.chi2(start))} → {result.chi2_final:.4g}"
    for said in ("a survey", "chordal", "Converged", chi2, "8 x", "log", result.reason):
        assert said in page.text
    sections = "maps findings kinds worst covariances convergence sparsity provenance time"
    assert page.ids == set(sections.split())
    assert len(page.images) == 5  # before, after, ellipses, convergence, sparsity
    assert "http" not in page.text
    assert "url(" not in STYLE
    cost = nls.analysis.inspection.inspect(graph, result.values)
    for name in ("rows_of_A", "columns_of_A", "numbers_in_A", "numbers_in_R"):
        assert f"{cost[name]:,} " in page.text


@pytest.mark.parametrize("group", [R(1), R(3), SO3, SE3], ids=str)
def test_every_space(group: LieGroup, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    graph, start, result = solved(group)
    page = Page(report(graph, start, result))
    assert ("maps" in page.ids) == (group.position(group.identity(1)).shape[1] > 0)
    assert "Converged" in page.text


def test_points_and_functions_and_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    sample = mixed(0)
    robust = sample.graph.robust(Cauchy(1.0))
    page = Page(report(robust, sample.values, robust.optimize(sample.values)))
    assert "robust cost" in page.text
    assert "4 l, 6 x, 2 y" in page.text


def test_names_are_harmless(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    graph, start, result = solved()
    figure = Figure()
    named: dict[str, Any] = {"title": EVIL, "init": EVIL, "facts": {EVIL: EVIL}, "seconds": {EVIL: 1.0}}
    text = report(graph, start, result, **named, pictures={EVIL: figure})
    page = Page(text)
    assert page.texts.count(EVIL) == 7  # title twice, start, fact and its name, part, caption
    assert page.images[0]["alt"] == EVIL
    assert "<script" not in text


def test_numbers_are_short_and_whole_where_they_are_large() -> None:
    texts = [number(value) for value in (0.0, 0.12345, 17.0, 999.94, 1234.5, 23318531317.0)]
    assert texts == ["0", "0.1235", "17", "999.9", "1,234", "23,318,531,317"]


def test_the_style_stays_inside_of_the_page() -> None:
    """In a notebook the rules of every output are those of the whole page."""
    rules = re.sub(r"@media[^{]*", "", STYLE)
    selectors = [each.strip() for found in re.findall(r"([^{};]+)\{", rules) for each in found.split(",")]
    assert len(selectors) > 40
    assert "</style" not in STYLE
    assert [each for each in selectors if ".leadline" not in each and each != ""] == []


def test_a_wrong_closure_is_named_and_red(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    rng = np.random.default_rng(5)
    n = 40
    a = 2 * np.pi * np.arange(n) / n
    X = np.stack([10 * np.cos(a), 10 * np.sin(a), a + np.pi / 2], axis=1)
    i, j = np.r_[np.arange(n - 1), 0, 1, 2, 3, 10], np.r_[np.arange(1, n), n - 1, n - 2, n - 3, n - 4, 30]
    z = SE2.retract(SE2.between(X[i], X[j]), rng.normal(size=(len(i), 3)) * [0.05, 0.05, 0.01])
    z[-1] = [1.0, 1.0, 0.0]  # x10 and x30 are 20 m apart
    graph = nls.FactorGraph([Between(x[i], x[j], z, Diagonal(x=0.05, y=0.05, yaw=0.01))])
    start = nls.Values({x: (SE2, X)})
    result = graph.optimize(start)
    drawn: list[np.ndarray[Any, Any]] = []
    plot = __import__("matplotlib.axes").axes.Axes.plot

    def watched(self: Any, *args: Any, **style: Any) -> Any:
        if style.get("color") == REJECTED:
            drawn.append(np.stack(args[:2], axis=1))
        return plot(self, *args, **style)

    monkeypatch.setattr("matplotlib.axes.Axes.plot", watched)
    page = Page(report(graph, start, result))
    assert "Between(x10, x30)" in page.text
    np.testing.assert_allclose(drawn[0][:2], X[[10, 30], :2])
    np.testing.assert_allclose(drawn[1][:2], result.values[x][[10, 30], :2])
    assert len(drawn) == 2  # before, after
    assert "red: measurements that do not fit the others" in page.text


def test_covariances_beside_something_free(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    sample = pose_graph(SE2)
    sample.graph.add(Range(x[3], l[0], [5.0], Isotropic(0.1)))
    values = Values({x: (SE2, sample.values[x]), l: (R(2), [[4.0, 3.0]])})
    result = sample.graph.optimize(values, nls.LevenbergMarquardt())
    page = Page(report(sample.graph, values, result))
    assert "Some variables have no covariance: the measurements leave 1 direction free: l0: x, y" in page.text
    assert "95 %" in [image["alt"][-4:] for image in page.images]


def test_what_is_free_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    sample = pose_graph(SE2, anchored=False)
    with pytest.raises(UnderconstrainedError) as caught:
        sample.graph.optimize(sample.values, gauge="none")
    page = Page(report(sample.graph, sample.values, caught.value))
    assert "Not solved" in page.text
    assert caught.value.message in page.text
    assert "convergence" not in page.ids
    stopped = sample.graph.optimize(sample.values, nls.GaussNewton(nls.Stop(max_iterations=1)))
    page = Page(report(sample.graph, sample.values, stopped))
    assert "Not converged" in page.text
    assert stopped.reason in page.text
    assert "95 %" not in [image["alt"][-4:] for image in page.images]  # no covariances of what is no optimum


def test_what_was_rejected_and_certified(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    graph, start, result = solved()

    rejected = [Rejected("Between(x3, x7)", 291.25, 0, 3, (x[3], x[7]), 1e-9)] * 12
    certificate = nls.certify(nls.FactorGraph([f for f in graph.factors if f.name == "Between"]), result.values)
    page = Page(report(graph, start, result, certificate=certificate, rejected=rejected))
    assert "12 loop closures rejected." in page.text  # in the headline
    assert "Rejected measurements: 12" in page.text
    assert "Between(x3, x7) 291 below 0.01 %" in " ".join(page.text.split())
    assert "and 2 more" in page.text
    assert page.text.count("Between(x3, x7)") == 12
    for line in certificate.report().splitlines():
        assert line in page.text
    lower = replace(certificate, verdict="refuted", better=start)
    page = Page(report(graph, start, result, certificate=lower))
    assert "Not the optimum  The certificate found a lower minimum." in page.text


def test_bars_are_drawn_to_scale() -> None:
    for ratio in (0.2, 1.0, 7.0):
        bar = across(0.8, 1.25, ratio, [0.2, 0.8, 1.25, 7.0])
        assert isinstance(bar, Html)
        middle = float(re.search(r'<line x1="([0-9.]+)" x2="\1"', bar)[1])  # type: ignore[index]
        dot = float(re.search(r'cx="([0-9.]+)"', bar)[1])  # type: ignore[index]
        assert dot - middle == pytest.approx(96 * np.log(ratio) / np.log(7), abs=0.06)
        assert ("--good" in bar) == (ratio == 1.0)


def test_a_matrix_of_many_numbers_is_not_even_drawn_as_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dots count, not the variables of the graph: the drawing of 11 edges of space has 280 kB, the image 80."""
    drawn: list[tuple[int, str]] = []

    def counted(figure: Figure, kind: str) -> bytes:
        drawn.append((len(figure.axes), kind))
        return b"drawn"

    monkeypatch.setattr(import_module("nls.plot.report.markup"), "_drawn", counted)
    for group in (SO3, SE3):
        graph, start, result = solved(group)
        report(graph, start, result)
    assert [kind for axes, kind in drawn if axes == 3] == ["svg", "png"]
    assert {kind for axes, kind in drawn if axes != 3} == {"svg"}


def test_small_pictures_are_drawings_large_ones_images() -> None:
    figure = Figure(figsize=(3, 2))
    axes = figure.add_subplot()
    axes.plot([0, 1])
    assert "image/svg+xml" in picture(figure, "a", "c", 2)
    assert "image/png" in picture(figure, "a", "c", SMALL + 1)
    axes.plot(np.random.default_rng(0).normal(size=9000), ".")
    assert "image/png" in picture(figure, "a", "c", 2)  # as the drawing is larger
