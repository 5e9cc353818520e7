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
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases
from tests.nls.missions.folder.mission_files import RAW, TINY, folder, raw

EXOTIC = ["inf", "1_0", "\uff11", "0x1A", "1e999", "--1", "north", "1 2", '"1"', "1;2", '"', "-"]
WORDS = [*EXOTIC, "nan", "#", ",", ",,", ""]
NUMBERS = ["0", "-1", "9", "1e308", "1e-308", "3.5", "007", "9223372036854775807", "9223372036854775808", "1e160"]

FOLDERS: list[tuple[dict[str, str | None], str]] = [
    ({"zpr": None}, r"m: has no zpr\.csv"),
    ({"odometry": None}, r"m: has no odometry\.csv"),
    ({"sonar": None}, r"m: has contacts\.csv and no sonar\.csv"),
    ({"contacts": None}, r"m: has sonar\.csv and no contacts\.csv"),
    ({"contacts": None, "contact": TINY["contacts"]}, r"no contacts\.csv, .*; is it contact\.csv\?"),
    ({"contacts": None, "Contacts": TINY["contacts"]}, r"no contacts\.csv, .*; is it Contacts\.csv\?"),
    ({"sonar": None, "Sonar ": TINY["sonar"]}, r"no sonar\.csv, .*; is it Sonar \.csv\?"),
    ({"zpr": None, "ZPR": TINY["zpr"]}, r"m: has no zpr\.csv; .*; is it ZPR\.csv\?"),
    ({"odometry": None, "zpr": None}, "m: is a folder, but no mission: .*; it has anchor, contacts"),
    ({"dvl": raw()["dvl"]}, r"m: has odometry\.csv and dvl\.csv"),
    ({"zpr": re.sub(r"(?m)^(.*?,.*?,.*?),.*?,", r"\1,", TINY["zpr"])}, r"zpr\.csv:1: no column 'roll_rad'; .*i,z_m"),
    ({"zpr": TINY["zpr"].replace(",", ";")}, r"zpr\.csv:1: one column; .* semicolons"),
    ({"zpr": TINY["zpr"].replace(",", "\t")}, r"zpr\.csv:1: one column; .* tabs"),
    ({"zpr": TINY["zpr"].partition("\n")[2]}, r"zpr\.csv:1: the first line must name the columns: i,z_m"),
    ({"zpr": ""}, r"zpr\.csv:1: is empty; .*i,z_m"),
    ({"zpr": "PK\x03\x04\x00"}, r"zpr\.csv:1: has a zero byte"),
    ({"contacts": "# nothing\n\n"}, r"contacts\.csv:1: is empty"),
    ({"contacts": TINY["contacts"].partition("\n")[0]}, r"contacts\.csv:1: has no row"),
    ({"anchor": TINY["anchor"] + "0,1,1,1,1,1,1\n"}, r"anchor\.csv:3: pose 0 .* on line 2"),
    ({"truth": TINY["truth"].partition("\n")[0] + "\n7,0,0,0,0,0,0\n"}, r"truth\.csv:2: pose 7 and all others are"),
    ({"sonar": TINY["sonar"] + TINY["sonar"].splitlines()[1]}, r"sonar\.csv:3: a second sonar"),
    ({"poses": "i,time_s\n0,1\n1,2\n2,2\n3,4\n"}, r"poses\.csv:4: time_s 2\.0 does not rise over 2\.0"),
    ({"poses": "i,time_s\n0,1\n1,2\n2,3\n"}, r"poses\.csv:4: this is the last row, and pose 3 has none"),
    ({"poses": "i,time_s\n0,1\n1,2\n2,3\n3,4\n4,5\n"}, r"poses\.csv:6: i 4"),
]

