"""What all tests share: how property-based tests run, and where the public data sets are."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("leadline", deadline=None, derandomize=True, max_examples=30, database=None)
settings.load_profile("leadline")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of public data sets, which are not shipped; tests that need it are skipped without it."""
    name = os.environ.get("LEADLINE_DATA")
    if not name:
        pytest.skip("the public data sets are not shipped: set LEADLINE_DATA to the folder that holds them")
    folder = Path(name)
    assert folder.is_dir(), f"LEADLINE_DATA is {name!r}, which is not a folder"
    return folder


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """A script of benchmarks/evidence, imported by its name; tests that need one are skipped in an installed copy."""
    folder = Path(__file__).parents[1] / "benchmarks" / "evidence"
    if not folder.is_dir():
        pytest.skip("there are no benchmarks here (an installed copy has none)")
    monkeypatch.syspath_prepend(str(folder))
    return import_module
