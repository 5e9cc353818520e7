"""Tables of a mission folder that are implausible, from the files to the findings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from nls.cli import main
from nls.missions.folder.write import write_mission
from tests.combinations import for_all
from tests.nls.missions.checks.missions import files_of
from tests.nls.missions.checks.spoils import SPOILS
from tests.nls.missions.checks.vehicle import clean
from tests.nls.missions.folder.mission_files import TINY, folder


def findings_of(path: Path) -> list[str]:
    """Sentences about a folder."""
    return [entry.says for entry in nls.load(path)[2].findings]  # type: ignore[attr-defined]


@for_all(
    case=[(1500.0, ""), (4921.0, "divide C by 3.2808"), (1.5, "multiply C by 1000"), (1200.0, "none of the usual")]
)
@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_speeds_of_sound_that_water_does_not_have(case: tuple[float, str], tmp_path: Path) -> None:
    c, cause = case[0], case[1].replace("C", "sound_speed_m_s")
    table = f"z_m,sound_speed_m_s\n0,1490\n10,{c}\n"
    findings = findings_of(folder(tmp_path / f"{c}", {**TINY, "sound-speed": table}))
    assert len(findings) == (1 if cause else 0)
    assert not cause or (cause in findings[0] and findings[0].startswith("sound-speed.csv:3: "))


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_an_integrated_track(tmp_path: Path) -> None:
    up = TINY["zpr"].replace(",5.", ",-5.")
    assert "z is down" in findings_of(folder(tmp_path / "up", zpr=up))[0]
    degrees = TINY["zpr"].replace("0.0479", "0.9").replace("0.03,", "1.1,")
    assert "roll_rad" in findings_of(folder(tmp_path / "degrees", zpr=degrees))[0]
    for word, cause in (("3e8", "none of the usual mistakes"), ("-1e9", "none of the usual mistakes"), ("1e5", "mm")):
        deep = findings_of(folder(tmp_path / word, zpr=TINY["zpr"].replace("5.0332", word)))
        assert deep[0].startswith("zpr.csv:2: z_m is implausible: a depth of ")
        assert cause in deep[0]
    fast = findings_of(folder(tmp_path / "fast", poses="i,time_s\n0,0\n1,0.001\n2,0.002\n3,0.003\n"))
    assert "the middle speed is" in fast[0]
    assert findings_of(folder(tmp_path / "right", poses="i,time_s\n0,0\n1,1\n2,2\n3,3\n")) == []


def test_a_simulated_sonar_mission_is_plausible(tmp_path: Path) -> None:
    for seed in range(3):
        mission = sim.hauv_floor(np.random.default_rng(seed), legs=2, per_leg=6)
        write_mission(tmp_path / str(seed), mission.graph, mission.sonar, mission.offset, mission.truth)
        assert findings_of(tmp_path / str(seed)) == []


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_solve_and_explain_name_the_doubt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = SPOILS["velocity in mm/s"][0](clean(1, minutes=4.0))
    path = str(folder(tmp_path / "m", files_of(log)))
    assert main(["solve", path, "--json", str(tmp_path / "r.json")]) == 1
    table = capsys.readouterr().out
    (result,) = [line for line in table.splitlines() if line.startswith("result ")]
    assert "converged" in result
    assert "but implausible: speed (dvl.csv)" in result
    (finding,) = json.loads((tmp_path / "r.json").read_text())["findings"]
    columns = "vx_m_s, vy_m_s, vz_m_s"
    cure = f'divide {columns} by 1000, or write `unit = "mm/s"` for {columns} in [dvl] of the mapping'
    assert finding["sentence"].endswith(cure)
    assert (finding["file"], finding["line"], finding["readings"][0]["factor"]) == ("dvl.csv", 2, 1000.0)
    assert main(["explain", path, "--json", str(tmp_path / "e.json")]) == 0
    assert "1. dvl.csv:2: vx_m_s is implausible" in capsys.readouterr().out
    assert json.loads((tmp_path / "e.json").read_text())["findings"][0]["kind"] == "implausible"
