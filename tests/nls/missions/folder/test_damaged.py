"""Mission folders that cannot be right: one error with file, line, what was expected and what came; never another."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nls
from models.errors import SingularGeometryError
from nls import EvaluationError, GraphFileError, GraphWarning, ResourceLimitError
from nls.missions.folder.columns import COLUMNS, MAY_BE_0
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases
from tests.nls.missions.folder.mission_files import RAW, TINY, folder, raw

EXOTIC = ["nan", "inf", "1_0", "\uff11", "0x1A", "1e999", "--1", "north", "1 2", '"1"', "1;2", '"', "-"]
WORDS = [*EXOTIC, "#", ",", ",,", ""]
NUMBERS = ["0", "-1", "9", "1e308", "1e-308", "3.5", "007", "9223372036854775807", "9223372036854775808", "1e160"]

PLACED = raw() | {
    "poses": "i,time_s\n0,1\n1,2\n2,3\n3,4.5\n",
    "origin": "lat_deg,lon_deg\n54.1,10.2\n",
    "fixes": "time_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,delay_s,arm_x_m,arm_y_m,arm_z_m,kernel\n"
    "1,5,6,2,0.5,0.5,0.5,0,1,0,0,huber:1.345\n"
    "2.5,6,6,2,0.5,0.5,0.5,0.5,1,0,0,none\n",
    "beacons": "beacon,lat_deg,lon_deg,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n3,54.1001,10.2001,20,1,1,1\n",
    "ranges": "i,beacon,travel_time_s,sigma_travel_time_s,turn_around_s,ways\n0,3,0.04,0.001,0,2\n"
    "1,3,0.3,0.001,0.25,2\n",
    "sound-speed": "z_m,sound_speed_m_s\n0,1500\n10,1490\n",
    "usbl": "i,range_m,bearing_rad,elevation_rad,sigma_range_m,sigma_bearing_rad,sigma_elevation_rad\n"
    "2,30,0.5,0.4,0.5,0.05,0.05\n",
    "ship": "time_s,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad\n0,0,0,0,0,0,0\n60,5,0,0,0,0,0.1\n",
    "closures": "i,j,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad,sigma_x_m,sigma_y_m,sigma_z_m,sigma_roll_rad,"
    "sigma_pitch_rad,sigma_yaw_rad\n0,3,3.5,0,0.3,0,0,0,1,1,1,1,1,1\n",
    "calibration": "name,value,sigma\nfixes_clock_s,0,0\nsound_speed_scale,0,0.01\n",
}

ROV = {
    "motion": "sigma_walk_m_sqrt_s\n0.3\n",
    "fixes": "time_s,x_m,y_m,sigma_x_m,sigma_y_m,arm_x_m,arm_y_m,arm_z_m\n0,0,0,1,1,0,0,0\n3,5,5,1,1,0,0,0\n",
    "noise": ",".join(RAW["noise"][3:]) + "\n0.01,0.02,0.03,0.1\n",
}
LOG = raw()
SETS: dict[str, dict[str, str | None]] = {
    "tiny": TINY,
    "rest": {"anchor": TINY["anchor"], "contacts": TINY["contacts"], "sonar": TINY["sonar"]},
    "raw": LOG,
    "placed": PLACED,
    "gyro": LOG
    | {
        "ahrs": "time_s,roll_rad,pitch_rad\n0,0,0\n40,0,0\n",
        "gyro": ",".join(COLUMNS["gyro"]) + "\n0,0,0,0\n40,0,0,0\n",
        "noise": ",".join((*RAW["noise"], *COLUMNS["noise"][-3:])) + "\n" + ",".join(["0.01"] * 10),
    },
    "water": LOG
    | {
        "depth": None,
        "pressure": "time_s,pressure_pa\n0,201325\n40,201325\n",
        "water": "density_kg_m3\n1025\n",
        "tide": "time_s,tide_m\n-10,1\n50,4\n",
    },
    "path": {"path": "time_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n0,0,0,0,1,1,1\n1,1,1,0,1,1,1"},
    "walk": {**ROV, "ahrs": LOG["ahrs"], "depth": LOG["depth"]},
    "dry": ROV,
}

# set and file, text (* the whole file), other text (- no file, > another name), file and line of the error, its words
DAMAGED = cases(r"""
tiny.zpr | * | - | - | m: has no zpr.csv
tiny.odometry | * | - | - | m: has no odometry.csv
tiny.sonar | * | - | - | m: has contacts.csv and no sonar.csv
tiny.contacts | * | - | - | m: has sonar.csv and no contacts.csv
tiny.contacts | * | >contact | - | ; is it contact.csv?
tiny.sonar | * | >Sonar_ | - | ; is it Sonar .csv?
rest.sonar | * | - | - | m: is a folder, but no mission: a mission is odometry.csv and zpr.csv, or dvl.csv, ahrs.csv,
tiny.dvl | * | time_s | - | m: has odometry.csv and dvl.csv
tiny.ahrs | * | time_s | - | go into zpr.csv, columns yaw_rad and sigma_yaw_rad
tiny.zpr | * | i,z_m,pitch_rad,sigma_z_m\n0,1,1,1 | 1 | no column 'roll_rad'; expected i,z_m
tiny.zpr | * | i;z_m;pitch_rad;roll_rad\n0;1;1;1 | 1 | these are separated by semicolons
tiny.zpr | * | i\tz_m\tpitch_rad\troll_rad | 1 | these are separated by tabs
tiny.zpr | * | 0,5.0332,0.0005,-0.0007,0.01,0.002,0.002 | 1 | the first line must name the columns: i,z_m
tiny.zpr | * |  | 1 | is empty; expected a first line i,z_m
tiny.zpr | * | PK\x03\x04\x00 | 1 | has a zero byte
tiny.landmarks | * | landmark,x_m,y_m,z_m | 1 | has no row
tiny.truth | * | i,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n7,0,0,0,0,0,0 | 2 | pose 7 and all others are
tiny.poses | * | i,time_s\n0,1\n1,2\n2,3 | 4 | this is the last row, and pose 3 has none
tiny.poses | * | i,time_s\n0,1\n1,2\n2,3\n3,4\n4,5 | 6 | i 4
tiny.zpr | roll_rad | heel_rad | 1 | 'heel_rad'; expected i,z_m
tiny.zpr | roll_rad | z_m | 1 | repeated column 'z_m'
tiny.zpr | roll_rad | roll_roll_roll_roll_roll_roll_roll_roll_roll_ | 1 | 'roll_roll_roll_roll_roll_roll_roll_ro...'
tiny.zpr | 0,5.0332,0.0005,-0.0007,0.01,0.002,0.002 | 0;5,0332 | 2 | 2 cells, expected 7: i,z_m
tiny.zpr | 0,5.0332,0.0005,-0.0007,0.01,0.002,0.002 | 0;5.0332;0.0005 | 2 | separated by semicolons
tiny.contacts | 0,11,4.7457,0.0625,0.01,0.004 | 0,11,4.7457,0.0625,0.01,0.004,7 | 2 | 7 cells, expected 6: i,landmark
tiny.contacts | 4.7457 |  | 2 | range_m is empty
tiny.contacts | 4.7457 | nan | 2 | 'nan' is not a number [0,11,nan,0.0625,0.01,0.004]
tiny.contacts | 4.7457 | -4.7457 | 2 | range_m is -4.7457; expected a number above 0
tiny.contacts | 0.0625 | 5.9 | 2 | azimuth_rad is 5.9; expected radians, -pi to pi
tiny.contacts | 0.01,0.004 | 0.01,1e-320 | 2 | sigma_azimuth_rad is 1e-320; expected 1e-12
tiny.contacts | 0,11, | 0,1.5, | 2 | id '1.5'
tiny.contacts | 0,11, | 8,11, | 2 | i 8
tiny.odometry | 1,2, | 1,1, | 3 | pose 1 to itself
tiny.zpr | \n3, | \n2, | 5 | pose 2 was given before, on line 4
tiny.zpr | \n3, | \n4, | 5 | i 4: odometry.csv
tiny.zpr | -0.0313 | 2.5 | 3 | pitch_rad is 2.5; expected radians, between -pi/2 and pi/2
tiny.zpr | -0.0313 | 1.5707963267948966 | 3 | pitch_rad is 1.5707963267948966
tiny.truth | 5.1 | -1e308 | 3 | z_m is -1e+308; expected meters, within 1e9
tiny.anchor | \n0, | \n9, | 2 | i 9
tiny.sonar | ,1.0,6.0, | ,6.0,1.0, | 2 | window: (6.0, 1.0)
tiny.sonar | ,96, | ,0, | 2 | beams: 0
tiny.sonar | frequency" | frequency | 2 | quotation mark
raw.dvl | 0.5,1.0,0.0,0.0,1 | 0.5,1.0,0.0,0.0,true | 4 | valid is 'true'
raw.dvl | 0.5,1.0,0.0,0.0,1 | 0.5,1.0,0.0,0.0,1.5 | 4 | valid is '1.5'
raw.dvl | 0.5,1.0 | 0.25,1.0 | 4 | time_s 0.25 does not rise over 0.25 before it; delete one
raw.dvl | 0.5,1.0 | 0.125,1.0 | 4 | time_s 0.125 does not rise over 0.25 before it; sort
raw.dvl | 0.5,1.0 | 0.5,1e308 | 4 | vx_m_s is 1e+308; expected meters per second, within 1e9
raw.ahrs | 0.5,0.0,0.0 | 0.5,0.0,2.0 | 4 | pitch_rad is 2.0
raw.noise | 0.002,0.05 | -0.1,0.05 | 2 | scale is -0.1; expected 0 or above
raw.ahrs | * | - | - | m: has no ahrs.csv
raw.depth | * | time_s,z_m\n0,1\n0.5,1 | dvl:- | the logs have less than a second in common: dvl.csv 0.0 to
raw.poses | * | i,time_s\n2,-1\n3,4 | 2 | pose 2 is at -1.0 s, not within all logs: dvl.csv 0.0 to 30.0 s, ahrs.csv
raw.poses | * | i,time_s\n2,1 | 2 | one pose
raw.truth | * | roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n0,0,0,0,0,0 | 2 | has neither i nor time_s
raw.truth | * | i,time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n0,0,0,0,0,0,0,0 | 2 | has both i and time_s
raw.truth | * | time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n50,0,0,0,0,0,0 | 2 | no time in common
raw.dvl | * | time_s,vx_m_s,vy_m_s,vz_m_s\n0,1,0,0\n1,1,0,0 | - | has no column 'valid' and none 'beams'
raw.dvl | * | time_s,vx_m_s,vy_m_s,vz_m_s,beams\n0,1,0,0,-1\n1,1,0,0,4 | 2 | beams is -1; expected how many see the bott
raw.dvl | * | time_s,vx_m_s,vy_m_s,vz_m_s,beams\n0,1,0,0,2\n1,1,0,0,4 | - | 1 of 2 rows are valid; expected two
raw.calibration | * | name,value,sigma\ndvl_scal,0,0.01 | 2 | no calibration is called 'dvl_scal'
raw.calibration | * | name,value,sigma\ndvl_scale,0,-1 | 2 | sigma is -1.0; expected a standard deviation, or 0
raw.tide | * | time_s,tide_m\n0,1 | 2 | depth.csv has depths; tide.csv is for pressure.csv
raw.pressure | * | time_s,pressure_pa\n0,1 | - | has depth.csv and pressure.csv, the depth twice
gyro.ahrs | * | time_s,roll_rad,pitch_rad,yaw_rad\n0,0,0,0\n40,0,0,0 | gyro:- | gives the yaw, and ahrs.csv has
gyro.gyro | * | - | ahrs:- | has no column 'yaw_rad', and there is no gyro.csv
gyro.noise | ,sigma_w_rad_s_sqrt_hz | ,gate_v_m_s | 2 | there is no column sigma_w_rad_s_sqrt_hz, which gyro
raw.noise | sigma_yaw_rad | gate_v_m_s | 2 | there is no column sigma_yaw_rad, which ahrs.csv needs
gyro.gyro | 0,0,0,0 | 0,0,0,300 | 2 | wz_rad_s is 300.0; expected radians per second, within 100
gyro.calibration | * | name,value,sigma\ndeclination_rad,0.1,0 | 2 | no measurement of this mission depends on declin
water.water | * | - | pressure:2 | nothing gives the density of the water; add water.csv
water.water | * | density_kg_m3,latitude_deg\n1025,60 | 2 | both give the density
water.water | * | density_kg_m3\n-3 | 2 | density_kg_m3 is -3.0; expected a number above 0
water.water | * | latitude_deg\n100 | 2 | latitude_deg is 100.0; expected -90 to 90
water.tide | * | time_s,tide_m\n0,1\n20,2 | 2 | the tide is known from 0.0 to 20.0 s
path.dvl | * | time_s\n0 | - | has path.csv and dvl.csv, the motion twice
path.path | \n1,1,1,0,1,1,1 |  | 2 | one pose
walk.noise | * | - | ahrs:1 | has no sigma; write noise.csv with one row of sigma_roll_rad, sigma_pitch_
walk.noise | * | sigma_z_m\n0.1 | 2 | there is no column sigma_roll_rad, which ahrs.csv needs
walk.ahrs | * | time_s\n0\n1 | 1 | has times and no angle
dry.tide | * | time_s,tide_m\n0,1 | 2 | is for pressure.csv, which is not there
dry.fixes | 1,1,0,0,0 | 1,1,1,0,0 | 2 | has a lever arm; leave the arm out, or write roll_rad and pitch_rad and
walk.dvl | * | time_s\n0 | - | has motion.csv and dvl.csv, the motion twice
walk.gyro | * | time_s,wx_rad_s,wy_rad_s,wz_rad_s\n0,0,0,0 | - | has motion.csv and gyro.csv
walk.fixes | * | time_s,x_m,y_m,sigma_x_m,sigma_y_m\n90,0,0,1,1\n93,5,5,1,1 | motion:2 | while all 2 logs of sensors las
walk.fixes | * | - | motion:2 | fewer than two times
raw.fixes | * | time_s,x_m,y_m,sigma_x_m,sigma_y_m,arm_x_m\n1,5,6,1,1,1 | 1 | has arm_x_m and no arm_y_m;
raw.fixes | * | time_s,x_m,y_m,sigma_x_m,sigma_y_m,z_m\n1,5,6,1,1,1 | 1 | has z_m and no sigma_z_m; they need each other
placed.fixes | time_s | i | 1 | has delay_s and no time_s
placed.usbl | i,range_m | kernel,range_m | 1 | has neither; expected either time_s or i
placed.fixes | x_m,y_m | x_m,lat_deg | 1 | has x_m and lat_deg; expected either x_m and y_m or lat_deg and lon_deg
placed.fixes | huber:1.345 | hubert | 2 | kernel is 'hubert'; expected one such as huber:1.345
placed.fixes | huber:1.345 | huber:-1 | 2 | kernel is 'huber:-1'
placed.fixes | \n2.5, | \n2.6, | 3 | no pose is at 2.1 s; the nearest is pose 1 at 2.0 s. Add a pose at this time to pos
placed.fixes | arm_z_m | i | 1 | has time_s and i
placed.origin | 54.1 | 154.1 | 2 | lat
placed.beacons | 54.1001,10.2001 | 10.2001,54.1001 | 2 | ; with lat_deg, lon_deg exchanged it is
placed.beacons | 54.1001 | 91 | 2 | lat_deg is 91.0; expected degrees, -90 to 90
placed.beacons | 54.1001 | 14.1001 | 2 | km from origin.csv; expected at most 1,000 km
placed.beacons | beacon,lat | i,lat | 1 | unknown column 'i'
placed.beacons | sigma_x_m | x_m | 1 | has x_m and lat_deg
placed.ranges | sigma_travel_time_s | sigma_range_m | 1 | has sigma_range_m and travel_time_s; expected either range_m a
placed.ranges | i,beacon | i,range_m | 1 | no column 'beacon'
placed.ranges | 0.3,0.001 | 0.25,0.001 | 3 | travel_time_s is 0.25, of which 0.25 s are the turn-around
placed.ranges | 0.04,0.001,0,2 | 0.04,0.001,-1,2 | 2 | turn_around_s is -1.0
placed.ranges | 0.04,0.001,0,2 | 0.04,0.001,0,3 | 2 | ways is 3; expected 1, or 2
placed.ranges | \n1,3 | \n7,3 | 3 | i 7: no such pose in the track
placed.sound-speed | 1490 | 4900 | 3 | sound_speed_m_s is 4900.0; expected m/s, near 1500
placed.usbl | 0.4,0.5 | 1.8,0.5 | 2 | elevation_rad is 1.8; expected radians, -pi/2 to pi/2
placed.ship | \n60 | \n1 | usbl:2 | is at 3.0 s, and no row is within the times of ship.csv, 0.0 to 1.0 s
placed.closures | 0,3,3.5 | 3,3,3.5 | 2 | the closure connects pose 3 to itself
placed.closures | 0,3,3.5 | 0,9,3.5 | 2 | j 9: no such pose in the track
placed.closures | i,j | i,time_j_s | 1 | has time_j_s and i; expected either time_i_s and time_j_s or i and j
placed.calibration | fixes_clock_s | ranges_clock_s | 2 | no measurement of this mission depends on ranges_clock_s
placed.calibration | fixes_clock_s,0,0 | fixes_clock_s,0.7,0 | fixes:2 | no pose is at 0.3 s; the nearest is pose 0 at 1
""")


def changed(case: list[str], path: Path) -> Path:
    """The folder of a row."""
    (name, file), old, new = case[0].split("."), case[1], case[2].encode().decode("unicode_escape")
    files = SETS[name]
    text = str(files.get(file, ""))
    assert old == "*" or old in text
    if new[:1] == ">":
        return folder(path, {**files, file: None, new[1:].replace("_", " "): text})
    return folder(path, {**files, file: None if new == "-" else new if old == "*" else text.replace(old, new, 1)})


@for_all(case=DAMAGED)
def test_a_damaged_file(case: list[str], tmp_path: Path) -> None:
    above = tmp_path / str(DAMAGED.index(case))
    above.mkdir()
    place = changed(case, above / "m")
    file, _, line = case[3].rpartition(":")
    error = assert_refused(None if line == "-" else int(line), case[4], nls.load, place)
    own = str(place / f"{file or case[0].split('.')[1]}.csv")
    assert error.path == own or (line == "-" and error.path == str(place))


WHOLE = {name: files for name, files in SETS.items() if name not in ("rest", "dry")}
SEVERAL = {"contacts", "odometry", "fixes", "ranges", "usbl", "closures"}  # files that may measure a thing twice


@for_all(name=WHOLE)
def test_no_exotic_number_gets_through(name: str, tmp_path: Path) -> None:
    """In every column of every file a word that is no number, one after the other, and a number beyond all bounds.

    No sigma and no range is 0.
    """
    words, files = cycle(EXOTIC), WHOLE[name]
    assert nls.load(folder(tmp_path / name, files))[1]
    for file, text in ((file, text) for file, text in files.items() if text):
        head, *lines = text.splitlines()
        cells = lines[-1].split(",")
        for k in range(2 if file == "sonar" else 0, len(cells)):
            column = head.split(",")[k - len(cells)]  # the quoted name of the sonar has a comma
            zero = ["0"] * (column.startswith(("sigma_", "range_m")) and column not in MAY_BE_0)
            for word in (next(words), "inf" if file == "sonar" else "1e308", *zero):
                damaged = "\n".join([head, *lines[:-1], ",".join([*cells[:k], word, *cells[k + 1 :]])])
                place = folder(tmp_path / name, {file: damaged})
                assert assert_refused(len(lines) + 1, "", nls.load, place).path.endswith(f"{file}.csv")
        folder(tmp_path / name, {file: text})


@for_all(name=WHOLE)
def test_no_row_of_a_pose_a_time_or_a_name_is_there_twice(name: str, tmp_path: Path) -> None:
    for file, text in WHOLE[name].items():
        if text and file not in SEVERAL:
            rows = text.splitlines()
            place = folder(tmp_path / name, WHOLE[name] | {file: "\n".join([*rows, rows[-1]])})
            error = assert_refused(len(rows) + 1, "", nls.load, place)
            assert any(words in str(error) for words in ("was given before, on line", "does not rise over", "a second"))


def test_folders_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes\n.txt").write_text("")
    assert_refused(None, "; it is empty", nls.load, tmp_path / "empty")
    assert_refused(None, "; it has notes\\n.txt", nls.load, tmp_path / "other")
    m = folder(tmp_path / "m", zpr=None)
    file = m / "zpr.csv"
    for make, remove, problem in (
        (file.mkdir, file.rmdir, "is a folder"),
        (lambda: os.mkfifo(file), file.unlink, "is a pipe"),  # which is not waited for
        (lambda: file.symlink_to(tmp_path / "gone.csv"), file.unlink, "cannot be read: No such file"),
    ):
        make()
        assert_refused(None, f"zpr.csv: {problem}", nls.load, m)
        remove()


def refusal(path: Path) -> str:
    """The error of the library; empty where there is a graph of finite numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)
        try:
            graph, values, report = nls.load(path)
        except (GraphFileError, ResourceLimitError) as error:
            return str(error)
    assert all(np.isfinite(stack.X).all() for stack in values.stacks.values())
    assert str(report)
    with suppress(EvaluationError, SingularGeometryError):  # too far off, or at the sonar
        assert np.isfinite(graph.chi2(values))
    return ""


