"""The command line: one table, files that read back, one line for every mistake."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sim
from nls import kinds, load
from sim.cli import WORLDS, main
from tests.nls.io.disk import small_disk

(x,) = kinds("x")
SMALL = {
    "manhattan": ["--poses", "60"],
    "grid3d": ["--poses", "60"],
    "ring": ["--laps", "2", "--per-lap", "30"],
    "sphere": ["--rings", "5", "--per-ring", "12"],
    "torus": ["--coils", "5", "--per-coil", "12"],
}


@pytest.mark.parametrize("name", sorted(WORLDS))
def test_table(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--seed", "7", *SMALL[name]]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    labels = ["world", "poses", "edges", "chi2 at start", "chi2 at truth", "dof", "start error"]
    assert [line[:14].strip() for line in out.splitlines()] == labels
    assert f"{name}, seed 7" in out
    assert re.search(r"^poses +60 in SE[23]$", out, re.MULTILINE)


@pytest.mark.parametrize("name", ["manhattan", "sphere"])
def test_files_read_back(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert main([name, *SMALL[name], "--seed", "3", "--out", str(folder)]) == 0
    assert sorted(p.name for p in folder.iterdir()) == ["README.txt", "graph.g2o", "truth.g2o"]
    sizes = {o.lstrip("-").replace("-", "_"): int(v) for o, v in zip(SMALL[name][::2], SMALL[name][1::2], strict=True)}
    sizes = {"n_poses" if o == "poses" else o: v for o, v in sizes.items()}
    world = WORLDS[name](np.random.default_rng(3), **sizes)
    for file, expected in (("graph.g2o", world.start), ("truth.g2o", world.truth)):
        graph, values, _ = load(folder / file, convention="log")
        np.testing.assert_array_equal(values[x], expected[x])
        assert len(graph) == len(world.graph)
        assert graph.chi2(values) == pytest.approx(world.graph.chi2(expected), rel=1e-9)
    graph, start, _ = load(folder / "graph.g2o")
    result = graph.optimize(start)
    assert result.converged
    assert sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    assert "seed 3" in readme
    assert f"{world.poses} in" in readme
    assert str(folder / "graph.g2o") in capsys.readouterr().out


def test_the_command_in_the_readme_makes_the_same_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["manhattan", "--poses", "50", "--sigma-r", "0.031", "--seed", "12", "--out", str(one)]) == 0
    call = re.search(r"^Made by: nls-sim (.*)$", (one / "README.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert call is not None
    assert main([*call[1].split(), "--out", str(two)]) == 0
    for file in ("graph.g2o", "truth.g2o", "README.txt"):
        assert (one / file).read_bytes() == (two / file).read_bytes()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "NAME"),
        (["sphre"], "invalid choice: 'sphre'"),
        (["sphere", "--poses", "30"], "--poses is no option of sphere; see nls-sim sphere --help"),
        (["ring", "extra"], "extra is no option of ring"),
        (["sphere", "--ring", "30"], "--ring is no option of sphere"),
        (["sphere", "--rings"], "expected one argument"),
        (["sphere", "--rings", "many"], "'many' is not a whole number"),
        (
            ["ring", "--seed", "9223372036854775808"],
            "'9223372036854775808' is too large; a whole number has at most 18",
        ),
        (["sphere", "--rings", "1_0"], "'1_0' is not a whole number"),
        (["sphere", "--rings", "1"], "--rings: 1 is not possible; give a whole number from 2"),
        (["manhattan", "--poses", "2"], "--poses: 2 is not possible; give a whole number from 3"),
        (["sphere", "--rings", "9" * 7, "--per-ring", "9" * 7], "give at most 10000000 poses"),
        (["sphere", "--sigma-t", "nan"], "'nan' is not a number"),
        (["sphere", "--sigma-t", "0"], "--sigma-t: 0.0 is not possible; give a number above 0"),
        (["torus", "--tube", "30"], "--tube: 30.0 is not possible; give less than the radius of the ring, 20"),
        (["ring", "--seed", "-1"], "a seed is a whole number of at least 0"),
        (["ring", "--out", ""], "--out: '' is not possible; give a folder"),
        (["manhattan", "--poses", "12000", "--radius", "1e6"], "choose a smaller radius"),
    ],
)
def test_one_line_for_a_mistake(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = leave.code
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert said in err
    assert re.fullmatch(r"nls-sim: .*\n", err)


def test_a_folder_that_cannot_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("taken")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["ring", *SMALL["ring"], "--out", str(folder)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert re.fullmatch(r"nls-sim: .*file.*: cannot be made: .*; give another folder\n", err)
    assert (tmp_path / "file").read_text() == "taken"


@pytest.mark.parametrize(
    "arguments",
    [
        ["hauv-floor", "--legs", "2", "--per-leg", "8"],
        ["ring", "--per-lap", "40"],
        ["rig", "--poses", "4", "--points", "20"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_full_disk_leaves_the_folder_as_it_was(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files may have 8 kB: the first ones fit, a later one does not."""
    old = tmp_path / "old"
    old.mkdir()
    (old / "README.txt").write_text("older")
    for folder in (tmp_path / "new" / "folder", old):
        with small_disk(8000):
            status = main([*arguments, "--out", str(folder)])
        out, err = capsys.readouterr()
        assert (status, out) == (2, "")
        assert re.fullmatch(rf"nls-sim: {re.escape(str(folder))}/\S+: cannot be written: .*\n", err)
    assert not (tmp_path / "new").exists()
    assert [(file.name, file.read_text()) for file in old.iterdir()] == [("README.txt", "older")]


@pytest.mark.parametrize("arguments", [["--help"], *([name, "--help"] for name in sorted(WORLDS))])
def test_help(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(arguments)
    out = capsys.readouterr().out
    assert leave.value.code == 0
    assert "example" in out
    assert all(
        name in out for name in (WORLDS if len(arguments) == 1 else [arguments[0], "--seed", "--out", "default"])
    )


def test_examples_of_the_help_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    from sim.cli import EXAMPLES

    calls = [line.split("   ")[0].split()[1:] for line in EXAMPLES.splitlines() if line.startswith("  nls-sim")]
    assert len(calls) == 10
    assert [main(call) for call in calls if "--help" not in call] == [0] * 9
    assert (tmp_path / "demo" / "graph.g2o").exists()
    assert (tmp_path / "survey" / "contacts.csv").exists()
    assert (tmp_path / "calibrated" / "rig.png").exists()
    assert (tmp_path / "over-confident" / "estimate.png").exists()


def test_python_m_sim() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "sim", "ring", "--laps", "1", "--per-lap", "20"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("world           ring, seed 0\n")
