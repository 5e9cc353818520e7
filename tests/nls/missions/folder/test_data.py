"""Real logs as mission folders: the DVL of an AUV at sea, dead-reckoned against its navigation-grade truth."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nls.cli import main
from nls.missions.folder.table import csv_text
from tests.combinations import for_all
from tests.nls.missions.folder.mission_files import RAW, folder

SIGMA_ATTITUDE, SIGMA_Z = (0.002, 0.002, 0.005), 0.05


@for_all(number=[1, 4, 7])
def test_the_drift_of_a_real_log(
    number: int, data: Path, script: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Attitude and depth are those of the truth with noise; the DVL, with six seconds taken out, is as measured."""
    log = script("logs").read_auv_dvl(data / "underwater-auv-dvl", number)
    rng = np.random.default_rng(number)
    n = len(log.t)
    t = log.t[:, None]
    valid = np.ones(n, dtype=int)
    valid[100:106] = 0
    poses = np.arange(0, n, 5)
    noise = [[0.02, 0.002, 0.05, *SIGMA_ATTITUDE, SIGMA_Z]]
    rows: dict[str, tuple[object, ...]] = {
        "dvl": (t, log.v_d, valid),
        "ahrs": (t, log.rpy + rng.normal(0, SIGMA_ATTITUDE, (n, 3))),
        "depth": (t, log.p[:, 2:] + rng.normal(0, SIGMA_Z, (n, 1))),
        "noise": (noise,),
        "poses": (poses, t[poses]),
        "truth": (poses, log.rpy[poses], log.p[poses]),
    }
    files = {name: csv_text(RAW[name], *columns).decode() for name, columns in rows.items()}  # type: ignore[arg-type]
    assert main(["solve", str(folder(tmp_path / str(number), files)), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    mission = report["mission"]
    assert 600 < mission["distance_m"] < 1000
    assert mission["dead_reckoning"]["drift_percent"] < 1.2
    assert mission["dead_reckoning"]["ate_rmse_m"] < 5.0
    assert mission["solution"]["ate_rmse_m"] == pytest.approx(mission["dead_reckoning"]["ate_rmse_m"], rel=1e-3)
    assert re.search(r"velocity is bridged for [67]\.0", " ".join(report["notes"]))