EDIT = st.tuples(
    st.sampled_from(sorted(TINY)), st.integers(0, 4), st.integers(0, 10**6), st.sampled_from(WORDS + NUMBERS)
)


@given(edits=st.lists(EDIT, min_size=1, max_size=3))
@settings(max_examples=75, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_of_any_kind(edits: list[tuple[str, int, int, str]], tmp_path: Path) -> None:
    files = dict(TINY)
    for name, act, place, word in edits:
        lines = files[name].splitlines() or [""]
        row, k = divmod(place, len(lines))
        line, cells = lines[k], lines[k].split(",")
        j = row % len(cells)
        other = ",".join([*cells[:j], word, *cells[j + 1 :]])
        byte = line[:j] + chr(place % 300) + line[j + 1 :]
        lines[k : k + 1] = ([], [line, line], [line[: 3 * j]], [other], [byte])[act]
        files[name] = "\n".join(lines)
    assert (refusal(folder(tmp_path / "m", files)) or str(tmp_path)).startswith(str(tmp_path))


def test_the_undamaged_folders_are_read(tmp_path: Path) -> None:
    assert not refusal(folder(tmp_path / "m"))
    graph, values, _ = nls.load(folder(tmp_path / "placed", PLACED))
    assert [factor.name for factor in graph.factors[3:]] == [
        *("Position", "Position", "Between", "Prior", "ScaledRange", "BearingRange", "Prior")
    ]
    assert graph.optimize(values).converged
    files = raw(lost=(5.0, 8.0))  # velocities without bottom lock may be anything
    assert nls.load(folder(tmp_path / "lost", files, dvl=files["dvl"].replace("99.0", "1e308")))[1]


def test_the_folder_of_a_solution_names_the_mission_around_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    solved = folder(tmp_path / "dive", TINY) / "solved"
    solved.mkdir()
    (solved / "trajectory.csv").touch()
    with pytest.raises(GraphFileError, match=r"is the solution of a mission, not a mission; give dive instead"):
        nls.load("dive/solved/")
    nls.load("dive")
