"""The command line: one table, files that read back, one line for every mistake; worlds, missions and the rig."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from nls import kinds, load
from nls.missions import read_mission
from sim.arguments import flag
from sim.cli import EXAMPLES, MISSIONS, WORLDS, main
from sim.files import calibrated
from tests.nls.io.disk import small_disk
from tests.sim.commands import made_again, refused, table
from tests.sim.scenes import MADE

x, s = kinds("x", "s")
SMALL: dict[str, dict[str, Any]] = {
    **{name: sizes for name, (_, sizes) in MADE.items()},
    **{"ring": {"laps": 2, "per_lap": 30}, "survey": {"legs": 1, "leg": 30}},
    **{"subsea": {"laps": 1}, "compare": {"laps": 1}},
}


def small(name: str) -> list[str]:
    return [name, *(str(word) for option, size in SMALL[name].items() for word in (flag(option), size))]


@pytest.mark.parametrize("name", ["manhattan", "sphere"])
def test_files_read_back(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert main([*small(name), "--seed", "3", "--sigma-r", "0.031", "--out", str(folder)]) == 0
    assert str(folder / "graph.g2o") in capsys.readouterr().out
    world = WORLDS[name](np.random.default_rng(3), sigma_r=0.031, **SMALL[name])
    for file, expected in (("graph.g2o", world.start), ("truth.g2o", world.truth)):
        graph, values, _ = load(folder / file, convention="log")
        np.testing.assert_array_equal(values[x], expected[x])
        assert len(graph) == len(world.graph)
        assert graph.chi2(values) == pytest.approx(world.graph.chi2(expected), rel=1e-9)
    np.testing.assert_array_equal(load(folder / "truth.npz")[1][x], world.truth[x])
    graph, start, _ = load(folder)
    assert graph.chi2(start) == world.graph.chi2(world.start)
    result = graph.optimize(start)
    assert result.converged
    assert sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    readme = made_again(folder, ["graph.g2o", "graph.npz", "truth.g2o", "truth.npz"], tmp_path / "again")
    assert "seed 3" in readme
    assert f"{world.poses} in" in readme


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("hauv-floor", "--aperture 28deg", "28 deg high"),
        ("hauv-hull", "--aperture 28deg --drop-outs 0.1 --outliers 0.05 --wrong-associations 0.05", "28 deg high"),
        ("survey", "--usbl-outliers 0.1", "1 legs of 30 m"),
        ("rig", "--views 5", "each seen from 5 poses"),
        ("harbor", "--geometry quay", "quay"),
    ],
)
def test_a_folder(name: str, options: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    said = table([*small(name), "--seed", "3", *options.split(), "--out", str(folder)], capsys)
    assert (said["world"].split(",")[0], said["world"].split()[-1]) == (name, "3")
    assert sorted(said["written"].split(", ")) == sorted(str(p) for p in folder.rglob("*") if p.is_file())
    assert words in made_again(folder, [], tmp_path / "again")


@pytest.mark.parametrize("name", sorted(MISSIONS))
def test_missions(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = table([*small(name), "--seed", "3", "--aperture", "28deg", "--out", str(tmp_path)], capsys)
    mission = MISSIONS[name](np.random.default_rng(3), aperture=radians(28), **SMALL[name])
    assert list(said)[1:-1] == ["poses", "landmarks", "contacts", "elevation", "chi2 at truth", "dead reckoning"]
    assert said["poses"].startswith(f"{mission.poses} in SE3, ")
    assert (said["landmarks"], said["contacts"]) == (str(mission.landmarks), str(len(mission.contacts)))
    chi2, expected = map(float, re.match(r"([\d.]+), expected (\d+) \(", said["chi2 at truth"]).groups())
    assert (chi2, expected) == (pytest.approx(mission.sensed.chi2(mission.truth), rel=1e-5), mission.rows)
    assert float(said["dead reckoning"].split()[0]) == pytest.approx(mission.ate(mission.start), rel=1e-3)
    graph, values, *_ = read_mission(tmp_path)
    assert graph.chi2(mission.truth) == pytest.approx(mission.graph.chi2(mission.truth), rel=1e-9)
    assert [len(values.stack(kind)) for kind in ("x", "l")] == [mission.poses, mission.landmarks]


def test_survey(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = table([*small("survey"), "--seed", "3", "--usbl-outliers", "0.1"], capsys)
    log = sim.survey(np.random.default_rng(3), legs=1, leg=30, usbl_outliers=0.1)
    assert list(said) == ["world", "way", "DVL", "AHRS, depth", "GPS", "LBL", "USBL", "calibration"]
    assert said["way"] == f"{log.distance:.4g} m in {log.duration} s"
    assert said["USBL"].endswith(f"{log.wrong.sum()} of them wrong")
    (tmp_path / "zpr.csv").touch()
    refused([*small("survey"), "--out", str(tmp_path)], "another mission", capsys)


def test_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = table([*small("rig"), "--seed", "3", "--out", str(tmp_path)], capsys)
    rig = sim.rig(np.random.default_rng(3), poses=6, points=60)
    result = calibrated(rig)
    before, after = rig.errors(rig.start), rig.errors(result.values)
    assert said["measured"] == "360 images, 360 sonar contacts"
    assert said["chi2"].endswith(f"-> {result.chi2_final:.6g}, dof {rig.dof}")
    assert said["solved"].startswith(f"CONVERGED, {result.iterations} iterations of gauss-newton: ")
    assert said["cameras"] == f"{100 * before.poses:.3g} cm -> {100 * after.poses:.3g} cm"
    assert said["sonar"].endswith(f"{np.degrees(after.extrinsic_rad):.3g} deg")
    assert (tmp_path / "rig.png").read_bytes()[:4] == b"\x89PNG"
    report = json.loads((tmp_path / "rig.json").read_text())
    assert (report["images"], report["contacts"], report["dof"], report["converged"]) == (360, 360, rig.dof, True)
    for name, errors, values in (("before", before, rig.start), ("after", after, result.values)):
        assert report[name] == {key: getattr(errors, key) for key in report[name]}
        assert report["extrinsic"][name] == values[s[0]].tolist()
    assert report["extrinsic"]["truth"] == rig.truth[s[0]].tolist()


def test_one_line_for_a_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, named in (
        ("", "NAME"),
        ("sphre", "invalid choice: 'sphre'"),
        ("hauv_floor", "invalid choice: 'hauv_floor'"),
        ("sphere --poses 30", "--poses is no option of sphere"),
        ("rig --aperture 28deg", "--aperture is no option of rig"),
        ("ring extra", "extra is no option of ring"),
        ("sphere --ring 30", "--ring is no option of sphere"),
        ("sphere --rings", "expected one argument"),
        ("sphere --rings many", "'many' is not a whole number"),
        ("ring --seed 9223372036854775808", "'9223372036854775808' is too large"),
        ("sphere --rings 1_0", "'1_0' is not a whole number"),
        ("sphere --rings 1", "--rings: 1 is not possible; give a whole number from 2"),
        ("sphere --sigma-t nan", "'nan' is not a number"),
        ("ring --seed -1", "seed"),
        ("manhattan --poses 12000 --radius 1e6", "choose a smaller radius"),
        ("hauv-floor --elevation guess", "--elevation: invalid choice: 'guess'"),
        ("hauv-floor --aperture deg", "'deg' is not a number"),
        ("hauv-floor --aperture 180deg", "nls-sim: --aperture: 3.14159"),
        ("hauv-floor --per-leg 2 --legs 1 --passes 1", "none of 399 points is seen 3 times"),
        ("survey --noise-scale 1e20", "--noise-scale: 1e+20 is not possible; give a number from 0 to 1e+05, a factor"),
    ):
        refused(arguments.split(), named, capsys)
    refused(["hauv-floor", "--aperture", "28 deg"], "'28 deg' is not a number", capsys)
    refused(["ring", "--out", ""], "--out: '' is not possible", capsys)
    (tmp_path / "file").write_text("taken")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        refused([*small("ring"), "--out", str(folder)], "cannot be made", capsys)
    assert (tmp_path / "file").read_text() == "taken"


@pytest.mark.parametrize("name", ["hauv-floor", "ring"])
def test_a_full_disk_leaves_the_folder_as_it_was(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Files may have 8 kB: the first ones fit, a later one does not."""
    old = tmp_path / "old"
    old.mkdir()
    (old / "README.txt").write_text("older")
    for folder in (tmp_path / "new" / "folder", old):
        with small_disk(8000):
            refused([*small(name), "--out", str(folder)], f"nls-sim: {folder}/", capsys)
    assert not (tmp_path / "new").exists()
    assert [(file.name, file.read_text()) for file in old.iterdir()] == [("README.txt", "older")]


def test_examples_of_the_help_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With smaller sizes, which come last and count."""
    monkeypatch.chdir(tmp_path)
    calls = [line.split("   ")[0].split()[1:] for line in EXAMPLES.splitlines() if line.startswith("  nls-sim")]
    assert len(calls) == 12
    assert [main([*call, *small(call[0])[1:]]) for call in calls if not {"--help", "--runs"} & set(call)] == [0] * 10
    made = ("demo/graph.g2o", "survey/contacts.csv", "log/truth/truth.csv", "quay/scans.csv")
    made += ("calibrated/rig.png", "over-confident/estimate.png")
    assert all((tmp_path / name).exists() for name in made)


def test_python_m_sim_does_not_import_matplotlib() -> None:
    code = (
        "import runpy, sys; import sim, sim.cli; assert 'matplotlib' not in sys.modules;"
        "sys.argv = ['sim', 'ring', '--laps', '1', '--per-lap', '20']; runpy.run_module('sim', run_name='__main__')"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("world           ring, seed 0\n")
