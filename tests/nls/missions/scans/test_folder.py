"""Scan missions: points in the frame of the vehicle, keyframes, truth, what cannot be right; the page about them."""

from __future__ import annotations

import gzip
import re
import tomllib
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import nls
from factors.keys import kinds
from models import SE2
from models.errors import GraphFileError, GraphWarning, OptionError
from nls.cli import main
from nls.missions.scans import Drift, Verdict
from nls.missions.scans.folder import (
    COLUMNS,
    SECTIONS,
    ScanReport,
    Settings,
    is_scan_mission,
    read_scan_mission,
    read_settings,
)
from nls.missions.scans.solution import CLOSURES, MAP, TRAJECTORY
from tests.combinations import for_all
from tests.nls.io.formats_page import columns_of, files_of, section, shown_tables
from tests.nls.io.g2o_files import assert_refused, cases
from tests.nls.missions.scans.room_files import room, track, walls, write

x = kinds("x")[0]
FILES = {
    "keyframes": b"keyframe,time,x,y,yaw\n4,10,0,0,0\n7,12,1,0,0.1\n9,15,2,0.5,0.2\n",
    "scans": b"intensity,keyframe,range,azimuth\n80,9,5,0.5\n90,4,8,-0.25\n70,9,6,0\n",
    "truth": b"time,x,y,yaw\n9,0,0,1.5\n13,0,4,1.5\n16,-3,4,3\n",
    "mission.toml": b'[sonar]\nazimuth = "left"\nx_m = 0.5\n\n[drift]\nmean = 0.1\n',
}

TEXT = '# dive 3\n[sonar]\nazimuth = "right"\nx_m = 1\nyaw_rad = 0.1\n[drift]\nmean = 0.05\nheading = false\n'


def test_points_numbers_and_truth(tmp_path: Path) -> None:
    graph, values, scans, report = read_scan_mission(write(tmp_path / "m", FILES))
    assert values[x].tolist() == [[0, 0, 0], [1, 0, 0.1], [2, 0.5, 0.2]]
    assert (report.numbers.tolist(), report.vertex_times["x"].tolist()) == ([4, 7, 9], [10, 12, 15])
    assert np.diff(scans.starts).tolist() == [1, 0, 2]
    np.testing.assert_allclose(scans[0], [[0.5 + 8 * np.cos(0.25), -8 * np.sin(0.25)]])
    np.testing.assert_allclose(scans[2], [[0.5 + 5 * np.cos(0.5), 5 * np.sin(0.5)], [6.5, 0]])
    assert report.intensity is not None
    assert report.intensity.tolist() == [90, 80, 70]  # as the points, by keyframe
    assert report.truth is not None
    np.testing.assert_allclose(report.truth.poses, [[0, 1, 1.5], [0, 3, 1.5], [-2, 4, 2.5]])
    assert (report.drift.mean, report.drift.stretch) == (0.1, 0.15)
    assert graph.chi2(values) == 0
    steps, headings = report.sources[0], report.sources[-1]
    assert (steps.lines.tolist(), headings.lines.tolist()) == ([3, 4], [2, 3, 4])
    loaded = nls.load(tmp_path / "m")[2]
    assert isinstance(loaded, ScanReport)
    assert loaded.scans.points.tolist() == scans.points.tolist()


@pytest.mark.parametrize(("side", "word"), [(1.0, "left"), (-1.0, "right")])
def test_the_side_and_the_mounting_put_the_points_on_the_walls(side: float, word: str, tmp_path: Path) -> None:
    mount = np.array([0.5, -0.2, 0.3])
    lines = f'[sonar]\nazimuth = "{word}"\nx_m = 0.5\ny_m = -0.2\nyaw_rad = 0.3\n'
    files = room(1, side, mount) | {"mission.toml": lines.encode()}
    scans = read_scan_mission(write(tmp_path / "m", files))[2]
    points = SE2.act(track(1)[scans.keyframe], scans.points)
    apart = np.linalg.norm(points[:, None] - walls()[None], axis=2).min(axis=1)
    assert apart.max() < 0.2


