"""``nls`` on a mission folder: the table, the files, and what cannot be said."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import nls
from models import SE3, euler
from nls.io import read_tum
from nls.missions import elevations
from nls.missions.files import MAP, TRAJECTORY
from nls.missions.folder.table import Table
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.missions.folder.mission_files import TINY, folder, raw

x, l = nls.kinds("x", "l")
TABLES = ["trajectory.tum", "trajectory.csv", "map.csv", "map.ply", "depth.asc"]
FILES = [*TABLES, "chart.png", "track.png", "landmarks.png", "sonar.png"]
ONCE = TINY["contacts"] + "0,20,4.0,0.0,0.01,0.004\n"
LOST = {  # nothing measures the depth of x2
    "zpr": TINY["zpr"].replace("2,5.2461,0.041,-0.0405,0.01,0.002,0.002\n", ""),
    "contacts": "".join(row + "\n" for row in TINY["contacts"].splitlines() if not row.startswith("2,")),
}


def test_both_commands_draw_a_mission_from_above_and_from_the_side(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr("nls.plot.picture.write_picture", lambda path, figure, doubts=(): figures.append(figure))
    folder(shell / "m")
    shell("plot m a.png")
    shell("solve m --plot b.png")
    as_read, solved = figures
    assert [axes.get_ylabel() for axes in as_read.axes] == ["x, north [m]", "z, down [m]"]
    assert [axes.get_ylabel() for axes in solved.axes] == ["x, north [m]", "z, down [m]", "chi2"]
    assert as_read.get_suptitle() == solved.get_suptitle() == "m"


def test_the_table_and_the_report(shell: Shell) -> None:
    folder(shell / "m")
    out, report = shell.told("solve m")
    mission, solution = report["mission"], report["mission"]["solution"]
    assert row(out, "mission") == "4 poses over 1.533 m, 3 landmarks, 11 contacts by the sonar DIDSON, high frequency"
    assert row(out, "drift").startswith("dead reckoning 4.52 % (0.0693 m), solution ")
    assert row(out, "drift").endswith(" of the distance at the end, against the truth")
    assert row(out, "ATE").endswith("m rmse (no alignment: x0 is anchored)")
    assert "landmarks.csv" in row(out, "landmarks")
    assert report["method"] == "levenberg-marquardt"
    graph, values, loaded = nls.load("m")
    values = graph.optimize(nls.initialize(graph, values)[0]).values
    away = SE3.position(values[x]) - SE3.position(loaded.truth[x])  # type: ignore[attr-defined]
    end, off = np.linalg.norm(away[-1]), values[l] - loaded.truth[l]  # type: ignore[attr-defined]
    assert solution["ate_rmse_m"] == pytest.approx(np.sqrt((away**2).sum(axis=1).mean()), rel=1e-6)
    assert solution["end_error_m"] == pytest.approx(end, rel=1e-6)
    assert solution["drift_percent"] == pytest.approx(100 * end / mission["distance_m"])
    assert solution["ate_alignment"] == "none"
    level = np.hypot(*away[:, :2].T)
    circles = [np.median(level), np.quantile(level, 0.95), 2 * np.sqrt((level**2).mean())]
    assert [solution[name] for name in ("cep50_m", "cep95_m", "drms2_m")] == pytest.approx(circles, rel=1e-5)
    assert mission["landmark_rmse_m"] == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=1e-6)
    assert "elevation_sigma_deg" not in mission  # no covariances without files
    assert (mission["anchor"], mission["judge"]) == ("x0", "truth")


def test_without_truth_dead_reckoning_is_judged_by_the_solution(shell: Shell) -> None:
    folder(shell / "m", truth=None, landmarks=None)
    out, report = shell.told("solve m")
    assert row(out, "drift").endswith("against the solution (there is no truth.csv)")
    assert "solution 0" not in out
    assert rows(out, "landmarks") == []
    mission = report["mission"]
    assert "solution" not in mission
    assert 0 < mission["dead_reckoning"]["ate_rmse_m"] < 0.1


@pytest.mark.parametrize("lost", [(0.0, 0.0), (5.0, 8.0)])
def test_where_nothing_checks_dead_reckoning_it_has_a_sigma_and_no_drift(
    shell: Shell, lost: tuple[float, float]
) -> None:
    """A hole in the attitude leaves a degree of freedom, of the yaw: it does not check the position."""
    files = raw(lost)
    if lost[1]:
        rows_kept = [
            row for row in files["ahrs"].splitlines() if not row[:1].isdigit() or not 8 < float(row.split(",")[0]) < 12
        ]
        files["ahrs"] = "\n".join(rows_kept)
    folder(shell / "m", files)
    out, report = shell.told("solve m")
    mission = report["mission"]
    assert (report["dof"] > 0) == (lost[1] > 0)
    assert (mission["checks"], mission["judge"]) == (0, None)
    assert "dead_reckoning" not in mission
    graph, values, _ = nls.load("m")
    Sigma = nls.Marginals(graph, graph.optimize(values).values).covariance(x[30], view="position")
    assert mission["end_sigma_m"] == pytest.approx(np.sqrt(np.trace(Sigma)), rel=1e-6)
    assert mission["end_sigma_percent"] == pytest.approx(100 * mission["end_sigma_m"] / mission["distance_m"])
    assert f"{mission['end_sigma_m']:.3g} m" in row(out, "end")


def test_a_contact_from_two_places_checks_dead_reckoning(shell: Shell) -> None:
    folder(shell / "once", contacts="\n".join(TINY["contacts"].splitlines()[:3]), truth=None, landmarks=None)
    folder(shell / "often", truth=None, landmarks=None)
    assert [shell.report(f"solve {name}")["mission"]["checks"] for name in ("once", "often")] == [0, 13]


def test_the_files(shell: Shell) -> None:
    folder(shell / "m", poses="i,time_s\n0,10\n1,10.5\n2,12\n3,12.25\n")
    printed, report = shell.told("solve m -o deep/out")
    out = shell / "deep/out"
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert report["written"] == [*(f"deep/out/{name}" for name in FILES), "r.json"]
    assert all((out / name).read_bytes()[:4] == b"\x89PNG" for name in FILES[5:])
    graph, values, _ = nls.load("m")
    values = graph.optimize(nls.initialize(graph, values)[0]).values
    marginals = nls.Marginals(graph, values)

    times, poses = read_tum(out / "trajectory.tum")
    assert times.tolist() == [10.0, 10.5, 12.0, 12.25]
    assert SE3.local(poses, values[x]) == pytest.approx(np.zeros((4, 6)), abs=1e-9)
    table = Table(out / "trajectory.csv", (*TRAJECTORY, "time_s"))
    assert table.floats("time_s").T.tolist() == [times.tolist()]
    assert table.names[:7] == ["i", "roll_rad", "pitch_rad", "yaw_rad", "x_m", "y_m", "z_m"]
    assert table.integers("i").tolist() == [0, 1, 2, 3]
    assert table.floats(*TRAJECTORY[1:7]) == pytest.approx(euler.from_se3(values[x]), abs=1e-9)
    sigmas = np.sqrt(np.diagonal(marginals.all(x, view="euler"), axis1=1, axis2=2))
    assert table.floats(*TRAJECTORY[7:]) == pytest.approx(sigmas, rel=1e-6)

    table, seen = Table(out / "map.csv", MAP), elevations(graph, values, sigmas=True)
    assert table.floats("x_m", "y_m", "z_m") == pytest.approx(values[l], abs=1e-9)
    Sigma = seen.bounded(marginals.all(l))
    named = [f"cov_{a}_{b}_m2" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")]
    assert table.floats(*named) == pytest.approx(Sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], rel=1e-6)
    angles = table.floats("elevation_rad", "sigma_elevation_rad").T
    assert angles == pytest.approx(np.array([seen.elevation, seen.sigma]), rel=1e-5)
    assert (table.integers("views").tolist(), table.integers("first_i").tolist()) == ([3, 4, 4], [0, 0, 0])
    sigma = np.degrees(seen.sigma)
    expected = pytest.approx({"median": np.median(sigma), "largest": sigma.max()})
    assert report["mission"]["elevation_sigma_deg"] == expected
    assert "deg (median)" in row(printed, "elevation")


def test_raw_logs_have_no_map_and_trajectories_the_order_of_time(shell: Shell, undrawn: None) -> None:
    folder(shell / "m", raw(lost=(5.0, 8.0)))
    printed = shell("solve m -o out")
    assert {path.name for path in (shell / "out").iterdir()} == {"trajectory.tum", "trajectory.csv", "track.png"}
    assert "bridged for 3 s" in printed
    assert rows(printed, "drift") == rows(printed, "ATE") == []
    assert row(printed, "unchecked").startswith("nothing checks dead reckoning")
    assert read_tum(shell / "out/trajectory.tum")[0].tolist() == np.arange(31.0).tolist()
    folder(shell / "n", raw() | {"poses": "i,time_s\n21,0.0\n7,3.3\n14,19.0\n"})
    shell("solve n -o out --quiet")
    times, poses = read_tum(shell / "out/trajectory.tum")
    assert times.tolist() == [0.0, 3.3, 19.0]
    assert poses[:, 2] == pytest.approx([2.0, 2.33, 3.9], abs=1e-6)


@pytest.mark.filterwarnings("default::nls.GraphWarning")
def test_a_landmark_seen_once_costs_no_sigmas_but_its_own(shell: Shell, undrawn: None) -> None:
    """One view leaves its elevation free: all other sigmas are those of the mission without it."""
    tables, maps = {}, {}
    for name, contacts in (("with", ONCE), ("without", TINY["contacts"])):
        folder(shell / name, contacts=contacts)
        out, _ = shell.both(f"solve {name} -o {name}-out")
        assert out.count("nothing measures the elevation of l20: no sigmas there") == (name == "with")
        assert ("--elevation prior" in out) == (name == "with")
        assert "known to " in row(out, "elevation")
        assert {path.name for path in (shell / f"{name}-out").iterdir()} == set(FILES)
        tables[name] = Table(shell / f"{name}-out/trajectory.csv", TRAJECTORY).floats(*TRAJECTORY[1:])
        maps[name] = [line.split(",") for line in (shell / f"{name}-out/map.csv").read_text().splitlines()]
    assert tables["with"] == pytest.approx(tables["without"], rel=1e-4, abs=1e-7)
    *seen, free = maps["with"][1:]
    expected = np.array(maps["without"][1:], dtype=float)
    assert np.array(seen, dtype=float) == pytest.approx(expected, rel=1e-4, abs=1e-7)
    assert (free[0], free[4:10], free[10:12], free[-3:]) == ("20", [""] * 6, ["1", "0"], ["", "0", ""])
    assert float(free[-4]) == pytest.approx(0.0, abs=1e-3)  # where it began

    assert "nothing measures" not in shell("solve with -o prior --elevation prior")
    last = Table(shell / "prior/map.csv", MAP).floats("sigma_elevation_rad")[-1]
    assert last == pytest.approx(0.2443 / np.sqrt(12), rel=0.01)


def test_landmarks_that_nothing_is_known_of(tmp_path: Path) -> None:
    """Twenty of them, more than are named one by one: all other elevations are those of the mission without them."""
    once = TINY["contacts"] + "".join(f"1,{k},4.0,{0.01 * (k - 30)!r},0.01,0.004\n" for k in range(20, 40))
    found = []
    for name, contacts in (("many", once), ("few", TINY["contacts"])):
        graph, values, _ = nls.load(folder(tmp_path / name, contacts=contacts))
        values = graph.optimize(values, nls.LevenbergMarquardt()).values
        found.append(elevations(graph, values, sigmas=True))
    assert np.isnan(found[0].sigma).tolist() == [False] * 3 + [True] * 20
    np.testing.assert_allclose(found[0].sigma[:3], found[1].sigma, rtol=1e-3)


@pytest.mark.filterwarnings("default::nls.GraphWarning")
def test_no_sigmas_where_there_are_none_and_all_others(shell: Shell, undrawn: None) -> None:
    folder(shell / "m", **LOST)
    printed, _ = shell.both("solve m -o out --covariance m.csv --allow-doubtful")
    status = {"".join(cells[:2]): cells[2] for cells in csv.reader((shell / "m.csv").read_text().splitlines()[1:])}
    assert {name for name, word in status.items() if word != "estimated"} == {"x2"}
    assert "note        no sigmas of x2, all others are given: 3 unknowns are not measured" in printed
    assert "x2: z, roll, pitch" in printed
    assert {path.name for path in (shell / "out").iterdir()} == {*FILES, "doubtful.txt"}
    _, *poses = csv.reader((shell / "out/trajectory.csv").read_text().splitlines())
    assert [all(row[7:]) for row in poses] == [True, True, False, True]
    assert poses[2][7:] == [""] * 6
    assert all(all(row.split(",")[4:10]) for row in (shell / "out/map.csv").read_text().splitlines()[1:])


def test_other_options_and_commands(shell: Shell) -> None:
    folder(shell / "dive.tum")  # a folder named like a trajectory
    assert "gauss-newton" in row(shell("solve dive.tum --elevation free"), "solver")
    assert "contacts.csv             11" in shell("info dive.tum")
    shell("convert dive.tum a.tum")
    assert len(read_tum(shell / "a.tum")[1]) == 4


def test_a_folder_that_cannot_be_made_loses_no_outcome(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    def mkdir(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    folder(shell / "m")
    monkeypatch.setattr(Path, "mkdir", mkdir)
    out, err = shell.both("solve m -o out", 2)
    assert err == "nls: out: cannot be made: Permission denied; give another folder\n"
    assert "converged" in out


def test_no_percent_of_no_distance(shell: Shell) -> None:
    """One true pose, or a vehicle that does not move: a dash, null for programs."""
    lines = {name: TINY[name].splitlines(keepends=True) for name in ("truth", "odometry", "zpr")}
    folder(shell / "one", truth="".join(lines["truth"][:3:2]))
    still = {"odometry": lines["odometry"][0] + "0,1,0,0,0,0.02,0.02,0.005\n"}
    still["zpr"] = lines["zpr"][0] + "0,5,0,0,0.01,0.002,0.002\n1,5,0,0,0.01,0.002,0.002\n"
    still["truth"] = lines["truth"][0] + "0,0,0,0,0,0,5\n1,0,0,0,0,0,5\n"
    folder(shell / "still", still)
    for name in ("one", "still"):
        out, report = shell.told(f"solve {name}")
        assert "nan" not in out
        assert row(out, "drift").startswith("dead reckoning - (")
        assert report["mission"]["dead_reckoning"]["drift_percent"] is None


def test_sigmas_come_from_the_solver_and_gauge_that_were_asked_for(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, undrawn: None
) -> None:
    asked: list[tuple[str, str]] = []
    init = nls.Marginals.__init__

    def noted(self: nls.Marginals, graph: nls.FactorGraph, values: nls.Values, solver: Any, gauge: str) -> None:
        asked.append((type(solver).__name__, gauge))
        init(self, graph, values, solver, gauge)

    monkeypatch.setattr(nls.Marginals, "__init__", noted)
    folder(shell / "m")
    shell("solve m --linear-solver lu --gauge none -o out")
    assert asked == [("LU", "none")] * 2  # of the poses and landmarks, and of the elevations
