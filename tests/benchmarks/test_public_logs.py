"""The evidence about public logs: what counts as an edit of a draft, and that every log has its mapping."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import Any

import pytest

DRAFT = """
[ahrs]
time_s = "t"
yaw_rad = { column = "yaw", unit = "deg" }

[truth]
time_s = "t"
x_m = "x"
"""


@pytest.fixture
def evidence(script: Callable[[str], Any]) -> Any:
    return script("public_logs")


@pytest.mark.parametrize(
    ("kept", "edits"),
    [
        (DRAFT, 0),
        (DRAFT.replace('"deg"', '"cdeg"'), 1),
        (DRAFT.replace('x_m = "x"', "y_m = 0"), 2),
        (DRAFT.partition("[truth]")[0], 1),
        (f"skip = 3\n{DRAFT}", 1),
        ("[motion]\nsigma_walk_m_sqrt_s = 1", 3),
    ],
    ids=["none", "a unit", "one for another", "a section less", "an option", "another mission"],
)
def test_edits_of_a_draft(evidence: Any, kept: str, edits: int) -> None:
    assert evidence.edits(DRAFT, kept) == edits


def test_every_log_has_its_mapping_and_its_origin(evidence: Any) -> None:
    text = (evidence.FOLDER / "logs.toml").read_text(encoding="utf-8")
    logs = [evidence.Log(**entry) for entry in tomllib.loads(text)["log"]]
    assert len({log.repository for log in logs}) >= 10
    mappings = {path.stem for path in evidence.FOLDER.glob("*.toml")} - {"logs"}
    assert mappings == {log.name for log in logs}
    for log in logs:
        clone, *shows = log.commands()
        assert log.repository in clone
        assert len(log.commit) == 40
        assert all(log.commit in show for show in shows)
