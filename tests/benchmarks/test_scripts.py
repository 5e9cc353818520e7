"""Scripts of the benchmarks: each is imported, every table is made, and guard and gate name what is slow."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from nls import Cholesky
from tests.benchmarks.conftest import FOLDER, run

QUICK = ("build", "linearize SE2")

references = pytest.mark.skipif(Cholesky.missing() is not None, reason="the references need CHOLMOD")


def table(folder: Path, script: str, world: str, *arguments: object) -> dict[str, list[str]]:
    """Cells of the rows of a world, by the method in the fifth."""
    done = run(f"{script}.py", "--quick", *arguments, "--out", folder)
    assert done.returncode == 0, done.stderr
    lines = [line for line in (folder / f"{script}.md").read_text().splitlines() if line.startswith(f"| {world}")]
    return {line.split("|")[5].strip(" `"): [cell.strip() for cell in line.split("|")] for line in lines}


@references
def test_the_guard_measures_what_is_asked_for_and_wants_a_baseline(tmp_path: Path) -> None:
    file = tmp_path / "baselines.json"
    file.write_text(json.dumps({"machine": ["any"], "ratios": {"build": 1e3}}))
    done = run("guard.py", "--baselines", file, "--seconds", 0.05, "--only", *QUICK)
    assert tuple(line[:20].strip() for line in done.stdout.splitlines()[1:]) == QUICK
    assert done.returncode == 1
    assert done.stderr == "guard: no baseline for linearize SE2: make them with --update\n"


@references
def test_a_table_of_sizes(tmp_path: Path) -> None:
    """Times and memory of every stage."""
    done = run("scaling.py", "--largest", 1000, "--only", "grid3d", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (world,) = json.loads((tmp_path / "scaling.json").read_text())["worlds"]
    (found,) = world["runs"]
    assert (world["world"], found["converged"]) == ("grid3d", True)
    assert found["edges"] == pytest.approx(1000, rel=0.1)
    for what in ("seconds", "wall"):
        stages = dict(found[what])
        assert stages.pop("total") == pytest.approx(sum(stages.values()))
        assert min(stages.values()) > 0  # a stage that is never entered is one whose method was renamed
    assert 3e7 < found["bytes"]["factorize"] <= found["bytes"]["total"] < 1e9
    assert (tmp_path / "scaling.png").stat().st_size > 1e4
    assert "| edges | variables | read |" in (tmp_path / "scaling.md").read_text()


@references
def test_all_elimination_orders_give_the_same_step(tmp_path: Path) -> None:
    rows = table(tmp_path, "schur", "floor", "--flops", "1e10")
    assert list(rows) == ["schur", "cholesky", "natural"]
    assert rows["natural"][7] == "not run"
    flops = {name: float(cells[10].replace(",", "")) for name, cells in rows.items()}
    assert flops["natural"] > 20 * max(flops["schur"], flops["cholesky"])
    for name in ("schur", "cholesky"):
        assert float(rows[name][7]) > 0
        assert float(rows[name][12]) < 1e-12


@references
def test_every_stage_of_closing_loops_is_timed() -> None:
    done = run("scans.py", "--child", "whole", 60)
    assert done.returncode == 0, done.stderr
    seconds = json.loads(done.stdout)["seconds"]
    assert min(seconds[stage] for stage in ("pairs", "windows", "matching", "solving")) > 0


@pytest.mark.parametrize("name", ["lu", "formula"])
def test_a_measurement_leaves_the_update(
    name: str, part: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pinv = part("pinv")
    monkeypatch.setattr(pinv, "RUNS", 1)
    assert pinv.measure(name, "30", str(tmp_path))["seconds"] > 0
    world = sim.manhattan(np.random.default_rng(1), n_poses=11)
    world.graph.fix(next(iter(world.truth)))
    A, b = world.graph.linearize(world.truth)
    np.testing.assert_allclose(np.load(tmp_path / "dx.npy"), np.linalg.lstsq(A.toarray(), b)[0], atol=1e-9)


def options(folder: Path, update: bool = False, **baselines: float) -> argparse.Namespace:
    file = folder / "baselines.json"
    file.write_text(json.dumps({"machine": ["any"], "ratios": baselines}))
    return argparse.Namespace(update=update, baselines=file, seconds=0.1)


def pair(ratio: float, second: float | None = None) -> tuple[Callable[[], float], Callable[[], float]]:
    """Clocks of a piece that takes so many seconds beside a reference of one, and others when it is measured again."""
    times = iter([ratio] * 6 + [second or ratio] * 100)
    return lambda: next(times), lambda: 1.0


def test_what_exceeds_its_baseline_twice_is_named(
    part: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gate = part("gate").gate
    assert gate("guard", {"read": pair(1.4), "build": pair(1.6, 1.4)}, options(tmp_path, read=1, build=1)) == 0
    assert gate("guard", {"read": pair(1.4), "build": pair(1.6)}, options(tmp_path, read=1, build=1)) == 1
    assert capsys.readouterr().err == "guard: build: 1.6, 1.6 times its 1\n"
    assert gate("guard", {"read": pair(1.0)}, options(tmp_path)) == 1
    assert capsys.readouterr().err == "guard: no baseline for read: make them with --update\n"


def test_new_baselines_are_written(part: Callable[[str], Any], tmp_path: Path) -> None:
    chosen = options(tmp_path, update=True, read=9)
    assert part("gate").gate("guard", {"read": pair(2.5)}, chosen) == 0
    written = json.loads(chosen.baselines.read_text())
    assert (written["ratios"], len(written["machine"])) == ({"read": 2.5}, 3)


def test_what_cannot_be_compared_is_refused_beforehand(
    part: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = options(tmp_path, update=True)
    with pytest.raises(SystemExit):
        part("gate").refuse(argparse.ArgumentParser(), chosen, True)
    assert "--update needs all ratios" in capsys.readouterr().err
    chosen.baselines.unlink()
    part("gate").refuse(argparse.ArgumentParser(), chosen, False)
    chosen.update = False
    with pytest.raises(SystemExit):
        part("gate").refuse(argparse.ArgumentParser(), chosen, False)
    assert "make it with --update" in capsys.readouterr().err


def test_every_script_can_be_imported(part: Callable[[str], Any], script: Callable[[str], Any]) -> None:
    names = Counter(path.stem for pattern in ("*.py", "evidence/*.py") for path in FOLDER.glob(pattern))
    assert [name for name, number in names.items() if number > 1] == []
    for name in names:
        part(name)


def test_a_page(part: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Head, options, folders and table; a process of its own prints what it measured."""
    harness = part("harness")

    def page(data: Path, out: Path, seeds: int, quick: bool) -> list[str]:
        table = harness.Table(("folder", "seeds"))
        table.add(data.name, harness.spread(range(seeds), 1))
        return table if quick else [str(out)]

    def made(*words: object) -> None:
        monkeypatch.setattr("sys.argv", ["page.py", *map(str, words)])
        harness.make_page("To {last}", page, str.upper, seeds=(3, "seeds"), quick="less")

    monkeypatch.setenv("LEADLINE_DATA", str(tmp_path / "public"))
    made("--quick", "--out", tmp_path / "new")
    title, blank, head, rule, row, *_ = (tmp_path / "new" / "test_scripts.md").read_text().splitlines()
    assert (title, blank) == ("# To 2", "")
    assert (head, rule, row) == ("| folder | seeds |", "|:--|--:|", "| public | 1.0 (0.0-2.0) |")
    for words in (["--seeds", "0"], ["--out", Path(__file__) / "below"]):
        with pytest.raises(SystemExit):
            made(*words)
    monkeypatch.delenv("LEADLINE_DATA")
    with pytest.raises(SystemExit):
        made()


def test_a_child(
    part: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, measure in (["a"], str.upper), (["up", "a"], {"up": str.upper}):
        monkeypatch.setattr("sys.argv", ["page.py", "--child", *words])
        part("harness").make_page("Title", lambda: [], measure)
        assert json.loads(capsys.readouterr().out) == "A"


def test_blank_lines(part: Callable[[str], Any]) -> None:
    lines = ["# title", "- a", "- b\n  of b", "| t |", "|--:|", "", "| u |", "text\nof two lines", "text"]
    assert list(part("harness").spaced(lines)) == [
        *("# title", "", "- a", "- b\n  of b", "", "| t |", "|--:|", "", "| u |", "", "text\nof two lines", "", "text")
    ]


@pytest.mark.parametrize("figure", [["![a](a.png)"], ["| t |", "|--:|"]])
def test_conditions_follow_the_first_picture_or_table(part: Callable[[str], Any], figure: list[str]) -> None:
    lines = ["# title", "- a", "text", "- b", *figure, "text", "- c", "| u |"]
    assert part("harness").figure_first(lines) == ["# title", "text", *figure, "- a", "- b", "text", "- c", "| u |"]
    assert part("harness").figure_first(["# title", "- a", "text"]) == ["# title", "text", "- a"]
