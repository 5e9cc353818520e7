"""g2o files: read, written and read again the same to the bit; whatever is wrong in one has its line."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from factors import Between, Information
from models import SE2
from nls import (
    FactorGraph,
    GraphError,
    GraphFileError,
    GraphWarning,
    LoadReport,
    OptionError,
    Values,
    kinds,
    load,
)
from nls.io.read import read_graph
from nls.plot.trajectory import _closures
from tests.nls.graphs import distance
from tests.nls.io.g2o_files import CONVENTIONS, INFORMATION_2, PLANE, SPACE, UPPER_3, again, quoted, read, same, write

x, l = kinds("x", "l")


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_round_trip(text: str, convention: str, tmp_path: Path) -> None:
    loaded = load(write(tmp_path, text), convention)
    same(loaded, again(loaded, tmp_path, convention))
    written = (tmp_path / "again.g2o").read_text()
    assert written.split() == text.split() or len(written.split()) == len(text.split())


def test_round_trip_with_everything_unusual(tmp_path: Path) -> None:
    text = f"""# a comment
EDGE_SE2 900 -4 0.1 -0.0 1e-320 1e300 0 0 1e-300 0 5e-324

VERTEX_SE2 900 .5 5. 3.1415926535897931
FIX 7
VERTEX_SE2 {2**63 - 1} 1e22 -1e-7 -12.5
VERTEX_SE2 -4 0.1 0.2 0.30000000000000004
PARAMS_SE2OFFSET 0 0 0 0
VERTEX_SE2 7 1 2 3
EDGE_SE2 7 {2**63 - 1} 1 2 3 1 0 0 1 0 0
EDGE_WHATEVER ünïcode 1 2   three
FIX 900 -4
# another
"""
    with pytest.warns(
        GraphWarning, match=r"unknown tags were not used: EDGE_WHATEVER \(1, first on line 11\)"
    ) as caught:
        loaded = load(write(tmp_path, text))
    assert [Path(w.filename).name for w in caught] == ["test_g2o.py"]  # it points at the line that called load
    graph, values, report = loaded
    assert values.stacks["x"].numbers.tolist() == [900, 2**63 - 1, -4, 7]
    assert graph.factors[0].keys[0].numbers.tolist() == [900, 7]
    assert sorted(n for keys in graph.fixed for n in keys.numbers.tolist()) == [-4, 7, 900]
    assert report.ignored == ["EDGE_WHATEVER ünïcode 1 2   three", "PARAMS_SE2OFFSET 0 0 0 0"]
    assert "1 parameter that no edge uses" in report.notes
    assert report.tags == {"EDGE_SE2": 2, "VERTEX_SE2": 4, "FIX": 2, "PARAMS_SE2OFFSET": 1, "EDGE_WHATEVER": 1}
    assert "2 comment lines" in report.notes
    same(loaded, again(loaded, tmp_path))
    lines = (tmp_path / "again.g2o").read_text().splitlines()
    assert lines[0] == "VERTEX_SE2 900 0.5 5 3.141592653589793"
    assert lines[1] == "FIX 900"
    assert "#" not in "".join(lines)
    assert lines[-2:] == report.ignored


def test_numbers_survive_writing() -> None:
    rng = np.random.default_rng(0)
    z = rng.normal(size=(50, 3)) * 10.0 ** rng.integers(-12, 12, size=(50, 3))
    lines = [f"EDGE_SE2 {k} {k + 1} {v[0]!r} {v[1]!r} {v[2]!r} 1 0 0 1 0 1" for k, v in enumerate(z.tolist())]
    graph, _, _ = read(
        "VERTEX_SE2 0 0 0 0\n" + "\n".join(f"VERTEX_SE2 {k + 1} 0 0 0" for k in range(50)) + "\n" + "\n".join(lines)
    )
    assert np.asarray(graph.factors[0].z).tobytes() == z.tobytes()  # type: ignore[attr-defined]


def test_the_report_says_what_was_read(tmp_path: Path) -> None:
    _, _, report = load(write(tmp_path, SPACE))
    text = str(report)
    assert "3-D, convention g2o" in text
    assert re.search(r"VERTEX_SE3:QUAT +3", text)
    assert re.search(r"EDGE_SE3:QUAT +3", text)
    assert report.vertices_given
    assert report.notes == []


# ---- what is wrong has its line

V2, V3 = "VERTEX_SE2", "VERTEX_SE3:QUAT"
E2 = f"EDGE_SE2 0 1 1 0 0 {INFORMATION_2}"
TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
Q = "0 0 0 0 0 0 1"
CHAIN_BEYOND = f"EDGE_SE2 0 1 1e308 0 0 {INFORMATION_2}\nEDGE_SE2 1 2 1e308 0 0 {INFORMATION_2}\n"

WRONG = {
    "empty": ("", 1, "is empty; expected lines such as EDGE_SE2"),
    "blank": ("\n \n", 1, "is empty"),
    "no tag of ours": ("hello world\n", 1, "is no graph: 'hello' is no tag of a graph; expected"),
    "only FIX": ("FIX 0\n", 1, "fixes vertices and has neither a vertex nor an edge"),
    "only comments": ("\n# hi\n#ho\n", 2, "has nothing but comments; expected lines such as EDGE_SE2"),
    "FIX and no tag of ours": ("FIX 0\nhello\n", 2, "is no graph: 'hello' is no tag of a graph"),
    "short vertex": ("\nVERTEX_SE2 0 0 0\n", 2, "3 numbers after the tag, expected 4: id x y theta"),
    "long vertex": (TWO + "VERTEX_SE2 2 0 0 0 0\n" + E2, 3, "5 numbers after the tag, expected 4"),
    "short edge": (
        TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n",
        3,
        "10 numbers after the tag, expected 11: i j dx dy dtheta",
    ),
    "long edge": (TWO + E2 + " 7\n", 3, "12 numbers after the tag, expected 11"),
    "tag alone": (TWO + "EDGE_SE2\n", 3, "0 numbers after the tag"),
    "6 for 21": (
        f"{V3} 0 {Q}\n{V3} 1 {Q}\nEDGE_SE3:QUAT 0 1 {Q} 1 0 0 1 0 1",
        3,
        "15 numbers after the tag, expected 30",
    ),
    "word": (TWO + "EDGE_SE2 0 1 1 zero 0 1 0 0 1 0 1\n", 3, "'zero' is not a number"),
    "nan": ("VERTEX_SE2 0 nan 0 0\n", 1, "'nan' is not a number"),
    "huge": ("VERTEX_SE2 0 1e999 0 0\n", 1, "'1e999' is beyond the largest number"),
    "half id": ("VERTEX_SE2 0.5 0 0 0\n", 1, "id '0.5' is not a whole number"),
    "edge id": (TWO + "EDGE_SE2 0 1e0 1 0 0 1 0 0 1 0 1\n", 3, "id '1e0' is not a whole number"),
    "large id": (f"VERTEX_SE2 {2**63} 0 0 0\n", 1, "is not a whole number below 2^63"),
    "given twice": (TWO + "VERTEX_SE2 0 5 5 5\n" + E2, 3, "vertex 0 was given before, on line 1"),
    "self edge": (TWO + E2 + f"\nEDGE_SE2 1 1 1 0 0 {INFORMATION_2}\n", 4, "the edge joins vertex 1 to itself"),
    "missing vertex": (
        TWO + E2 + f"\nEDGE_SE2 1 9 1 0 0 {INFORMATION_2}\n",
        4,
        "the edge needs vertex 9, which no VERTEX_SE2 line has",
    ),
    "missing first": (TWO + f"EDGE_SE2 8 1 1 0 0 {INFORMATION_2}\n", 3, "the edge needs vertex 8"),
    "negative": (TWO + E2 + "\nEDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n", 4, "has the negative eigenvalue -1"),
    "indefinite": (TWO + "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n" + E2, 3, "has the negative eigenvalue -1"),
    "all indefinite": (TWO + 2 * "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", 3, "negative eigenvalue"),
    "zero quaternion": (f"{V3} 0 {Q}\n{V3} 1 0 0 0 0 0 0 0\n", 2, "the quaternion has length 0, expected 1"),
    "long quaternion": (f"{V3} 0 {Q}\n{V3} 1 0 0 0 0 0 0 2\n", 2, "length 2, expected 1; the order is x y z w"),
    "edge quaternion": (f"{V3} 0 {Q}\n{V3} 1 {Q}\nEDGE_SE3:QUAT 0 1 0 0 0 1 1 0 0 {UPPER_3}\n", 3, "length 1.41421"),
    "mixed": (TWO + E2 + f"\n{V3} 2 {Q}\n", 4, "mixes poses of the plane and of space"),
    "mixed, space first": (f"{V3} 2 {Q}\n" + TWO, 2, "mixes poses of the plane and of space"),
    "FIX unknown": (TWO + E2 + "\nFIX 0 5\n", 4, "FIX names vertex 5, which no VERTEX_SE2 line has; add one"),
    "FIX of chained poses": (E2 + "\nFIX 1\nFIX 0 7\n", 3, "FIX names vertex 7, which no EDGE_SE2 line has"),
    "FIX word": (TWO + E2 + "\nFIX one\n", 4, "id 'one' is not a whole number"),
    "FIX nothing": (TWO + E2 + "\nFIX\n", 4, "FIX without a vertex; expected FIX id"),
    "chained beyond": (CHAIN_BEYOND, 1, "grow beyond the largest number"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_has_its_line(case: str) -> None:
    text, line, message = WRONG[case]
    with pytest.raises(GraphFileError) as caught:
        read(text)
    assert caught.value.line == line
    assert str(caught.value).startswith(f"f.g2o:{line}: ")
    assert message in str(caught.value)
    if text.strip():
        assert caught.value.text == quoted(text.splitlines()[line - 1])


def test_wrong_convention() -> None:
    with pytest.raises(OptionError, match="convention: 'g3o' is not possible"):
        read(PLANE, "g3o")


# ---- what is unusual and right


def test_edges_before_vertices_and_fix_before_both() -> None:
    lines = PLANE.splitlines()
    graph, values, _ = read("FIX 2\n" + "\n".join(lines[4:] + lines[:4]))
    same((graph, values, LoadReport("", "", "", "")), (*read(PLANE + "FIX 2\n")[:2], LoadReport("", "", "", "")))


def test_several_ids_per_fix() -> None:
    graph, values, _ = read(PLANE + "FIX 0 3 1\nFIX 3\n")
    assert graph.linearize(values).cols == ["x2: x", "x2: y", "x2: yaw"]
    result = graph.optimize(values)
    assert np.array_equal(result.values[x[[0, 1, 3]]], values[x[[0, 1, 3]]])


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_without_vertices_the_poses_are_chained(text: str) -> None:
    edges = "\n".join(line for line in text.splitlines() if line.startswith("EDGE"))
    graph, values, report = read(edges)
    group = values.stacks["x"].manifold
    n = 4 if group is SE2 else 3
    assert not report.vertices_given
    assert report.notes == [f"no vertices in the file: {n} poses chained along the edges"]
    X = group.identity(1)
    for k in range(n - 1):
        X = np.concatenate([X, group.compose(X[-1:], np.asarray(graph.factors[0].z)[k : k + 1])])  # type: ignore[attr-defined]
    assert distance(group, X, values[x]) < 1e-12  # type: ignore[arg-type]


def test_vertices_alone() -> None:
    graph, values, _ = read(TWO)
    assert len(graph) == 0
    with pytest.raises(GraphError, match="nothing to optimize"):
        graph.optimize(values)


@pytest.mark.parametrize("change", [lambda t: t.replace("\n", "\r\n"), lambda t: t.replace(" ", "\t"), str.rstrip])
def test_line_ends_and_tabs(change: object) -> None:
    same(read(PLANE), read(change(PLANE)))  # type: ignore[operator]


def test_zero_information_is_legal(tmp_path: Path) -> None:
    loaded = read(TWO + E2 + "\nEDGE_SE2 0 1 5 5 5 0 0 0 0 0 0\nEDGE_SE2 0 1 1.5 0 0 4 0 0 0 0 0\n")
    same(loaded, again(loaded, tmp_path))
    result = loaded[0].optimize(loaded[1])
    assert result.values[x[1]] == pytest.approx([1.0 + 4 * 0.5 / (504 - 0.0), 0.0, 0.0], abs=2e-3)


# ---- conventions


def information(convention: str, text: str = SPACE) -> np.ndarray:
    noise = read(text, convention)[0].factors[0].noise
    assert isinstance(noise, Information)
    return noise.matrix


def test_the_upper_triangle_row_by_row() -> None:
    assert information("g2o", PLANE)[0].tolist() == [[500, 1, 2], [1, 400, 3], [2, 3, 300]]
    M = information("g2o")[0]
    assert M[0].tolist() == [100, 1, 2, 3, 4, 5]
    assert M[1, 1:].tolist() == [200, 6, 7, 8, 9]
    assert (M == M.T).all()


def test_only_log_converts_and_only_in_space() -> None:
    verbatim = information("g2o")
    for convention in ("graphslam", "gtsam"):
        assert np.array_equal(information(convention), verbatim)
    half = np.array([1, 1, 1, 2, 2, 2])
    assert np.array_equal(information("log"), verbatim / (half[:, None] * half))
    for convention in CONVENTIONS:
        assert np.array_equal(information(convention, PLANE), information("g2o", PLANE))


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_chi2_agrees_to_first_order(text: str) -> None:
    """At poses that almost meet the measurements g2o, graphslam and log agree, gtsam is tighter in space."""
    graph, values, _ = read(text)
    group, z = values.stacks["x"].manifold, np.asarray(graph.factors[0].z)  # type: ignore[attr-defined]
    graph.remove(graph.factors[0])
    chi2 = {}
    for convention in CONVENTIONS:
        edges = read(text, convention)[0].factors[0]
        i, j = (keys.numbers for keys in edges.keys)
        chain = j - i == 1
        X = [group.identity(1)]
        for k in np.flatnonzero(chain):
            delta = 1e-5 * np.random.default_rng(k).normal(size=(1, group.dim))
            X.append(group.compose(group.compose(X[-1], z[k : k + 1]), group.exp(delta)))  # type: ignore[attr-defined]
        near = Values({x: (group, np.concatenate(X))})
        one = Between(
            edges.keys[0][chain], edges.keys[1][chain], z[chain], Information(edges.noise.matrix[chain]), convention
        )  # type: ignore[attr-defined]
        chi2[convention] = FactorGraph([one]).chi2(near)
    assert chi2["graphslam"] == pytest.approx(chi2["g2o"], rel=1e-3)
    assert chi2["log"] == pytest.approx(chi2["g2o"], rel=1e-3)
    if group is SE2:
        assert chi2["gtsam"] == chi2["log"]
    else:
        assert 1.5 * chi2["g2o"] < chi2["gtsam"] < 4.1 * chi2["g2o"]


def test_ignored_vertices_are_not_said_to_be_missing() -> None:
    text = TWO + "VERTEX_SWITCH 5 1\n"
    with pytest.raises(GraphFileError, match="no VERTEX_SE2 line has"):
        read(text + "FIX 5\n")
    with pytest.raises(GraphFileError, match="no VERTEX_SE2 line has"):
        read(text + f"EDGE_SE2 0 5 1 0 0 {INFORMATION_2}\n")


@pytest.mark.parametrize(("w", "warned"), [("0.99998", True), ("1.0005", True), ("0.999995", False), ("1", False)])
def test_rounded_quaternions_are_kept_with_a_warning(w: str, warned: bool, tmp_path: Path) -> None:
    text = f"{V3} 0 {Q}\n{V3} 1 0 0 0 0 0 0 {w}\n# c\nEDGE_SE3:QUAT 0 1 0 0 0 0 0 0 {w} {UPPER_3}\n"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        graph, values, report = load(write(tmp_path, text))
    notes = [note for note in report.notes if "length" in note]
    assert [str(c.message) for c in caught] == [f"{tmp_path / 'graph.g2o'}: {note}" for note in notes]
    assert len(caught) == warned
    if warned:
        assert "the length of 2 quaternions is off by more than 1e-05, first on line 2" in report.notes[-1]
    assert values[x[1]][-1] == graph.factors[0].z[0, -1] == float(w)  # type: ignore[attr-defined]


def test_many_unknown_tags_are_a_short_warning() -> None:
    _, _, report = read(TWO + "\n".join(f"T{k}" for k in range(100)))
    assert re.search(r"T8 \(1, first on line 11\) and 91 more tags", report.warnings[0])
    assert len(report.warnings[0]) < 500
    assert len(report.ignored) == 100


@pytest.mark.parametrize(
    "line", ["{k}.5,{k},7", "{k} 1 2", "T 1,2", "word-{k}-word-{k}-word-{k}-word-{k}-word-{k}-word-{k}-{k}"]
)
def test_a_large_table_is_refused_at_once(line: str) -> None:
    data = "\n".join(line.format(k=100_000 + k) for k in range(100_000)).encode()
    started = process_time()
    with pytest.raises(GraphFileError, match="is no graph"):
        read_graph(data, "f.csv")
    _, _, report = read_graph(TWO.encode() + data, "f.csv")
    assert process_time() - started < 4
    assert "unknown tags" in report.warnings[0]
    assert len(report.ignored) == 100_000


def test_neighbors_of_extreme_ids() -> None:
    low, high = -(2**63), 2**63 - 1
    edges = [(low, high), (high, low), (low, low + 1), (high, high - 1), (high, 0), (0, low)]
    graph, values, _ = read("\n".join(f"EDGE_SE2 {i} {j} 1 0 0 {INFORMATION_2}" for i, j in edges))
    assert _closures(graph, values)[1] == 4
