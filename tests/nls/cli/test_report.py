"""``nls solve --report``: the page of a file, a mission and a bundle, written beside everything else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from nls.cli import main
from tests.nls.cli.shell import Shell
from tests.nls.io.test_bal import GOOD
from tests.nls.missions.folder.mission_files import folder
from tests.nls.plot.html_page import Page, undrawn


def test_the_command(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    file = shell.file(name="<b>$a$.g2o")
    printed = shell(f"solve '{file}' --certify --report out.html --json r.json --verbose")
    assert re.search(r"^report +[0-9.]+ +[0-9.]+ +explanation, covariances and pictures", printed, re.MULTILINE)
    record = json.loads((shell / "r.json").read_text())
    assert "out.html" in record["written"]
    seconds = record["timings"]
    parts = ("solved", "check", "write", "certify", "report")
    assert seconds["total"] == pytest.approx(sum(seconds[part] for part in parts))
    text = (shell / "out.html").read_text()
    page = Page(text)
    assert {"certificate", "provenance", "time"} <= page.ids
    for said in ("<b>$a$.g2o", "4 VERTEX_SE2, 4 EDGE_SE2", "g2o, 2-D", "--certify --report", record["reason"][11:]):
        assert said in page.text
    assert "<b>" not in text


def test_a_mission(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    folder(shell / "m", anchor=None)  # the anchor is assumed, and not a measurement that nothing checks
    assert shell("solve m --report out.html --quiet") == ""
    page = Page((shell / "out.html").read_text())
    assert [image["alt"] for image in page.images[:2]] == ["The track", "The landmarks"]
    assert {"RangeAzimuth", "XYH", "ZPR", "Nothing suspicious."} <= set(page.texts)


def test_a_bundle(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    shell.both(f"solve {shell.file(chr(10).join(GOOD), 'b.txt')} --report out.html --quiet", 1)
    page = Page((shell / "out.html").read_text())
    assert "Not solved" in page.text  # two cameras, three points: much is free
    assert "2 c, 2 k, 3 l" in page.text


def test_the_page_of_a_large_graph_stays_below_3_mb(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.html"
    assert main(["solve", str(data / "pose-graphs-3d/sphere2500.g2o.gz"), "--report", str(out), "--quiet"]) == 0
    assert 5e4 < out.stat().st_size < 3e6
    assert len(Page(out.read_text()).images) == 5