# file, text, other text, line, words of the error
EDITS = cases(r"""
zpr | roll_rad | heel_rad | 1 | 'heel_rad'; expected i,z_m
zpr | roll_rad | z_m | 1 | repeated column 'z_m'
zpr | roll_rad | roll_roll_roll_roll_roll_roll_roll_roll_roll_ | 1 | 'roll_roll_roll_roll_roll_roll_roll_ro...'
zpr | i,z_m | i;z_m | 1 | 'i;z_m'
zpr | 0,5.0332,0.0005,-0.0007,0.01,0.002,0.002 | 0;5,0332 | 2 | 2 cells, expected 7: i,z_m
zpr | 0,5.0332,0.0005,-0.0007,0.01,0.002,0.002 | 0;5.0332;0.0005 | 2 | separated by semicolons
contacts | 0,11,4.7457,0.0625,0.01,0.004 | 0,11,4.7457,0.0625,0.01,0.004,7 | 2 | 7 cells, expected 6: i,landmark
contacts | 0,11,4.7457,0.0625,0.01,0.004 | 0,11,4.7457,0.0625,0.01 | 2 | 5 cells, expected 6
contacts | 4.7457 |  | 2 | range_m is empty
contacts | 4.7457 | nan | 2 | 'nan' is not a number [0,11,nan,0.0625,0.01,0.004]
contacts | 4.7457 | 4.7 m | 2 | '4.7 m' is not a number
contacts | 4.7457 | 1e999 | 2 | '1e999' is beyond
contacts | 4.7457 | -4.7457 | 2 | range_m is -4.7457; expected a number above 0
contacts | 4.7457 | 1e10 | 2 | range_m is 10000000000.0
contacts | 0.0625 | 5.9 | 2 | azimuth_rad is 5.9; expected radians, -pi to pi
contacts | 0.01,0.004 | 0,0.004 | 2 | sigma_range_m is 0.0
contacts | 0.01,0.004 | 0.01,1e-320 | 2 | sigma_azimuth_rad is 1e-320; expected 1e-12
contacts | 0,11, | 0,1.5, | 2 | id '1.5'
contacts | 0,11, | 8,11, | 2 | i 8
odometry | 1,2, | 1,1, | 3 | pose 1 to itself
odometry | 0.0521 | 52.1 | 2 | yaw_rad is 52.1; expected radians, -2 pi to 2 pi
odometry | 0.5408 | 1e160 | 2 | x_m is 1e+160
zpr | \n3, | \n2, | 5 | pose 2 was given before, on line 4
zpr | \n3, | \n4, | 5 | i 4: odometry.csv
zpr | -0.0313 | 2.5 | 3 | pitch_rad is 2.5; expected radians, between -pi/2 and pi/2
zpr | -0.0313 | 1.5707963267948966 | 3 | pitch_rad is 1.5707963267948966
zpr | 0.0479 | -6.4 | 3 | roll_rad is -6.4
zpr | 0.01,0.002 | 1e17,0.002 | 2 | sigma_z_m is 1e+17; expected 1e-12 to 1e12
truth | \n3, | \n2, | 5 | pose 2 was given before, on line 4
truth | -0.03,0.05 | -3,0.05 | 3 | pitch_rad is -3.0
truth | 5.1 | -1e308 | 3 | z_m is -1e+308; expected meters, within 1e9
landmarks | \n14, | \n11, | 4 | landmark 11 was given before, on line 2
landmarks | 4.5, | 1e308, | 2 | x_m is 1e+308
anchor | \n0, | \n9, | 2 | i 9
anchor | 0.0,0.0,0.0, | 0.0,0.0,90, | 2 | yaw_rad is 90.0
anchor | 0,0.0,0.0 | 0,0.0,2e9 | 2 | y_m is 2000000000.0
sonar | ,1.0,6.0, | ,6.0,1.0, | 2 | window: (6.0, 1.0)
sonar | ,96, | ,0, | 2 | beams: 0
sonar | frequency" | frequency | 2 | quotation mark
sonar | -0.5236 | -30 | 2 | pitch_rad is -30.0
sonar | 0.3,0.0,0.1 | 9e18,0.0,0.1 | 2 | x_m is 9e+18
dvl | 0.5,1.0,0.0,0.0,1 | 0.5,1.0,0.0,0.0,2 | 4 | valid is '2'; expected 0 or 1
dvl | 0.5,1.0,0.0,0.0,1 | 0.5,1.0,0.0,0.0,true | 4 | valid is 'true'
dvl | 0.5,1.0,0.0,0.0,1 | 0.5,1.0,0.0,0.0,1.5 | 4 | valid is '1.5'
dvl | 0.5,1.0 | 0.25,1.0 | 4 | time_s 0.25 does not rise over 0.25 before it; delete one
dvl | 0.5,1.0 | 0.125,1.0 | 4 | time_s 0.125 does not rise over 0.25 before it; sort
dvl | 0.5,1.0 | 0.5,1e308 | 4 | vx_m_s is 1e+308; expected meters per second, within 1e9
ahrs | 0.5,0.0 | 9.5,0.0 | 5 | time_s 0.75 does not rise over 9.5
ahrs | 0.5,0.0,0.0 | 0.5,0.0,2.0 | 4 | pitch_rad is 2.0
ahrs | 0.5,0.0,0.0 | 0.5,17.0,0.0 | 4 | roll_rad is 17.0
depth | 1.0,2.1 | 1.0,deep | 4 | 'deep' is not a number
depth | 1.0,2.1 | 1.0,1e308 | 4 | z_m is 1e+308
noise | 0.01, | 0.0, | 2 | sigma_v_m_s is 0.0; expected a number above 0
noise | 0.01, | 1e-320, | 2 | sigma_v_m_s is 1e-320; expected 1e-12 to 1e12
noise | 0.002,0.05 | -0.1,0.05 | 2 | scale is -0.1; expected 0 or above
noise | 0.002,0.05 | 0.002,1e17 | 2 | sigma_bridge_m_s_sqrt_s is 1e+17
noise | 0.05\n | 0.05\n1,1,1,1,1,1,1\n | 3 | a second row
""")


@for_all(case=FOLDERS)
def test_a_damaged_folder(case: tuple[dict[str, str | None], str], tmp_path: Path) -> None:
    place = tmp_path / str(FOLDERS.index(case)) / "m"
    place.parent.mkdir()
    with pytest.raises(GraphFileError, match=case[1]) as caught:
        nls.load(folder(place, **case[0]))
    assert str(place) in str(caught.value)


