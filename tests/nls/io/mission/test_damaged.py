"""Mission folders that cannot be right: one error with file, line, what was expected and what came; never another."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nls
from models.errors import LeadlineError, SingularGeometryError
from nls import EvaluationError, GraphFileError, GraphWarning, ResourceLimitError
from nls.io.mission.columns import COLUMNS
from tests.nls.io.mission.mission_files import TINY, folder, raw

WORDS = [
    "nan",
    "inf",
    "1_0",
    "\uff11",
    "0x1A",
    "1e999",
    "--1",
    "north",
    "1 2",
    '"1"',
    "#",
    "1;2",
    ",",
    ",,",
    '"',
    "-",
    "",
]
NUMBERS = ["0", "-1", "9", "1e308", "1e-308", "3.5", "007", "9223372036854775807", "9223372036854775808", "1e160"]
LINE = "0,11,4.7457,0.0625,0.01,0.004"


def without(file: str, column: int) -> str:
    """A file of TINY without a column."""
    rows = [line.split(",") for line in TINY[file].splitlines()]
    return "\n".join(",".join(row[:column] + row[column + 1 :]) for row in rows)


def changed(file: str, old: str, new: str) -> dict[str, str]:
    assert old in TINY[file]
    return {file: TINY[file].replace(old, new, 1)}


CASES: list[tuple[dict[str, str | None], str]] = [
    ({"zpr": None}, r"m: has no zpr\.csv; a mission is odometry\.csv and zpr\.csv, or dvl\.csv"),
    ({"odometry": None}, r"m: has no odometry\.csv"),
    ({"sonar": None}, r"m: has contacts\.csv and no sonar\.csv, which says what sonar"),
    (
        {"contacts": None},
        r"m: has sonar\.csv and no contacts\.csv, which says what the sonar saw; leave sonar\.csv out",
    ),
    (
        {"contacts": None, "contact": TINY["contacts"]},
        r"no contacts\.csv, .*; is it contact\.csv\? names are written as",
    ),
    (
        {"contacts": None, "Contacts": TINY["contacts"]},
        r"no contacts\.csv, .*; is it Contacts\.csv\? names are written",
    ),
    ({"sonar": None, "Sonar ": TINY["sonar"]}, r"no sonar\.csv, which says what sonar .*; is it Sonar \.csv\?"),
    ({"zpr": None, "ZPR": TINY["zpr"]}, r"m: has no zpr\.csv; .*; is it ZPR\.csv\?"),
    ({"odometry": None, "zpr": None}, r"m: is a folder, but no mission: a mission is .*; it has anchor, contacts"),
    ({"dvl": raw()["dvl"]}, r"m: has odometry\.csv and dvl\.csv, the same way twice; leave either"),
    ({"zpr": without("zpr", 3)}, r"zpr\.csv:1: no column 'roll_rad'; expected i,z_m,pitch_rad,roll_rad,sigma_z_m"),
    (changed("zpr", "roll_rad", "heel_rad"), r"zpr\.csv:1: unknown column 'heel_rad'; expected i,z_m"),
    (changed("zpr", "roll_rad", "z_m"), r"zpr\.csv:1: repeated column 'z_m'"),
    (
        {"zpr": TINY["zpr"].replace(",", ";")},
        r"zpr\.csv:1: one column; .*; these are separated by semicolons, separate",
    ),
    (
        {"zpr": TINY["zpr"].replace(",", "\t")},
        r"zpr\.csv:1: one column; expected i,z_m.* separated by tabs, separate them",
    ),
    (
        changed("zpr", "0,5.0332,0.0005,-0.0007,0.01,0.002,0.002", "0;5,0332"),
        r"zpr\.csv:2: 2 cells, expected 7: i,z_m",
    ),
    (
        changed("zpr", "0,5.0332,0.0005,-0.0007,0.01,0.002,0.002", "0;5.0332;0.0005"),
        r"zpr\.csv:2: 1 cells, expected 7: i,.*; these are separated by semicolons, separate them with commas",
    ),
    (
        {"zpr": "\n".join(TINY["zpr"].splitlines()[1:])},
        r"zpr\.csv:1: the first line must name the columns: i,z_m,pitch_rad,roll_rad,sigma_z_m",
    ),
    (changed("zpr", "roll_rad", "roll_" * 9), r"zpr\.csv:1: unknown column '(roll_){7}ro\.\.\.'; expected i,z_m"),
    (changed("zpr", "i,z_m", "i;z_m"), r"zpr\.csv:1: unknown column 'i;z_m'"),
    ({"zpr": ""}, r"zpr\.csv:1: is empty; expected a first line i,z_m,.* and a row of values"),
    ({"contacts": "# nothing\n\n"}, r"contacts\.csv:1: is empty"),
    (
        {"contacts": TINY["contacts"].splitlines()[0]},
        r"contacts\.csv:1: has no row below its names; leave the file out",
    ),
    (changed("contacts", LINE, LINE + ",7"), r"contacts\.csv:2: 7 cells, expected 6: i,landmark,range_m"),
    (changed("contacts", LINE, LINE[:-6]), r"contacts\.csv:2: 5 cells, expected 6"),
    (changed("contacts", "4.7457", ""), r"contacts\.csv:2: range_m is empty; expected a value in every cell"),
    (changed("contacts", "4.7457", "nan"), r"contacts\.csv:2: 'nan' is not a number \[0,11,nan,0\.0625,0\.01,0\.004\]"),
    (changed("contacts", "4.7457", "4.7 m"), r"contacts\.csv:2: '4\.7 m' is not a number"),
    (changed("contacts", "4.7457", "1e999"), r"contacts\.csv:2: '1e999' is beyond the largest number"),
    (changed("contacts", "4.7457", "-4.7457"), r"contacts\.csv:2: range_m is -4\.7457; expected a number above 0"),
    (changed("contacts", "0.0625", "5.9"), r"contacts\.csv:2: azimuth_rad is 5\.9; expected radians, -pi to pi"),
    (
        changed("contacts", "0.01,0.004", "0,0.004"),
        r"contacts\.csv:2: sigma_range_m is 0\.0; expected a number above 0",
    ),
    (changed("contacts", "0,11,", "0,1.5,"), r"contacts\.csv:2: id '1\.5' is not a whole number"),
    (changed("contacts", "0,11,", "8,11,"), r"contacts\.csv:2: i 8: a contact of a pose that nothing else measures"),
    (changed("odometry", "1,2,", "1,1,"), r"odometry\.csv:3: the step joins pose 1 to itself"),
    (changed("zpr", "\n3,", "\n2,"), r"zpr\.csv:5: pose 2 was given before, on line 4"),
    (changed("zpr", "\n3,", "\n4,"), r"zpr\.csv:5: i 4: odometry\.csv has no such pose"),
    (changed("truth", "\n3,", "\n2,"), r"truth\.csv:5: pose 2 was given before, on line 4"),
    (changed("landmarks", "\n14,", "\n11,"), r"landmarks\.csv:4: landmark 11 was given before, on line 2"),
    (changed("anchor", "\n0,", "\n9,"), r"anchor\.csv:2: i 9: nothing else measures this pose"),
    ({"anchor": TINY["anchor"] + "0,1,1,1,1,1,1\n"}, r"anchor\.csv:3: pose 0 was given before, on line 2"),
    (
        {"truth": "i,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n7,0,0,0,0,0,0\n"},
        r"truth\.csv:2: pose 7 and all others are",
    ),
    ({"sonar": TINY["sonar"] + TINY["sonar"].splitlines()[1]}, r"sonar\.csv:3: a second sonar; a mission has one"),
    (changed("sonar", ",1.0,6.0,", ",6.0,1.0,"), r"sonar\.csv:2: ImagingSonar DIDSON.*: window: \(6\.0, 1\.0\)"),
    (changed("sonar", ",96,", ",0,"), r"sonar\.csv:2: .*beams: 0 is not possible; expected .*at least 1"),
    (changed("sonar", 'frequency"', "frequency"), r"sonar\.csv:2: a quotation mark is not closed on its line"),
    (
        {"poses": "i,time_s\n0,1\n1,2\n2,2\n3,4\n"},
        r"poses\.csv:4: time_s 2\.0 does not rise over 2\.0 before it; delete",
    ),
    ({"poses": "i,time_s\n0,1\n1,2\n2,3\n"}, r"poses\.csv:4: this is the last row, and pose 3 has none; give a time"),
    ({"poses": "i,time_s\n0,1\n1,2\n2,3\n3,4\n4,5\n"}, r"poses\.csv:6: i 4: nothing measures this pose; leave it out"),
    ({"zpr": "PK\x03\x04\x00"}, r"zpr\.csv:1: has a zero byte"),
    (changed("zpr", "-0.0313", "2.5"), r"zpr\.csv:3: pitch_rad is 2\.5; expected radians, between -pi/2 and pi/2"),
    (changed("zpr", "-0.0313", repr(np.pi / 2)), r"zpr\.csv:3: pitch_rad is 1\.5707963267948966; expected radians"),
    (changed("zpr", "0.0479", "-6.4"), r"zpr\.csv:3: roll_rad is -6\.4; expected radians, -2 pi to 2 pi"),
    (changed("odometry", "0.0521", "52.1"), r"odometry\.csv:2: yaw_rad is 52\.1; expected radians, -2 pi to 2 pi"),
    (changed("truth", "-0.03,0.05", "-3,0.05"), r"truth\.csv:3: pitch_rad is -3\.0; expected radians, between"),
    (changed("anchor", "0.0,0.0,0.0,", "0.0,0.0,90,"), r"anchor\.csv:2: yaw_rad is 90\.0; expected radians"),
    (changed("sonar", "-0.5236", "-30"), r"sonar\.csv:2: pitch_rad is -30\.0; expected radians, -2 pi to 2 pi"),
    (changed("sonar", "0.3,0.0,0.1", "9e18,0.0,0.1"), r"sonar\.csv:2: x_m is 9e\+18; expected meters, within 1e9"),
    (changed("landmarks", "4.5,", "1e308,"), r"landmarks\.csv:2: x_m is 1e\+308; expected meters, within 1e9"),
    (changed("truth", "5.1", "-1e308"), r"truth\.csv:3: z_m is -1e\+308; expected meters, within 1e9"),
    (changed("anchor", "0,0.0,0.0", "0,0.0,2e9"), r"anchor\.csv:2: y_m is 2000000000\.0; expected meters, within"),
    (changed("odometry", "0.5408", "1e160"), r"odometry\.csv:2: x_m is 1e\+160; expected meters, within 1e9"),
    (changed("contacts", "4.7457", "1e10"), r"contacts\.csv:2: range_m is 10000000000\.0; expected meters, within 1e9"),
    (changed("contacts", "0.01,0.004", "0.01,1e-320"), r"contacts\.csv:2: sigma_azimuth_rad is 1e-320; expected 1e-12"),
    (changed("zpr", "0.01,0.002", "1e17,0.002"), r"zpr\.csv:2: sigma_z_m is 1e\+17; expected 1e-12 to 1e12"),
]


@pytest.mark.parametrize(("files", "message"), CASES, ids=[message.replace("\\", "")[:50] for _, message in CASES])
def test_a_damaged_folder(files: dict[str, str | None], message: str, tmp_path: Path) -> None:
    with pytest.raises(GraphFileError) as caught:
        nls.load(folder(tmp_path / "m", **files))
    assert re.search(message, str(caught.value)), str(caught.value)
    assert str(tmp_path / "m") in str(caught.value)


LOGS: list[tuple[str, str, str, str]] = [
    ("dvl", "0.5,1.0", "0.25,1.0", r"dvl\.csv:4: time_s 0\.25 does not rise over 0\.25"),
    ("ahrs", "0.5,0.0", "9.5,0.0", r"ahrs\.csv:5: time_s 0\.75 does not rise over 9\.5"),
    ("depth", "1.0,2.1", "1.0,deep", r"depth\.csv:4: 'deep' is not a number"),
    ("dvl", "0.5,1.0,0.0,0.0,1", "0.5,1.0,0.0,0.0,2", r"dvl\.csv:4: valid is '2'; expected 0 or 1: 1 where the DVL"),
    (
        "dvl",
        "0.5,1.0,0.0,0.0,1",
        "0.5,1.0,0.0,0.0,true",
        r"dvl\.csv:4: valid is 'true'; expected 0 or 1: 1 where the DVL",
    ),
    (
        "dvl",
        "0.5,1.0,0.0,0.0,1",
        "0.5,1.0,0.0,0.0,1.0",
        r"dvl\.csv:4: valid is '1\.0'; expected 0 or 1: 1 where the DVL",
    ),
    (
        "dvl",
        "0.5,1.0",
        "0.25,1.0",
        r"dvl\.csv:4: time_s 0\.25 does not rise over 0\.25 before it; delete one of the two",
    ),
    (
        "dvl",
        "0.5,1.0",
        "0.125,1.0",
        r"dvl\.csv:4: time_s 0\.125 does not rise over 0\.25 before it; sort the rows by time",
    ),
    ("noise", "0.01,", "0.0,", r"noise\.csv:2: sigma_v_m_s is 0\.0; expected a number above 0"),
    ("noise", "0.002,0.05", "-0.1,0.05", r"noise\.csv:2: scale is -0\.1; expected 0 or above"),
    ("dvl", "0.5,1.0", "0.5,1e308", r"dvl\.csv:4: vx_m_s is 1e\+308; expected meters per second, within 1e9"),
    ("ahrs", "0.5,0.0,0.0", "0.5,0.0,2.0", r"ahrs\.csv:4: pitch_rad is 2\.0; expected radians, between -pi/2 and pi/2"),
    ("ahrs", "0.5,0.0,0.0", "0.5,17.0,0.0", r"ahrs\.csv:4: roll_rad is 17\.0; expected radians, -2 pi to 2 pi"),
    ("depth", "1.0,2.1", "1.0,1e308", r"depth\.csv:4: z_m is 1e\+308; expected meters, within 1e9"),
    ("noise", "0.01,", "1e-320,", r"noise\.csv:2: sigma_v_m_s is 1e-320; expected 1e-12 to 1e12"),
    ("noise", "0.002,0.05", "0.002,1e17", r"noise\.csv:2: sigma_bridge_m_s_sqrt_s is 1e\+17; expected a number within"),
    ("noise", "0.05\n", "0.05\n" + "1,1,1,1,1,1,1\n", r"noise\.csv:3: a second row; expected one"),
]


@pytest.mark.parametrize(("file", "old", "new", "message"), LOGS)
def test_a_damaged_log(file: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    files = raw()
    assert old in files[file]
    files[file] = files[file].replace(old, new, 1)
    with pytest.raises(GraphFileError, match=message):
        nls.load(folder(tmp_path / "m", files))


def test_a_log_that_is_not_there_or_too_short(tmp_path: Path) -> None:
    for name in ("ahrs", "depth", "noise"):
        with pytest.raises(GraphFileError, match=rf"has no {name}\.csv; a mission is"):
            nls.load(folder(tmp_path / name, raw(), **{name: None}))
    short = {"depth": "time_s,z_m\n0,1\n0.5,1\n"}
    with pytest.raises(GraphFileError, match=r"dvl\.csv: the logs have less than a second in common: dvl\.csv 0\.0 to"):
        nls.load(folder(tmp_path / "short", raw() | short))
    for poses, message in (
        (
            "2,-1\n3,4\n",
            r"poses\.csv:2: pose 2 is at -1\.0 s, not within all logs: dvl\.csv 0\.0 to 30\.0 s, ahrs\.csv",
        ),
        ("2,1\n3,31\n", r"poses\.csv:3: pose 3 is at 31\.0 s"),
        ("2,1\n", r"poses\.csv:2: one pose; a track has at least two"),
    ):
        with pytest.raises(GraphFileError, match=message):
            nls.load(folder(tmp_path / "poses", raw() | {"poses": "i,time_s\n" + poses}))


def test_folders_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(GraphFileError, match=r"empty: is a folder, but no mission: .*; it is empty"):
        nls.load(tmp_path / "empty")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes\n.txt").write_text("")
    with pytest.raises(GraphFileError, match=r"other: is a folder, but no mission: .*; it has notes\\n\.txt"):
        nls.load(tmp_path / "other")
    (folder(tmp_path / "m", zpr=None) / "zpr.csv").mkdir()
    with pytest.raises(GraphFileError, match=r"zpr\.csv: is a folder; expected a file"):
        nls.load(tmp_path / "m")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(folder(tmp_path / "m", zpr=None) / "zpr.csv")
    with pytest.raises(GraphFileError, match=r"zpr\.csv: is a pipe or a device; expected a file"):
        nls.load(tmp_path / "m")
    (tmp_path / "m" / "zpr.csv").unlink()
    (tmp_path / "m" / "zpr.csv").symlink_to(tmp_path / "gone.csv")
    with pytest.raises(GraphFileError, match=r"zpr\.csv: cannot be read: No such file"):
        nls.load(tmp_path / "m")


def test_velocities_without_bottom_lock_may_be_anything(tmp_path: Path) -> None:
    files = raw(lost=(5.0, 8.0))
    assert nls.load(folder(tmp_path / "m", files, dvl=files["dvl"].replace("99.0", "1e308")))[1]


@pytest.mark.parametrize("file", TINY)
@pytest.mark.parametrize("word", [word for word in WORDS if word not in ("#", ",", ",,", "")])
def test_no_exotic_number_gets_through(file: str, word: str, tmp_path: Path) -> None:
    """In every column of every file, refused with its line."""
    lines = TINY[file].splitlines()
    cells = lines[-1].split(",")
    for k in range(2 if file == "sonar" else 0, len(cells)):
        lines[-1] = ",".join([*cells[:k], word, *cells[k + 1 :]])
        with pytest.raises(GraphFileError) as caught:
            nls.load(folder(tmp_path / "m", **{file: "\n".join(lines)}))
        assert caught.value.path.endswith(f"{file}.csv")
        assert caught.value.line == len(lines)


def read_or_refused(path: Path) -> bool:
    """A graph of finite numbers, or an error of the library that names a file."""
    refused: LeadlineError | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", GraphWarning)
        try:
            graph, values, report = nls.load(path)
        except (GraphFileError, ResourceLimitError) as error:
            refused = error
        if refused is not None:
            assert str(refused).startswith(str(path))
            return False
        assert all(np.isfinite(stack.X).all() for stack in values.stacks.values())
        assert str(report)
        try:
            assert np.isfinite(graph.chi2(values))
        except (EvaluationError, SingularGeometryError) as error:  # too far off, or at the sonar
            refused = error
    return True


@given(
    edits=st.lists(
        st.tuples(
            st.sampled_from(sorted(TINY)),
            st.sampled_from(["drop", "twice", "cut", "cell", "byte"]),
            st.integers(0, 10**6),
            st.sampled_from(WORDS + NUMBERS),
        ),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_of_any_kind(edits: list[tuple[str, str, int, str]], tmp_path: Path) -> None:
    files = dict(TINY)
    for name, how, place, word in edits:
        lines = files[name].splitlines() or [""]
        k = place % len(lines)
        cells = lines[k].split(",")
        j = place // len(lines) % len(cells)
        if how == "drop":
            lines = lines[:k] + lines[k + 1 :]
        elif how == "twice":
            lines.insert(k, lines[k])
        elif how == "cut":
            lines[k] = lines[k][: 3 * j]
        elif how == "cell":
            lines[k] = ",".join([*cells[:j], word, *cells[j + 1 :]])
        else:
            lines[k] = lines[k][:j] + chr(place % 300) + lines[k][j + 1 :]
        files[name] = "\n".join(lines)
    read_or_refused(folder(tmp_path / "m", files))


def test_the_undamaged_folder_is_read_and_every_file_has_its_columns(tmp_path: Path) -> None:
    assert read_or_refused(folder(tmp_path / "m"))
    for name, text in {**TINY, **raw()}.items():
        assert tuple(text.splitlines()[0].split(",")) == COLUMNS[name]
