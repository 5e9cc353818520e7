"""Scripts of the benchmarks, as modules and as programs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "benchmarks"


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """Import a script of the benchmarks."""
    if not FOLDER.is_dir():
        pytest.skip("there are no benchmarks here (an installed copy has none)")
    monkeypatch.syspath_prepend(str(FOLDER))
    return import_module


@pytest.fixture
def evidence(script: Callable[[str], Any], request: pytest.FixtureRequest) -> Any:
    """The script of benchmarks/evidence whose name a file of tests gives as SCRIPT."""
    return script(request.module.SCRIPT)


def run(script: str, *words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """A script of the benchmarks as its users start it; warnings are errors."""
    if not FOLDER.is_dir():
        pytest.skip("there are no benchmarks here (an installed copy has none)")
    known = {name: value for name, value in os.environ.items() if name != "LEADLINE_DATA"}
    command = [sys.executable, "-W", "error", str(FOLDER / script), *map(str, words)]
    env = known | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False)
