"""``nls convert`` and ``nls plot``: every format by its suffix, names and numbers, and what a format cannot hold."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
import sim
from models import SE2
from nls import kinds
from nls.io.trajectory import lifted, read_kitti, read_tum, write_tum
from nls.io.variable_names import with_known_kinds
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.io.g2o_files import PLANE, ROBOTS, SPACE, A, L, X, renamed, without
from tests.nls.io.io_files import FILES, ISAM_APART_2, TORO_2
from tests.nls.missions.charts.test_charts import charted

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


x, l = kinds("x", "l")


def test_landmarks_go_behind_the_largest_pose_and_the_optimum_is_the_same(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    n, m = (len(scene.start.stack(kind)) for kind in (x, l))
    note = f"{m} variables have new numbers: l{n} to l{n + m - 1} were l0 to l{m - 1}"
    assert rows(shell("convert subsea.npz subsea.g2o --renumber"), "note") == [note]
    one, two = (
        shell.report(f"solve {name} --convention log --allow-doubtful") for name in ("subsea.npz", "subsea.g2o")
    )
    assert two["chi2_final"] == pytest.approx(one["chi2_final"], rel=1e-6)
    assert note in rows(shell("solve subsea.npz -o solved.g2o --renumber --allow-doubtful"), "note")
    shell("solve subsea.npz -o solved.npz --allow-doubtful")
    solved, named = (nls.load(name, "log")[1] for name in ("solved.g2o", "solved.npz"))
    assert solved.stack(l).numbers.tolist() == list(range(n, n + m))
    assert named.stack(l).numbers.tolist() == list(range(m))
    assert all(np.array_equal(solved[kind], named[kind]) for kind in (x, l))
    comments = [line for line in (shell / "solved.g2o").read_text().splitlines() if line.startswith("#")]
    assert comments == []  # some readers lose a file's edges over one


def test_without_the_option_the_refusal_names_it(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    for command in ("convert subsea.npz a.g2o", "solve subsea.npz -o a.g2o", "convert subsea.npz a.toro"):
        problem, renumber, native = shell.refused(command).splitlines()
        assert "x0 and l0 have one number" in problem
        assert renumber.endswith("give the variables whose numbers clash new numbers: --renumber")
        assert ".npz or .json" in native
    with pytest.raises(nls.GraphError, match=r"x0 and l0 have one number") as caught:
        nls.save("a.g2o", scene.graph, scene.start)
    assert "nls.save(..., renumber=True)" in str(caught.value)


def test_formats_that_need_no_new_numbers_refuse_the_option(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    for name in ("a.npz", "a.pyfg", "a.tum"):
        assert "--renumber: " in shell.refused(f"convert subsea.npz {name} --renumber")
    assert "expected an output in one of the formats g2o, toro, graph" in shell.refused("solve subsea.npz --renumber")
    with pytest.raises(nls.OptionError, match="renumber: 'npz' is not possible"):
        nls.save("a.npz", scene.graph, scene.start, renumber=True)


@pytest.mark.parametrize("between", ["npz", "json", "toro", "pyfg"])
def test_through_another_format_every_number_and_id_comes_back(between: str, shell: Shell) -> None:
    """Robot x, whose name is that of plain ids, keeps its keys in the library's own files."""
    text = without(ROBOTS, "FIX", "PARAMS", "XY")
    if between in ("npz", "json"):
        text = ROBOTS
        for k in (0, 1, 44):
            text = text.replace(str(A | k), str(X | k))
    shell.file(text)
    shell(f"convert graph.g2o a.{between}")
    shell(f"convert a.{between} out.g2o")
    out = (shell / "out.g2o").read_text().replace("OFFSET 0 ", "OFFSET 3 ").replace(f"{L | 3} 0 ", f"{L | 3} 3 ")
    assert sorted(out.splitlines()) == sorted(text.splitlines())


def test_commands_show_the_names(shell: Shell) -> None:
    shell.file(ROBOTS)
    out = shell("solve graph.g2o --covariance cov.csv -o out.g2o")
    assert row(out, "note") == "ids are keys of GTSAM, a letter and a number in one: kinds a, b, l"
    assert row(out, "result")[-3:-2] in "ab"  # the variable of the largest step
    names = ["".join(line.split(",")[:2]) for line in (shell / "cov.csv").read_text().splitlines()[1:]]
    assert names == ["a0", "a1", "a44", "b0", "b1", "l3"]
    written, given = (
        [line.split()[:2] for line in text.splitlines()] for text in ((shell / "out.g2o").read_text(), ROBOTS)
    )
    assert written == given
    shell("convert graph.g2o out.csv")
    assert "a,44,2.0,0.125,0.0" in (shell / "out.csv").read_text().splitlines()
    steps = [json.loads(line) for line in shell("stream graph.g2o").splitlines()]
    assert [step["variable"] for step in steps] == ["a1", "b1", "a44", "b0", "a1"]
    assert [step.get("waiting") for step in steps] == [None, *[["b0", "b1", "l3"]] * 2, None, None]
    assert steps[-1]["chi2"] == pytest.approx(shell.report("solve graph.g2o")["chi2_final"], rel=1e-3)


