"""Tables of fixes, beacons, ranges, directions and closures that cannot be right: one error with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

import nls
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases
from tests.nls.missions.folder.mission_files import folder, raw

FILES = raw() | {
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

# file, text, other text, line, words of the error
EDITS = cases(r"""
fixes | time_s | i | 1 | has delay_s and no time_s
usbl | i,range_m | kernel,range_m | 1 | has neither; expected either time_s or i
fixes | x_m,y_m | x_m,lat_deg | 1 | has x_m and lat_deg; expected either x_m and y_m or lat_deg and lon_deg
fixes | x_m,y_m | lat_deg,lon_deg | 2 | km from origin.csv
fixes | \n1,5,6 | \n1,1e10,6 | 2 | x_m is 10000000000.0
fixes | huber:1.345 | hubert | 2 | kernel is 'hubert'; expected one such as huber:1.345
fixes | huber:1.345 | huber:-1 | 2 | kernel is 'huber:-1'
fixes | \n2.5, | \n2.6, | 3 | no pose is at 2.1 s; the nearest is pose 1 at 2.0 s. Add a pose at this time to poses.csv
fixes | arm_z_m | i | 1 | has time_s and i
fixes | 0.5,0.5,0.5,0, | 0,0.5,0.5,0, | 2 | sigma_x_m is 0.0
origin | 54.1 | 154.1 | 2 | lat
beacons | 54.1001 | 91 | 2 | lat_deg is 91.0; expected degrees, -90 to 90
beacons | 54.1001 | 14.1001 | 2 | km from origin.csv; expected at most 1,000 km
beacons | beacon,lat | i,lat | 1 | unknown column 'i'
beacons | sigma_x_m | x_m | 1 | has x_m and lat_deg
ranges | sigma_travel_time_s | sigma_range_m | 1 | has sigma_range_m and travel_time_s; expected either range_m and
ranges | i,beacon | i,range_m | 1 | no column 'beacon'
ranges | 0.3,0.001 | 0.25,0.001 | 3 | travel_time_s is 0.25, of which 0.25 s are the turn-around
ranges | 0.04,0.001,0,2 | 0.04,0.001,-1,2 | 2 | turn_around_s is -1.0
ranges | 0.04,0.001,0,2 | 0.04,0.001,0,3 | 2 | ways is 3; expected 1, or 2
ranges | \n1,3 | \n7,3 | 3 | i 7: no such pose in the track
sound-speed | 10,1490 | 0,1490 | 3 | z_m 0.0 does not rise over 0.0
sound-speed | 1490 | 4900 | 3 | sound_speed_m_s is 4900.0; expected m/s, near 1500
usbl | 0.4,0.5 | 1.8,0.5 | 2 | elevation_rad is 1.8; expected radians, -pi/2 to pi/2
usbl | 2,30 | 2,-30 | 2 | range_m is -30.0; expected a number above 0
ship | \n60 | \n1 | 2 | is at 3.0 s, and no row is within the times of ship.csv, 0.0 to 1.0 s
ship | \n0,0,0 | \n70,0,0 | 3 | time_s 60.0 does not rise over 70.0
closures | 0,3,3.5 | 3,3,3.5 | 2 | the closure joins pose 3 to itself
closures | 0,3,3.5 | 0,9,3.5 | 2 | j 9: no such pose in the track
closures | i,j | i,time_j_s | 1 | has time_j_s and i; expected either time_i_s and time_j_s or i and j
calibration | fixes_clock_s | ranges_clock_s | 2 | no measurement of this mission has a ranges_clock_s
calibration | fixes_clock_s,0,0 | fixes_clock_s,0.7,0 | 2 | no pose is at 0.3 s; the nearest is pose 0 at 1.0 s
""")


@for_all(case=EDITS)
def test_a_damaged_table(case: list[str], tmp_path: Path) -> None:
    name, old, new, line, words = case
    assert old in FILES[name]
    place = folder(tmp_path / str(EDITS.index(case)), {**FILES, name: FILES[name].replace(old, new, 1)})
    error = assert_refused(int(line), words, nls.load, place)
    owner = {"fixes_clock_s,0.7,0": "fixes", "\n1": "usbl"}.get(new, name)  # the file of the row that does not fit
    assert error.path == str(place / f"{owner}.csv")


def test_the_undamaged_tables_are_read(tmp_path: Path) -> None:
    graph, values, _ = nls.load(folder(tmp_path / "m", FILES))
    assert [factor.name for factor in graph.factors[3:]] == [
        *("Position", "Position", "Between", "Prior", "ScaledRange", "BearingRange", "Prior")
    ]
    assert graph.optimize(values).converged


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("arm_x_m", "has arm_x_m and no arm_y_m; they need each other"),
        ("z_m", "has z_m and no sigma_z_m; they need each other"),
    ],
)
def test_columns_that_need_each_other(columns: str, words: str, tmp_path: Path) -> None:
    fixes = f"time_s,x_m,y_m,sigma_x_m,sigma_y_m,{columns}\n1,5,6,1,1,1\n"
    assert_refused(1, words, nls.load, folder(tmp_path / "m", raw(), fixes=fixes))
