"""What tests of mission folders share."""

from __future__ import annotations

import pytest


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not rendered: that is most of the time."""
    monkeypatch.setattr("nls.plot.picture.drawn", lambda path, figure: b"drawn")
