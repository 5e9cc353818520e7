"""A doubtful result of ``nls solve``: exit status 1, and the same reasons in table, report, charts and pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Cauchy
from nls.missions.folder.table import csv_text
from nls.plot import picture
from tests.nls.cli.shell import SPOILED, Shell, row, rows
from tests.nls.missions.folder.mission_files import folder, raw
from tests.nls.plot.html_page import Page, undrawn

pytestmark = pytest.mark.filterwarnings("ignore::nls.GraphWarning")
ENDS = np.r_[0.5:4:0.5, 16.5:20:0.5]  # s, of fixes at both ends
ORIGIN = "lat_deg,lon_deg\n54.0,10.0\n"


def fixes(t: np.ndarray, turn: float = 0.0, jump: float = 0.0) -> str:
    """Fixes of the track of `raw`, turned by an angle, one of them away by a jump."""
    p = np.outer(t, [np.cos(0.3 + turn), np.sin(0.3 + turn)])
    p[len(t) // 2] += jump
    names = ["time_s", "x_m", "y_m", "sigma_x_m", "sigma_y_m"]
    return csv_text(names, t, p, np.full((len(t), 2), 0.1)).decode()


def dive(path: Path, **tables: str) -> None:
    folder(path, raw() | {"origin": ORIGIN} | tables)


def mistaken(path: Path, name: str) -> None:
    """A dive with a heading 13 deg off, a DVL turned by 45 deg, or rows of attitude that are zero."""
    tables = raw()
    if name == "attitude":
        lines = tables["ahrs"].splitlines()
        zeros = [f"{line.split(',')[0]},0.0,0.0,0.0" for line in lines[21:61]]
        tables["ahrs"] = "\n".join([*lines[:21], *zeros, *lines[61:]])
    turn = {"heading": np.radians(-13.0), "dvl": np.radians(45.0), "attitude": 0.0}[name]
    folder(path, tables | {"origin": ORIGIN, "fixes": fixes(ENDS, turn)})


@pytest.mark.parametrize("name", ["heading", "dvl", "attitude"])
def test_a_kernel_that_silences_a_sensor_is_loud(name: str, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every output names the table; the fit is the same in Python, and `--allow-doubtful` ends with 0."""
    undrawn(monkeypatch)
    mistaken(shell / "m", name)
    words = "solve m --robust cauchy:1 -o out --report p.html --json r.json"
    out, err = shell.both(words, 1)
    report = json.loads((shell / "r.json").read_text())
    (reason,) = [reason for reason in report["doubtful"] if "Position (fixes.csv)" in reason]
    assert reason.startswith("the kernel ignored ")
    assert (report["converged"], report["fit"]) == (True, "IMPLAUSIBLE")
    (share,) = [share for share in report["ignored"] if share["table"] == "Position (fixes.csv)"]
    assert share["ignored"] > share["total"] / 4
    assert f"nls: doubtful: {'; '.join(report['doubtful'])}; take the estimate with --allow-doubtful" in err
    assert row(out, "result").endswith("; ".join(report["doubtful"]))
    assert (shell / "out" / "doubtful.txt").read_text().splitlines() == report["doubtful"]
    for text in ((shell / "out" / f"track.{form}").read_text() for form in ("kml", "geojson")):
        assert f"m, doubtful: {'; '.join(report['doubtful'])}" in text
    assert Page((shell / "p.html").read_text()).text.count("Doubtful") == 1
    shell.both(f"{words} --allow-doubtful")
    graph, values, _ = nls.load("m")
    robust = graph.robust(Cauchy(1.0))
    assert robust.optimize(nls.initialize(robust, values)[0]).fit is nls.Fit.IMPLAUSIBLE


def test_a_good_solution_is_not_marked_and_takes_the_mark_away(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    mistaken(shell / "m", "heading")
    shell.both("solve m --robust cauchy:1 -o out", 1)
    dive(shell / "n", fixes=fixes(ENDS))
    for kernel in ("", *(f"--robust {name}" for name in ("cauchy:1", "huber:1", "tukey", "welsch", "dcs:1"))):
        report = shell.report(f"solve n {kernel} -o out")
        assert (report["doubtful"], report["fit"]) == ([], "PLAUSIBLE")
        assert sum(table["ignored"] for table in report["ignored"]) == 0
        assert bool(report["ignored"]) == bool(kernel)
        assert report["ratio"] < 1
    assert not (shell / "out" / "doubtful.txt").exists()
    assert "doubtful" not in "".join((shell / "out" / f"track.{form}").read_text() for form in ("kml", "geojson"))


def test_findings_of_the_tables_are_doubts_of_every_mission(shell: Shell) -> None:
    """Of one dive, and of several; outliers of a table that has a kernel are what that is for."""
    dive(shell / "m", fixes=fixes(np.arange(0.5, 20.0, 0.5)))
    dive(shell / "fast", dvl=raw()["dvl"].replace(",1.0,", ",1000.0,"), fixes=fixes(ENDS))
    dive(shell / "away", fixes=fixes(np.arange(0.5, 20.0, 0.5), jump=44.0))
    for words, doubted in (("m", []), ("fast", ["fast"]), ("m fast", ["fast"]), ("away", ["away"])):
        report = shell.report(f"solve {words} --allow-doubtful")
        assert bool(report["findings"]) == bool(doubted)
        assert any(reason.startswith("implausible: ") for reason in report["doubtful"]) == bool(doubted)
        shell.both(f"solve {words}", int(bool(doubted)))
    (finding,) = shell.report("solve away --allow-doubtful")["findings"]
    assert finding["file"] == "fixes.csv"
    assert shell.report("solve away --robust Position=cauchy:1")["doubtful"] == []
    assert shell.report("solve away --robust XYH=cauchy:1", 1)["doubtful"][0].startswith("implausible: ")


def test_a_kernel_is_judged_by_what_it_believes(shell: Shell) -> None:
    """One wrong closure of seven is for a kernel; the plain optimum is doubtful."""
    shell.file(SPOILED)
    shell.both("solve graph.g2o", 1)
    out = shell("solve graph.g2o --robust cauchy:1")
    assert row(out, "ignored") == "by the kernel: 0 of 7 Between of odometry, 1 of 8 Between closures (12.5 %)"
    assert "of what the kernel believes, 1 expected)" in row(out, "chi2")
    assert not any("implausible" in note for note in rows(out, "note"))


def test_a_picture_is_headed_by_its_doubts(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    figure.suptitle("dive")
    picture.write_picture(tmp_path / "a.png", figure)
    assert figure.get_suptitle() == "dive"
    picture.write_picture(tmp_path / "a.png", figure, ["one", "two"])
    assert figure.get_suptitle() == "dive\ndoubtful: one; two"
