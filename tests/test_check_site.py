"""The check of the built site: a whole one has nothing to say against it, and each fault is named."""

from __future__ import annotations

from pathlib import Path

import pytest

if not (Path(__file__).parents[1] / "tools" / "check_site.py").is_file():
    pytest.skip("there are no tools here (an installed copy has none)", allow_module_level=True)

from tools import check_site

HEAD = '<script src="_static/mathjax/tex.js"></script><link rel="stylesheet" href="_static/site.css">'
WHOLE = f"""<html><head>{HEAD}</head><body><h1 id="top">A</h1>
<a href="b.html#there">b</a> <a href="#top">up</a> <a href="https://example.org">out</a>
<span class="math">x</span> <img src="a.png" alt="A map, before and after"></body></html>"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A site of two pages with everything it refers to; there are no benchmarks."""
    root = tmp_path / "html"
    files = {
        "a.html": WHOLE,
        "b.html": '<h1 id="there">B</h1>',
        "a.png": "",
        "_static/mathjax/tex.js": "",
        "_static/site.css": "/* @import 'http://example.org/old.css' */ body { background: url(a.png) }",
        "_static/part.html": '<script src="{{ template }}"></script>',
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(check_site, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(check_site, "DOCS", tmp_path / "docs")
    return root


def test_a_whole_site(site: Path) -> None:
    assert list(check_site.problems(site)) == []


MJ, CSS = "_static/mathjax/tex.js", 'href="_static/site.css"'
NO_ALT = "the picture a.png has no text (alt)"
FAULTS = [
    ("b.html#there", "c.html", "the link c.html leads nowhere"),
    ("#there", "#gone", "the link b.html#gone has no such anchor"),
    ('"#top"', '"#bottom"', "the link #bottom has no such anchor"),
    ("A map, before and after", "", NO_ALT),
    ("A map, before and after", "../_images/a.png", NO_ALT),
    ('img src="a.png"', 'img src="z.png"', "loads z.png, which is not there"),
    ('<a href="#top">up</a>', "<p>| a | b |\n|---|---|</p>", "shows the source of a table"),
    (MJ, "b.html", "has equations, but does not load MathJax"),
    (MJ, "https://cdn.org/mathjax.js", "loads https://cdn.org/mathjax.js from the network"),
    (CSS, 'href="//fonts.org/a.css"', "loads //fonts.org/a.css from the network"),
]


def test_each_fault_is_named(site: Path) -> None:
    for right, wrong, fault in FAULTS:
        assert right in WHOLE
        (site / "a.html").write_text(WHOLE.replace(right, wrong), encoding="utf-8")
        assert list(check_site.problems(site)) == [f"a.html: {fault}"]


def test_a_page_is_heavy_with_its_pictures(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_site, "HEAVIEST", len(WHOLE) + 10)
    (site / "a.png").write_bytes(bytes(10))
    assert list(check_site.problems(site)) == []
    (site / "a.png").write_bytes(bytes(11))
    assert [fault.split(" bytes")[0] for fault in check_site.problems(site)] == [f"a.html: takes {len(WHOLE) + 11:,}"]


def test_style_sheets_and_benchmarks(site: Path) -> None:
    (site / "_static" / "site.css").write_text(
        "@font-face { src: url('https://example.org/f.woff') }", encoding="utf-8"
    )
    check_site.RESULTS.mkdir()
    (check_site.RESULTS / "speed.md").write_text("# Speed", encoding="utf-8")
    assert list(check_site.problems(site)) == [
        "_static/site.css: loads https://example.org/f.woff from the network",
        "benchmarks/results/speed.md has no page: add docs/benchmarks/speed.md, which includes it",
    ]
    assert next(check_site.problems(site / "nowhere")).endswith("there are no pages; build them first: make docs")


def test_links_without_a_text(site: Path) -> None:
    check_site.DOCS.mkdir()
    (check_site.DOCS / "a.md").write_text("[b](b.md), ![](picture.png), [](c.md#d)", encoding="utf-8")
    assert list(check_site.problems(site)) == ["docs/a.md: the link to c.md#d has no text: write [text](c.md#d)"]
