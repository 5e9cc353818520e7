"""Which dialect a file is in, what its numbers then mean, and what is no graph at all."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from factors import Between, Covariance, Information, SqrtInformation
from models import SE3
from models.manifolds.euler import quaternion_from_angles, to_se3
from nls import Values, kinds, load
from nls.io import DIALECTS
from tests.combinations import for_all
from tests.nls.io.g2o_files import CONVENTIONS, assert_refused, read, write
from tests.nls.io.io_files import (
    COVARIANCE_2,
    EDGES_2,
    FILES,
    ISAM_2,
    ISAM_3,
    ISAM_APART_2,
    ISAM_APART_3,
    TORO_2,
    TORO_3,
)

x, l = kinds("x", "l")
EDGE2 = "EDGE2 0 1 1 0 0.05 500 1 400 300 2 3\n"
ODOMETRY = "ODOMETRY 0 1 1 0 0.05 20 1 2 30 3 40\n"


def test_the_tags_decide_and_the_report_names_them() -> None:
    for text, dialect, reason in (
        (EDGES_2, "g2o", "by its tags"),
        (TORO_2, "toro", "VERTEX2 lines are TORO's; name the dialect graph if its numbers are covariances"),
        (TORO_3, "toro", "by its tag VERTEX3"),
        (ISAM_2, "isam", "by its tag Constraint2"),
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
    assert_refused(5, "may join variables: EDGE2 (1)", read, text, dialect="g2o")
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
    text = (ISAM_APART_2, ISAM_APART_3)[number]
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
    graph = read(FILES["graph"][1], dialect="graph")[0].factors[0].noise
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
