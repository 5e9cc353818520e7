"""The shell of the tests of the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.nls.cli.shell import Shell
from tests.nls.plot import html_page


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(tmp_path)
    return Shell(tmp_path, capsys)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not rendered: that is most of the time of a page or a picture."""
    monkeypatch.setattr("nls.plot.picture.drawn", lambda path, figure: b"drawn")
    html_page.undrawn(monkeypatch)


@pytest.fixture
def untried(monkeypatch: pytest.MonkeyPatch) -> None:
    """No mistake of a setup is tried as the cause of an implausible chi2: that is most of the time of a mission."""
    monkeypatch.setattr("nls.missions.checks.trials.worth_trying", lambda findings: False)
