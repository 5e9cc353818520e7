"""Everything the README shows is run: its Python in one namespace, its commands in a folder of their own."""

from __future__ import annotations

import json
import re
import shlex
from importlib import import_module
from pathlib import Path

import matplotlib
import pytest

import nls.cli
import sim.cli

README = Path(__file__).parents[1] / "README.md"
COMMANDS = {"nls": nls.cli.main, "nls-sim": sim.cli.main}


def blocks(*languages: str) -> list[str]:
    """Contents of the fenced blocks of these languages."""
    if not README.exists():
        pytest.skip("there is no README.md here (an installed copy has none)")
    text = README.read_text(encoding="utf-8")
    return [body for language, body in re.findall(r"^```(\w+)\n(.*?)^```$", text, re.M | re.S) if language in languages]


def test_the_python_blocks_run_in_order_and_print_what_they_claim(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``print(...)  # text`` promises that the text is printed, where the comment quotes it with a bar or dots."""
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    namespace: dict[str, object] = {"__name__": "readme"}
    printed = ""
    for k, block in enumerate(blocks("python")):
        exec(compile(block, f"README.md, Python block {k + 1}", "exec"), namespace)
        printed += (out := capsys.readouterr().out)
        for claim in re.findall(r"print\(.*\)\s+# (.*(?:\.\.\.|\|).*)$", block, re.M):
            for part in filter(None, (p.strip(" ;") for p in claim.split("..."))):
                assert part in out
    assert printed.strip()


def test_the_chart_is_of_the_last_benchmark(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = README.parent / "benchmarks"
    if not README.exists() or not folder.is_dir():
        pytest.skip("there is no README.md here (an installed copy has none)")
    monkeypatch.syspath_prepend(str(folder))
    run = json.loads((folder / "results" / "posegraphs.json").read_text())
    rows = import_module("posegraphs_report").bars(run["sets"])
    assert len(rows) > 10
    assert "\n".join(rows) in blocks("text")[0]  # python benchmarks/posegraphs_report.py prints it
    assert run["machine"][0].removeprefix("- ")[:10] in README.read_text(encoding="utf-8")  # the date


def test_it_is_short() -> None:
    blocks()
    assert len(README.read_text(encoding="utf-8").split()) < 1200


def test_the_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line[2:] for block in blocks("console", "sh") for line in block.splitlines() if line.startswith("$ ")]
    caption = re.search(r"^\*(.*)\*$", README.read_text(encoding="utf-8"), re.M)
    assert caption is not None
    assert set(re.findall("`(.+?)`", caption[1])) <= set(lines)  # commands that made the first picture
    words = [shlex.split(line, comments=True) for line in lines]
    ran = 0
    for command, *arguments in words:
        if command in COMMANDS:
            assert COMMANDS[command](arguments) == 0, " ".join([command, *arguments])
            assert "Traceback" not in capsys.readouterr().err
            ran += 1
        for word in arguments:  # what a command says it writes is there
            if word.endswith((".png", ".json")):
                assert (tmp_path / word).stat().st_size > 0
    assert ran == len(words) > 0
