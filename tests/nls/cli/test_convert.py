"""``nls convert`` and ``nls plot``: every format by its suffix, and what a format has no place for."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import nls
from models import SE2
from nls.cli import main
from nls.io.kind_names import with_known_kinds
from nls.io.trajectory import lifted, read_kitti, read_tum, write_tum
from tests.nls.io.g2o_files import PLANE, SPACE, write
from tests.nls.io.io_files import FILES, ISAM_APART_2, TORO_2

Captured = pytest.CaptureFixture[str]
PYFG = """VERTEX_SE2 5.5 A0 1 2 0.1
VERTEX_SE2 4.5 A1 2 2.5 0.2
VERTEX_XY L3 4 6
EDGE_SE2 5.5 A0 A1 1 0.4 0.1 0.01 0 0 0.02 0 0.03
EDGE_RANGE 5.5 A0 L3 5.1 0.04
"""
BAL = "1 1 1\n0 0 10.5 -3\n0 0 0 0 0 0 500 0 0\n0.1 0.2 -5\n"


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
@pytest.mark.parametrize("name", ["out.g2o", "out.g2o.gz", "out.toro", "out.pyfg", "out.pyfg.gz"])
@pytest.mark.parametrize("convention", ["g2o", "log"])
def test_a_graph_has_the_same_chi2_in_every_format(
    text: str, name: str, convention: str, tmp_path: Path, capsys: Captured
) -> None:
    file, out = write(tmp_path, text), tmp_path / name
    assert main(["convert", str(file), str(out), "--convention", convention]) == 0
    assert f"written     {out}" in capsys.readouterr().out
    graph, values, _ = nls.load(file, convention)
    dialect = "toro" if "toro" in name else "auto"
    again, found, _ = nls.load(out, convention, dialect)
    assert found[nls.Kind("x")] == pytest.approx(values[nls.Kind("x")], abs=1e-12)
    assert again.chi2(found) == pytest.approx(graph.chi2(values), rel=1e-9)


def test_a_name_may_say_anything_when_the_format_is_named(tmp_path: Path) -> None:
    file, out = write(tmp_path, PLANE), tmp_path / "out.data"
    assert main(["convert", str(file), str(out), "--to", "tum"]) == 0
    assert len(read_tum(out)[0]) == 4


def test_trajectories_of_graphs(tmp_path: Path, capsys: Captured) -> None:
    file = write(tmp_path, PLANE)
    values = nls.load(file)[1]
    assert main(["convert", str(file), str(tmp_path / "a.tum")]) == 0
    out = capsys.readouterr().out
    assert "note        the file has no times: the numbers of the poses stand for them" in out
    assert "note        a trajectory file holds no measurements: 4 measurements left out" in out
    times, X = read_tum(tmp_path / "a.tum")
    assert times.tolist() == [0, 1, 2, 3]
    assert np.array_equal(X, lifted(values[nls.Kind("x")]))
    assert main(["convert", str(file), str(tmp_path / "a.kitti")]) == 0
    assert read_kitti(tmp_path / "a.kitti")[:, :3] == pytest.approx(X[:, :3])


def test_a_trajectory_takes_the_times_of_its_file(tmp_path: Path, capsys: Captured) -> None:
    assert main(["convert", str(write(tmp_path, PYFG, "a.pyfg")), str(tmp_path / "a.tum")]) == 0
    assert (
        "note        a trajectory file holds poses only: 1 variable of other kinds left out" in capsys.readouterr().out
    )
    times, X = read_tum(tmp_path / "a.tum")
    assert times.tolist() == [4.5, 5.5]
    assert X[:, :2].tolist() == [[2, 2.5], [1, 2]]


def test_times_and_unknown_lines_stay(tmp_path: Path) -> None:
    file = write(tmp_path, PYFG + "EDGE_BEARING 1 A0 L3 2\n", "a.pyfg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        assert main(["convert", str(file), str(tmp_path / "b.pyfg")]) == 0
    lines = (tmp_path / "b.pyfg").read_text().splitlines()
    assert lines[0] == "VERTEX_SE2 5.5 A0 1.0 2.0 0.1"
    assert lines[-2:] == ["EDGE_RANGE 5.5 A0 L3 5.1 0.04", "EDGE_BEARING 1 A0 L3 2"]


def test_a_trajectory_is_a_graph_without_measurements(tmp_path: Path, capsys: Captured) -> None:
    X = SE2.exp(np.random.default_rng(0).normal(size=(3, 3)))
    write_tum(tmp_path / "a.tum", [1, 2, 4], X)
    assert main(["convert", str(tmp_path / "a.tum"), str(tmp_path / "a.g2o")]) == 0
    found = nls.load(tmp_path / "a.g2o")[1][nls.Kind("x")]
    assert np.array_equal(found, lifted(X))
    capsys.readouterr()
    assert main(["solve", str(tmp_path / "a.tum")]) == 2
    assert "a.tum: has no measurement: nothing to optimize" in capsys.readouterr().err


def test_bundle_adjustment(tmp_path: Path) -> None:
    file = write(tmp_path, BAL, "a.txt")
    assert main(["convert", str(file), str(tmp_path / "b.bal")]) == 0
    assert (tmp_path / "b.bal").read_text().split() == [
        word if k < 5 else repr(float(word)) for k, word in enumerate(BAL.split())
    ]


@pytest.mark.parametrize(
    ("text", "out", "message"),
    [
        (PLANE, "out.bal", r"Between\(.*cannot be written to a bundle-adjustment file"),
        (PLANE + "FIX 1\n", "out.pyfg", "x1 is held fixed, which a PyFactorGraph file has no line for"),
        (BAL, "out.g2o", "out.g2o: "),
        (BAL, "out.pyfg", "variables c in .wx.* have no line in a PyFactorGraph file"),
        (BAL, "out.tum", "a trajectory file holds the poses of one kind, this graph has none"),
        (PYFG.replace("A1", "B1"), "out.tum", "poses of one kind, this graph has A, B"),
        (PYFG, "out.kity", "expected a name ending in .g2o, .toro, .isam, .pyfg, .bal, .tum, .kitti, or --to FORMAT"),
        (PYFG, "nowhere/out.tum", "expected a file in a folder that exists"),
        ("", "out.tum", "in:1: is empty"),
        ("0 1 2 3 0 0 0 2\n", "out.g2o", "is no graph"),
    ],
)
def test_what_cannot_be_converted(text: str, out: str, message: str, tmp_path: Path, capsys: Captured) -> None:
    file = write(tmp_path, text, "in")
    assert main(["convert", str(file), str(tmp_path / out)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "internal error" not in said.err
    assert re.search(message, said.err)
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("name", ["out.png", "out.pdf", "out.svg"])
def test_pictures(name: str, tmp_path: Path, capsys: Captured) -> None:
    begins = {"out.png": b"\x89PNG", "out.pdf": b"%PDF", "out.svg": b"<?xml"}
    for text in (PLANE, SPACE, PYFG):
        out = tmp_path / name
        assert main(["plot", str(write(tmp_path, text)), str(out)]) == 0
        assert capsys.readouterr().out == f"written     {out}\n"
        assert out.read_bytes().startswith(begins[name])
        assert out.stat().st_size > 5_000
        out.unlink()


def test_no_picture(tmp_path: Path, capsys: Captured) -> None:
    assert main(["plot", str(write(tmp_path, PLANE)), str(tmp_path / "out.xyz")]) == 2
    assert "expected a file name ending in .png, .pdf, .svg" in capsys.readouterr().err
    assert main(["plot", str(tmp_path / "none.g2o"), str(tmp_path / "out.png")]) == 2
    assert "none.g2o: cannot be read" in capsys.readouterr().err


# ---- times, names and lines that are not used, from one format to another


def test_times_of_a_trajectory_stay(tmp_path: Path, capsys: Captured) -> None:
    X = SE2.exp(np.random.default_rng(0).normal(size=(3, 3)))
    write_tum(tmp_path / "a.tum", [1.7e9, 1.7e9 + 0.25, 1.7e9 + 1], X)
    (tmp_path / "a.tum").write_bytes(b"# one\n# two\n" + (tmp_path / "a.tum").read_bytes())
    for name in ("b.tum", "c.pyfg", "d.kitti"):
        assert main(["convert", str(tmp_path / "a.tum"), str(tmp_path / name)]) == 0
        out = capsys.readouterr().out
        assert "note        2 comment lines" in out
        assert "has no times" not in out
        assert ("note        a kitti file holds no times" in out) == (name == "d.kitti")
    assert (tmp_path / "b.tum").read_bytes() == (tmp_path / "a.tum").read_bytes().split(b"\n", 2)[2]
    times = [line.split()[1] for line in (tmp_path / "c.pyfg").read_text().splitlines()]
    assert times == ["1700000000.0", "1700000000.25", "1700000001.0"]
    assert main(["convert", str(tmp_path / "c.pyfg"), str(tmp_path / "e.tum")]) == 0
    assert (tmp_path / "e.tum").read_bytes() == (tmp_path / "b.tum").read_bytes()


@pytest.mark.parametrize(
    ("text", "name", "out", "tags", "edges"),
    [
        (TORO_2 + "FIX 1\n", "a.toro", "b.g2o", "FIX (1)", 3),
        (TORO_2 + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", "a.toro", "b.g2o", "EDGE_SE2 (1)", 3),
        (PLANE + "EDGE_RANGE 0 5 1.4 100\nEDGE_RANGE 1 5 2 100\nX\n", "a.g2o", "b.pyfg", "EDGE_RANGE (2), X (1)", 4),
        (PLANE + "EDGE2 0 1 1 0 0 1 0 1 1 0 0\n", "a.g2o", "b.toro", "EDGE2 (1)", 4),
        (PLANE + "EDGE_RANGE 0 5 1.4 100\n", "a.g2o", "b.tum", "EDGE_RANGE (1)", 0),
    ],
)
def test_unused_lines_do_not_come_to_life(
    text: str, name: str, out: str, tags: str, edges: int, tmp_path: Path, capsys: Captured
) -> None:
    """A line means nothing to the dialect it was in; to another it may."""
    file, dialect = write(tmp_path, text, name), name.split(".")[1]
    count = tags.count("(1)") + 2 * tags.count("(2)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        assert main(["convert", str(file), str(tmp_path / out), "--dialect", dialect]) == 0
    lines, them = (
        ("1 line that was not used is", "it") if count == 1 else (f"{count} lines that were not used are", "them")
    )
    said = f"{lines} left out, only a {dialect} file gets {them} back: {tags}"
    printed = capsys.readouterr().out
    assert f"note        {said}" in printed
    assert "kept" not in printed
    if out == "b.tum":
        return
    graph, _, report = nls.load(tmp_path / out)
    assert (len(graph), report.ignored) == (edges, [])
    assert sum(map(len, graph.fixed)) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        loaded = nls.load(file, dialect=dialect)
    with pytest.warns(nls.GraphWarning, match=re.escape(f"c.out: {said}")) as caught:
        nls.save(tmp_path / "c.out", *loaded, out.split(".")[1])
    assert [warning.filename for warning in caught] == [__file__]
    assert (tmp_path / "c.out").read_bytes() == (tmp_path / out).read_bytes()
    nls.save(tmp_path / "d.out", *loaded, dialect)  # to its own it comes back, without a word
    assert (tmp_path / "d.out").read_text().endswith("\n".join([*loaded[2].ignored, ""]))


NAMED = """VERTEX_SE2 0 A0 0 0 0
VERTEX_SE2 1 A1 1 0.1 0.1
VERTEX_SE2 2 A2 2 0 0.2
VERTEX_XY L1 1 2
VERTEX_XY L7 3 2
VERTEX_SE2:PRIOR 0 A0 0.01 0.02 0 0.01 0 0 0.01 0 0.01
EDGE_SE2 1 A0 A1 1 0 0.1 0.01 0 0 0.02 0 0.03
EDGE_SE2 1 A1 A2 1 0 0.1 0.01 0 0 0.02 0 0.03
EDGE_SE2_XY 1 A1 L1 0.3 1.9 0.1 0.02 0.2
EDGE_SE2_XY 1 A2 L7 1.3 1.9 0.1 0.02 0.2
"""


def test_kinds_of_other_names_become_x_and_l(tmp_path: Path, capsys: Captured) -> None:
    """Only the point whose number a pose has, too, gets another."""
    file = write(tmp_path, NAMED, "a.pyfg")
    assert main(["convert", str(file), str(tmp_path / "b.g2o")]) == 0
    said = "poses A are written as x, points L as l; 1 of the points had the number of a pose: they are numbered from 8"
    assert f"note        {said}" in capsys.readouterr().out
    (graph, values, _), (found, again, _) = nls.load(file), nls.load(tmp_path / "b.g2o")
    assert {kind: stack.numbers.tolist() for kind, stack in again.stacks.items()} == {"x": [0, 1, 2], "l": [8, 7]}
    assert [repr(factor) for factor in found.factors if "Landmark" in repr(factor)] == ["Landmark(x[1, 2], l[8, 7])"]
    assert found.chi2(again) == pytest.approx(graph.chi2(values), rel=1e-12)
    named, moved, _ = with_known_kinds(graph, values)  # bound before, under the old names
    assert all(moved.gather(factor)[0].factor is factor for factor in named.factors)
    optimum, other = (g.optimize(v) for g, v in ((graph, values), (found, again)))
    assert other.chi2_final == pytest.approx(optimum.chi2_final, rel=1e-9)
    assert other.values[nls.Kind("l")] == pytest.approx(optimum.values[nls.Kind("L")], abs=1e-9)
    assert main(["convert", str(write(tmp_path, NAMED.replace("L1", "L9"), "c.pyfg")), str(tmp_path / "c.toro")]) == 2
    assert "poses A are written as x, points L as l\n" in capsys.readouterr().err


def test_points_numbered_apart_go_to_g2o_and_back(tmp_path: Path, capsys: Captured) -> None:
    """A g2o file gets new numbers for points of iSAM, an iSAM file keeps those of any graph."""
    file = write(tmp_path, ISAM_APART_2, "a.isam")
    assert main(["convert", str(file), str(tmp_path / "b.g2o")]) == 0
    assert "note        2 of the points had the number of a pose: they are numbered from 3" in capsys.readouterr().out
    (graph, values, _), (other, moved, _) = nls.load(file), nls.load(tmp_path / "b.g2o")
    assert moved.stacks["l"].numbers.tolist() == [3, 4]
    assert other.chi2(moved) == graph.chi2(values) > 0
    text = "".join(line + "\n" for line in NAMED.splitlines() if ":PRIOR" not in line)
    named = str(write(tmp_path, text, "c.pyfg"))
    with pytest.warns(nls.GraphWarning, match="the values of 5 variables are not in it"):
        nls.save(tmp_path / "d.isam", *with_known_kinds(*nls.load(named)[:2], apart=True)[:2])
    assert main(["convert", named, str(tmp_path / "e.isam")]) == 0
    assert (tmp_path / "d.isam").read_text() == (tmp_path / "e.isam").read_text()
    assert [line.split()[:3] for line in (tmp_path / "e.isam").read_text().splitlines()] == [
        ["EDGE2", "0", "1"],
        ["EDGE2", "1", "2"],
        ["LANDMARK", "1", "1"],
        ["LANDMARK", "2", "7"],
    ]


def test_landmarks_of_space_go_to_g2o_and_back(tmp_path: Path, capsys: Captured) -> None:
    """A g2o file names an offset for each; where it is none, other formats need no place for it."""
    dialect, text = FILES["isam, space"]
    largest = text.replace("POINT3 1 10", f"POINT3 1 {2**63 - 1}").replace("POINT3 2 10", "POINT3 2 1")
    for k, source in enumerate((text, largest)):
        first, middle = write(tmp_path, source, f"a{k}.isam"), tmp_path / f"b{k}.g2o"
        graph, values, _ = nls.load(first, dialect=dialect)
        assert main(["convert", str(first), str(middle)]) == 0
        for name in ("c.isam", "d.pyfg")[: 2 - k]:
            last = tmp_path / name
            assert main(["convert", str(middle), str(last)]) == 0
            again, moved, _ = nls.load(last)
            assert len(again) == len(graph)
            assert again.chi2(moved) == pytest.approx(graph.chi2(values), rel=1e-9)
    assert nls.load(middle)[1].stacks["l"].numbers.tolist() == [3, 2**63 - 1]
    capsys.readouterr()
    assert main(["convert", str(middle), str(tmp_path / "d.pyfg")]) == 2
    assert (
        "l9223372036854775807 is no name of a PyFactorGraph file, the number has more than" in capsys.readouterr().err
    )
    offset = middle.read_text().replace("OFFSET 0 0 0 0", "OFFSET 0 0.5 0 0")
    assert main(["convert", str(write(tmp_path, offset, "e.g2o")), str(tmp_path / "f.isam")]) == 2
    assert (
        "cannot be written to an isam file: its sensor is not at the origin of the vehicle" in capsys.readouterr().err
    )


def test_more_kinds_of_poses_are_refused_with_a_cure(tmp_path: Path, capsys: Captured) -> None:
    assert main(["convert", str(write(tmp_path, NAMED.replace("A2", "B2"), "a.pyfg")), str(tmp_path / "b.g2o")]) == 2
    assert "build the graph with these kinds, or let `nls convert` rename them, which takes one kind of poses" in (
        capsys.readouterr().err
    )
    graph, values, report = nls.load(write(tmp_path, NAMED, "a.pyfg"))
    with pytest.raises(nls.GraphError, match=r"variables A in SE2 have no line in a g2o file, .* rename them"):
        nls.save(tmp_path / "b.g2o", graph, values, report)
