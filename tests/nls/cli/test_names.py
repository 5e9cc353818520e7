"""Names and numbers of variables: new ones on request, keys of GTSAM, and native files, which hold them all."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
import sim
from nls import kinds
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.io.g2o_files import PLANE, ROBOTS, A, L, X, renamed, without
from tests.nls.missions.charts.charted import charted

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
    assert "too large to tell them apart" in shell.refused(f"convert {huge} out.tum")


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


def test_certify_and_a_folder(shell: Shell) -> None:
    world = WORLDS["ring"]()
    Path("demo").mkdir()
    nls.save("demo/graph.g2o", world.graph, world.truth)
    assert "demo/graph.g2o" in shell("solve demo")
    nls.save("demo/graph.npz", world.graph, world.start)
    out = shell("solve demo --certify")
    assert "input       demo/graph.npz" in out
    assert "certificate certified" in out


def test_several_held_variables_are_refused(shell: Shell) -> None:
    world = WORLDS["ring"]()
    nls.save("held.npz", nls.FactorGraph(world.graph.factors, [x[:3]]), world.start)
    assert "holds 3 variables; a stream holds the pose it begins with" in shell.refused("stream held.npz")