def test_compressed_tables_and_files_beside_them(tmp_path: Path) -> None:
    files = {f"{name}.csv.gz": gzip.compress(FILES[name]) for name in ("keyframes", "scans")}
    files |= {"README.md": b"about", "odometry.csv.gz": gzip.compress(b"time,x,y\n0,0,0\n"), "fixes.csv": b"a\n1\n"}
    with pytest.warns(GraphWarning, match=r"no file of a scan mission, not read: fixes\.csv"):
        _, _, report = nls.load(write(tmp_path / "m", files))
    assert isinstance(report, ScanReport)
    assert "not needed: odometry.csv.gz; the keyframes hold dead reckoning" in report.notes
    assert (report.truth, report.drift.mean, report.scans.mount.tolist()) == (None, 0.2, [0, 0, 0])


def test_folders_that_are_scan_missions(tmp_path: Path) -> None:
    alone = write(tmp_path / "alone", {"keyframes": FILES["keyframes"]})
    with pytest.raises(GraphFileError, match=r"has no scans\.csv; a scan mission is keyframes\.csv and scans\.csv"):
        nls.load(alone)
    other = write(tmp_path / "other", {"scans": FILES["scans"], "dvl": b"time_s\n0\n"})
    assert (is_scan_mission(alone), is_scan_mission(other), is_scan_mission(tmp_path)) == (True, False, False)
    both = write(tmp_path / "both", FILES | {"scans.csv.gz": gzip.compress(FILES["scans"])})
    with pytest.raises(GraphFileError, match=r"scans\.csv: there is scans\.csv\.gz beside it"):
        nls.load(both)
    with pytest.raises(OptionError, match="elevation"):
        nls.load(write(tmp_path / "m", FILES), elevation="hinge")


def test_what_the_settings_state_and_what_they_leave_out(tmp_path: Path) -> None:
    file = tmp_path / "mission.toml"
    for text, expected in (
        (TEXT, Settings(-1.0, (1.0, 0.0, 0.1), Drift(mean=0.05, heading=None))),
        ("", Settings()),
        ("drift.yaw = 0.5", Settings(drift=Drift(yaw=0.5))),
    ):
        file.write_text(text)
        assert read_settings(file) == expected


# file, text, other text, line, words of the error
EDITS = cases(r"""
keyframes | keyframe,time,x,y,yaw | keyframe,time,x,y,heading | 1 | unknown column 'heading'; expected keyframe,time,x
keyframes | 7,12,1 | 4,12,1 | 3 | keyframe 4 was given before, on line 2
keyframes | 7,12,1 | 2,12,1 | 3 | keyframe 2 after 4; expected numbers that rise
keyframes | 7,12,1 | 7,10,1 | 3 | time 10.0 does not rise over 10.0
keyframes | 7,12,1 | 7,nan,1 | 3 | nan
keyframes | 1,0,0.1 | 1,inf,0.1 | 3 | inf
keyframes | 1,0,0.1 | 1,2e9,0.1 | 3 | y is 2000000000.0; expected meters
keyframes | 0.5,0.2 | 0.5,12 | 4 | yaw is 12.0; expected radians
keyframes | \n7,12,1,0,0.1\n9,15,2,0.5,0.2\n | \n | 2 | is the only keyframe; expected two or more
keyframes | \n4,10,0,0,0\n7,12,1,0,0.1\n9,15,2,0.5,0.2\n | \n | 1 | has no row below its names; expected one or more
scans | 90,4,8 | 90,5,8 | 3 | keyframe 5: no such keyframe in keyframes.csv, which has 3 from 4 to 9
scans | 90,4,8 | 90,4.5,8 | 3 | 4.5
scans | 90,4,8 | 90,4,-8 | 3 | range is -8.0; expected a number above 0
scans | 90,4,8 | 90,4,2e10 | 3 | range is 20000000000.0; expected meters
scans | -0.25 | -25 | 3 | azimuth is -25.0; expected radians
scans | 80,9,5,0.5 | 80,9,5,left | 2 | left
scans | 80,9,5,0.5 | 80,9,5 | 2 | 3 cells, expected 4
scans | 80,9 | nan,9 | 2 | nan
scans | intensity,keyframe,range | intensity,keyframe,distance | 1 | unknown column 'distance'
scans | \n80,9,5,0.5\n90,4,8,-0.25\n70,9,6,0\n | \n | 1 | has no row below its names; expected one or more
truth | 13,0,4 | 8,0,4 | 3 | time 8.0 does not rise over 9.0
truth | \n9,0,0,1.5\n13 | \n13.5,0,0,1.5\n14 | 2 | keyframes of 10.0 to 15.0 s: 1 of these within, expected 2 or more
truth | 13,0,4 | 13,0,4e9 | 3 | y is 4000000000.0; expected meters
mission.toml | [sonar] | [sonnar] | 2 | unknown section 'sonnar'; expected [sonar] and [drift]; did you mean 'sonar'?
mission.toml | [sonar]\n | sonar = 3\n[sonar]\n | 3 | is no TOML
mission.toml | x_m | xm | 4 | [sonar] has no 'xm'; expected azimuth, x_m, y_m, yaw_rad; did you mean 'x_m'?
mission.toml | mean | x_m | 7 | [drift] has no 'x_m'; expected mean, stretch, length, step, yaw, heading
mission.toml | "right" | "rigth" | 3 | expected the positive side, 'left' or 'right'; did you mean 'right'?
mission.toml | "right" | -1 | 3 | azimuth is -1; expected the positive side
mission.toml | x_m = 1 | x_m = "1" | 4 | x_m is '1'; expected a number, m, within 1000
mission.toml | x_m = 1 | x_m = nan | 4 | x_m is nan
mission.toml | 0.1 | 30 | 5 | yaw_rad is 30; expected a number, rad
mission.toml | 0.05 | -0.05 | 7 | mean is -0.05; expected a number from 1e-06 to 1000
mission.toml | 0.05 | inf | 7 | mean is inf
mission.toml | 0.05 | false | 7 | mean is False; expected a number from 1e-06 to 1000
mission.toml | false | true | 8 | heading is True; expected a number from 1e-06 to 1000, or false: no compass
mission.toml | 0.05 | = | 7 | is no TOML
""")


