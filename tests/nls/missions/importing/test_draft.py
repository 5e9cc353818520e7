"""Drafts of a mapping: what a log is by the names of its columns, and that the draft is a mapping of it."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np

from nls.missions.importing import Mapping, draft, import_logs
from nls.missions.importing.templates import templates

ODOMETRY = "time,x_odo [m],y_odo [m],depth [m],heading [deg]\n0,0,0,4,0\n2,1,0,4,9\n"
ECHOES = "time,target,range [m],bearing [deg]\n0,1,6.9,15.8\n1,4,10.8,48.9\n"


def test_odometry_is_a_path_and_ranges_with_bearings_are_contacts(tmp_path: Path) -> None:
    logs = [tmp_path / "odometry.csv", tmp_path / "echoes.csv"]
    for log, text in zip(logs, (ODOMETRY, ECHOES), strict=True):
        log.write_text(text)
    text = draft(logs)
    assert not any(line.startswith(("# [", "# not used", "[noise]", "[depth]")) for line in text.splitlines())
    imported = import_logs(logs, Mapping(text, "mapping.toml"))
    assert imported.rows == {"path": 2, "contacts": 2, "sonar": 1}
    assert not any("nls solve needs" in note for note in imported.notes)
    assert imported.files["path.csv"].decode().splitlines()[2].startswith("2.0,1.0,0.0,4.0,0.157")
    assert imported.files["contacts.csv"].decode().splitlines()[1].startswith("0.0,1,6.9,0.2757")


def test_whole_poses_are_a_truth_unless_their_name_says_odometry(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    for name, table in (("x", "truth"), ("x_odo", "path")):
        log.write_text(f"time,{name},y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n1,1,0,0,0,0,0\n")
        text = draft([log])
        assert f"\n[{table}]\n" in text
        assert ("[ahrs]\ntime_s" in text) == (table == "truth")


def test_a_heading_alone_is_the_attitude_of_a_level_vehicle(tmp_path: Path) -> None:
    """Unless another log has a whole attitude."""
    compass, ahrs = tmp_path / "compass.csv", tmp_path / "ahrs.csv"
    compass.write_text("time,Heading [deg]\n0,90\n1,90\n")
    ahrs.write_text("time,roll [deg],pitch [deg],yaw [deg]\n0,1,2,90\n1,1,2,90\n")
    imported = import_logs([compass], Mapping(draft([compass]), "mapping.toml"))
    assert imported.files["ahrs.csv"].decode().splitlines()[1] == f"0.0,0.0,0.0,{np.pi / 2!r}"
    assert tomllib.loads(draft([compass, ahrs]))["ahrs"]["file"] == "ahrs.csv"


def test_velocities_along_the_axes_of_the_vehicle_have_their_signs(tmp_path: Path) -> None:
    """Also where names are short; those over ground by north, east and down are none."""
    log = tmp_path / "log.csv"
    for header, cells, row in (
        ("BT_Vel_Fwd,BT_Vel_Stbd,BT_Vel_Down", "1,2,3", "0.0,1.0,2.0,3.0,1"),
        ("BT_Vel_Up,BT_Vel_Port,WT_Vel_Fwd,BT_Vel_Fwd", "1,2,3,4", "0.0,4.0,-2.0,-1.0,1"),
        ("V North,V East,V Down", "1,2,3", ""),
        ("V North,V East,Vel_Fwd,Vel_Stbd,Vel_Down", "1,2,3,4,5", ""),
    ):
        log.write_text(f"time,{header}\n0,{cells}\n")
        text = draft([log])
        assert ("\n[dvl]" in text) == bool(row)
        if row:
            assert import_logs([log], Mapping(text, "mapping.toml")).files["dvl.csv"].decode().splitlines()[1] == row


def test_small_angles_are_in_degrees_where_the_heading_is(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time,HDG_mag,HDG_true,Pitch,Roll\n0,85,90,2,0\n1,85,90,2,0\n")
    imported = import_logs([log], Mapping(draft([log]), "mapping.toml"))
    assert imported.files["ahrs.csv"].decode().splitlines()[1] == f"0.0,0.0,{float(np.radians(2))!r},{np.pi / 2!r}"


def test_a_range_is_one_to_a_beacon_where_its_name_says_so(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    for header, line in (("Slant range", "beacon = 1"), ("slant_range,Beacon", 'beacon = "Beacon"'), ("range", "")):
        log.write_text(f"time,{header}\n0,12.5{',3' * header.count(',')}\n")
        text = draft([log])
        assert ("[ranges]" in text) == bool(line)
        assert line in text


def test_the_sonar_of_a_draft_is_that_of_its_template(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        "time,odo x [m],odo y [m],yaw [rad],range [m],azimuth [rad],landmark\n0,0,0,0,5,0.1,3\n1,1,0,0,5,0.1,3\n"
    )
    section = tomllib.loads(draft([log]))["sonar"]
    names, values = templates()["templates/sonar.csv"].decode().splitlines()[-2:]
    row = next(csv.reader([values.removeprefix("# ")]))
    assert dict(zip(names.split(","), row, strict=True)) == {name: str(value) for name, value in section.items()}


def test_a_log_without_a_dvl_is_of_fixes_and_a_walk(tmp_path: Path) -> None:
    """Its EKF's velocities north, east and down are no DVL, the lock of its GPS no bottom lock."""
    log = tmp_path / "rov.csv"
    log.write_text(
        "Timestamp,roll,pitch,heading,altitudeRelative,gps.lat,gps.lon,gps.lock,localPosition.vx,localPosition.vy,"
        "localPosition.vz,headingSetpoint\n2022-08-15 09:56:00.8,4,5,190,-2,54.1,10.2,3,.1,.2,.3,7\n"
        "2022-08-15 09:56:01.8,4,5,190,-2,54.1,10.2,3,.1,.2,.3,7\n"
    )
    sections = tomllib.loads(draft([log]))
    assert {*sections} == {"ahrs", "depth", "fixes", "motion", "noise"}
    assert {*sections["noise"]} == {"sigma_roll_rad", "sigma_pitch_rad", "sigma_yaw_rad", "sigma_z_m"}
    assert sections["depth"]["z_m"] == {"column": "altitudeRelative", "up": True}


