"""The evidence about public logs: what counts as an edit of a draft, and that every log has its mapping."""

from __future__ import annotations

import tomllib
from typing import Any

SCRIPT = "public_logs"


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
