"""``nls`` on a mission folder: the table, the files, and one line for every mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
from models import SE3, euler
from nls.cli import main
from nls.io import read_tum
from nls.io.mission import elevations, held_free
from nls.io.mission.results import MAP, TRAJECTORY
from nls.io.mission.table import Table
from tests.nls.io.mission.mission_files import TINY, folder, raw

Captured = pytest.CaptureFixture[str]
x, l = nls.kinds("x", "l")
FILES = {"trajectory.tum", "trajectory.csv", "map.csv", "track.png", "landmarks.png", "sonar.png"}


def line(out: str, label: str) -> str:
    """The line of the table with a label."""
    (found,) = [row for row in out.splitlines() if row.startswith(f"{label} ")]
    return found.removeprefix(label).strip()


def test_the_table_and_the_report(tmp_path: Path, capsys: Captured) -> None:
    here = folder(tmp_path / "m")
    assert main(["solve", str(here), "--json", str(tmp_path / "r.json")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    report = json.loads((tmp_path / "r.json").read_text())
    mission = report["mission"]
    assert line(out, "mission") == "4 poses over 1.533 m, 3 landmarks, 11 contacts of a DIDSON, high frequency"
    assert line(out, "drift").startswith("dead reckoning 4.52 % (0.0693 m), solution ")
    assert line(out, "drift").endswith(" of the distance at the end, against the truth")
    assert line(out, "ATE").endswith("m rmse (no alignment: x0 is anchored)")
    assert "landmarks.csv" in line(out, "landmarks")
    assert report["method"] == "levenberg-marquardt"
    graph, values, loaded = nls.load(here)
    values = graph.optimize(nls.initialize(graph, values)[0]).values
    away = SE3.position(values[x]) - SE3.position(loaded.truth[x])  # type: ignore[attr-defined]
    assert mission["solution"]["ate_rmse_m"] == pytest.approx(np.sqrt((away**2).sum(axis=1).mean()), rel=1e-6)
    assert mission["solution"]["end_error_m"] == pytest.approx(np.linalg.norm(away[-1]), rel=1e-6)
    assert mission["solution"]["drift_percent"] == pytest.approx(
        100 * mission["solution"]["end_error_m"] / mission["distance_m"]
    )
    assert mission["solution"]["ate_alignment"] == "none"
    off = values[l] - loaded.truth[l]  # type: ignore[attr-defined]
    assert mission["landmark_rmse_m"] == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=1e-6)
    assert "elevation_sigma_deg" not in mission  # no covariances without files
    assert (mission["anchor"], mission["judge"]) == ("x0", "truth")


def test_without_truth_dead_reckoning_is_judged_by_the_solution(tmp_path: Path, capsys: Captured) -> None:
    here = folder(tmp_path / "m", truth=None, landmarks=None)
    assert main(["solve", str(here), "--json", str(tmp_path / "r.json")]) == 0
    out = capsys.readouterr().out
    assert line(out, "drift").endswith("against the solution, as there is no truth.csv")
    assert "solution 0" not in out
    assert not any(row.startswith("landmarks ") for row in out.splitlines())
    mission = json.loads((tmp_path / "r.json").read_text())["mission"]
    assert "solution" not in mission
    assert 0 < mission["dead_reckoning"]["ate_rmse_m"] < 0.1


def test_the_files(tmp_path: Path, capsys: Captured) -> None:
    here, out = folder(tmp_path / "m", poses="i,time_s\n0,10\n1,10.5\n2,12\n3,12.25\n"), tmp_path / "deep" / "out"
    assert main(["solve", str(here), "-o", str(out), "--json", str(tmp_path / "r.json")]) == 0
    assert {path.name for path in out.iterdir()} == FILES
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["written"] == [
        *(str(out / name) for name in sorted(FILES, key=report_order)),
        str(tmp_path / "r.json"),
    ]
    graph, values, _ = nls.load(here)
    values = graph.optimize(nls.initialize(graph, values)[0]).values
    marginals = nls.Marginals(graph, values)

    times, poses = read_tum(out / "trajectory.tum")
    assert times.tolist() == [10.0, 10.5, 12.0, 12.25]
    assert SE3.local(poses, values[x]) == pytest.approx(np.zeros((4, 6)), abs=1e-9)
    table = Table(out / "trajectory.csv", TRAJECTORY)
    assert table.names[:7] == ["i", "roll_rad", "pitch_rad", "yaw_rad", "x_m", "y_m", "z_m"]
    assert table.integers("i").tolist() == [0, 1, 2, 3]
    assert table.floats(*TRAJECTORY[1:7]) == pytest.approx(euler.from_se3(values[x]), abs=1e-9)
    sigmas = np.sqrt(np.diagonal(marginals.all(x, view="euler"), axis1=1, axis2=2))
    assert table.floats(*TRAJECTORY[7:]) == pytest.approx(sigmas, rel=1e-6)

    table, found = Table(out / "map.csv", MAP), elevations(graph, values, sigmas=True)
    assert table.floats("x_m", "y_m", "z_m") == pytest.approx(values[l], abs=1e-9)
    Sigma = found.bounded(marginals.all(l))
    named = [f"cov_{a}_{b}_m2" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")]
    assert table.floats(*named) == pytest.approx(Sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], rel=1e-6)
    assert table.floats("elevation_rad", "sigma_elevation_rad").T == pytest.approx(
        np.array([found.elevation, found.sigma]), rel=1e-5
    )
    assert (table.integers("views").tolist(), table.integers("first_i").tolist()) == ([3, 4, 4], [0, 0, 0])
    sigma = np.degrees(found.sigma)
    assert report["mission"]["elevation_sigma_deg"] == pytest.approx(
        {"median": np.median(sigma), "largest": sigma.max()}
    )
    assert "deg (median)" in line(capsys.readouterr().out, "elevation")
    for name in FILES:
        if name.endswith(".png"):
            assert (out / name).read_bytes()[:4] == b"\x89PNG"


def report_order(name: str) -> int:
    return ["trajectory.tum", "trajectory.csv", "map.csv", "track.png", "landmarks.png", "sonar.png"].index(name)


def test_a_raw_log_has_no_map(tmp_path: Path, capsys: Captured) -> None:
    here, out = folder(tmp_path / "m", raw(lost=(5.0, 8.0))), tmp_path / "out"
    assert main(["solve", str(here), "-o", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {"trajectory.tum", "trajectory.csv", "track.png"}
    said = capsys.readouterr().out
    assert "bridged for 3 s" in said
    assert line(said, "drift").startswith("dead reckoning 0 % (0 m) of the distance")
    assert read_tum(out / "trajectory.tum")[0].tolist() == np.arange(31.0).tolist()


def test_a_landmark_seen_once_costs_no_sigmas_but_its_own(tmp_path: Path, capsys: Captured) -> None:
    """One view leaves its elevation free: all other sigmas are those of the mission without it."""
    once = TINY["contacts"] + "0,20,4.0,0.0,0.01,0.004\n"
    outs = {}
    for name, contacts in (("with", once), ("without", TINY["contacts"])):
        here = folder(tmp_path / name, contacts=contacts)
        assert main(["solve", str(here), "-o", str(tmp_path / f"{name}-out")]) == 0
        outs[name] = tmp_path / f"{name}-out"
        said = capsys.readouterr().out
        assert ("note        nothing measures the elevation of l20: no sigmas there" in said) == (name == "with")
        assert ("--elevation prior" in said) == (name == "with")
        assert "known to " in line(said, "elevation")
        assert {path.name for path in outs[name].iterdir()} == FILES
    tables = [Table(outs[name] / "trajectory.csv", TRAJECTORY).floats(*TRAJECTORY[1:]) for name in outs]
    assert tables[0] == pytest.approx(tables[1], rel=1e-4, abs=1e-7)
    rows = [[row.split(",") for row in (out / "map.csv").read_text().splitlines()[1:]] for out in outs.values()]
    assert np.array(rows[0][:-1], dtype=float) == pytest.approx(np.array(rows[1], dtype=float), rel=1e-4, abs=1e-7)
    free = rows[0][-1]
    assert (free[0], free[4:10], free[10:12], free[-2:]) == ("20", [""] * 6, ["1", "0"], ["", "0"])
    assert float(free[-3]) == pytest.approx(0.0, abs=1e-3)  # where it began

    assert main(["solve", str(tmp_path / "with"), "-o", str(tmp_path / "prior"), "--elevation", "prior"]) == 0
    assert "nothing measures" not in capsys.readouterr().out
    last = Table(tmp_path / "prior" / "map.csv", MAP).floats("sigma_elevation_rad")[-1]
    assert last == pytest.approx(0.2443 / np.sqrt(12), rel=0.01)


@pytest.mark.filterwarnings("default::nls.GraphWarning")
def test_covariances_of_all_but_a_landmark_seen_once(tmp_path: Path, capsys: Captured) -> None:
    """Those of the mission without it, and an empty row that says why; a track that is free has none at all."""
    once = TINY["contacts"] + "0,20,4.0,0.0,0.01,0.004\n"
    rows = {}
    for name, contacts in (("with", once), ("without", TINY["contacts"])):
        csv = tmp_path / f"{name}.csv"
        here = folder(tmp_path / name, contacts=contacts)
        assert main(["solve", str(here), "--covariance", str(csv), "-o", str(tmp_path / f"{name}-out")]) == 0
        said = capsys.readouterr().out
        assert said.count("nothing measures the elevation of l20: no sigmas there") == (name == "with")
        rows[name] = [row.split(",") for row in csv.read_text().splitlines()]
    assert rows["with"][-1][:3] == ["l", "20", "free"]
    assert not any(rows["with"][-1][3:])
    assert rows["with"][0] == rows["without"][0]
    assert [row[:3] for row in rows["with"][1:-1]] == [row[:3] for row in rows["without"][1:]]
    assert {row[2] for row in rows["without"][1:]} == {"estimated"}
    found, expected = (
        np.array([[float(cell or "nan") for cell in row[3:]] for row in each])
        for each in (rows["with"][1:-1], rows["without"][1:])
    )
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-8)

    lost = TINY["zpr"].replace("2,5.2461,0.041,-0.0405,0.01,0.002,0.002\n", "")
    few = "".join(row + "\n" for row in TINY["contacts"].splitlines() if not row.startswith("2,"))
    here = folder(tmp_path / "n", zpr=lost, contacts=few)
    status = main(["solve", str(here), "--covariance", str(tmp_path / "n.csv")])
    assert status == 2
    assert "n.csv was not written" in capsys.readouterr().err
    assert not (tmp_path / "n.csv").exists()


def test_landmarks_that_nothing_is_known_of_and_others(tmp_path: Path) -> None:
    """Twenty of them, more than are named one by one; and held along what is free alone."""
    once = TINY["contacts"] + "".join(f"1,{k},4.0,{0.01 * (k - 30)!r},0.01,0.004\n" for k in range(20, 40))
    graph, values, _ = nls.load(folder(tmp_path / "m", contacts=once))
    values = graph.optimize(values, nls.LevenbergMarquardt()).values
    with pytest.raises(nls.UnderconstrainedError):
        nls.Marginals(graph, values)
    held, free = held_free(graph, values)
    assert free == l[np.arange(20, 40)]
    assert held.chi2(values) == pytest.approx(graph.chi2(values), rel=1e-12)
    found = elevations(held, values, sigmas=True, free=free)
    assert np.isnan(found.sigma).tolist() == [False] * 3 + [True] * 20
    Sigma = nls.Marginals(held, values).all(l)[3:]
    r = np.sqrt(np.einsum("ni,nij,nj->n", found.along[3:], Sigma, found.along[3:]))
    assert (r < 1.0).all()  # held there, by no more than what is known across


@pytest.mark.filterwarnings("default::nls.GraphWarning")
def test_no_sigmas_where_there_are_none(tmp_path: Path, capsys: Captured) -> None:
    here, out = folder(tmp_path / "m"), tmp_path / "out"
    lost = TINY["zpr"].replace("2,5.2461,0.041,-0.0405,0.01,0.002,0.002\n", "")
    few = "".join(row + "\n" for row in TINY["contacts"].splitlines() if not row.startswith("2,"))
    assert main(["solve", str(folder(tmp_path / "n", zpr=lost, contacts=few)), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "note        the files have no sigmas: 3 unknowns have factors that do not react" in said
    assert "x2: z, roll, pitch" in said
    assert {path.name for path in out.iterdir()} == FILES
    assert all(row.endswith(",,,,,,") for row in (out / "trajectory.csv").read_text().splitlines()[1:])
    assert all(row.split(",")[4:10] == [""] * 6 for row in (out / "map.csv").read_text().splitlines()[1:])
    assert not any(row.startswith("elevation ") for row in said.splitlines())
    one_step = ["--init", "file", "--max-iterations", "1", "--allow-unconverged"]
    assert main(["solve", str(folder(here)), "-o", str(out), *one_step]) == 0
    assert "the files have no sigmas: this is no optimum" in capsys.readouterr().out


def test_elevation_by_name(tmp_path: Path, capsys: Captured) -> None:
    here = str(folder(tmp_path / "m"))
    assert main(["solve", here, "--elevation", "free", "--robust", "huber:2"]) == 0
    assert "gauss-newton" in line(capsys.readouterr().out, "solver")
    (tmp_path / "a.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert main(["solve", str(tmp_path / "a.g2o"), "--elevation", "free"]) == 2
    assert "no folder of a mission" in capsys.readouterr().err


def test_the_other_commands(tmp_path: Path, capsys: Captured) -> None:
    here = str(folder(tmp_path / "m"))
    assert main(["info", here]) == 0
    assert "contacts.csv             11" in capsys.readouterr().out
    assert main(["plot", here, str(tmp_path / "a.png")]) == 0
    assert main(["convert", here, str(tmp_path / "a.tum")]) == 0
    assert len(read_tum(tmp_path / "a.tum")[1]) == 4
    capsys.readouterr()
    assert main(["convert", here, str(tmp_path / "a.g2o")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "a.g2o: a mission cannot be written as g2o, which has no lines for its steps and contacts; --to tum" in err
    assert err.endswith("writes its poses\n")  # and no remark on a file that is not there
    assert not (tmp_path / "a.g2o").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "m"], "output folder: 'm' is not possible; expected another folder than that of the mission"),
        (["-o", "m/zpr.csv"], "output folder: 'm/zpr.csv' is not possible; expected a folder, or the name of one"),
        (["-o", "m/zpr.csv/in"], "expected a folder, or the name of one to be made"),
        (["-o", "out.g2o"], "expected a folder: the solution of a mission is several files"),
        (["-o", "-"], "expected a folder, or the name of one to be made"),
        (["-o", ""], "expected a folder, or the name of one to be made"),
        (["--to", "g2o"], "--to: 'g2o' is not possible; expected nothing"),
        (["--dialect", "g2o"], "dialect: 'g2o' is not possible; expected auto: m is a folder"),
        (["--repair-information"], "the format mission, which has no information matrices"),
    ],
)
def test_mistakes(
    options: list[str], message: str, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder(tmp_path / "m")
    monkeypatch.setattr(nls.FactorGraph, "optimize", None)  # nothing is solved
    assert main(["solve", "m", *options]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["m"]


def test_a_folder_that_cannot_be_made_loses_no_outcome(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mkdir(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    here = folder(tmp_path / "m")
    monkeypatch.setattr(Path, "mkdir", mkdir)
    assert main(["solve", str(here), "-o", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert err == f"nls: {tmp_path / 'out'}: cannot be made: Permission denied; give another folder\n"
    assert "converged" in out


def test_one_line_for_a_damaged_folder(tmp_path: Path, capsys: Captured) -> None:
    here = folder(tmp_path / "m", contacts=TINY["contacts"].replace("4.7457", "nan"))
    for command in (["solve", str(here)], ["info", str(here)], ["plot", str(here), str(tmp_path / "a.png")]):
        assert main(command) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"nls: {here / 'contacts.csv'}:2: 'nan' is not a number")
        assert err.count("\n") == 1


def test_a_trajectory_is_in_the_order_of_time(tmp_path: Path) -> None:
    here = folder(tmp_path / "m", raw() | {"poses": "i,time_s\n21,0.0\n7,3.3\n14,19.0\n"})
    assert main(["solve", str(here), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    times, poses = read_tum(tmp_path / "out" / "trajectory.tum")
    assert times.tolist() == [0.0, 3.3, 19.0]
    assert poses[:, 2] == pytest.approx([2.0, 2.33, 3.9], abs=1e-6)


def test_no_percent_of_no_distance(tmp_path: Path, capsys: Captured) -> None:
    """One true pose, or a vehicle that does not move: a dash, null for programs."""
    one = "".join(row + "\n" for row in TINY["truth"].splitlines()[:3:2])
    still = {"odometry": "".join(r + "\n" for r in TINY["odometry"].splitlines()[:1]) + "0,1,0,0,0,0.02,0.02,0.005\n"}
    still["zpr"] = TINY["zpr"].splitlines()[0] + "\n0,5,0,0,0.01,0.002,0.002\n1,5,0,0,0.01,0.002,0.002\n"
    for here in (folder(tmp_path / "one", truth=one), folder(tmp_path / "still", still)):
        assert main(["solve", str(here), "--json", str(tmp_path / "r.json")]) == 0
        out = capsys.readouterr().out
        assert "nan" not in out
        assert line(out, "drift").startswith("dead reckoning - (")
        assert json.loads((tmp_path / "r.json").read_text())["mission"]["dead_reckoning"]["drift_percent"] is None


def test_a_folder_named_like_a_trajectory(tmp_path: Path, capsys: Captured) -> None:
    for name in ("dive.tum", "dive.kitti"):
        assert main(["solve", str(folder(tmp_path / name))]) == 0
        assert line(capsys.readouterr().out, "mission").startswith("4 poses")


def test_sigmas_come_from_the_solver_and_gauge_that_were_asked_for(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str]] = []
    init = nls.Marginals.__init__

    def noted(self: nls.Marginals, graph: nls.FactorGraph, values: nls.Values, solver: Any, gauge: str) -> None:
        asked.append((type(solver).__name__, gauge))
        init(self, graph, values, solver, gauge)

    monkeypatch.setattr(nls.Marginals, "__init__", noted)
    options = ["--linear-solver", "lu", "--gauge", "none", "-o", str(tmp_path / "out")]
    assert main(["solve", str(folder(tmp_path / "m")), *options]) == 0
    assert asked == [("LU", "none")] * 2  # of the poses and landmarks, and of the elevations
