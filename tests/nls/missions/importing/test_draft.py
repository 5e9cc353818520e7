"""Mappings: drafts by the names of columns, templates that read back, and each mistake with its line."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path

import numpy as np

from nls.missions.folder.columns import COLUMNS, OPTIONAL
from nls.missions.folder.table import Table
from nls.missions.importing import Mapping, templates
from tests.combinations import for_all
from tests.nls.io.g2o_files import cases
from tests.nls.missions.importing.logs import drafted, imported, line, refused

ODOMETRY = "time,x_odo [m],y_odo [m],depth [m],heading [deg]\n0,0,0,4,0\n2,1,0,4,9\n"
ECHOES = "time,target,range [m],bearing [deg]\n0,1,6.9,15.8\n1,4,10.8,48.9\n"


def test_odometry_is_a_path_and_ranges_with_bearings_are_contacts(tmp_path: Path) -> None:
    """The sonar of the draft is that of its template."""
    logs = {"odometry": ODOMETRY, "echoes": ECHOES}
    text = drafted(tmp_path, **logs)
    assert not any(row.startswith(("# [", "# not used", "[noise]", "[depth]")) for row in text.splitlines())
    result = imported(tmp_path, text, **logs)
    assert result.rows == {"path": 2, "contacts": 2, "sonar": 1}
    assert not any("nls solve needs" in note for note in result.notes)
    assert line(result, "path", 2).startswith("2.0,1.0,0.0,4.0,0.157")
    assert line(result, "contacts").startswith("0.0,1,6.9,0.2757")
    names, values = templates()["templates/sonar.csv"].decode().splitlines()[-2:]
    row = dict(zip(names.split(","), next(csv.reader([values.removeprefix("# ")])), strict=True))
    assert row == {name: str(value) for name, value in tomllib.loads(text)["sonar"].items()}


@for_all(case=[("x", "truth"), ("x_odo", "path")])
def test_whole_poses_are_a_truth_unless_their_name_says_odometry(case: tuple[str, str], tmp_path: Path) -> None:
    name, table = case
    text = drafted(tmp_path, log=f"time,{name},y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n1,1,0,0,0,0,0\n")
    assert f"\n[{table}]\n" in text
    assert ("[ahrs]\ntime_s" in text) == (table == "truth")


def test_a_heading_alone_is_the_attitude_of_a_level_vehicle(tmp_path: Path) -> None:
    """Unless another log has a whole attitude."""
    compass, ahrs = "time,Heading [deg]\n0,90\n1,90\n", "time,roll [deg],pitch [deg],yaw [deg]\n0,1,2,90\n1,1,2,90\n"
    result = imported(tmp_path, drafted(tmp_path, compass=compass), compass=compass)
    assert line(result, "ahrs") == f"0.0,0.0,0.0,{np.pi / 2!r}"
    assert tomllib.loads(drafted(tmp_path, compass=compass, ahrs=ahrs))["ahrs"]["file"] == "ahrs.csv"


@for_all(
    case=[
        ("BT_Vel_Fwd,BT_Vel_Stbd,BT_Vel_Down", "1,2,3", "0.0,1.0,2.0,3.0,1"),
        ("BT_Vel_Up,BT_Vel_Port,WT_Vel_Fwd,BT_Vel_Fwd", "1,2,3,4", "0.0,4.0,-2.0,-1.0,1"),
        ("V North,V East,V Down", "1,2,3", ""),
        ("V North,V East,Vel_Fwd,Vel_Stbd,Vel_Down", "1,2,3,4,5", ""),
    ]
)
def test_velocities_along_the_axes_of_the_vehicle_have_their_signs(case: tuple[str, str, str], tmp_path: Path) -> None:
    """Also where names are short; those over ground by north, east and down are none."""
    log = f"time,{case[0]}\n0,{case[1]}\n"
    text = drafted(tmp_path, log=log)
    assert ("\n[dvl]" in text) == bool(case[2])
    assert not case[2] or line(imported(tmp_path, text, log=log), "dvl") == case[2]


def test_small_angles_are_in_degrees_where_the_heading_is(tmp_path: Path) -> None:
    log = "time,HDG_mag,HDG_true,Pitch,Roll\n0,85,90,2,0\n1,85,90,2,0\n"
    ahrs = line(imported(tmp_path, drafted(tmp_path, log=log), log=log), "ahrs")
    assert ahrs == f"0.0,0.0,{float(np.radians(2))!r},{np.pi / 2!r}"


@for_all(case=[("Slant range", "beacon = 1"), ("slant_range,Beacon", 'beacon = "Beacon"'), ("range", "")])
def test_a_range_is_one_to_a_beacon_where_its_name_says_so(case: tuple[str, str], tmp_path: Path) -> None:
    text = drafted(tmp_path, log=f"time,{case[0]}\n0,12.5{',3' * case[0].count(',')}\n")
    assert ("[ranges]" in text) == bool(case[1])
    assert case[1] in text


def test_a_log_without_a_dvl_is_of_fixes_and_a_walk(tmp_path: Path) -> None:
    """Velocities north, east and down of an EKF are no DVL, the lock of a GPS no bottom lock."""
    names = "Timestamp,roll,pitch,heading,altitudeRelative,gps.lat,gps.lon,gps.lock,localPosition.vx,localPosition.vy,"
    row = "2022-08-15 09:56:0{}.8,4,5,190,-2,54.1,10.2,3,.1,.2,.3,7\n"
    rov = f"{names}localPosition.vz,headingSetpoint\n{row.format(0)}{row.format(1)}"
    sections = tomllib.loads(drafted(tmp_path, rov=rov))
    assert {*sections} == {"ahrs", "depth", "fixes", "motion", "noise"}
    assert {*sections["noise"]} == {"sigma_roll_rad", "sigma_pitch_rad", "sigma_yaw_rad", "sigma_z_m"}
    assert sections["depth"]["z_m"] == {"column": "altitudeRelative", "up": True}


def test_measured_columns_come_before_commanded_ones(tmp_path: Path) -> None:
    """A Slocum glider: stamps since 1970 before times of a mission, degrees and minutes by their size."""
    glider = (
        "m_climb_tot_time,c_heading,c_pitch,c_wpt_lat,m_present_time,m_heading,m_pitch,m_roll,m_gps_lat,m_gps_lon\n"
    )
    sections = tomllib.loads(
        drafted(tmp_path, glider=glider + "-1,1,1,3306,1774571917.1,2.9,.6,0,3305.7966,-11746.4556\n")
    )
    assert sections["fixes"]["time_s"] == sections["ahrs"]["time_s"] == "m_present_time"
    assert sections["fixes"]["lat_deg"] == {"column": "m_gps_lat", "unit": "ddmm"}
    assert [sections["ahrs"][name]["column"] for name in ("yaw_rad", "pitch_rad")] == ["m_heading", "m_pitch"]


def test_the_height_over_the_bottom_is_no_depth(tmp_path: Path) -> None:
    log = "time,timestamp,vx,vy,vz,altitude,beam_1_valid,velocity_valid\n202.9,1639747615.3,0,0,0,4.7,0,1\n"
    sections = tomllib.loads(drafted(tmp_path, log=log))
    assert {*sections} == {"dvl", "noise"}
    assert (sections["dvl"]["time_s"], sections["dvl"]["valid"]) == ("timestamp", "velocity_valid")


def test_columns_without_a_time_are_named(tmp_path: Path) -> None:
    text = drafted(tmp_path, boat="Latitude,Longitude,Depth_in_Feet\n17.97,-67.01,10.5\n")
    assert "# [fixes]   # 'Latitude', 'Longitude': no column looks like their time" in text.splitlines()


def test_every_template_reads_back(tmp_path: Path) -> None:
    files = templates()
    assert set(files) == {"mapping.toml", *(f"templates/{name}.csv" for name in COLUMNS)}
    for name, columns in COLUMNS.items():
        text = files[f"templates/{name}.csv"].decode()
        *comments, head, example = text.splitlines()
        assert all(line.startswith("# ") for line in [*comments, example])
        assert not head.startswith("#")
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join([*comments, head, example.removeprefix("# ")]) + "\n")
        table = Table(file, columns, OPTIONAL.get(name, ()))
        assert len(table) == 1
        table.measured(*(column for column in table.names if column not in ("name", "kernel")))


def test_the_mapping_is_one_when_uncommented() -> None:
    text = templates(mapping=True)["mapping.toml"].decode()
    assert [section.table for section in Mapping(text, "m.toml").sections] == ["noise"]
    sections = re.sub(r"^# (?=\[|\w+ *= \")", "", text.split("\n\n# time_s")[1].split("\n", 1)[1], flags=re.M)
    tables = [section.table for section in Mapping(sections, "m.toml").sections]
    assert tables == ["dvl", "ahrs", "depth", "path", "motion", "fixes", "contacts", "sonar", "noise"]


LOG = "t,depth,word,Altitude [m],p [dbar],late\n0,5,deep,-5,5,0\n1,5,deep,-5,5,700000\n"
DEPTH = '[depth]\ntime_s = "t"\nz_m = "depth"'

# a mapping, of which DEPTH stands for the three lines above; words of the error
REFUSED = cases(r"""
[dvl | :1: is no TOML
a = 1\n\nb = "x\n | :3: is no TOML
[dvl]\nvalid = [1, 2\n\n\n\n | :2: is no TOML: Unclosed array
[dvl]\nvalid = [1, 2\n\n\nvx_m_s = 3 | :2: is no TOML: Unclosed array
[dvl]\nvalid = '''abc\n\n\n | :2: is no TOML: Expected "'''"
[dvl]\nvalid =\n\n\n | :2: is no TOML: Invalid value
 | mapping.toml: has no section
[dvll] | :1: [dvll] is no table of a mission; did you mean 'dvl'?
seperator = ';'\n[dvl] | :1: 'seperator' is no table of a mission and no option; did you mean 'separator'?
[depth]\nz_m = 1\n\n[dvl]\nvx = "u" | :5: dvl.csv has no column 'vx'; did you mean 'vx_m_s'?; write vx_m_s = "u"
[fixes]\nvalid = "ok" | :2: fixes.csv has no column 'valid'; select rows: where = { column = "ok", equals = true }; it
dvl.vx = "u" | :1: dvl.csv has no column 'vx'
dvl = { time_s = "t", vx = "u" } | :1: dvl.csv has no column 'vx'
[contacts]\ncolour = "red" | :2: contacts.csv has no column 'colour'; it has i, time_s, landmark
[dvl]\nvelocity = ["a", "b"] | :2: velocity is ['a', 'b']; expected a list for vx_m_s, vy_m_s, vz_m_s
[dvl]\nvx_m_s = { colum = "a" } | :2: vx_m_s: 'colum' is no key of a column; did you mean 'column'?
[dvl]\nvx_m_s = { column = "a", unit = "m" } | unit 'm' is not one of m/s, mm/s
[dvl]\nvx_m_s = { column = "a", unit = [] } | :2: vx_m_s: unit [] is not one of m/s, mm/s
[dvl]\nvx_m_s = { column = "a", sign = 2 } | sign is 2; expected 1 or -1
[dvl]\nvx_m_s = { column = "a", unit = "m/s", scale = 2 } | unit and scale are both given
[dvl]\nvx_m_s = { column = "a", up = true } | up = true is for z_m alone
[dvl]\nvx_m_s = { column = "a", scale = nan } | :2: vx_m_s: scale is nan; expected a finite number
[dvl]\nvx_m_s = { column = "a", scale = 0 } | scale is 0; expected a finite number other than 0
[dvl]\nvx_m_s = [1] | vx_m_s: [1] is not possible; expected the name of a column
[dvl]\nframe = "ENV" | :2: frame is 'ENV'; expected one of NED, ENU
[dvl]\nskip = -1 | skip is -1; expected a whole number
[ahrs]\nquaternion = [1, 2] | expected a list of 4 columns, or of 4 numbers: x, y, z, w
[fixes]\nx_m = "x"\nsigma_x_m = -2 | :3: sigma_x_m: -2 is not possible; expected a standard deviation above 0, 1e-12 to
[noise]\nsigma_z_m = 0.0 | :2: sigma_z_m: 0.0 is not possible
[noise]\nscale = -0.1 | :2: scale: -0.1 is not possible; expected 0 or above
[noise]\nsigma_z_m = inf | :2: sigma_z_m: inf is not possible; expected a finite number
[path]\nx_m = 1\nsigma_position = [1, 0, 1] | :3: sigma_y_m: 0 is not possible
[[fixes]]\nx_m = "x"\n[[fixes]]\nx_m = 1\nsigma_x_m = 0 | :5: sigma_x_m: 0 is not possible
[poses]\ni = { row = 10000000000000000000000000000000000000000 } | :2: i: row is 1000
[poses]\ni = { row = true } | row is True; expected the number of the first row, such as { row = 0 }
[sonar]\nname = '''a\nb''' | expected one line [name = '''a]
time_s = "t"\nseparator = "ab"\n\n[depth]\nz_m = "depth" | :2: separator is 'ab'
DEPTH\nmissing = true | :4: missing is True; expected numbers and words that mean a missing value
DEPTH\nmissing = [1, []] | :4: missing is [1, []]; expected numbers
DEPTH\nmissing = { z = 1 } | :4: missing: 'z' is not mapped here; did you mean 'z_m'?
DEPTH\nmissing = inf | :4: missing is inf; expected
DEPTH\nrows = [] | :4: rows is []; expected [first], or [first, last]
DEPTH\nrows = [9] | :4: rows = [9] leaves no row
DEPTH\nmissing_together = 0 | :4: missing_together is 0; expected a table of numbers by column
DEPTH\nmissing_together = { z = 0 } | :4: missing_together: 'z' is not mapped here; did you mean 'z_m'?
DEPTH\ntime_format = 5 | :4: time_format is 5; expected how times are written, such as '%m/%d/%Y
DEPTH\ntime_format = "%m/%d %H:%M" | :4: time_format = '%m/%d %H:%M' names no year; expected %Y or %y, or write `date =
DEPTH\ntime_format = "%Y %H:%M" | :4: time_format = '%Y %H:%M' reads 2022-08-25 13:59 as 2022-01-01 13:59
DEPTH\ntime_format = "%Y %Q" | 'Q' is a bad directive
DEPTH\ntime_format = "%Y %Y" | has a directive twice
DEPTH\ntime_format = "%d.%m.%Y %H:%M %Z" | write %z for +02:00
DEPTH\ntime_format = "%Y%m%d %H" | log.csv:2: '0' does not fit %Y%m%d %H, of a year in 1970 to 2190; expected
DEPTH\ndate = "15.08.2022" | :4: date is '15.08.2022'; expected the day of the first row
DEPTH\ndate = "2022-08-15"\ntime_format = "%d.%m.%Y %H:%M" | has a date and so has date; leave date out
DEPTH\n[noise]\ntime_format = "%Y" | :5: [noise] has no column of times; leave time_format out
DEPTH\n[poses]\ni = 0\ntime_s = 1\ndate = "2022-08-15" | [poses] has no column of times; leave date out
[depth]\ntime_s = "late"\nz_m = "depth"\ndate = "2022-08-15" | log.csv:3: 700000 s is later than a day or a week of GPS;
[depth]\ntime_s = "t"\nz_m = "dept" | :3: log.csv has no column 'dept'; write z_m = "depth"; it has
[depth]\ntime_s = "t" | :1: [depth] has no z_m; write z_m = "depth"
[depth]\ntime_s = "t"\nz_m = "Altitude [m]" | write z_m = { column = "Altitude [m]", up = true }, or up = false
[depth]\ntime_s = "t"\nz_m = "p [dbar]" | 'p [dbar]' is in dbar, pressure; z_m is a length, m; scale and offset
[depth]\ntime_s = "t"\nz_m = { column = "depth", unit = "dbar" } | ; of a pressure give scale
[depth]\ntime_s = "t"\nz_m = "word" | 'deep' is not a number; correct it, or name another column; in the mapping write
[depth]\ntime_s = "word"\nz_m = "depth" | log.csv:2: word: 'deep' is not a number
[depth]\ntime_s = 3\nz_m = "depth" | time_s is a constant, and times rise
[depth]\ntime_s = "Altitude [m]"\nz_m = "depth" | 'Altitude [m]' is in m, length; time_s is a time, s
[depth]\ntime_s = { column = "t", scale = 1e10 }\nz_m = "depth" | log.csv:3: t: 1e+10 s is no time
DEPTH\njoin = 3 | mapping.toml:4:
DEPTH\nskip = 9 | has no row; expected a line of names and rows of values; correct skip
DEPTH\nwhere = { column = "x", equals = 1 } | mapping.toml:4:
sonar.file = "log.csv" | mapping.toml:1: [sonar] uses no column of log.csv; name one of its columns, or leave file out
[motion]\nsigma_walk_m_sqrt_s = 1 | mapping.toml: uses no column of log.csv; write the name of one
""")


@for_all(case=REFUSED)
def test_a_mapping_is_refused(case: list[str], tmp_path: Path) -> None:
    assert case[1] in refused(tmp_path, case[0].replace("DEPTH", DEPTH) + "\n", log=LOG)


@for_all(
    case=cases(r"""
t,z\n0,1,5 | log.csv:2: 3 cells, expected 2: t, z; in the mapping where =
t,z,z\n0,1,2 | header = false and skip = 1 of the mapping call them 1, 2
t,z\n0,\n1,nan | mapping.toml:3: no row of log.csv has all that [depth] needs: z_m has none
t,z\n,1 | mapping.toml:2: no row of log.csv has all that [depth] needs: time_s has none
""")
)
def test_a_log_is_refused(case: list[str], tmp_path: Path) -> None:
    assert case[1] in refused(tmp_path, DEPTH.replace('depth"', 'z"'), log=case[0] + "\n")


def test_what_stands_above_all_sections() -> None:
    """A key there is for every table that has it; a section may say otherwise, and a row of a pose has no time."""
    text = 'time_s = "t"\nsort = true\ndepth.z_m = "z"\nnoise.scale = 0.1\n'
    text += 'ahrs = { time_s = "u", sort = false }\ntruth.i = "k"\n'
    depth, noise, ahrs, truth = Mapping(text, "m.toml").sections
    assert [depth.cells["time_s"].columns, ahrs.cells["time_s"].columns] == [("t",), ("u",)]
    assert [depth.options["sort"], ahrs.options["sort"]] == [True, False]
    assert ("time_s" in noise.cells, "time_s" in truth.cells) == (False, False)
