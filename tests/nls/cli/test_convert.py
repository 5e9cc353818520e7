"""``nls convert`` and ``nls plot``: every format by its suffix, and what a format has no place for."""

from __future__ import annotations

import re

import numpy as np
import pytest

import nls
from models import SE2
from nls.io.trajectory import lifted, read_kitti, read_tum, write_tum
from nls.io.variable_names import with_known_kinds
from tests.nls.cli.shell import Shell
from tests.nls.io.g2o_files import PLANE, SPACE
from tests.nls.io.io_files import FILES, ISAM_APART_2, TORO_2

PYFG = """VERTEX_SE2 5.5 A0 1 2 0.1
VERTEX_SE2 4.5 A1 2 2.5 0.2
VERTEX_XY L3 4 6
EDGE_SE2 5.5 A0 A1 1 0.4 0.1 0.01 0 0 0.02 0 0.03
EDGE_RANGE 5.5 A0 L3 5.1 0.04
"""


def test_trajectories_of_graphs(shell: Shell) -> None:
    values = nls.load(shell.file())[1]
    out = shell("convert graph.g2o a.tum")
    assert "note        the file has no times: the numbers of the poses stand for them" in out
    assert "note        a trajectory file holds no measurements: 4 measurements left out" in out
    times, X = read_tum(shell / "a.tum")
    assert times.tolist() == [0, 1, 2, 3]
    assert np.array_equal(X, lifted(values[nls.Kind("x")]))
    shell("convert graph.g2o out.data --to kitti")  # a name may say anything when the format is named
    assert read_kitti(shell / "out.data")[:, :3] == pytest.approx(X[:, :3])
    out = shell(f"convert {shell.file(PYFG, 'a.pyfg')} a.tum")
    assert "note        a trajectory file holds poses only: 1 variable of other kinds left out" in out
    times, X = read_tum(shell / "a.tum")
    assert times.tolist() == [4.5, 5.5]
    assert X[:, :2].tolist() == [[2, 2.5], [1, 2]]


def test_a_trajectory_is_a_graph_without_measurements(shell: Shell) -> None:
    """Times and poses stay, comments do not."""
    X = SE2.exp(np.random.default_rng(0).normal(size=(3, 3)))
    write_tum(shell / "a.tum", [1.7e9, 1.7e9 + 0.25, 1.7e9 + 1], X)
    body = (shell / "a.tum").read_bytes()
    shell.file(b"# one\n# two\n" + body, "a.tum")
    for name in ("b.tum", "c.pyfg", "d.kitti", "e.g2o"):
        out = shell(f"convert a.tum {name}")
        assert "note        2 comment lines" in out
        assert "has no times" not in out
        assert ("note        a kitti file holds no times" in out) == (name == "d.kitti")
    assert (shell / "b.tum").read_bytes() == body
    assert np.array_equal(nls.load("e.g2o")[1][nls.Kind("x")], lifted(X))
    times = [line.split()[1] for line in (shell / "c.pyfg").read_text().splitlines()]
    assert times == ["1700000000.0", "1700000000.25", "1700000001.0"]
    shell("convert c.pyfg f.tum")
    assert (shell / "f.tum").read_bytes() == body


def test_pictures(shell: Shell) -> None:
    for text, name, begin in ((PLANE, "a.png", b"\x89PNG"), (SPACE, "a.pdf", b"%PDF"), (PYFG, "a.svg", b"<?xml")):
        assert shell(f"plot {shell.file(text)} {name}") == f"written     {name}\n"
        picture = (shell / name).read_bytes()
        assert picture.startswith(begin)
        assert len(picture) > 5_000


# ---- names and lines that are not used, from one format to another


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
@pytest.mark.parametrize(
    ("text", "dialect", "form", "tags", "edges"),
    [
        (TORO_2 + "FIX 1\n", "toro", "g2o", "FIX (1)", 3),
        (PLANE + "EDGE_RANGE 0 5 1.4 100\nEDGE_RANGE 1 5 2 100\nX\n", "g2o", "pyfg", "EDGE_RANGE (2), X (1)", 4),
        (PLANE + "EDGE2 0 1 1 0 0 1 0 1 1 0 0\n", "g2o", "toro", "EDGE2 (1)", 4),
    ],
)
def test_unused_lines_do_not_come_to_life(
    text: str, dialect: str, form: str, tags: str, edges: int, shell: Shell
) -> None:
    """A line means nothing to the dialect it was in; to another it may."""
    ignored = tags.split(" (")[0] if tags.startswith("EDGE") else ""
    option = f"--ignore-tags {ignored}" if ignored else ""
    out, _ = shell.both(f"convert {shell.file(text, 'a')} b.{form} --dialect {dialect} {option}")
    (said,) = (line.removeprefix("note").strip() for line in out.splitlines() if "not used" in line)
    count = {"EDGE_RANGE (2), X (1)": 3}.get(tags, 1)
    assert said.startswith(f"{count} line")
    assert said.endswith(f", only a {dialect} file gets {'it' if count == 1 else 'them'} back: {tags}")
    graph, _, report = nls.load(f"b.{form}")
    assert (len(graph), report.ignored, sum(map(len, graph.fixed))) == (edges, [], 0)
    loaded = nls.load("a", dialect=dialect, ignore_tags=ignored)
    with pytest.warns(nls.GraphWarning, match=re.escape(f"c.out: {said}")) as caught:
        nls.save("c.out", *loaded, form)
    assert [warning.filename for warning in caught] == [__file__]
    assert (shell / "c.out").read_bytes() == (shell / f"b.{form}").read_bytes()


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


