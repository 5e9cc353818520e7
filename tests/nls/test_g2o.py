"""g2o files: read, written and read again the same to the bit; whatever is wrong in one has its line."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from factors import Between, Diagonal, Information, Isotropic, Prior
from models import SE2, SE3, R
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
    save,
)
from nls.io.g2o import read_g2o
from tests.nls.g2o_files import INFORMATION_2, PLANE, SPACE, UPPER_3, write
from tests.nls.graphs import distance, pose_graph

x, l = kinds("x", "l")
CONVENTIONS = ("g2o", "graphslam", "log", "gtsam")
Loaded = tuple[FactorGraph, Values, LoadReport]


def read(text: str, convention: str = "g2o") -> Loaded:
    return read_g2o(text.encode(), "f.g2o", convention)


def same(one: Loaded, other: Loaded) -> None:
    """Two graphs equal to the bit: poses, ids, edges in order, measurements, information, what is fixed, kept text."""
    a, b = one[1].stacks["x"], other[1].stacks["x"]
    assert a.manifold is b.manifold
    assert np.array_equal(a.numbers, b.numbers)
    assert a.X.tobytes("C") == b.X.tobytes("C")
    assert len(one[0].factors) == len(other[0].factors)
    for f, g in zip(one[0].factors, other[0].factors, strict=True):
        assert isinstance(f, Between)
        assert isinstance(g, Between)
        assert all(np.array_equal(i.numbers, j.numbers) for i, j in zip(f.keys, g.keys, strict=True))
        assert np.asarray(f.z).tobytes("C") == np.asarray(g.z).tobytes("C")
        assert isinstance(f.noise, Information)
        assert isinstance(g.noise, Information)
        assert f.noise.matrix.tobytes("C") == g.noise.matrix.tobytes("C")
        assert f.convention == g.convention
    fixed = [sorted(n for keys in graph.fixed for n in keys.numbers.tolist()) for graph, _, _ in (one, other)]
    assert fixed[0] == fixed[1]
    assert one[2].ignored == other[2].ignored


def again(loaded: Loaded, folder: Path, convention: str = "g2o") -> Loaded:
    save(folder / "again.g2o", loaded[0], loaded[1], loaded[2].ignored)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)
        return load(folder / "again.g2o", convention)


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
        GraphWarning, match="PARAMS_SE2OFFSET .1, first on line 8.*EDGE_WHATEVER .1, first on line 11"
    ) as caught:
        loaded = load(write(tmp_path, text))
    assert [Path(w.filename).name for w in caught] == ["test_g2o.py"]  # it points at the line that called load
    graph, values, report = loaded
    assert values.stacks["x"].numbers.tolist() == [900, 2**63 - 1, -4, 7]
    assert graph.factors[0].keys[0].numbers.tolist() == [900, 7]
    assert sorted(n for keys in graph.fixed for n in keys.numbers.tolist()) == [-4, 7, 900]
    assert report.ignored == ["PARAMS_SE2OFFSET 0 0 0 0", "EDGE_WHATEVER ünïcode 1 2   three"]
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
    "no tag of ours": ("hello world\n", 1, "'hello' is no tag of a pose graph; expected"),
    "only FIX": ("FIX 0\n", 1, "'FIX' is no tag of a pose graph"),
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
        "the edge needs vertex 9, which is not in",
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
    "FIX unknown": (TWO + E2 + "\nFIX 0 5\n", 4, "FIX names x5, which is not in the file"),
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
        assert caught.value.text == text.splitlines()[line - 1].strip()[:80]


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


# ---- writing


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
@pytest.mark.parametrize(
    "noise", [Isotropic(0.3), Diagonal([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])], ids=["isotropic", "diagonal"]
)
def test_graphs_made_in_python_are_written(group: object, noise: object, tmp_path: Path) -> None:
    sample = pose_graph(group, anchored=False)  # type: ignore[arg-type]
    if isinstance(noise, Diagonal):
        noise = Diagonal(noise.sigmas[:, : group.dim])  # type: ignore[attr-defined, index]
    edge = sample.graph.factors[0]
    graph = FactorGraph([Between(*edge.keys, edge.z, noise), sample.graph.factors[1]])  # type: ignore[arg-type]
    graph.fix(x[2])
    save(tmp_path / "out.g2o", graph, sample.values)
    read_back, values, _ = load(tmp_path / "out.g2o", "log")
    assert np.array_equal(values[x], sample.values[x])
    assert read_back.chi2(values) == pytest.approx(graph.chi2(sample.values), rel=1e-12)
    assert [repr(keys) for keys in read_back.fixed] == ["x2"]


def test_what_the_format_cannot_hold(tmp_path: Path) -> None:
    sample = pose_graph(SE2)
    with pytest.raises(GraphError, match=r"Prior\(x2\) cannot be written to a g2o file"):
        save(tmp_path / "out.g2o", sample.graph, sample.values)
    edges = FactorGraph(sample.graph.factors[:-1])
    with pytest.raises(GraphError, match="poses of kind x"):
        save(tmp_path / "out.g2o", edges, Values({l: (SE2, SE2.identity(2))}))
    with pytest.raises(GraphError, match=r"these are in R\(2\)"):
        save(tmp_path / "out.g2o", FactorGraph(), Values({x: (R(2), [[0.0, 0.0]])}))
    assert list(tmp_path.iterdir()) == []
    graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1))])
    with pytest.raises(GraphError, match="cannot be written"):
        save(tmp_path / "out.g2o", graph, sample.values)


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, "what was there before", "out.g2o")
    graph, values, _ = read(PLANE)

    def failing(*_: object) -> None:
        raise OSError("disk full")

    with monkeypatch.context() as patched:
        patched.setattr("os.replace", failing)
        with pytest.raises(OSError, match="disk full"):
            save(path, graph, values)
    assert path.read_text() == "what was there before"
    assert list(tmp_path.iterdir()) == [path]
    save(path, graph, values)
    assert list(tmp_path.iterdir()) == [path]
    same(read(PLANE), load(path))


def test_every_public_pose_graph_goes_round(data: Path, tmp_path: Path) -> None:
    files = sorted(
        f for folder in ("pose-graphs-2d", "pose-graphs-3d", "robust-real") for f in (data / folder).glob("*.g2o*")
    )
    assert len(files) >= 15
    for file in files:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GraphWarning)
            loaded = load(file)
        same(loaded, again(loaded, tmp_path))
