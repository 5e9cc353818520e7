"""GTSAM's keys, c << 56 | k, at the command line: shown and converted as a44, written as they were."""

from __future__ import annotations

import json

import pytest

import nls
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.io.g2o_files import PLANE
from tests.nls.io.robots import ROBOTS, A, L, X, renamed, without


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
    assert [line.split(",")[:2] for line in (shell / "cov.csv").read_text().splitlines()[1:]] == [
        ["a", "0"],
        ["a", "1"],
        ["a", "44"],
        ["b", "0"],
        ["b", "1"],
        ["l", "3"],
    ]
    assert [line.split()[:2] for line in (shell / "out.g2o").read_text().splitlines()] == [
        line.split()[:2] for line in ROBOTS.splitlines()
    ]
    shell("convert graph.g2o out.csv")
    assert "a,44,2.0,0.125,0.0" in (shell / "out.csv").read_text().splitlines()
    assert shell.report("explain graph.g2o")["gauge"] is not None
    steps = [json.loads(line) for line in shell("stream graph.g2o").splitlines()]
    assert [step["variable"] for step in steps] == ["a1", "b1", "a44", "b0", "a1"]
    assert [step.get("waiting") for step in steps] == [None, *[["b0", "b1", "l3"]] * 2, None, None]
    assert steps[-1]["chi2"] == pytest.approx(shell.report("solve graph.g2o")["chi2_final"], rel=1e-3)


def test_several_trajectories_are_not_one(shell: Shell) -> None:
    """No word of times; the cures work as they are printed."""
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
    shell("convert graph.g2o out.csv")
    huge = shell.file(renamed(PLANE, lambda n: (1 << 55) + n), "huge.g2o")
    assert "too large to tell them apart" in shell.refused(f"convert {huge} out.tum")
    assert "times" not in shell.refused("convert graph.g2o out.tum")


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