def test_measured_columns_come_before_commanded_ones(tmp_path: Path) -> None:
    """A Slocum glider: stamps since 1970 before times of a mission, degrees and minutes by their size."""
    log = tmp_path / "glider.csv"
    log.write_text(
        "m_climb_tot_time,c_heading,c_pitch,c_wpt_lat,m_present_time,m_heading,m_pitch,m_roll,m_gps_lat,m_gps_lon\n"
        "-1,1,1,3306,1774571917.1,2.9,.6,0,3305.7966,-11746.4556\n"
    )
    sections = tomllib.loads(draft([log]))
    assert sections["fixes"]["time_s"] == sections["ahrs"]["time_s"] == "m_present_time"
    assert sections["fixes"]["lat_deg"] == {"column": "m_gps_lat", "unit": "ddmm"}
    assert [sections["ahrs"][name]["column"] for name in ("yaw_rad", "pitch_rad")] == ["m_heading", "m_pitch"]


def test_the_height_over_the_bottom_is_no_depth(tmp_path: Path) -> None:
    log = tmp_path / "dvl.csv"
    log.write_text("time,timestamp,vx,vy,vz,altitude,beam_1_valid,velocity_valid\n202.9,1639747615.3,0,0,0,4.7,0,1\n")
    sections = tomllib.loads(draft([log]))
    assert {*sections} == {"dvl", "noise"}
    assert (sections["dvl"]["time_s"], sections["dvl"]["valid"]) == ("timestamp", "velocity_valid")


def test_columns_without_a_time_are_named(tmp_path: Path) -> None:
    log = tmp_path / "boat.csv"
    log.write_text("Latitude,Longitude,Depth_in_Feet\n17.97,-67.01,10.5\n")
    assert "# [fixes]   # 'Latitude', 'Longitude': no column looks like their time" in draft([log]).splitlines()
