"""Which dialect a file is in, what its numbers then mean, what is no graph; files as other programs write them."""

from __future__ import annotations

import re
import shlex
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from factors import DCS, Between, Covariance, Information, Landmark, Position, Prior, SqrtInformation
from models import SE3
from models.manifolds.euler import quaternion_from_angles, to_se3
from nls import GraphWarning, OptionError, Values, kinds, load
from nls.io import DIALECTS
from tests.combinations import for_all
from tests.nls.io import io_files
from tests.nls.io.g2o_files import CONVENTIONS, INFORMATION_2, PLANE, again, assert_refused, read, same, write
from tests.nls.io.io_files import COVARIANCE_2, EDGES_2, GTSAM_2, ISAM_3, RTABMAP_3, SWITCHED_2, SWITCHED_3, UPPER_3, C

x, l = kinds("x", "l")
EDGE2 = "EDGE2 0 1 1 0 0.05 500 1 400 300 2 3\n"
ODOMETRY = "ODOMETRY 0 1 1 0 0.05 20 1 2 30 3 40\n"


def test_the_tags_decide_and_the_report_names_them() -> None:
    for text, dialect, reason in (
        (EDGES_2, "g2o", "by its tags"),
        (io_files.TORO_2, "toro", "VERTEX2 lines are TORO's; name the dialect graph if its numbers are covariances"),
        (io_files.TORO_3, "toro", "by its tag VERTEX3"),
        (io_files.ISAM_2, "isam", "by its tag Constraint2"),
        (ISAM_3, "isam", "by its tag POINT3"),
        (ODOMETRY + "SOLVE\n", "isam", "by its tag SOLVE"),
    ):
        _, _, report = read(text)
        assert (report.format, report.reason) == (dialect, reason)
        assert str(report).startswith(f"f.g2o: {dialect} ({reason}), ")


def test_several_readings_are_refused_with_the_choices() -> None:
    for text, choices in (
        ("EDGE2 0 1 1 0 0.05 9 1 4 7 1 2\n", ["toro", "isam", "isam-covariance", "graph"]),
        (ODOMETRY, ["isam", "isam-covariance"]),
        (COVARIANCE_2, ["isam", "isam-covariance"]),
        ("\n" + ISAM_3.split("POINT3")[0], ["toro", "isam"]),
    ):
        error = assert_refused(1 + text.startswith("\n"), "several readings", read, text)
        assert [name for name in DIALECTS if f"{name}: " in str(error)] == [n for n in DIALECTS if n in choices]
        for name in choices:
            assert read(text, dialect=name)[2].reason == "as asked for"


def test_tags_of_two_dialects() -> None:
    text = EDGES_2 + EDGE2
    assert_refused(5, "EDGE2 is a tag of toro or isam", read, text)
    assert_refused(5, "may connect variables: EDGE2 (1)", read, text, dialect="g2o")
    _, _, report = read(text, dialect="g2o", ignore_tags=["EDGE2"])
    assert report.ignored == [EDGE2.strip()]
    assert "unknown tags" in report.warnings[0]


def test_a_dialect_that_is_none_of_the_file() -> None:
    assert_refused(1, "'EDGE2' is no tag", read, EDGE2, dialect="g2o")


def test_what_only_steers_isam_is_kept_with_a_count() -> None:
    _, _, report = read("EDGE3_TRUE 0 1 1 0 0 0 0 0\n" + ISAM_3 + "SOLVE\nSOLVE\n")
    assert report.warnings == ["lines were not used: EDGE3_TRUE (1, first on line 1), SOLVE (2, first on line 7)"]
    assert report.tags["SOLVE"] == 2


@for_all(number=[0, 1])
def test_points_of_isam_are_numbered_apart(number: int) -> None:
    """A pose and a point of one number are two variables; with another number the same graph."""
    text = (io_files.ISAM_APART_2, io_files.ISAM_APART_3)[number]
    graph, values, _ = read(text)
    assert values.stacks["x"].numbers.tolist() == [0, 1, 2]
    assert number in values.stacks["l"].numbers
    other = text.replace(f" {number} 3.1", " 9 3.1").replace(f" {number} 2.0", " 9 2.0").replace("1 1 1.9", "1 9 1.9")
    moved_graph, moved, _ = read(other.replace("2 1 0.9", "2 9 0.9"))
    assert graph.chi2(values) == moved_graph.chi2(moved) > 0
    assert values[l[number]] == pytest.approx(moved[l[9]], abs=0)
    seen = next(factor for factor in graph.factors if factor.name == "Landmark")
    assert [(k.kind, k.numbers[0]) for k in seen.keys] == [("x", 0 if number == 0 else 1), ("l", number)]


