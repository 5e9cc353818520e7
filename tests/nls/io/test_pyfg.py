"""PyFactorGraph files: names, times and covariances come back; every mistake has its line."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from factors import Between, Cauchy, Covariance, Diagonal, Factor, Information, Isotropic, Landmark, Prior, Range
from models import SE2, SO2, R
from nls import FactorGraph, GraphWarning, Values, kinds, load, save
from nls.io.files import read_bytes
from nls.io.pyfg import read_pyfg
from tests.combinations import for_all
from tests.nls.io.g2o_files import CONVENTIONS, Loaded, assert_refused, assert_unwritable, cases, write
from tests.nls.io.g2o_files import same as same_graph
from tests.nls.io.io_files import BAL

A, B, L, x = kinds("A", "B", "L", "x")

PLANE = """# a comment
VERTEX_SE2 0.5 A0 1 2 0.1
VERTEX_SE2 1.5 A1 2 2.5 0.2
VERTEX_SE2 0.7 B10 -3 1 -3.0

VERTEX_XY L3 4 6
VERTEX_SE2:PRIOR 0.5 A0 1.01 2.01 0.11 0.01 0.002 0.003 0.04 0.005 0.06
VERTEX_XY:PRIOR 0 L3 4.1 6.1 0.5 0.1 0.25
EDGE_SE2 1.5 A0 A1 1 0.4 0.1 0.01 0 0 0.02 0 0.03
EDGE_SE2 0.9 A0 B10 -4 -1 -3.1 0.5 0.1 0 0.6 0 0.7
EDGE_SE2_XY 1.6 A1 L3 2.6 3.1 0.1 0.02 0.2
EDGE_RANGE 0.6 A0 L3 5.1 0.04
EDGE_RANGE 0.8 B10 A1 5.3 0.09
EDGE_RANGE 1.7 A1 L3 4.0 0.01
"""
UPPER = "0.01 0.001 0.002 0.003 0.004 0.005 0.02 0.001 0.002 0.003 0.004 0.03 0 0 0 0.04 0 0 0.05 0 0.0625"
SPACE = f"""VERTEX_SE3:QUAT 0 A0 1 2 3 0 0 0 1
VERTEX_SE3:QUAT 1 A1 2 2 3 0.099833416646828155 0 0 0.99500416527802582
VERTEX_XYZ L0 4 6 -8
VERTEX_SE3:QUAT:PRIOR 0 A0 1 2 3 0 0 0.19866933079506122 0.98006657784124163 {UPPER}
VERTEX_XYZ:PRIOR 0 L0 4 6 -8.5 1 0 0 1 0 0.25
EDGE_SE3:QUAT 1 A0 A1 1.1 0 0 0 0.19866933079506122 0 0.98006657784124163 {UPPER}
EDGE_SE3_XYZ 1 A1 L0 2.6 3.1 -11 0.1 0 0 0.2 0 0.3
EDGE_RANGE 0 A0 L0 11.5 0.25
"""


def read(text: str, convention: str = "g2o") -> Loaded:
    return read_pyfg(text.encode(), "f.pyfg", convention)


def again(loaded: Loaded, folder: Path, convention: str = "g2o", ignore_tags: Sequence[str] = ()) -> Loaded:
    graph, values, report = loaded
    save(folder / "out.pyfg", graph, values, report)
    return read_pyfg(read_bytes(folder / "out.pyfg"), "out.pyfg", convention, ignore_tags)


def same(one: Loaded, two: Loaded) -> None:
    same_graph(one, two)
    for times in (lambda r: r.vertex_times.items(), lambda r: r.factor_times):
        assert [t.tolist() for _, t in times(one[2])] == [t.tolist() for _, t in times(two[2])]


def test_what_is_read_in_the_plane() -> None:
    graph, values, report = read(PLANE)
    assert {k: (s.manifold, s.numbers.tolist()) for k, s in values.stacks.items()} == {
        "A": (SE2, [0, 1]),
        "B": (SE2, [10]),
        "L": (R(2), [3]),
    }
    assert {k: t.tolist() for k, t in report.vertex_times.items()} == {"A": [0.5, 1.5], "B": [0.7]}
    found = [(type(f), repr(f), t.tolist()) for f, t in report.factor_times]
    assert found == [
        (Prior, "Prior(A0)", [0.5]),
        (Prior, "Prior(L3)", [0.0]),
        (Between, "Between(A0, A1)", [1.5]),
        (Between, "Between(A0, B10)", [0.9]),
        (Landmark, "Landmark(A1, L3)", [1.6]),
        (Range, "Range(A[0, 1], L[3, 3])", [0.6, 1.7]),
        (Range, "Range(B10, A1)", [0.8]),
    ]
    prior, *_, ranges, _ = graph.factors
    assert prior.noise.matrix.tolist() == [  # type: ignore[attr-defined]
        [[0.01, 0.002, 0.003], [0.002, 0.04, 0.005], [0.003, 0.005, 0.06]]
    ]
    assert ranges.z.tolist() == [5.1, 4.0]
    assert ranges.chi2(values)[0] == pytest.approx((5.1 - 5) ** 2 / 0.04)
    assert (report.format, report.dimension) == ("pyfg", "2-D")
    assert report.tags["EDGE_RANGE"] == 3


def test_the_covariance_in_space_is_that_of_the_rotation_vector() -> None:
    """All conventions give one optimum's worth of chi2 to first order: compare them at small residuals."""
    small = SPACE.replace("1.1 0 0 0 0.19866933079506122 0 0.98006657784124163", "1.001 0 0 0.0998 0.0005 0.0003 0.995")
    chi2 = {}
    for convention in ("log", "gtsam", "g2o", "graphslam"):
        graph, values, _ = read(small, convention)
        chi2[convention] = graph.factors[2].chi2(values)[0]
    assert chi2["log"] == chi2["gtsam"]
    assert chi2["g2o"] == pytest.approx(chi2["log"], rel=1e-3)
    assert chi2["graphslam"] == pytest.approx(chi2["log"], rel=1e-3)
    graph, values, _ = read(SPACE, "log")
    prior = graph.factors[0]
    assert prior.noise.matrix[0, 5, 5] == 0.0625  # type: ignore[attr-defined]
    assert prior.noise.matrix[0, 0, 5] == 0.005  # type: ignore[attr-defined]
    turned = 0.4 * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    expected = turned @ np.linalg.inv(prior.noise.matrix[0]) @ turned  # type: ignore[attr-defined]
    assert prior.chi2(values)[0] == pytest.approx(expected)


