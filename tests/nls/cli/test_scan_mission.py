"""``nls`` on a scan mission: the table, the files, what it refuses, and a harbor with the truth beside it."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

import nls
from factors.keys import kinds
from nls.io import read_tum
from nls.missions.scans.solution import CLOSURES, MAP, TRAJECTORY
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.missions.scans.room_files import room, write
from tests.nls.missions.scans.test_folder import FILES

x = kinds("x")[0]
TABLES = ["trajectory.csv", "trajectory.tum", "map.csv", "map.ply", "graph.npz", "map.png"]


def table(file: Path) -> tuple[list[str], list[list[str]]]:
    head, *body = list(csv.reader(file.read_text().splitlines()))
    return head, body


def test_a_room_is_solved_with_all_files(shell: Shell, undrawn: None) -> None:
    write(shell / "m", room())
    out, report = shell.told("solve m -o out --plot p.png --report page.html --covariance c.csv")
    record = report["scans"]
    assert record["solution"]["ate_rmse_m"] < 0.2 < 0.7 < record["dead_reckoning"]["ate_rmse_m"]
    assert (record["keyframes"], record["with_points"], record["settled"], record["select"]) == (90, 81, True, "gnc")
    assert len(rows(out, "round")) == len(record["rounds"]) >= 2
    assert row(out, "settled") == f"after {len(record['rounds'])} rounds"
    assert row(out, "ATE").endswith("m rmse of 90 keyframes against the truth (rigid alignment)")
    assert sorted(path.name for path in (shell / "out").iterdir()) == sorted([*TABLES, "closures.csv"])

    head, body = table(shell / "out/trajectory.csv")
    numbers = np.array(body, dtype=float)
    assert head == list(TRAJECTORY)
    assert (numbers[:, 0].tolist(), numbers[3, 1]) == ([100 + 3 * k for k in range(90)], 11.0)
    assert numbers[0, 5:].tolist() == [0] * 6  # the first keyframe is held
    graph, values, _ = nls.load(shell / "out/graph.npz")
    Sigma = nls.Marginals(graph, values).covariance(x[40], frame="world")
    np.testing.assert_allclose(numbers[40, 2:5], values[x[40]])
    np.testing.assert_allclose(numbers[40, 5:8] ** 2, np.diag(Sigma))
    np.testing.assert_allclose(numbers[40, 8] * numbers[40, 5] * numbers[40, 6], Sigma[0, 1])
    times, _ = read_tum(shell / "out/trajectory.tum")[:2]
    assert len(times) == 90

    head, body = table(shell / "out/map.csv")
    assert (head, len(body)) == (list(MAP[:3]), record["points"])
    assert min(float(cells[0]) for cells in body) == pytest.approx(-9, abs=0.7)
    head, body = table(shell / "out/closures.csv")
    verdicts = [cells[-1] for cells in body]
    assert head == list(CLOSURES)
    assert {word: verdicts.count(word) for word in verdicts} == record["verdicts"]
    assert record["verdicts"]["kept"] == record["closures"] == len(graph.factors[-1])
    assert all(int(cells[0]) % 3 == 1 and int(cells[1]) % 3 == 1 for cells in body)
    page = (shell / "page.html").read_text()
    assert "The map" in page
    before, after = (record[name]["ate_rmse_m"] for name in ("dead_reckoning", "solution"))
    assert f"<dt>ATE</dt><dd>{before:.3g} → {after:.3g} m" in page.replace("\n", "")
    assert "nls explain" not in (shell / "page.html").read_text()

    judged = shell.report("evaluate out/trajectory.csv m/truth.csv --align rigid")
    assert judged["ate"]["rmse_m"] == pytest.approx(record["solution"]["ate_rmse_m"], rel=1e-6)
    explained = shell("explain out/graph.npz")
    count = {kind: int(number) for kind, number in re.findall(r"^([A-Z][\w, ]+?) {2,}(\d+) ", explained, re.MULTILINE)}
    assert count.keys() == {"DriftingStep", "Between", "Prior", "Heading", "SequentialMatch", "Between, closures"}
    assert count["Between, closures"] == record["closures"] > 0
    assert count["Between"] == len(values.stack("d")), "drifts about their mean"
    assert count["SequentialMatch"] > 20


def test_without_a_closure_the_solution_is_dead_reckoning(shell: Shell, undrawn: None) -> None:
    write(shell / "m", FILES)
    out = shell("solve m -o out")
    assert row(out, "unchecked").endswith("the solution is dead reckoning and matches of consecutive scans")
    assert row(out, "end").startswith("1 sigma of the position at the end: 0.")
    assert not rows(out, "settled")
    assert sorted(path.name for path in (shell / "out").iterdir()) == sorted(TABLES)
    head, body = table(shell / "out/map.csv")
    assert (head, body[0][2:]) == (list(MAP), ["4", "90.0"])


def test_a_mission_without_truth_and_the_selections(shell: Shell) -> None:
    write(shell / "m", {name: data for name, data in room().items() if name != "truth"})
    record = shell.report("solve m --robust cauchy")
    assert (record["robust"], record["scans"]["select"]) == (None, "cauchy")
    assert record["scans"]["rounds"][0]["kept"] == record["scans"]["rounds"][0]["accepted"] > 0
    assert not {"solution", "alignment"} & record["scans"].keys()


def test_a_track_that_still_moves_is_no_solution(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    write(shell / "m", room())
    monkeypatch.setattr("nls.cli.scan_mission.ROUNDS", 1)
    out = shell("solve m")
    assert row(out, "settled").startswith("no: the last round moved the track by 0.7")
    monkeypatch.setattr("nls.missions.scans.solution.WILD", 0.1)
    _, err = shell.both("solve m", status=1)
    assert err.startswith("nls: m: doubtful: not settled: the last of 1 rounds moved the track by 0.7")


def test_other_commands(shell: Shell) -> None:
    write(shell / "m", FILES)
    assert "scans                      2" in shell("info m")
    shell("convert m m.npz")
    shell("plot m m.png")


@pytest.mark.filterwarnings("default::models.errors.GraphWarning")
def test_a_wrong_setup_is_said_where_the_user_looks(shell: Shell) -> None:
    """Azimuths to the right, and no mission.toml that says so."""
    write(shell / "m", room(side=-1.0))
    _, err = shell.both("solve m --json r.json", status=1)
    assert "nls: m: doubtful: no solution: the setup is wrong (mirrored), see the warning" in err
    assert "[drift]" not in err
    assert "nls: warning: m: azimuths look mirrored: 72 turning steps fit the other sign better, 0 fit this" in err
    (finding,) = shell.json()["scans"]["setup"]
    assert finding["kind"] == "mirrored"