# ---- what the numbers mean


def test_entries_in_the_order_of_each_dialect() -> None:
    toro = read(EDGE2, dialect="toro")[0].factors[0].noise
    assert isinstance(toro, Information)
    assert toro.matrix[0].tolist() == [[500, 1, 2], [1, 400, 3], [2, 3, 300]]
    graph = read(io_files.FILES["graph"][1], dialect="graph")[0].factors[0].noise
    assert isinstance(graph, Covariance)
    assert graph.matrix[0].tolist() == [[0.02, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.01]]
    isam = read(ODOMETRY, dialect="isam")[0].factors[0].noise
    assert isinstance(isam, SqrtInformation)
    assert isam.matrix[0].tolist() == [[20, 1, 2], [0, 30, 3], [0, 0, 40]]
    covariance = read(COVARIANCE_2, dialect="isam-covariance")[0].factors
    assert covariance[0].noise.matrix[0].tolist() == graph.matrix[0].tolist()  # type: ignore[attr-defined]
    assert covariance[1].noise.matrix[0].tolist() == [[0.4, 0.05], [0.05, 0.3]]  # type: ignore[attr-defined]


@for_all(dialect=["toro", "isam"], convention=CONVENTIONS)
def test_noise_of_angles_is_turned_to_first_order(dialect: str, convention: str) -> None:
    """chi2 near the measurement is that of small errors of roll, pitch and yaw, whatever the convention."""
    rng = np.random.default_rng(0)
    M = rng.normal(size=(6, 6))
    M = np.linalg.cholesky(M @ M.T + np.eye(6)).T if dialect == "isam" else M @ M.T + np.eye(6)
    entries = " ".join(map(repr, M[np.triu_indices(6)].tolist()))
    measured = [0.5, -0.3, 0.2, 0.4, -0.7, 2.1]
    graph = read(f"EDGE3 0 1 {' '.join(map(str, measured))} {entries}\n", convention, dialect)[0]
    for _ in range(5):
        e = 1e-5 * rng.normal(size=6)
        T = to_se3(np.concatenate([measured[3:], measured[:3]]))
        q = quaternion_from_angles(np.array(measured[3:]) + e[3:])
        t = SE3.act(T, e[:3])  # a translation error is taken along the axes of the pose reached
        values = Values({x: (SE3, [SE3.identity()[0], np.concatenate([t, q])])})
        expected = np.sum((M @ e) ** 2) if dialect == "isam" else e @ M @ e
        assert graph.chi2(values) == pytest.approx(expected, rel=1e-3)


def test_measured_angles_are_roll_pitch_yaw_and_no_gimbal_lock() -> None:
    graph, _, report = read(ISAM_3)
    edge = graph.factors[0]
    assert isinstance(edge, Between)
    assert edge.z[0] == pytest.approx(to_se3([0.11, -0.21, 0.41, 1.01, 0, 0.02]), abs=1e-15)
    assert report.statements[0].noise is edge.noise
    line = f"EDGE3 1 2 0 0 0 0.1 {np.pi / 2!r} 0 " + " ".join(["1"] * 21)
    for dialect in ("toro", "isam"):
        assert_refused(2, "pitch is +-90 deg", read, ISAM_3.split("\n")[0] + "\n" + line, dialect=dialect)


def test_public_files_solve(data: Path) -> None:
    """Residuals as large as the numbers say they are: chi2 is about the degrees of freedom where the noise is known."""
    graph, values, _ = load(data / "pose-graphs-3d" / "sphere400.txt", dialect="isam")
    result = graph.optimize(values)
    assert result.converged
    assert result.chi2_final / result.dof == pytest.approx(1.0, abs=0.05)
    graph, values, _ = load(data / "pose-graphs-2d" / "FR079_P_toro.graph")
    result = graph.optimize(values)
    assert result.converged
    assert result.chi2_final < 40 < 8000 < result.chi2_initial
    whole = load(data / "victoria-park" / "victoria_park.txt", dialect="isam-covariance")
    assert [len(stack) for stack in whole[1].stacks.values()] == [6969, 151]
    text = (data / "victoria-park" / "victoria_park.txt").read_text().splitlines()
    first = [n for n in text if int(n.split()[1]) < 300 and (n.startswith("L") or int(n.split()[2]) <= 300)]
    graph, values, _ = read("\n".join(first), dialect="isam-covariance")
    result = graph.optimize(values)
    assert result.chi2_final == pytest.approx(18.808, abs=0.01)
    as_root = read("\n".join(first), dialect="isam")[0].chi2(result.values)
    assert as_root < 0.1 * result.chi2_final  # the other reading says errors far larger than they are