@for_all(text=[PLANE, SPACE], convention=CONVENTIONS)
def test_round_trip(text: str, convention: str, tmp_path: Path) -> None:
    before = read(text, convention)
    same(before, again(before, tmp_path, convention))
    numbers = sorted(line.split()[0:1] + [repr(float(w)) if w[0] in "-.0123456789" else w for w in line.split()[1:]]
                     for line in text.splitlines() if line and line[0] != "#")  # fmt: skip
    assert sorted(line.split() for line in (tmp_path / "out.pyfg").read_text().splitlines()) == numbers


def test_unknown_lines_are_kept(tmp_path: Path) -> None:
    path = write(tmp_path, PLANE + "EDGE_BEARING 1 A0 L3 0.5 0.1\nEDGE_BEARING x\n", "f.pyfg")
    with pytest.warns(GraphWarning, match=rf"{path}: .* EDGE_BEARING \(2, first on line 15\)") as caught:
        before = load(path, ignore_tags=["EDGE_BEARING"])
    assert [warning.filename for warning in caught] == [__file__]
    assert before[2].notes == [*before[2].warnings, "1 comment line"]
    assert before[2].ignored == ["EDGE_BEARING 1 A0 L3 0.5 0.1", "EDGE_BEARING x"]
    assert again(before, tmp_path, ignore_tags=["EDGE_BEARING"])[2].ignored == before[2].ignored


def test_why_a_file_was_read_so(tmp_path: Path) -> None:
    assert load(write(tmp_path, PLANE, "f.pyfg"))[2].reason == "by its name"
    assert load(write(tmp_path, PLANE, "f.txt"))[2].reason == "'A0' after a time is the name of a pose"
    assert load(tmp_path / "f.txt", dialect="pyfg")[2].reason == "as asked for"
    assert load(write(tmp_path, BAL, "f.txt"))[2].reason == "three counts on its first line"
    damaged = write(tmp_path, "VERTEX_SE2 0 nan 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")  # no name of pyfg
    assert_refused(1, "'nan' is not a number", load, damaged)


