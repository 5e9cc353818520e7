"""Sonar missions on the command line: the table, folders that read back, words and degrees as options."""

from __future__ import annotations

import re
from math import radians
from pathlib import Path

import numpy as np
import pytest

from nls import kinds
from nls.io.mission import read_mission
from sim.cli import MISSIONS, main

x, l = kinds("x", "l")
SMALL = {"hauv-floor": ["--legs", "2", "--per-leg", "12"], "hauv-hull": ["--levels", "2", "--per-level", "13"]}
every_mission = pytest.mark.parametrize("name", sorted(MISSIONS))


def sizes(name: str) -> dict[str, int]:
    return {o.strip("-").replace("-", "_"): int(v) for o, v in zip(SMALL[name][::2], SMALL[name][1::2], strict=True)}


def table(out: str) -> dict[str, str]:
    return {line[:14].strip(): line[16:] for line in out.splitlines()}


@every_mission
def test_table(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--seed", "7", *SMALL[name]]) == 0
    out, err = capsys.readouterr()
    said = table(out)
    mission = MISSIONS[name](np.random.default_rng(7), **sizes(name))
    labels = ["world", "poses", "landmarks", "contacts", "elevation", "chi2 at truth", "dead reckoning"]
    assert (list(said), err) == (labels, "")
    assert said["world"] == f"{name}, seed 7"
    assert said["poses"].startswith(f"{mission.poses} in SE3, ")
    assert (said["landmarks"], said["contacts"]) == (str(mission.landmarks), str(len(mission.contacts)))
    chi2, expected = re.fullmatch(r"([\d.]+), expected (\d+) \(.*\)", said["chi2 at truth"]).groups()
    assert float(chi2) == pytest.approx(mission.sensed.chi2(mission.truth), rel=1e-5)
    assert abs(float(chi2) - int(expected)) < 4 * np.sqrt(2 * int(expected))
    assert float(said["dead reckoning"].split()[0]) == pytest.approx(mission.ate(mission.start), rel=1e-3)


@every_mission
def test_spoiled_to_order(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--drop-outs", "0.1", "--outliers", "0.05", "--wrong-associations", "0.05"]
    assert main([name, *SMALL[name], *options]) == 0
    contacts, wrong = map(
        int, re.fullmatch(r"(\d+), (\d+) of them wrong", table(capsys.readouterr().out)["contacts"]).groups()
    )
    assert wrong == round(0.05 * contacts) + 2 * round(0.025 * contacts)


@every_mission
def test_folders_read_back(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert main([name, *SMALL[name], "--seed", "3", "--aperture", "28deg", "--out", str(folder)]) == 0
    mission = MISSIONS[name](np.random.default_rng(3), aperture=radians(28), **sizes(name))
    graph, values, *_ = read_mission(folder)
    assert len(graph) == len(mission.graph)
    assert graph.chi2(mission.truth) == pytest.approx(mission.graph.chi2(mission.truth), rel=1e-9)
    assert sorted(values.stacks) == ["l", "x"]
    assert (len(values.stack("x")), len(values.stack("l"))) == (mission.poses, mission.landmarks)
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    assert "28 deg high" in readme.replace("\n", " ")
    written = table(capsys.readouterr().out)["written"].split(", ")
    assert sorted(written) == sorted(map(str, folder.iterdir()))
    call = re.search(r"^Made by: nls-sim (.*)$", readme, re.MULTILINE)[1]
    again = tmp_path / "again"
    assert main([*call.split(), "--out", str(again)]) == 0
    for file in folder.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["hauv_floor"], "invalid choice: 'hauv_floor'"),
        (["hauv-floor", "--elevation", "guess"], "--elevation: invalid choice: 'guess' (choose from"),
        (["hauv-floor", "--aperture", "28 deg"], "'28 deg' is not a number"),
        (["hauv-floor", "--aperture", "deg"], "'deg' is not a number"),
        (["hauv-floor", "--aperture", "180deg"], "nls-sim: --aperture: 3.14159"),
        (["hauv-hull", "--aperture", "200deg"], "is not possible; give an angle in (0, pi), rad"),
        (
            ["hauv-floor", "--per-leg", "2", "--legs", "1", "--passes", "1"],
            "hauv-floor: none of 399 points is seen 3 times",
        ),
        (
            ["hauv-hull", *SMALL["hauv-hull"], "--noise-scale", "1e300"],
            "--noise-scale: 1e+300 is not possible; give at most 1e+30",
        ),
        (["hauv-floor", "--passes", "0"], "--passes: 0 is not possible; give a whole number from 1"),
        (["hauv-floor", "--outliers", "2"], "--outliers: 2.0 is not possible; give a number from 0 to 1"),
        (["hauv-hull", "--wrong-associations", "1"], "--wrong-associations: 1.0 is not possible; give less"),
        (["hauv-hull", "--drop-outs", "1"], "--drop-outs: 1.0 is not possible; give less"),
        (["hauv-hull", "--legs", "3"], "--legs is no option of hauv-hull"),
    ],
)
def test_one_line_for_a_mistake(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = leave.code
    out, err = capsys.readouterr()
    assert (code, out) == (2, "")
    assert said in err
    assert re.fullmatch(r"nls-sim: .*\n", err)


@every_mission
def test_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main([name, "--help"])
    out = capsys.readouterr().out
    assert leave.value.code == 0
    for said in ("--aperture X", "(default 0.2443)", "{free,hinge,prior}", "(default hinge)", "a mission (CSV files"):
        assert said in out


def test_the_list_has_missions(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    out = capsys.readouterr().out
    assert all(name in out for name in MISSIONS)
