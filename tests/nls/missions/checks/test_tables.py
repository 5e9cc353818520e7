"""Tables of a mission folder that are implausible, from the files to the findings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import sim
from nls.cli import main
from nls.missions import read_mission, write_mission
from nls.missions.checks.log import FROM_NORTH, readings
from nls.missions.folder.folder import read_tables
from tests.combinations import for_all
from tests.nls.missions.checks.missions import files_of, findings
from tests.nls.missions.checks.spoils import SPOILS
from tests.nls.missions.checks.vehicle import clean
from tests.nls.missions.folder.mission_files import TINY, folder
from tests.nls.missions.folder.test_damaged import WHOLE

ZPR, POSES, DEEP = TINY["zpr"], "i,time_s\n0,0\n1,{0}1\n2,{0}2\n3,{0}3\n", "zpr.csv:2: z_m is implausible: a depth of "
SPEEDS = "z_m,sound_speed_m_s\n0,1490\n10,{}\n"
SPEED = "sound-speed.csv:3: "


@for_all(
    case=[
        ({"sound-speed": SPEEDS.format(4921.0)}, SPEED, "divide sound_speed_m_s by 3.2808"),
        ({"sound-speed": SPEEDS.format(1.5)}, SPEED, "multiply sound_speed_m_s by 1000"),
        ({"sound-speed": SPEEDS.format(1200.0)}, SPEED, "none of the usual"),
        ({"zpr": ZPR.replace(",5.", ",-5.")}, "zpr.csv:", "z is down"),
        ({"zpr": ZPR.replace("0.0479", "0.9").replace("0.03,", "1.1,")}, "zpr.csv:", "roll_rad"),
        ({"zpr": ZPR.replace("5.0332", "3e8")}, DEEP, "none of the usual mistakes"),
        ({"zpr": ZPR.replace("5.0332", "-1e9")}, DEEP, "none of the usual mistakes"),
        ({"zpr": ZPR.replace("5.0332", "1e5")}, DEEP, "mm"),
        ({"poses": POSES.format("0.00")}, "odometry.csv:", "the middle speed is"),
    ]
)
def test_speeds_of_sound_and_integrated_tracks(case: tuple[dict[str, str], str, str]) -> None:
    files, place, cause = case
    first, *others = [entry.says for entry in findings(TINY | files)]
    assert first.startswith(place)
    assert cause in first
    assert not ("sound-speed" in files and others)


@for_all(files=[{"sound-speed": SPEEDS.format(1500.0)}, {"poses": POSES.format("")}])
def test_right_ones_are_plausible(files: dict[str, str]) -> None:
    assert findings(TINY | files) == []


@for_all(name=WHOLE)
def test_every_reading_is_tried_on_whatever_columns_there_are(name: str, tmp_path: Path) -> None:
    """Rows of usbl.csv with `i` have the times of poses.csv; without that file no bearing is read from the bow."""
    tables = read_tables(folder(tmp_path / name, WHOLE[name]))[0]
    tried = {a.reading: a.on_tables(tables) for a in readings(tables)}
    assert any(tried.values())
    if name == "placed":
        assert tried[FROM_NORTH]["usbl"].floats("bearing_rad") == pytest.approx(np.array([[0.5 - 0.1 * 3 / 60]]))
        (alone,) = (a for a in readings(tables) if a.reading == FROM_NORTH)
        assert alone.on_tables({k: table for k, table in tables.items() if k != "poses"}) == {}


def test_a_simulated_sonar_mission_is_plausible(tmp_path: Path) -> None:
    for seed in range(3):
        mission, path = sim.hauv_floor(np.random.default_rng(seed), legs=2, per_leg=6), tmp_path / str(seed)
        write_mission(path, mission.graph, mission.sonar, mission.offset, mission.truth)
        assert read_mission(path)[2].findings == []


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_solve_and_explain_name_the_doubt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = SPOILS["velocity in mm/s"][0](clean(1, minutes=4.0))
    path = str(folder(tmp_path / "m", files_of(log)))
    assert main(["solve", path, "--json", str(tmp_path / "r.json")]) == 1
    table = capsys.readouterr().out
    (result,) = [line for line in table.splitlines() if line.startswith("result ")]
    assert "; but implausible: speed (dvl.csv)" in result
    (finding,) = json.loads((tmp_path / "r.json").read_text())["findings"]
    assert (finding["file"], finding["line"], finding["readings"][0]["factor"]) == ("dvl.csv", 2, 1000.0)
    assert main(["explain", path, "--json", str(tmp_path / "e.json")]) == 0
    assert "1. dvl.csv:2: vx_m_s is implausible" in capsys.readouterr().out
    assert json.loads((tmp_path / "e.json").read_text())["findings"][0]["kind"] == "implausible"
