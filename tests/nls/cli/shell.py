"""``nls`` in this process and in a folder of its own, for the tests of the command line."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nls.cli import main
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, write

# a ring of eight poses with six chords, and one wrong closure

RING = "".join(f"EDGE_SE2 {k} {(k + 1) % 8} 1 0 0.7853981633974483 {INFORMATION_2}\n" for k in range(8))
CHORDS = "".join(f"EDGE_SE2 {k} {(k + 2) % 8} 1.7071 0.7071 1.5708 {INFORMATION_2}\n" for k in range(6))
SPOILED = RING + CHORDS + f"EDGE_SE2 1 5 9 9 0.3 {INFORMATION_2}\n"
# a second part that nothing joins to PLANE, and a point that is seen once
PART = f"VERTEX_SE2 10 5 5 0\nVERTEX_SE2 11 6 5 0\nEDGE_SE2 10 11 1 0 0 {INFORMATION_2}\n"
RAY = "VERTEX_XY 20 3 3\nEDGE_BEARING_SE2_XY 0 20 0.785 100\n"


ROOT = Path(__file__).parents[3]


def process(*words: str, env: dict[str, str] | None = None, **options: Any) -> subprocess.CompletedProcess[Any]:
    """Python in a process of its own, with the packages of this folder."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | (env or {})
    return subprocess.run([sys.executable, *words], env=environment, capture_output=True, timeout=60, **options)


class Shell:
    """Runs commands; files have their names from the folder."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self.capsys = folder, capsys

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    def file(self, text: str | bytes = PLANE, name: str = "graph.g2o") -> str:
        write(self.folder, text, name)
        return name

    def both(self, words: str, status: int = 0) -> tuple[str, str]:
        """Standard output and standard error of a command that ends with this status."""
        self.capsys.readouterr()
        assert main(shlex.split(words)) == status, self.capsys.readouterr().err
        out, err = self.capsys.readouterr()
        assert "Traceback" not in err
        assert "internal error" not in err
        return out, err

    def __call__(self, words: str, status: int = 0) -> str:
        """Standard output of a command that says nothing on standard error, or fails there with one line and advice."""
        out, err = self.both(words, status)
        assert (err == "") == (status == 0), err
        return out

    def report(self, words: str, status: int = 0) -> dict[str, Any]:
        """The report for programs, which is all there is on standard output."""
        return dict(json.loads(self.both(f"{words} --json -", status)[0]))

    def told(self, words: str, status: int = 0) -> tuple[str, dict[str, Any]]:
        """Standard output, and the report for programs beside it."""
        return self(f"{words} --json r.json", status), self.json()

    def json(self, name: str = "r.json") -> dict[str, Any]:
        """The content of a report."""
        return dict(json.loads((self / name).read_text()))

    def refused(self, words: str, status: int = 2) -> str:
        """A refusal: one line and advice below it, nothing on standard output, and every file as it was."""
        before = self.contents()
        out, err = self.both(words, status)
        first, *advice = err.splitlines()
        assert (out, first[:5], [line for line in advice if not line.startswith("  -> ")]) == ("", "nls: ", []), err
        assert self.contents() == before
        return err

    def contents(self) -> dict[str, bytes]:
        """Of every file below the folder."""
        paths = (path for path in self.folder.rglob("*") if path.is_file())
        return {path.relative_to(self.folder).as_posix(): path.read_bytes() for path in paths}


def rows(out: str, label: str) -> list[str]:
    """The lines of a table that have this label."""
    return [row.removeprefix(label).strip() for row in out.splitlines() if row.startswith(f"{label} ")]


def row(out: str, label: str) -> str:
    (line,) = rows(out, label)
    return line