MISTAKES = cases("""
VERTEX_SE2 0.5 A2 1 2 | 4 words after VERTEX_SE2, expected 5: time name 3 numbers
VERTEX_XY 0.5 L4 1 2 | 4 words after VERTEX_XY, expected 3: name 2 numbers
EDGE_RANGE 0.5 A0 L3 5.1 | expected 5: time name name 1 numbers 1 of covariance
VERTEX_SE2 0.5 A1 1 2 3 | vertex A1 was given before, on line 3
VERTEX_SE2 0.5 L4 1 2 3 | kind L is in SE2 and in R
VERTEX_SE2 0.5 17 1 2 3 | name '17': expected letters and a number
VERTEX_SE2 0.5 A 1 2 3 | name 'A'
VERTEX_SE2 0.5 A1b 1 2 3 | name 'A1b'
VERTEX_SE2 0.5 A-1 1 2 3 | name 'A-1'
VERTEX_SE2 0.5 A01 1 2 3 | name 'A01'
VERTEX_SE2 0.5 Ä1 1 2 3 | name 'Ä1'
VERTEX_SE2 0.5 A1234567890123456789 1 2 3 | at most 18 digits
VERTEX_SE2 0.5 AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA1 1 2 3 | expected letters
VERTEX_SE2 t A2 1 2 3 | 't' is not a number
EDGE_RANGE 0.5 A0 L4 5.1 0.1 | L4 is measured, but no vertex line gives it
EDGE_RANGE 0.5 C0 L3 5.1 0.1 | C0 is measured, but no vertex line gives it
EDGE_RANGE 0.5 A0 A0 5.1 0.1 | connects A0 to itself
EDGE_RANGE 0.5 A0 L3 -5.1 0.1 | a range is at least 0 m
EDGE_RANGE 0.5 A0 L3 5.1 0 | Covariance of measurement 2 is 0, expected > 0
EDGE_RANGE 0.5 L3 A0 5.1 0.1 | expected a pose
EDGE_SE2 1 A0 A1 1 0 0 1 2 0 1 0 1 | not positive definite
EDGE_SE2 1 A0 L3 1 0 0 1 0 0 1 0 1 | connects SE2 and R
EDGE_SE2_XY 1 A0 A1 1 0 0 1 | covariance
VERTEX_XYZ L9 1 2 3 | mixes the plane and space
""")


def test_every_mistake_has_its_line() -> None:
    for line, words in MISTAKES:
        assert_refused(15, words, read, PLANE + line + "\n")
    lines = PLANE.splitlines()
    assert lines[12].startswith("EDGE_RANGE 0.8 B10 A1")  # of another factor
    lines[13] = "EDGE_RANGE 1.7 A1 L3 4.0 -0.01"
    assert_refused(14, "measurement 1 is -0.01", read, "\n".join(lines))
    for text in ("", "# nothing\n", "EDGE_RANGE 0 A0 L0 1 1\n", "HELLO\n"):
        assert_refused(1, "no vertices", read, text)


def test_what_the_format_has_no_line_for(tmp_path: Path) -> None:
    values = Values({A: (SE2, SE2.identity(2)), L: (R(2), [[1.0, 2.0]])})

    def refused(factor: Factor, message: str, values: Values = values) -> None:
        assert_unwritable(tmp_path / "out.pyfg", message, FactorGraph([factor]), values)

    zero = [0.0, 0.0, 0.0]
    refused(Prior(A[0], zero, Isotropic(1), components=["x"]), r"Prior\(A0\) cannot be written to a PyFactorGraph file")
    refused(Range(A[0], L[0], [1.0], Isotropic(1), offset=[1.0, 0.0, 0.0]), r"Range\(A0, L0\) cannot be written")
    refused(Between(L[0], L[1], [0.0, 0.0], Isotropic(1)), "cannot be written",
            Values({L: (R(2), [[0.0, 0.0], [1.0, 1.0]])}))  # fmt: skip
    refused(Between(A[0], A[1], zero, Information(np.diag([1.0, 1, 0]))), "measures nothing in some direction")
    refused(Between(A[0], A[1], zero, Diagonal([1, 1, 1])).robust(Cauchy(1.0)), "robust")
    prior = Prior(A[0], zero, Covariance(np.eye(3)))
    refused(prior, "variables p in SO2 have no line", Values({A: (SE2, zero), "p": (SO2, [0.0])}))
    refused(prior, "variables my_A in SE2", Values({"my_A": (SE2, zero), A: (SE2, zero)}))
    refused(prior, "the number is negative", Values({A: (SE2, [zero, zero], [0, -1])}))
    graph = FactorGraph([prior])
    graph.fix(A[0])
    assert_unwritable(tmp_path / "out.pyfg", "A0 is fixed", graph, values)


def test_the_public_file_comes_back_byte_for_byte(data: Path, tmp_path: Path) -> None:
    path = data / "range-only" / "plaza2.pyfg.gz"
    graph, values, report = read_pyfg(read_bytes(path), str(path))
    assert (len(values), len(graph)) == (4095, 5897)
    assert [len(f) for f in graph.factors] == [4090, 1807]
    save(tmp_path / "out.pyfg", graph, values, report)
    assert (tmp_path / "out.pyfg").read_bytes() == gzip.decompress(path.read_bytes())