# ---- other formats, and what is no graph


MATLAB = b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + struct.pack("<4xI", 7)


def test_files_that_are_no_graph(tmp_path: Path) -> None:
    for content, line, words in (
        (MATLAB, None, "is a MATLAB file"),
        (b"\x89PNG\r\n\x1a\n\x00\x01", 3, "zero byte"),
        (b"0.000\t  0.00\t  0.00\n1.0 2 3\n", 1, "table of numbers: a line begins with '0.000'"),
        (b"# header\n# more\n\n1248444175.103 \t 2.64\n", 4, "table of numbers"),
        (b"\xef\xbb\xbf-1 2 3 4\n", 1, "table of numbers: a line begins with '-1'"),
        (b"Time [s],DVL X [m/s]\r\n0.0,2.1\r\n", 1, "table, its numbers separated by commas"),
        (b"SOLVE\n", 1, "'SOLVE' is no tag"),
    ):
        error = assert_refused(line, words, load, write(tmp_path, content, "some.dat"))
        assert ("expected lines such as EDGE_SE2" in str(error)) == (line is not None and words != "zero byte")


def numbers(lines: list[str]) -> list[tuple[str | float, ...]]:
    """Tag and numbers of every line but those of vertices and parameters."""
    words = [line.split() for line in lines if line[0] not in "VP" or line.startswith("VERTEX_SWITCH")]
    return sorted((w[0], *map(float, w[1:])) for w in words)


def test_switches_are_dynamic_covariance_scaling() -> None:
    """With s = min(1, 2 phi / (phi + chi2)): the sum of s^2 chi2 + phi (1 - s)^2 up to a constant per edge."""
    graph, values, report = read(SWITCHED_2)
    plain, _, _ = read(re.sub(r"_SWITCHABLE (\d \d) \d", r" \1", SWITCHED_2))
    chi2 = plain.factors[0].chi2(values)
    assert (chi2[4] == 0) & (chi2[5:] > 100).all()
    gamma, xi = np.array([1, 0.5, 1]), np.array([1, 8, 1])
    s, phi = gamma**2 * chi2[4:], gamma**2 * xi
    expected = chi2[:4].sum() + np.where(s <= phi, s, phi * (3 * s - phi) / (s + phi)).sum()
    assert graph.chi2(values) == pytest.approx(expected, rel=1e-12)
    assert [f.kernel for f in graph.factors] == [None, DCS(1.0), DCS(2.0)]
    assert [len(f) for f in graph.factors] == [4, 2, 1]
    note = "EDGE_SE2_SWITCHABLE lines are closures under dcs:1 (2), dcs:2 (1), by the priors of their switches"
    assert report.notes == [f"{note}, which only a g2o file gets back"]


def test_edges_and_places_of_rtabmap_are_those_of_g2o() -> None:
    """EDGE_SE3 as EDGE_SE3:QUAT, priors of points and of poses."""
    graph, values, report = read(RTABMAP_3)
    assert [type(f) for f in graph.factors[2:]] == [Prior, Position]
    assert "EDGE_POINTXYZ_PRIOR lines of poses are read as positions" in report.notes
    text = re.sub("EDGE_POINTXYZ_PRIOR ([012])", r"EDGE_SE3_XYZ_PRIOR \1 0", RTABMAP_3).replace(
        "EDGE_SE3 ", "EDGE_SE3:QUAT "
    )
    same_as, its, _ = read(f"PARAMS_SE3OFFSET 0 0 0 0 {C}\n{text}")
    assert graph.chi2(values) == pytest.approx(same_as.chi2(its), rel=1e-12)