@for_all(case=EDITS)
def test_a_damaged_file(case: list[str], tmp_path: Path) -> None:
    name, old, new, line, words = case
    files = TINY if name in TINY else raw()
    assert old in files[name]
    place = folder(tmp_path / ("m" if name in TINY else "log"), {**files, name: files[name].replace(old, new, 1)})
    assert assert_refused(int(line), words, nls.load, place).path == str(place / f"{name}.csv")


def test_a_log_that_is_not_there_or_too_short(tmp_path: Path) -> None:
    for name in ("ahrs", "depth", "noise"):
        with pytest.raises(GraphFileError, match=rf"has no {name}\.csv"):
            nls.load(folder(tmp_path / name, raw(), **{name: None}))
    with pytest.raises(GraphFileError, match=r"dvl\.csv: .* less than a second in common: dvl\.csv 0\.0 to"):
        nls.load(folder(tmp_path / "short", raw(), depth="time_s,z_m\n0,1\n0.5,1\n"))
    for poses, line, words in (
        ("2,-1\n3,4\n", 2, "pose 2 is at -1.0 s, not within all logs: dvl.csv 0.0 to 30.0 s, ahrs.csv"),
        ("2,1\n3,31\n", 3, "pose 3 is at 31.0 s"),
        ("2,1\n", 2, "one pose"),
    ):
        place = folder(tmp_path / "poses", raw(), poses="i,time_s\n" + poses)
        assert assert_refused(line, words, nls.load, place).path.endswith("poses.csv")
    files = raw(lost=(5.0, 8.0))  # velocities without bottom lock may be anything
    assert nls.load(folder(tmp_path / "m", files, dvl=files["dvl"].replace("99.0", "1e308")))[1]


def test_folders_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes\n.txt").write_text("")
    m = folder(tmp_path / "m", zpr=None)

    def refused(place: Path, message: str) -> None:
        with pytest.raises(GraphFileError, match=message):
            nls.load(place)

    refused(tmp_path / "empty", "empty: is a folder, but no mission: .*; it is empty")
    refused(tmp_path / "other", r"other: is a folder, but no mission: .*; it has notes\\n\.txt")
    (m / "zpr.csv").mkdir()
    refused(m, r"zpr\.csv: is a folder")
    (m / "zpr.csv").rmdir()
    os.mkfifo(m / "zpr.csv")  # which is not waited for
    refused(m, r"zpr\.csv: is a pipe")
    (m / "zpr.csv").unlink()
    (m / "zpr.csv").symlink_to(tmp_path / "gone.csv")
    refused(m, r"zpr\.csv: cannot be read: No such file")


def test_no_exotic_number_gets_through(tmp_path: Path) -> None:
    """In every column of every file nan, and one of the others in turn."""
    turn = 0
    for file, text in TINY.items():
        lines = text.splitlines()
        cells = lines[-1].split(",")
        for k in range(2 if file == "sonar" else 0, len(cells)):
            turn += 1
            for word in ("nan", EXOTIC[turn % len(EXOTIC)]):
                damaged = "\n".join([*lines[:-1], ",".join([*cells[:k], word, *cells[k + 1 :]])])
                place = folder(tmp_path / "m", **{file: damaged})
                assert assert_refused(len(lines), "", nls.load, place).path.endswith(f"{file}.csv")
        folder(tmp_path / "m")


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


EDIT = st.tuples(
    st.sampled_from(sorted(TINY)),
    st.sampled_from(["drop", "twice", "cut", "cell", "byte"]),
    st.integers(0, 10**6),
    st.sampled_from(WORDS + NUMBERS),
)


@given(edits=st.lists(EDIT, min_size=1, max_size=3))
@settings(max_examples=75, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_of_any_kind(edits: list[tuple[str, str, int, str]], tmp_path: Path) -> None:
    files = dict(TINY)
    for name, act, place, word in edits:
        lines = files[name].splitlines() or [""]
        k = place % len(lines)
        cells = lines[k].split(",")
        j = place // len(lines) % len(cells)
        if act == "drop":
            lines = lines[:k] + lines[k + 1 :]
        elif act == "twice":
            lines.insert(k, lines[k])
        elif act == "cut":
            lines[k] = lines[k][: 3 * j]
        elif act == "cell":
            lines[k] = ",".join([*cells[:j], word, *cells[j + 1 :]])
        else:
            lines[k] = lines[k][:j] + chr(place % 300) + lines[k][j + 1 :]
        files[name] = "\n".join(lines)
    read_or_refused(folder(tmp_path / "m", files))


def test_the_undamaged_folder_is_read_and_every_file_has_its_columns(tmp_path: Path) -> None:
    assert read_or_refused(folder(tmp_path / "m"))
    for name, text in {**TINY, **raw()}.items():
        assert tuple(text.splitlines()[0].split(",")) == RAW[name]
