"""Where the time went: the table of ``nls solve --verbose`` and the timings of its report add up."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nls.cli import main
from tests.nls.io.g2o_files import PLANE, write

ROOT = Path(__file__).parents[3]
PARTS = ("linearize", "assemble", "factorize", "solve", "retract")
STAGES = ("startup", "imports", "read", "init", "check", "build", "analyze", *PARTS, "other", "write")


def test_the_table_adds_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", str(write(tmp_path, PLANE)), "--verbose", "--init", "file"]) == 0
    out = capsys.readouterr().out
    rows = re.findall(r"^([a-z]+) +([0-9.]+) +([0-9.]+)(?: .*)?$", out, re.MULTILINE)
    milliseconds = {name: float(ms) for name, ms, _ in rows}
    whole = milliseconds.pop("process")
    assert tuple(milliseconds) == STAGES
    assert sum(milliseconds.values()) == pytest.approx(whole, abs=0.05 * len(rows) + 0.01)
    assert sum(float(share) for *_, share in rows) == pytest.approx(200, abs=0.05 * len(rows) + 0.01)
    parts = re.search(r"^iteration +linearize.*\n((?: +\d+(?: +[0-9.]+){6}\n)+)", out, re.MULTILINE)
    assert parts is not None
    spent = np.array([line.split() for line in parts[1].splitlines()], dtype=float)
    assert spent[:, 1:6].sum(axis=1) == pytest.approx(spent[:, 6], abs=0.03)
    assert spent[:, 3].sum() == pytest.approx(milliseconds["factorize"], abs=0.1)


def test_the_timings_of_the_report_add_up(tmp_path: Path) -> None:
    where = tmp_path / "report.json"
    subprocess.run(
        [sys.executable, "-m", "nls", "solve", write(tmp_path, PLANE), "--json", where, "-o", tmp_path / "out.g2o"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=60,
        check=True,
    )
    seconds = json.loads(where.read_text())["timings"]
    solved = sum(seconds[part] for part in ("read", "init", "build", "analyze", *PARTS, "other"))
    assert seconds["solved"] == pytest.approx(solved)
    assert seconds["total"] == pytest.approx(solved + seconds["check"] + seconds["write"])
    assert seconds["process"] == pytest.approx(seconds["total"] + seconds["startup"] + seconds["imports"])
    assert all(value >= 0 for value in seconds.values())
    assert seconds["imports"] > seconds["check"] > 0
    assert 0 < seconds["startup"] < 5
    assert 0 < seconds["read file"] < seconds["read"]
