"""``nls solve --report``: the page of a file, a mission and a failure, written beside everything else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from nls.cli import main
from tests.nls.io.g2o_files import PLANE, write
from tests.nls.io.mission.mission_files import folder
from tests.nls.io.test_bal import GOOD
from tests.nls.plot.html_page import Page, undrawn

Captured = pytest.CaptureFixture[str]


def test_the_command(tmp_path: Path, capsys: Captured) -> None:
    file, out = write(tmp_path, PLANE, "<b>$a$.g2o"), tmp_path / "out.html"
    arguments = ["solve", str(file), "--certify", "--report", str(out), "--json", str(tmp_path / "r.json"), "--verbose"]
    assert main(arguments) == 0
    printed, err = capsys.readouterr()
    assert err == ""
    assert re.search(r"^report +[0-9.]+ +[0-9.]+ +explanation, covariances and pictures", printed, re.MULTILINE)
    record = json.loads((tmp_path / "r.json").read_text())
    assert str(out) in record["written"]
    seconds = record["timings"]
    parts = ("solved", "check", "write", "certify", "report")
    assert seconds["total"] == pytest.approx(sum(seconds[part] for part in parts))
    text = out.read_text()
    page = Page(text)
    assert {"certificate", "provenance", "time"} <= page.ids
    for said in ("<b>$a$.g2o", "4 VERTEX_SE2, 4 EDGE_SE2", "g2o, 2-D", "--certify --report", record["reason"][11:]):
        assert said in page.text
    assert "<b>" not in text
    assert main(arguments) == 0
    one, two = (re.sub(r'(?s)<section id="time">.*?</section>', "", each) for each in (text, out.read_text()))
    assert one == two


def test_a_mission(tmp_path: Path, capsys: Captured) -> None:
    here, out = folder(tmp_path / "m"), tmp_path / "out.html"
    assert main(["solve", str(here), "--report", str(out), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    page = Page(out.read_text())
    assert [image["alt"] for image in page.images[:2]] == ["The track", "The landmarks"]
    assert {"RangeAzimuth", "XYH", "ZPR"} <= set(page.texts)


def test_a_bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    out = tmp_path / "out.html"
    status = main(["solve", str(write(tmp_path, "\n".join(GOOD), "b.txt")), "--report", str(out), "--quiet"])
    page = Page(out.read_text())
    assert "Not solved" in page.text  # two cameras, three points: much is free
    assert "2 c, 2 k, 3 l" in page.text
    assert status == main(["solve", str(tmp_path / "b.txt"), "--quiet"])


def test_the_exit_status_stays(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    file, out = write(tmp_path, PLANE), tmp_path / "out.html"
    assert main(["solve", str(file), "--gauge", "none", "--report", str(out)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    message, *advice = captured.err.splitlines()
    page = Page(out.read_text())
    assert message.removeprefix("nls: ") in page.text
    assert "--gauge first" in page.text  # in the words of the command line
    assert advice[-2:] == [f"  -> see: nls explain {file}", f"  -> written: {out}"]
    assert main(["solve", str(file), "--init", "file", "--max-iterations", "1", "--report", str(out), "--quiet"]) == 1
    assert "Not converged" in Page(out.read_text()).text
    out.unlink()
    assert main(["solve", str(file), "--report", str(tmp_path / "no" / "out.html")]) == 2
    assert "expected a file in a folder that exists" in capsys.readouterr().err
    assert main(["solve", str(file), "--report", str(out), "--json", str(out)]) == 2
    assert "another output has this one" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(("name", "most"), [("3d/sphere2500.g2o.gz", 3e6), ("2d/city10000.g2o.gz", 3e6)])
def test_large_graphs_stay_below_3_mb(name: str, most: float, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.html"
    assert main(["solve", str(data / f"pose-graphs-{name}"), "--report", str(out), "--quiet"]) == 0
    assert 5e4 < out.stat().st_size < most
    page = Page(out.read_text())
    assert len(page.images) == 5