def test_several_trajectories_are_not_one(shell: Shell) -> None:
    """The cures work as they are printed."""
    graph, values, _ = nls.load(shell.file(ROBOTS))
    for form in ("tum", "kitti"):
        first, *cures = shell.refused(f"convert graph.g2o out.{form}").splitlines()
        assert first.endswith("a trajectory file holds the poses of one kind, this graph has a, b")
        assert [cure.split(" ends in ")[1].split(",")[0] for cure in cures] == [".csv", ".npz or .json"]
        with pytest.raises(nls.GraphError) as caught:
            nls.save(f"out.{form}", graph, values)
        one = str(caught.value).split("write one kind a file: ")[1].split("\n")[0]
        exec(one, {"nls": nls, "values": values})
        assert len((shell / f"a.{form}").read_text().splitlines()) == 3
    huge = shell.file(renamed(PLANE, lambda n: (1 << 55) + n), "huge.g2o")
    assert "too large to remain distinct" in shell.refused(f"convert {huge} out.tum")


def test_new_numbers_leave_keys_alone(shell: Shell) -> None:
    shell.file(ROBOTS.replace(f"{L | 3}", f"{L}"))
    out = shell("convert graph.g2o out.g2o --renumber")
    assert len(rows(out, "note")) == 1
    assert (shell / "out.g2o").read_bytes() == (shell / "graph.g2o").read_bytes()


def test_a_native_file_says_nothing_else_of_ids(shell: Shell) -> None:
    shell.file(ROBOTS)
    shell("convert graph.g2o a.json")
    for other in ('"keys of gtsam"', "7", "[7]", "null"):
        shell.file((shell / "a.json").read_text().replace('"keys of GTSAM"', other), "b.json")
        assert "values of 'a': " in shell.refused("convert b.json c.g2o")


WORLDS: dict[str, Callable[[], Any]] = {
    "ring": lambda: sim.ring(np.random.default_rng(0), laps=2, per_lap=15),
    "hauv": lambda: sim.hauv_floor(np.random.default_rng(0), legs=2, per_leg=5),
    "subsea": lambda: sim.subsea(np.random.default_rng(0), laps=1),
    "rig": lambda: sim.rig(np.random.default_rng(0), poses=4, points=20),
}


@pytest.mark.parametrize(("name", "form"), [*zip(WORLDS, ["npz", "json"] * 2, strict=True)])
def test_every_command_takes_it(name: str, form: str, shell: Shell, undrawn: None) -> None:
    world = WORLDS[name]()
    file = f"world.{form}"
    nls.save(file, world.graph, world.start)
    best = world.graph.optimize(world.start).chi2_final
    solved = shell.report(f"solve {file} -o solved.{form} --report a.html --plot a.png")
    assert shell.report(f"info {file}")["chi2"] == world.graph.chi2(world.start)
    assert solved["chi2_final"] == pytest.approx(best, rel=1e-6)
    graph, values, _ = nls.load(f"solved.{form}")
    assert graph.chi2(values) == solved["chi2_final"]
    assert shell.report(f"explain {file}")["chi2"] > 0
    shell(f"plot {file} b.png")
    shell(f"convert {file} again.npz")
    assert nls.load("again.npz")[0].chi2(world.start) == world.graph.chi2(world.start)


@pytest.mark.parametrize(("name", "form"), [("ring", "npz"), ("hauv", "npz"), ("subsea", "npz"), ("ring", "pyfg")])
def test_a_stream_ends_at_the_optimum(name: str, form: str, shell: Shell) -> None:
    world = WORLDS[name]()
    nls.save(f"world.{form}", world.graph, world.start)
    lines = [json.loads(line) for line in shell(f"stream world.{form} --convention log").splitlines()]
    graph, values = world.graph, world.start
    best = graph.optimize(nls.initialize(graph, values)[0]).chi2_final
    assert lines[-1]["chi2"] - best <= 1e-3 * max(best, 1.0) * 1.01
    assert "waiting" not in lines[-1]
    assert [line["step"] for line in lines] == list(range(1, len(lines) + 1))


@pytest.mark.filterwarnings("always::nls.GraphWarning")
def test_certify_and_a_folder(shell: Shell) -> None:
    world = WORLDS["ring"]()
    Path("demo").mkdir()
    nls.save("demo/graph.g2o", world.graph, world.truth)
    assert "demo/graph.g2o" in shell("solve demo")
    nls.save("demo/graph.npz", world.graph, world.start)
    out = shell("solve demo --certify")
    assert "input       demo/graph.npz" in out
    assert "certificate certified" in out
    now = Path("demo/graph.npz").stat().st_mtime
    os.utime("demo/graph.g2o", (now, now + 1))  # as after an edit
    newer = "graph.g2o is newer than graph.npz, which was read; give demo/graph.g2o"
    assert shell.both("info demo")[1] == f"nls: warning: demo: {newer}\n"
    assert shell.both("info demo/graph.g2o")[1] == ""
    with pytest.warns(nls.GraphWarning, match="demo/graph.g2o") as said:
        nls.load("demo")
    assert said[0].filename == __file__


def test_several_held_variables_are_refused(shell: Shell) -> None:
    world = WORLDS["ring"]()
    nls.save("held.npz", nls.FactorGraph(world.graph.factors, [x[:3]]), world.start)
    assert "fixes 3 variables; a stream fixes its first pose alone" in shell.refused("stream held.npz")
