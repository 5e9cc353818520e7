"""Everything the README shows is run: its Python in one namespace, its commands in a folder of their own."""

from __future__ import annotations

import json
import re
import shlex
from importlib import import_module
from pathlib import Path

import matplotlib
import pytest

import nls
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


def test_the_pictures_show_what_their_captions_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers in the alternative texts are those that the scripts draw; the date is that of the last benchmark."""
    blocks()
    figures = README.parent / "docs" / "figures"
    if not figures.is_dir():
        pytest.skip("there are no scripts of the figures here")
    monkeypatch.syspath_prepend(str(figures))
    text = README.read_text(encoding="utf-8")
    first, speed = re.findall(r"^!\[(.*)\]\(docs/images/(?:first|speed)\.png\)$", text, re.M)
    panels = import_module("first").make()[0][0].axes
    assert [re.findall(r"[\d.]+ m", axes.get_title()) for axes in panels] == [
        [n] for n in re.findall(r"[\d.]+ m", first)
    ]
    script = import_module("speed")
    (axes,) = script.make()[0][0].axes
    rows = [int(label.get_text().split(", ")[1].split()[0].replace(",", "")) for label in axes.get_yticklabels()]
    ours, *others = [
        next(c for c in axes.collections if c.get_label() == name).get_offsets()[:, 0] for name in ("leadline", "g2o")
    ]
    lost = [edges for k, edges in enumerate(rows) if any(ms[k] < ours[k] for ms in others)]
    won = min(edges for edges in rows if edges > max(lost))
    assert [f"{min(rows):,}", f"{max(rows):,}", f"{won:,}"] == re.findall(r"\d+,\d+", speed)
    run = json.loads((README.parent / "benchmarks" / "results" / "posegraphs.json").read_text())
    assert run["machine"][0].removeprefix("- ")[:10] in text


def test_it_is_short() -> None:
    blocks()
    assert len(README.read_text(encoding="utf-8").split()) <= 900


def test_the_commands_print_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each line below a command is a line that it prints, in this order; three dots stand for others."""
    monkeypatch.chdir(tmp_path)
    ran = 0
    for block in blocks("console"):
        for shown in block.split("$ ")[1:]:
            line, *output = shown.splitlines()
            command, *arguments = shlex.split(line)
            if command == "echo":
                text, _, name = arguments
                Path(name).write_text(Path(name).read_text(encoding="utf-8") + text + "\n", encoding="utf-8")
                continue
            assert COMMANDS[command](arguments) == 0, line
            out, err = capsys.readouterr()
            assert "Traceback" not in err
            printed = iter(out.splitlines())
            assert [wanted for wanted in output if wanted != "..." and wanted not in printed] == []
            for word in arguments:  # what a command says it writes is there
                if word.endswith((".png", ".json", ".g2o")):
                    assert Path(word).stat().st_size > 0
            ran += 1
    assert ran == 3


def test_the_citation_has_the_version_of_the_package() -> None:
    root = README.parent
    if not (root / "CITATION.cff").exists():
        pytest.skip("there is no CITATION.cff here (an installed copy has none)")
    assert f"\nversion: {nls.__version__}\n" in (root / "CITATION.cff").read_text(encoding="utf-8")
    entry = (root / "docs" / "how-to" / "cite.md").read_text(encoding="utf-8")
    assert f"version = {{{nls.__version__}}}" in entry
