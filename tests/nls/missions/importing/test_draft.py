"""Drafts of a mapping: what a log is by the names of its columns, and that the draft is a mapping of it."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np

from nls.missions.importing.templates import templates
from tests.combinations import for_all
from tests.nls.missions.importing.logs import drafted, imported, line

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