def test_kinds_of_other_names_become_x_and_l(shell: Shell) -> None:
    """Only the point whose number a pose has, too, gets another."""
    out = shell(f"convert {shell.file(NAMED, 'a.pyfg')} b.g2o --renumber")
    assert "note        poses A are written as x, points L as l\n" in out
    assert "note        1 variable has a new number: l8 was L1\n" in out
    (graph, values, _), (other, again, _) = nls.load("a.pyfg"), nls.load("b.g2o")
    assert {kind: stack.numbers.tolist() for kind, stack in again.stacks.items()} == {"x": [0, 1, 2], "l": [8, 7]}
    assert [repr(factor) for factor in other.factors if "Landmark" in repr(factor)] == ["Landmark(x[1, 2], l[8, 7])"]
    assert other.chi2(again) == pytest.approx(graph.chi2(values), rel=1e-12)
    named, moved, _ = with_known_kinds(graph, values)  # bound before, under the old names
    assert all(moved.gather(factor)[0].factor is factor for factor in named.factors)
    err = shell.refused(f"convert {shell.file(NAMED.replace('L1', 'L9'), 'c.pyfg')} c.toro")
    assert err.splitlines()[0].endswith("; poses A are written as x, points L as l")
    graph, values, _ = nls.load("a.pyfg")
    words = nls.Values({"track": (SE2, values.stack("A").X), "L": (values.stack("L").manifold, values.stack("L").X)})
    with pytest.raises(nls.GraphError, match=r"variables track in SE2 have no line in a g2o file, .* rename one kind"):
        nls.save("b.g2o", nls.FactorGraph(), words)
    nls.save("track.npz", nls.FactorGraph(), words)
    shell("convert track.npz b.g2o --renumber")  # the cure that it names


def test_points_numbered_apart_go_to_g2o_and_back(shell: Shell) -> None:
    """A g2o file gets new numbers for points of iSAM, an iSAM file keeps those of any graph."""
    assert "x0 and l0 have one number" in shell.refused(f"convert {shell.file(ISAM_APART_2, 'a.isam')} b.g2o")
    assert "note        2 variables have new numbers: l3 to l4 were l0 to l1\n" in shell(
        "convert a.isam b.g2o --renumber"
    )
    (graph, values, _), (other, moved, _) = nls.load("a.isam"), nls.load("b.g2o")
    assert moved.stacks["l"].numbers.tolist() == [3, 4]
    assert other.chi2(moved) == graph.chi2(values) > 0


def test_landmarks_of_space_go_to_g2o_and_back(shell: Shell) -> None:
    """A g2o file names an offset for each; where it is none, other formats need no place for it."""
    dialect, text = FILES["isam, space"]
    largest = text.replace("POINT3 1 10", f"POINT3 1 {2**63 - 1}").replace("POINT3 2 10", "POINT3 2 1")
    for source, names in ((text, ("c.isam", "d.pyfg")), (largest, ("c.isam",))):
        graph, values, _ = nls.load(shell.file(source, "a.isam"), dialect=dialect)
        shell("convert a.isam b.g2o --renumber")
        for name in names:
            shell(f"convert b.g2o {name}")
            again, moved, _ = nls.load(name)
            assert len(again) == len(graph)
            assert again.chi2(moved) == pytest.approx(graph.chi2(values), rel=1e-9)
    assert nls.load("b.g2o")[1].stacks["l"].numbers.tolist() == [3, 2**63 - 1]
    assert "l9223372036854775807 is no name of a PyFactorGraph file" in shell.refused("convert b.g2o d.pyfg")
    shell.file((shell / "b.g2o").read_text().replace("OFFSET 0 0 0 0", "OFFSET 0 0.5 0 0"), "e.g2o")
    assert "its sensor is not at the origin of the vehicle" in shell.refused("convert e.g2o f.isam")
