"""One constant that is wrong is named by the solver, and its line, followed to the letter, brings the place back."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
from factors.robust import Cauchy
from models.algebra import apply
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.cli import main
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.trials import explained, worth_trying
from nls.missions.folder.columns import ANGLES, VELOCITY
from nls.missions.folder.folder import read_tables
from nls.missions.folder.table import csv_text
from tests.nls.missions.checks.dives import Dive, Tables

Spoil = Callable[[Tables], object]
WITHIN = 1.5  # times the error without a mistake
DEG = np.pi / 180


def changed(name: str, **change: Callable[[np.ndarray], np.ndarray]) -> Spoil:  # type: ignore[type-arg]
    """Columns of a table as functions of themselves."""
    return lambda tables: tables[name].update({key: f(tables[name][key]) for key, f in change.items()})


def earth(tables: Tables) -> None:
    """Velocities of the DVL north, east and down."""
    ahrs, dvl = tables["ahrs"], tables["dvl"]
    R = rotation3(quaternion_from_angles(np.column_stack([ahrs[name] for name in ANGLES])))
    dvl.update(zip(VELOCITY, apply(R, np.column_stack([dvl[name] for name in VELOCITY])).T, strict=True))


def jump(tables: Tables) -> None:
    tables["fixes"]["x_m"][9] += 44.0


def heading(degrees: float) -> Spoil:
    return changed("ahrs", yaw_rad=lambda yaw: np.remainder(yaw + degrees * DEG + np.pi, 2 * np.pi) - np.pi)


CASES: dict[str, tuple[str, Spoil, str]] = {  # what measures the place, the mistake, the start of a cure
    "DVL north, east, down": ("fixes", earth, "a column earth_axes of 1"),
    "yaw from east": ("fixes", changed("ahrs", yaw_rad=lambda yaw: np.pi / 2 - yaw), "sign = -1, offset = 1.5708"),
    "fixes 3 s late": ("fixes", changed("fixes", time_s=lambda t: t + 3.0), "fixes_clock_s,"),
    "DVL 5 %": (
        "fixes",
        changed("dvl", **dict.fromkeys(("vx_m_s", "vy_m_s", "vz_m_s"), lambda v: 1.05 * v)),
        "dvl_scale,0.05",
    ),
    "yaw to port": ("fixes", changed("ahrs", yaw_rad=lambda yaw: -yaw), "multiply yaw_rad by -1"),
    "ranges in feet": ("ranges", changed("ranges", range_m=lambda r: 3.2808 * r), "divide range_m by 3.2808"),
    "USBL sigmas": (
        "usbl",
        changed(
            "usbl",
            **dict.fromkeys(("sigma_range_m", "sigma_bearing_rad", "sigma_elevation_rad"), lambda s: s / 10),
        ),
        "multiply sigma_range_m, sigma_bearing_rad, sigma_elevation_rad by",
    ),
    "declination 130 deg": ("fixes", heading(-130.0), "declination_rad,2.26"),
    "fixes exchanged": (
        "fixes",
        lambda t: t["fixes"].update(x_m=t["fixes"]["y_m"], y_m=t["fixes"]["x_m"]),
        "exchange the names of x_m, y_m",
    ),
    "USBL turned": ("usbl", changed("usbl", bearing_rad=lambda a: a - 0.1), "usbl_yaw_rad,0.09"),
    "USBL 18 s late": ("usbl", changed("usbl", time_s=lambda t: t + 18.0), "usbl_clock_s,"),
    "ranges 3 % long": ("ranges", changed("ranges", range_m=lambda r: 1.03 * r), "sound_speed_scale,0.0"),
    "a fix that jumps": ("fixes", jump, "--robust Position=cauchy:1"),
}


def solve(dive: Dive, folder: str, kernel: str = "") -> tuple[float, nls.Result]:
    """The error of a folder, m, and its result."""
    graph, values, report = nls.load(folder)
    if kernel:
        name, _, width = kernel.partition("=cauchy:")
        factors = [f.robust(Cauchy(float(width))) if f.name == name else f for f in graph.factors]
        graph = nls.FactorGraph(factors, graph.fixed)
    result = graph.optimize(nls.initialize(graph, values)[0])
    return dive.error(result.values, report), result


def rewritten(file: Path, change: Callable[[dict[str, np.ndarray]], object]) -> None:  # type: ignore[type-arg]
    """A table with its columns changed by name."""
    names, *lines = file.read_text().split()
    numbers = np.array([[float(cell) for cell in line.split(",")] for line in lines]).T
    columns = dict(zip(names.split(","), numbers, strict=True))
    change(columns)
    whole = [y.astype(int) if (y == y.astype(int)).all() else y for y in columns.values()]
    file.write_bytes(csv_text(list(columns), *whole))


def follow(cure: str, folder: Path) -> str:
    """Do what a sentence says, to the letter; returns the kernel to solve with."""
    if row := re.search(r"write `(\w+,[-\d.]+,[-\d.]+)` in calibration\.csv", cure):
        (folder / "calibration.csv").write_text(f"name,value,sigma\n{row[1]}\n")
    elif act := re.search(r"of (\w+\.csv) look.*?: (multiply|divide) ([\w, ]+?) by (-?[\d.]+)(?!, then)", cure):
        factor = float(act[4]) if act[2] == "multiply" else 1 / float(act[4])
        rewritten(folder / act[1], lambda table: table.update({n: factor * table[n] for n in act[3].split(", ")}))
    elif act := re.search(r"of (\w+\.csv) look exchanged: exchange the names of (\w+), (\w+)", cure):
        rewritten(folder / act[1], lambda table: table.update({act[2]: table[act[3]], act[3]: table[act[2]]}))
    elif re.search(r"multiply yaw_rad by -1, then add 1\.5708 to it", cure):
        rewritten(folder / "ahrs.csv", lambda table: table.update(yaw_rad=1.5708 - table["yaw_rad"]))
    elif re.search(r"give dvl\.csv a column earth_axes of 1", cure):
        rewritten(folder / "dvl.csv", lambda table: table.update(earth_axes=np.ones(len(table["time_s"]))))
    else:
        (kernel,) = re.findall(r"--robust (\S+)", cure)
        return str(kernel)
    return ""


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_the_cause_is_named_and_its_cure_works(name: str, tmp_path: Path) -> None:
    """The error after it is within 1.5 times that of the right tables with the same constant left open."""
    aid, spoil, start = CASES[name]
    dive, folder = Dive(1, (aid,)), tmp_path / name
    clean, right = solve(dive, dive.write(tmp_path / f"{name}, right"))
    assert right.fit is not nls.Fit.IMPLAUSIBLE
    wrong, result = solve(dive, dive.write(folder, spoil))
    assert result.fit is nls.Fit.IMPLAUSIBLE
    assert wrong > 2 * clean
    explanation = explained(read_tables(folder)[0], result.chi2_final, result.dof)
    cures = re.split("; or ", explanation.says)
    (cure,) = [words for words in cures if start in words]
    after, cured = solve(dive, str(folder), follow(cure, folder))
    if calibration := re.match(r"(\w+),", start):
        (tmp_path / f"{name}, right" / "calibration.csv").write_text(f"name,value,sigma\n{calibration[1]},0,1\n")
        clean = max(clean, solve(dive, str(tmp_path / f"{name}, right"))[0])
    assert after < WITHIN * clean
    assert cured.fit is not nls.Fit.IMPLAUSIBLE


def test_solve_and_explain_print_it_and_a_right_mission_is_not_tried(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    dive, where = Dive(3), tmp_path / "r.json"
    right, wrong = dive.write(tmp_path / "right"), dive.write(tmp_path / "wrong", heading(13.0))
    main(["solve", wrong, "--json", str(where)])
    report = json.loads(where.read_text())
    (note,) = [note for note in report["notes"] if note.startswith("implausible: ")]
    line = "write `declination_rad,-0.22"
    assert line in note
    assert line in report["explained"]["sentence"]
    assert "cauchy" not in note
    assert [trial["reading"]["column"] for trial in report["explained"]["trials"]] == ["declination_rad", "dvl_yaw_rad"]
    capsys.readouterr()
    main(["explain", wrong])
    out = capsys.readouterr().out
    assert line in out.partition("\n1. ")[2].partition("\n2. ")[0]
    assert "cauchy" not in out
    monkeypatch.setattr("nls.missions.checks.trials.explained", None)  # whoever calls it fails
    assert main(["solve", right, "--json", str(where)]) == 0
    assert json.loads(where.read_text())["explained"] is None
    assert "explains chi2" not in capsys.readouterr().out


def test_large_tables_begin_with_few_rows_and_end_with_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dive = Dive(1, ("usbl",))
    _, result = solve(dive, dive.write(tmp_path / "m", changed("usbl", range_m=lambda r: 1.03 * r)))
    tables = read_tables(tmp_path / "m")[0]
    whole = explained(tables, result.chi2_final, result.dof)
    monkeypatch.setattr("nls.missions.checks.trials.MOST_ROWS", 60)  # of 179
    few = explained(tables, result.chi2_final, result.dof)
    (a,), (b,) = whole.trials, few.trials
    assert (b.reading.column, b.dof) == (a.reading.column, a.dof)
    assert b.reading.factor == pytest.approx(a.reading.factor, abs=0.1 * a.sigma)


def test_two_mistakes_are_no_constant_and_units_come_first(tmp_path: Path) -> None:
    dive = Dive(1, ("usbl",))
    spoils = changed("usbl", range_m=lambda r: 1.2 * r), changed("usbl", elevation_rad=lambda a: -0.7 * a)
    _, result = solve(dive, dive.write(tmp_path / "m", heading(40.0), *spoils))
    explanation = explained(read_tables(tmp_path / "m")[0], result.chi2_final, result.dof)
    assert explanation.trials == ()
    assert explanation.says.startswith("no single constant and no single table explains chi2 (")
    reading = Reading(Cause.UNIT, "dvl.csv", "vx_m_s", 1000.0)
    unit = Implausible("speed", "dvl.csv", 2, "vx_m_s", 900.0, 10.0, "m/s", (reading,))
    turn = replace(unit, readings=(replace(reading, cause=Cause.CLOCK),))
    assert [worth_trying(findings) for findings in ([], [turn], [unit], [turn, unit])] == [True, True, False, False]