def test_points_of_landmark2_are_numbered_apart() -> None:
    graph, values, _ = read(GTSAM_2)
    assert type(graph.factors[1]) is Landmark
    assert values.stacks["l"].numbers.tolist() == [1, 7]
    same_as, its, _ = read(re.sub("LANDMARK2 (.) (.)", r"EDGE_SE2_XY \1 1\2", GTSAM_2))
    assert its.stacks["l"].numbers.tolist() == [11, 17]
    assert graph.chi2(values) == pytest.approx(same_as.chi2(its), rel=1e-12)
    assert_refused(8, "FIX 1 may mean the pose or the point", read, GTSAM_2 + "FIX 1\n")
    assert read(GTSAM_2 + "FIX 7\n")[0].fixed[0].kind == "l"


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_tags_types_and_switches_are_written_as_they_were(tmp_path: Path) -> None:
    """And what no edge uses is kept: offsets of the other dimension, a switch without an edge."""
    typed = "".join(f"{line} 8\n" if line.startswith("EDGE_SE3") else f"{line}\n" for line in RTABMAP_3.splitlines())
    unused = f"PARAMS_SE3OFFSET 5 0 0 0 {C}\n{SWITCHED_2}VERTEX_SWITCH 17 1\nEDGE_SWITCH_PRIOR 18 1 1\n"
    typed_switch = SWITCHED_3.replace(f"{UPPER_3}\n", f"{UPPER_3} 3\n")
    old = SWITCHED_3.replace("EDGE_SE3_SWITCHABLE", "EDGE_SE3:QUAT_SWITCHABLE")
    for text in (typed, unused, typed_switch, SWITCHED_3, GTSAM_2):
        loaded = read(text)
        same(loaded, again(loaded, tmp_path))
        lines = (tmp_path / "again.g2o").read_text().splitlines()
        assert numbers(lines) == numbers(text.splitlines())
    same(read(old), read(SWITCHED_3))
    assert read(unused)[2].ignored == [
        f"PARAMS_SE3OFFSET 5 0 0 0 {C}",
        "VERTEX_SWITCH 17 1",
        "EDGE_SWITCH_PRIOR 18 1 1",
    ]
    assert "EDGE_SE3 lines end in a type of a link, 8 (2): not used, and only a g2o file gets it back" in (
        read(typed)[2].warnings
    )
    same(loaded, (*again(loaded, tmp_path, dialect="json")[:2], loaded[2]))


def test_switches_that_say_no_kernel_are_refused_with_the_line() -> None:
    for old, new, line, words in (
        ("EDGE_SWITCH_PRIOR 3 1 2\n", "", 7, "switch 3 for itself alone, which no EDGE_SWITCH_PRIOR line"),
        ("VERTEX_SWITCH 3 1\n", "", 7, "switch 3 for itself alone, which no VERTEX_SWITCH line"),
        ("PRIOR 3 1 2", "PRIOR 3 0 2", 8, "value 0 and information 2"),
        ("PRIOR 3 1 2", "PRIOR 3 1 -2", 8, "value 1 and information -2"),
        ("PRIOR 3 1 2", "PRIOR 3 1 1e200", 8, "expected two numbers above 0"),
        ("VERTEX_SWITCH 3 1", "VERTEX_SWITCH 2 1", 6, "vertex 2 was given before"),
        ("_SWITCH_PRIOR 3 1 2\n", "_SWITCH_PRIOR 3 1 2\nEDGE_SWITCH_PRIOR 3 1 1\n", 8, "given before, on line 7"),
    ):
        assert_refused(line, words, read, SWITCHED_3.replace(old, new))
    twice = SWITCHED_3 + SWITCHED_3.splitlines()[-1]
    assert_refused(9, "one edge alone: an edge of switch 3 was given before, on line 8", read, twice)


def test_decimal_commas_are_named() -> None:
    for word in ("0,5", "-1,25e-3", ",5"):
        assert_refused(1, f"{word!r} is not a number; it has a decimal comma", read, f"VERTEX_SE2 0 {word} 0 0\n")
    error = assert_refused(1, "'0,5,1' is not a number", read, "VERTEX_SE2 0 0,5,1 0 0\n")
    assert "comma" not in str(error).split("[")[0]


