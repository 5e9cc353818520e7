"""Scripts of the benchmarks as modules."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """Import a script of the benchmarks."""
    if not FOLDER.is_dir():
        pytest.skip("there are no benchmarks here (an installed copy has none)")
    monkeypatch.syspath_prepend(str(FOLDER))
    return import_module
