"""The evidence about mistakes in logs: cures are found in words and followed to the letter, right logs are right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SENTENCES = [  # with the table it must make of z_m 1, 2 and 3 on lines 2, 3 and 4
    ("depth.csv:2: z_m is implausible. Probable cause: multiply z_m by -1", ["0,-1.0", "1,-2.0", "2,-3.0"]),
    ('z_m of depth.csv looks like ft: divide z_m by 2, or write `unit = "ft"` for z_m', ["0,0.5", "1,1.0", "2,1.5"]),
    ("times of depth.csv: subtract 18.5 s from time_s", ["-18.5,1", "-17.5,2", "-16.5,3"]),
    ("depth.csv: add 1 to z_m and divide by 2, or write `x = 1`", ["0,1.0", "1,1.5", "2,2.0"]),
    ("depth.csv: multiply z_m by -1, then add 1.5 to it, or", ["0,0.5", "1,-0.5", "2,-1.5"]),
    ("depth.csv: add 3600 s to time_s", ["3600.0,1", "3601.0,2", "3602.0,3"]),
    ("fixes.csv and depth.csv disagree: exchange the names of time_s, z_m", ["0,1", "1,2", "2,3"]),
    ("leave out lines 2, 4 of depth.csv", ["1,2"]),
    ("or leave out lines 2 to 3 and 12 more of depth.csv", ["2,3"]),
    ("leave out line 3 of depth.csv", ["0,1", "2,3"]),
]


SCRIPT = "cures"


@pytest.mark.parametrize(("sentence", "rows"), SENTENCES)
def test_tables_are_edited(evidence: Any, tmp_path: Path, sentence: str, rows: list[str]) -> None:
    (tmp_path / "depth.csv").write_text("time_s,z_m\n0,1\n1,2\n2,3\n")
    evidence.cures_of(sentence)[0].edit(tmp_path)
    head, *found = (tmp_path / "depth.csv").read_text().splitlines()
    assert (head, found) == ("z_m,time_s" if "names" in sentence else "time_s,z_m", rows)


def test_a_line_of_calibration_csv_replaces_one_of_its_name(evidence: Any, tmp_path: Path) -> None:
    for value in ("0.1", "-0.2274"):
        (cure,) = evidence.cures_of(f"write `declination_rad,{value},9e-4` in calibration.csv, which leaves chi2 at 21")
        cure.edit(tmp_path)
    assert (tmp_path / "calibration.csv").read_text() == "name,value,sigma\ndeclination_rad,-0.2274,9e-4\n"


def test_keys_of_the_mapping(evidence: Any) -> None:
    mapping = {"time_s": "t", "dvl": {"vx_m_s": "vx", "vz_m_s": {"column": "vz", "sign": -1}}, "depth": {"z_m": "z"}}
    written = 'time_s = "t"\n[dvl]\nvx_m_s = "vx"\nvz_m_s = { column = "vz", sign = -1 }\n[depth]\nz_m = "z"\n'
    for sentence in (
        "write `sign = -1, offset = 1` for vx_m_s in [dvl] of the mapping",
        'write `unit = "mm/s"` for vx_m_s, vz_m_s in [dvl] of the mapping; or write `missing = 0` in [ahrs]',
        'write `missing = [-9999, "NA"]` in [depth] of the mapping',
        "write `scale = 0.1` and `offset = -18` for time_s in [depth] of the mapping",
        'map.toml:6: no depths; write z_m = { column = "z", unit = "cm" } if it is',
    ):
        evidence.cures_of(sentence)[0].map(mapping, written)
    assert mapping == {
        "time_s": "t",
        "dvl": {
            "vx_m_s": {"column": "vx", "sign": -1, "offset": 1, "unit": "mm/s"},
            "vz_m_s": {"column": "vz", "sign": -1, "unit": "mm/s"},
        },
        "depth": {
            "z_m": {"column": "z", "unit": "cm"},
            "missing": [-9999, "NA"],
            "time_s": {"column": "t", "scale": 0.1, "offset": -18},
        },
    }


def test_what_cannot_be_followed_is_said(evidence: Any, tmp_path: Path) -> None:
    (tmp_path / "depth.csv").write_text("time_s,z_m\n0,1\n")
    sentences = {
        "depth.log.csv:3: the time falls; write sort = true in [depth] of the mapping if it may be": "sort",
        "depth.log.csv:3: 'NA' is no number; in the mapping write missing = 'NA' where it is none": "missing",
    }
    for sentence, key in sentences.items():
        mapping: dict[str, Any] = {"depth": {"file": "depth.log.csv"}}
        evidence.cures_of(sentence)[0].map(mapping, "")
        assert mapping["depth"][key] in (True, "NA")
    for sentence in ("multiply z_m by -1", "fixes.csv: multiply x_m by -1", "depth.csv: multiply y_m by -1"):
        with pytest.raises(evidence.Unfollowable):
            evidence.cures_of(sentence)[0].edit(tmp_path)
    with pytest.raises(evidence.Unfollowable):
        evidence.cures_of("write `missing = 0` in [depth] of the mapping")[0].map({}, "")
    assert evidence.cures_of("use a kernel: --robust Position=cauchy:1")[0].words == ("Position=cauchy:1",)
    assert evidence.cures_of("check units, signs, axes and times of depth.csv") == []


def test_of_causes_that_nothing_tells_apart_the_one_that_was_made_is_followed(script: Callable[[str], Any]) -> None:
    evidence = script("mistakes")
    late = next(mistake for mistake in evidence.MISTAKES if mistake.name == "ahrs: 1 s late")
    arm, clock = "x_m of dvl_mount.csv: subtract 1.9 from x_m", "write `ahrs_clock_s,1,0.3` in calibration.csv"
    forms = [[cure.form for cure in cures] for cures in evidence.choices([f"{arm}; or {clock}"], late, [])]
    assert forms == [["calibration"], ["numbers"], ["calibration"]]
    three = "exchange the names of vx_m_s, vy_m_s, multiply vz_m_s by -1, and write `earth_axes = 1` in [dvl]"
    (cures,) = evidence.choices([f"{three} of the mapping, or give dvl.csv a column"], late, ["subtract 1.9 from x_m"])
    assert [cure.form for cure in cures] == ["names", "numbers", "key"]
