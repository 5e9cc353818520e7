"""``nls evaluate``: what is printed is what the library computes; poses are matched by time, number or row."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nls
from models import SE3, euler
from models.algebra import Array
from nls.io import write_kitti, write_tum
from nls.metrics import ALIGNMENTS, ate, cep, drms2, rpe
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.graphs import moved, walk
from tests.nls.io.g2o_files import INFORMATION_2
from tests.nls.missions.folder.mission_files import folder

BUNDLE = "1 1 1\n0 0 1 2\n" + "0\n" * 12
HEAD = "i,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m"


def pair(n: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(3)
    truth = walk(SE3, n, rng)
    return moved(SE3, truth, 0.05, rng), truth


def table(X: Array, numbers: Array, head: str = HEAD) -> str:
    lines = [
        ",".join([str(i), *map(repr, state)]) for i, state in zip(numbers, euler.from_se3(X).tolist(), strict=True)
    ]
    return "\n".join([head, *lines]) + "\n"


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_the_table_and_the_report(shell: Shell, align: str) -> None:
    P, Q = pair()
    write_tum(shell / "a.tum", np.arange(60.0), P)
    write_tum(shell / "b.tum", np.arange(60.0), Q)
    out, record = shell.told(f"evaluate a.tum b.tum --align {align} --distances 5,20,1e6")
    error, drift = ate(P, Q, align), rpe(P, Q, [5, 20])
    assert record["ate"]["rmse_m"] == pytest.approx(error.rmse, rel=1e-9)
    assert record["horizontal"]["cep50_m"] == pytest.approx(cep(error.errors))
    assert record["horizontal"]["cep95_m"] == pytest.approx(cep(error.errors, 0.95))
    assert record["horizontal"]["drms2_m"] == pytest.approx(drms2(error.errors))
    assert record["scale"] == pytest.approx(error.scale)
    assert [r["translation_percent"] for r in record["rpe"][:2]] == pytest.approx([100 * d.translation for d in drift])
    assert [r["rotation_deg_m"] for r in record["rpe"][:2]] == pytest.approx([np.degrees(d.rotation) for d in drift])
    assert record["rpe"][2]["translation_percent"] is None
    assert row(out, "matched") == "60 poses by time, gaps of the truth up to 2 s bridged"
    assert row(out, "ATE").startswith(f"{error.rmse:.4g} m rmse")
    assert row(out, "alignment").split(",")[0] == align
    assert rows(out, "RPE")[2] == "over 1e+06 m: the track is shorter"
    assert shell.report(f"evaluate a.tum b.tum --align {align} --distances 5,20,1e6") == record
    # angles of R_i^-1 S_i by SciPy, after a motion that is known; the report says this motion in words
    R, p, q = Rotation.from_quat(record["T"][3:]), Rotation.from_quat(P[:, 3:]), Rotation.from_quat(Q[:, 3:])
    rmse = np.degrees(np.sqrt(np.mean((q.inv() * R * p).magnitude() ** 2)))
    assert record["ate"]["rotation_rmse_deg"] == pytest.approx(rmse, rel=1e-9, abs=1e-9)
    assert record["ate"]["rotation_rmse_deg"] > 1
    assert f"rotation {rmse:.4g} deg rmse" in row(out, "ATE")
    assert record["translation_m"] == record["T"][:3]
    yaw = R.as_euler("ZYX", degrees=True)[0]
    assert record["yaw_deg"] == pytest.approx(yaw, abs=1e-9)
    assert record["tilt_deg"] == pytest.approx(np.degrees(np.arccos(min(R.as_matrix()[2, 2], 1.0))), abs=1e-5)
    assert (f"turned by {yaw:.4g} deg" in row(out, "alignment")) == (align != "none")
    assert not record["turned_over"]


def test_poses_are_matched_by_time_number_or_row(shell: Shell) -> None:
    P, Q = pair()
    write_tum(shell / "a.tum", np.arange(60.0) + 0.5, P)
    write_tum(shell / "b.tum", np.r_[0.0:20, 30:60], np.delete(Q, np.s_[20:30], axis=0))
    assert row(shell("evaluate a.tum b.tum"), "matched") == (
        "48 poses by time, gaps of the truth up to 2 s bridged; 1 before or after the truth left out; "
        "11 in gaps of the truth left out"
    )
    assert row(shell("evaluate a.tum b.tum --tolerance 20"), "matched").startswith("59 poses by time")
    numbers = np.arange(60) * 2
    (shell / "a.csv").write_text(table(P, numbers))
    (shell / "b.csv").write_text("# true\n" + table(Q[::-1], numbers[::-1] + 10))
    record = shell.report("evaluate a.csv b.csv")
    assert (record["matched_by"], record["matched"]) == ("number", 55)
    assert record["ate"]["rmse_m"] == pytest.approx(ate(P[5:], Q[:55]).rmse)
    assert record["rpe"][0]["translation_percent"] == pytest.approx(100 * rpe(P[5:], Q[:55], [10])[0].translation)
    write_kitti(shell / "a.kitti", P)
    write_kitti(shell / "b.kitti", Q)
    assert row(shell("evaluate a.kitti b.kitti"), "matched") == "60 poses by row"


def test_the_solution_of_a_mission_beside_its_truth(shell: Shell, undrawn: None) -> None:
    """By files and by folders; sigmas are judged where nothing was aligned."""
    folder(shell / "m")
    solution = shell.report("solve m -o solved")["mission"]["solution"]
    out, record = shell.told("evaluate solved/trajectory.csv m/truth.csv --distances 1")
    assert record["ate"]["rmse_m"] == pytest.approx(solution["ate_rmse_m"])
    assert row(out, "sigmas").startswith("mean of (error / sigma)^2: x ")
    assert rows(shell("evaluate solved/trajectory.csv m/truth.csv --align rigid"), "sigmas") == []
    assert shell.report("evaluate solved m --distances 1") == record
    (shell / "s" / "truth").mkdir(parents=True)
    (shell / "m" / "truth.csv").rename("s/truth/truth.csv")  # as nls-sim survey writes it
    assert shell.report("evaluate solved s --distances 1")["ate"] == record["ate"]
    assert shell.report("evaluate solved solved --distances 1")["ate"]["rmse_m"] == 0


def test_refusals(shell: Shell) -> None:
    P, Q = pair(4)
    write_tum(shell / "a.tum", np.arange(4.0), P)
    write_kitti(shell / "a.kitti", P)
    write_kitti(shell / "b.kitti", Q[:3])
    files = {
        "n.csv": table(P, np.arange(4)),
        "m.csv": table(P, np.arange(4) + 50),
        "typo.csv": table(P, np.arange(4), HEAD.replace("yaw_rad", "yaw_deg")),
        "none.csv": table(P, np.arange(4), HEAD.replace("i,", "k,")),
        "twice.csv": table(P, np.array([0, 1, 1, 2])),
        "image.csv": b"\x89PNG\xff\n\xfe",
    }
    for name, text in files.items():
        shell.file(text, name)
    shell.file(BUNDLE, "b.bal")
    (shell / "empty").mkdir()
    for words, message in (
        ("a.tum n.csv", "a.tum has times alone; n.csv has numbers alone. Expected times in both"),
        ("a.kitti n.csv", "a.kitti has rows alone; n.csv has numbers alone"),
        ("a.kitti b.kitti", "a.kitti has 4 poses, b.kitti 3"),
        ("n.csv m.csv", "have no number i in common"),
        ("typo.csv n.csv", "typo.csv:1: no column 'yaw_rad'; did you mean 'yaw_deg'"),
        ("none.csv n.csv", "no column 'i' and none 'time_s'"),
        ("twice.csv n.csv", "twice.csv:4: pose 1 was given before"),
        ("n.csv image.csv", "image.csv:1: no column 'x_m'"),
        ("n.csv lost.csv", "lost.csv"),
        ("n.csv graph.txt", "a folder, or a file ending in .g2o, .toro, "),
        ("n.csv b.bal", "holds the poses of one kind, this graph has none"),
        ("empty n.csv", "expected a folder with trajectory.csv, as nls solve empty -o OUT writes"),
        ("n.csv empty", "expected a folder with truth.csv or truth/truth.csv or truth.npz or trajectory.csv"),
        ("n.csv n.csv --distances 0,5", "meters above 0 with commas between"),
        ("n.csv n.csv --distances far", "meters above 0 with commas between"),
        ("n.csv n.csv --tolerance 1", "the poses are matched by number, not by time"),
        ("n.csv m.csv --json n.csv", "another name: this is the input"),
    ):
        assert message in shell.refused(f"evaluate {words}"), words


def plane(name: str, t: Array, xyyaw: Array) -> str:
    lines = [",".join(map(repr, line)) for line in np.column_stack([t, xyyaw]).tolist()]
    return "\n".join([name, *lines]) + "\n"


def circle(n: int = 80) -> tuple[Array, Array]:
    yaw = np.linspace(0.0, 5.0, n)
    return np.arange(n, dtype=float), np.column_stack([10 * np.sin(yaw), -10 * np.cos(yaw), yaw])


def test_a_truth_of_positions_has_no_relative_error(shell: Shell) -> None:
    t, X = circle()
    (shell / "a.csv").write_text(plane("time,x,y,yaw", t, X))
    (shell / "b.csv").write_text(plane("time,x,y", t, X[:, :2] + [3.0, 0.0]))
    out, record = shell.told("evaluate a.csv b.csv --align none")
    assert row(out, "RPE") == "none: b.csv has no headings"
    assert record["rpe"] == []
    assert record["rpe_unknown"] == "b.csv has no headings"
    assert record["ate"]["rmse_m"] == pytest.approx(3.0)


STRAIGHT = np.arange(80.0), np.column_stack([np.arange(80.0), np.zeros(80), 0.01 * np.sin(np.arange(80.0))])


@pytest.mark.parametrize("offset", [0.0, 2.5])
@pytest.mark.parametrize(
    ("track", "sense", "opposed"),
    [(circle(), 1.0, False), (circle(), -1.0, True), (STRAIGHT, -1.0, False)],
    ids=["one", "two", "a straight track has none"],
)
def test_headings_of_two_conventions(
    shell: Shell, track: tuple[Array, Array], sense: float, opposed: bool, offset: float
) -> None:
    t, X = track
    shell.file(plane("time,x,y,yaw", t, X), "a.csv")
    shell.file(plane("time,x,y,yaw", t, np.column_stack([X[:, :2], sense * X[:, 2] + offset])), "b.csv")
    record = shell.report("evaluate a.csv b.csv --distances 10")
    assert bool(record["rpe_unknown"]) == opposed
    assert len(record["rpe"]) == (not opposed)
    assert record["ate"]["rmse_m"] < 1e-9


@pytest.mark.parametrize("align", ["rigid", "similarity"])
def test_a_mirrored_track_is_called_so_and_its_cure_helps(shell: Shell, align: str) -> None:
    """A level track and its mirror image differ by half a turn about a horizontal axis, which no ATE shows."""
    t, X = circle()
    (shell / "truth.csv").write_text(plane("time,x,y,yaw", t, X))
    (shell / "mirrored.csv").write_text(plane("time,x,y,yaw", t, X * [1, -1, -1]))
    out, err = shell.both(f"evaluate mirrored.csv truth.csv --align {align} --json r.json")
    record = shell.json()
    assert record["ate"]["rmse_m"] < 1e-9
    assert (record["turned_over"], record["tilt_deg"]) == (True, pytest.approx(180.0))
    assert record["ate"]["rotation_rmse_deg"] > 90
    assert err.startswith(f"nls: warning: mirrored.csv: the alignment {align} turned the track upside down")
    assert "tilted by 180 deg" in row(out, "alignment")
    # the cures: another alignment shows it, other signs remove it
    assert shell.report("evaluate mirrored.csv truth.csv --align yaw")["ate"]["rmse_m"] > 5
    (shell / "signs.csv").write_text(plane("time,x,y,yaw", t, X))
    assert shell.report(f"evaluate signs.csv truth.csv --align {align}")["turned_over"] is False


def test_graphs_are_compared_as_they_are_written(shell: Shell) -> None:
    """A g2o file, its npz and json, its TUM: the same errors, of the plane and of space, in any order of vertices."""
    _, X = circle(20)
    vertices = [f"VERTEX_SE2 {k} {' '.join(map(repr, pose))}" for k, pose in enumerate(X.tolist())]
    edges = [f"EDGE_SE2 {k} {k + 1} 1 0 0.2 {INFORMATION_2}" for k in range(19)]
    shell.file("\n".join([*vertices[::-1], *edges]) + "\n", "truth.g2o")
    shell("solve truth.g2o --allow-doubtful -o solved.g2o --quiet")
    for name in ("npz", "json", "tum"):
        shell(f"convert solved.g2o solved.{name}")
    shell("convert truth.g2o truth.tum")
    records = {
        name: shell.report(f"evaluate solved.{name} truth.{'tum' if name == 'tum' else 'g2o'} --align rigid")
        for name in ("g2o", "npz", "json", "tum")
    }
    P, Q = (nls.load(shell / f"{name}.g2o")[1][nls.Kind("x")[range(20)]] for name in ("solved", "truth"))
    error = ate(P, Q, "rigid")
    assert error.rmse > 0.1
    for name, record in records.items():
        assert record["matched"] == 20, name
        assert record["ate"]["rmse_m"] == pytest.approx(error.rmse, rel=1e-9), name
        assert record["ate"]["rotation_rmse_deg"] == pytest.approx(np.degrees(error.rotation), rel=1e-9), name
    assert "nls convert GRAPH OUT.tum" in shell.refused("evaluate solved.g2o truth.tum")


@pytest.mark.filterwarnings("always")
def test_the_cures_of_a_graph_that_is_not_read_are_options_of_another_command(shell: Shell) -> None:
    edges = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0.2 {INFORMATION_2}\n" for k in range(9))
    shell.file(edges, "truth.g2o")
    shell.file(edges + "EDGE_FOO 1 2\n", "two words.g2o")
    complaint = shell.refused("evaluate 'two words.g2o' truth.g2o")
    option, command = (line.rpartition(": ")[2].strip() for line in complaint.splitlines()[1:])
    assert (option, command) == ("--ignore-tags EDGE_FOO", "nls convert 'two words.g2o' OUT.npz")
    shell.both(f"{command.removeprefix('nls ')} {option}")
    assert shell.report("evaluate OUT.npz truth.g2o")["ate"]["rmse_m"] == 0
    (shell / "no poses").mkdir()
    assert "as nls solve 'no poses' -o OUT writes" in shell.refused("evaluate 'no poses' truth.g2o")


def test_a_file_of_no_times_is_not_matched_by_time(shell: Shell) -> None:
    """In a PyFactorGraph file all times are 0, that of the first pose of the truth."""
    shell.file("".join(f"EDGE_SE2 {k} {k + 1} 1 0 0.2 {INFORMATION_2}\n" for k in range(9)), "a.g2o")
    shell("convert a.g2o a.pyfg")
    shell("convert a.pyfg a.tum")  # by their numbers, as the note says
    assert shell.report("evaluate a.pyfg a.g2o")["matched_by"] == "number"
    assert "a.pyfg has numbers alone; a.tum has times alone" in shell.refused("evaluate a.pyfg a.tum")
