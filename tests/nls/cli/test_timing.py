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

from nls.cli.timing import Clock
from tests.nls.cli.shell import Shell

ROOT = Path(__file__).parents[3]
PARTS = ("linearize", "assemble", "factorize", "solve", "retract")
STAGES = ("startup", "imports", "read", "init", "check", "build", "analyze", *PARTS, "other", "write")


def test_the_table_adds_up(shell: Shell) -> None:
    out = shell(f"solve {shell.file()} --verbose --init file")
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


def test_parts_of_a_stage_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a solution that --improve left, and the one it ended at."""
    now = iter([1.0, 3.0, 4.0, 9.0])
    monkeypatch.setattr("nls.cli.timing.perf_counter", lambda: next(now))
    clock = Clock(0.0, 0.0)
    assert [clock.lap(name) for name in ("optimize", "certify", "optimize", "certify")] == [1.0, 2.0, 2.0, 7.0]
    assert clock.seconds == {"startup": 0.0, "optimize": 2.0, "certify": 7.0}


def test_the_report_of_a_process(shell: Shell) -> None:
    """Its timings add up, and count its start; its peak of memory is not that of the process that began it."""
    code = "import subprocess, sys; big = bytearray(b'1') * 400_000_000; subprocess.run(sys.argv[1:], check=True)"
    command = [sys.executable, "-m", "nls", "solve", shell.file(), "--json", "-", "-o", "out.g2o"]
    done = subprocess.run(
        [sys.executable, "-c", code, *command],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=60,
        check=True,
    )
    report = json.loads(done.stdout)
    seconds = report["timings"]
    solved = sum(seconds[part] for part in ("read", "init", "build", "analyze", *PARTS, "other"))
    assert seconds["solved"] == pytest.approx(solved)
    assert seconds["total"] == pytest.approx(solved + seconds["check"] + seconds["write"])
    assert seconds["process"] == pytest.approx(seconds["total"] + seconds["startup"] + seconds["imports"])
    assert all(value >= 0 for value in seconds.values())
    assert seconds["imports"] > seconds["check"] > 0
    assert 0 < seconds["startup"] < 5
    assert 0 < seconds["read file"] < seconds["read"]
    if Path("/proc/self/status").exists():  # elsewhere the peak of the parent is handed down
        assert 10 < report["peak_rss_mb"] < 350
