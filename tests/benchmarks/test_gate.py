"""The gate for speed, on clocks that stand still: what is too slow is named, after a second look, and nothing else."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def options(folder: Path, update: bool = False, **baselines: float) -> argparse.Namespace:
    file = folder / "baselines.json"
    file.write_text(json.dumps({"machine": ["any"], "ratios": baselines}))
    return argparse.Namespace(update=update, baselines=file, seconds=0.1)


def pair(ratio: float, second: float | None = None) -> tuple[Callable[[], float], Callable[[], float]]:
    """Clocks of a piece that takes so many seconds beside a reference of one, and others when it is measured again."""
    times = iter([ratio] * 6 + [second or ratio] * 100)
    return lambda: next(times), lambda: 1.0


def test_what_exceeds_its_baseline_twice_is_named(
    part: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gate = part("gate").gate
    assert gate("guard", {"read": pair(1.4), "build": pair(1.6, 1.4)}, options(tmp_path, read=1, build=1)) == 0
    assert gate("guard", {"read": pair(1.4), "build": pair(1.6)}, options(tmp_path, read=1, build=1)) == 1
    assert capsys.readouterr().err == "guard: build: 1.6, 1.6 times its 1\n"
    assert gate("guard", {"read": pair(1.0)}, options(tmp_path)) == 1
    assert capsys.readouterr().err == "guard: no baseline for read: make them with --update\n"


def test_new_baselines_are_written(part: Callable[[str], Any], tmp_path: Path) -> None:
    chosen = options(tmp_path, update=True, read=9)
    assert part("gate").gate("guard", {"read": pair(2.5)}, chosen) == 0
    written = json.loads(chosen.baselines.read_text())
    assert (written["ratios"], len(written["machine"])) == ({"read": 2.5}, 3)


def test_what_cannot_be_compared_is_refused_beforehand(
    part: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = options(tmp_path, update=True)
    with pytest.raises(SystemExit):
        part("gate").refuse(argparse.ArgumentParser(), chosen, True)
    assert "--update needs all ratios" in capsys.readouterr().err
    chosen.baselines.unlink()
    part("gate").refuse(argparse.ArgumentParser(), chosen, False)
    chosen.update = False
    with pytest.raises(SystemExit):
        part("gate").refuse(argparse.ArgumentParser(), chosen, False)
    assert "make it with --update" in capsys.readouterr().err