def test_a_tag_of_edges_is_left_out_only_where_that_is_asked_for(tmp_path: Path) -> None:
    text = PLANE + "EDGE_FOO 0 1\nedge_B,'x 1 2\nEDGE_FOO\nVERTEX_FOO 3\n"
    error = assert_refused(9, "EDGE_FOO (2), edge_B,'x (1)", read, text)
    assert "ignore_tags=['EDGE_FOO', \"edge_B,'x\"]" in str(error)
    (cure,) = error.advice
    option, value = shlex.split(cure.words(shell=True).split(": ")[1])
    assert option == "--ignore-tags"
    for ignored in (["EDGE_FOO", "edge_B,'x"], value):
        with pytest.warns(GraphWarning, match=r"EDGE_FOO \(2, first on line 9\), edge_B,'x \(1, first on line 10\)"):
            loaded = load(write(tmp_path, text), ignore_tags=ignored)
        assert loaded[2].ignored == text.splitlines()[8:]
        assert again(loaded, tmp_path, ignore_tags=ignored)[2].ignored == loaded[2].ignored
    assert_refused(10, "edge_B,'x (1)", read, text, ignore_tags=["EDGE_FOO", "edge_B"])
    for tag in ("EDGE_SE2", "VERTEX_XY", "EDGE_SE2_SWITCHABLE"):
        with pytest.raises(OptionError, match=f"ignore_tags: '{tag}' .* tags that are not read"):
            read(text, ignore_tags=[tag])
    with pytest.warns(GraphWarning) as caught:
        load(tmp_path / "graph.g2o", ignore_tags=[*value.split(","), "EDGE_FOOT"])
    assert str(caught[1].message).endswith("no line has the tag 'EDGE_FOOT'; did you mean 'EDGE_FOO'?")
    many = PLANE + "".join(f"EDGE_{k:050} 0 1\n" for k in range(30))
    assert assert_refused(9, "and 21 more tags", read, many).advice == ()
    assert read(PLANE + "EDGE_A 1\nEDGE, 2\n", ignore_tags="EDGE_A, EDGE,")[2].tags["EDGE,"] == 1


def test_edges_to_absent_vertices_are_left_out_only_where_that_is_asked_for(tmp_path: Path) -> None:
    edge = f"EDGE_SE3:QUAT 2 77 1 0 0 {C} {UPPER_3}\n"
    text = f"{io_files.POSES_3}{edge}EDGE_POINTXYZ_PRIOR 78 0 0 0 1 0 0 1 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 {C} {UPPER_3}\n"
    text += "".join(f"{line}\n" for line in SWITCHED_3.splitlines()[5:]).replace("0 2 3", "79 2 3")
    error = assert_refused(4, "vertex 77", read, text)
    assert [piece.words(shell=True) for piece in error.advice] == ["leave such edges out: --drop-absent"]
    assert "drop_absent=True" in str(error)
    loaded = read(text, drop_absent=True)
    assert loaded[2].warnings == ["3 edges to vertices that no line gives left out, first on line 4"]
    assert [repr(f) for f in loaded[0].factors] == ["Between(x0, x1)"]
    assert len(loaded[2].ignored) == 5  # with the switch
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        same(loaded, again(loaded, tmp_path, drop_absent=True))
    wrong = f"VERTEX_TRACKXYZ 4 1 1 1\nEDGE_SE3:QUAT 4 0 1 0 0 {C} {UPPER_3}\n"
    assert_refused(len(text.splitlines()) + 2, "vertex 4 is a point", read, text + wrong, drop_absent=True)
    without = f"EDGE_SE3:QUAT 0 1 1 0 0 {C} {UPPER_3}\n"
    assert read(without, drop_absent=True)[2].warnings == []


def test_a_pose_is_absent_though_a_point_of_its_own_numbering_has_its_number() -> None:
    vertices = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 2 2 0 0\nVERTEX_XY 1 1 1\n"
    edges = f"EDGE_SE2 0 2 2 0 0 {INFORMATION_2}\nLANDMARK2 0 1 1 1 1 0 1\nEDGE_SE2 0 1 1 0 0 {INFORMATION_2}\n"
    error = assert_refused(6, "the edge needs vertex 1, which no VERTEX_SE2 line has", read, vertices + edges)
    assert [piece.action for piece in error.advice] == ["drop absent"]
    graph, _, report = read(vertices + edges + "LANDMARK2 0 2 1 1 1 0 1\n", drop_absent=True)
    assert report.warnings == ["2 edges to vertices that no line gives left out, first on line 6"]
    assert [repr(f) for f in graph.factors] == ["Between(x0, x2)", "Landmark(x0, l1)"]
