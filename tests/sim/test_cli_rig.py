"""The rig on the command line: the table before and after, its files, one line for every mistake."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import sim
from nls import kinds
from sim.calibration import calibrated
from sim.cli import main

(s,) = kinds("s")
SMALL = ["--poses", "6", "--points", "60"]


def table(out: str) -> list[tuple[str, str]]:
    return [(line[:14].strip(), line[16:]) for line in out.splitlines()]


def test_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--seed", "7", *SMALL]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    rig = sim.rig(np.random.default_rng(7), poses=6, points=60)
    result = calibrated(rig)
    before, after = rig.errors(rig.start), rig.errors(result.values)
    said = table(out)
    labels = ["world", "poses", "points", "measured", "chi2 at truth", "chi2", "solved", "cameras", "points", "sonar"]
    assert [label for label, _ in said] == [*labels, "alignment"]
    assert said[0][1] == "rig, seed 7"
    assert said[3][1] == "360 images, 360 sonar contacts"
    assert said[5][1].endswith(f"-> {result.chi2_final:.6g}, dof {rig.dof}")
    assert said[6][1].startswith(f"CONVERGED, {result.iterations} iterations of gauss-newton: ")
    assert said[7][1] == f"{100 * before.poses:.3g} cm -> {100 * after.poses:.3g} cm"
    assert said[8][1] == f"{100 * before.points:.3g} cm -> {100 * after.points:.3g} cm"
    assert said[9][1].startswith("5 cm, 3 deg -> ")
    assert said[9][1].endswith(f"{np.degrees(after.extrinsic_rad):.3g} deg")
    assert "rigid, of cameras and points together" in said[10][1]


def test_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert main(["rig", "--seed", "3", *SMALL, "--views", "5", "--out", str(folder)]) == 0
    written = dict(table(capsys.readouterr().out))["written"].split(", ")
    assert sorted(written) == sorted(map(str, folder.iterdir()))
    assert sorted(p.name for p in folder.iterdir()) == ["README.txt", "rig.json", "rig.png"]
    assert (folder / "rig.png").read_bytes()[:4] == b"\x89PNG"
    report = json.loads((folder / "rig.json").read_text())
    rig = sim.rig(np.random.default_rng(3), poses=6, points=60, views=5)
    result = calibrated(rig)
    assert (report["images"], report["contacts"], report["dof"]) == (300, 300, rig.dof)
    assert report["converged"] is True
    for name, values in (("before", rig.start), ("after", result.values)):
        errors = rig.errors(values)
        found = {**report[name]}
        assert found == {
            "poses": errors.poses,
            "points": errors.points,
            "extrinsic_m": errors.extrinsic_m,
            "extrinsic_rad": errors.extrinsic_rad,
        }
        assert report["extrinsic"][name] == values[s[0]].tolist()
    assert report["extrinsic"]["truth"] == rig.truth[s[0]].tolist()
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    call = re.search(r"^Made by: nls-sim (.*)$", readme, re.MULTILINE)
    assert call is not None
    assert "each seen from 5 poses" in readme.replace("\n", " ")
    again = tmp_path / "again"
    assert main([*call[1].split(), "--out", str(again)]) == 0
    for file in folder.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--views", "30"], "--views: 30 is not possible; give at most the number of poses, 20"),
        (["--poses", "1"], "--poses: 1 is not possible; give a whole number from 2"),
        (["--noise-scale", "1e31"], "--noise-scale: 1e+31 is not possible; give at most 1e+30"),
        (["--aperture", "28deg"], "--aperture is no option of rig"),
        ([*SMALL, "--views", "1"], "x"),
    ],
)
def test_one_line_for_a_mistake(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert re.fullmatch(r"nls-sim: .*\n", err)


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(["rig", "--help"])
    out = capsys.readouterr().out
    assert leave.value.code == 0
    for said in ("--views N", "(default 20)", "(default 600)", "rig.png, rig.json", "pose of the sonar"):
        assert said in " ".join(out.split())