@for_all(case=EDITS)
def test_a_damaged_table(case: list[str], tmp_path: Path) -> None:
    name, old, new, line, words = case
    files = FILES | {"mission.toml": TEXT.encode()}
    assert old.encode() in files[name]
    place = write(tmp_path / str(EDITS.index(case)), files | {name: files[name].replace(old.encode(), new.encode(), 1)})
    error = assert_refused(int(line), words, nls.load, place)
    assert error.path == str(place / (name if "." in name else f"{name}.csv"))


TITLE = "Scan missions"


def test_every_file_and_column_is_defined_and_no_other() -> None:
    columns = columns_of(section(TITLE).split("`mission.toml` says")[0])
    assert columns == {name: list(names) for name, names in COLUMNS.items()}


def test_every_key_is_shown_with_its_default(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", section(TITLE), re.M | re.S)
    shown = tomllib.loads(text)
    assert {name: tuple(keys) for name, keys in shown.items()} == SECTIONS
    assert shown["drift"] == asdict(Drift())
    (tmp_path / "mission.toml").write_text(text)
    assert read_settings(tmp_path / "mission.toml").side == -1


def test_the_folder_it_shows_is_solved(tmp_path: Path) -> None:
    shown = shown_tables(section(TITLE))
    assert list(shown) == list(COLUMNS)
    write(tmp_path / "m", {name: text.encode() for name, text in shown.items()})
    assert main(["solve", str(tmp_path / "m"), "-o", str(tmp_path / "out")]) == 0
    write(tmp_path / "room", room())
    assert main(["solve", str(tmp_path / "room"), "-o", str(tmp_path / "map")]) == 0
    outputs = section(TITLE).split("it writes into")[1]
    files = files_of(outputs)
    assert {path.name for path in (tmp_path / "map").iterdir()} == files
    assert {path.name for path in (tmp_path / "out").iterdir()} == files - {"closures.csv"}
    for name in (*TRAJECTORY, *MAP, *CLOSURES):
        assert f"`{name}`" in outputs, name
    for verdict in set(Verdict) - {Verdict.ACCEPTED}:
        assert verdict.words in outputs
