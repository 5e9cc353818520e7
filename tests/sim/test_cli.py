"""The command line: one table, files that read back, one line for every mistake; worlds, missions, estimators."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
from sim.estimators import errors, of_seed, tracked
from sim.files import calibrated
from sim.monte_carlo import runs
from tests.nls.io.disk import small_disk
from tests.sim.scenes import MADE


def rows(out: str) -> list[tuple[str, str]]:
    return [(line[:14].strip(), line[16:]) for line in out.splitlines()]


def table(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """What a call without a mistake prints."""
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return dict(rows(out))


def made_again(folder: Path, names: list[str], again: Path) -> str:
    """The README of a folder; its command makes the same files."""
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    assert names == [] or sorted(p.name for p in folder.iterdir()) == ["README.txt", *names]
    call = re.search(r"^Made by: nls-sim (.*)$", readme, re.MULTILINE)
    assert call is not None
    assert main([*call[1].split(), "--out", str(again)]) == 0
    for file in (path for path in folder.rglob("*") if path.is_file()):
        assert file.read_bytes() == (again / file.relative_to(folder)).read_bytes()
    return readme.replace("\n", " ")


def refused(arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and one line on stderr that holds some words."""
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = int(str(leave.code))
    out, err = capsys.readouterr()
    assert (code, out) == (2, ""), arguments
    assert named in err, arguments
    assert re.fullmatch(r"nls-sim: .*\n", err), arguments


def help_text(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as leave:
        main([*arguments, "--help"])
    assert leave.value.code == 0
    return " ".join(capsys.readouterr().out.split())


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
    for name, found, values in (("before", before, rig.start), ("after", after, result.values)):
        assert report[name] == {key: getattr(found, key) for key in report[name]}
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


ONE_LAP = ["--laps", "1", "--known-start"]


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in a thread: processes are the matter of other tests."""

    def here(*given: Any, **options: Any) -> Any:
        with ThreadPoolExecutor(1) as executor:
            return runs(*given, executor=executor, **options)

    monkeypatch.setattr("sim.cli_estimators.runs", here)


def test_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    call = ["subsea", "--seed", "7", *ONE_LAP, "--azimuth", "absolute", "--estimator", "batch", "--out", str(folder)]
    said = table(call, capsys)
    world = sim.subsea(np.random.default_rng(7), laps=1, known_start=True, azimuth="absolute")
    found = errors(world, tracked(world, "batch"))
    assert said["world"] == "subsea, seed 7"
    assert said["poses"] == "91 in SE2"
    assert said["landmarks"] == f"6 in R(2), {len(world.sightings)} sightings"
    assert said["estimator"] == "batch"
    assert said["ATE"].startswith(f"{found['ate']:.4g} m, {found['aligned']:.4g} m after")
    assert said["final"] == f"{found['final']:.4g} m off; 3 sigma {3 * found['sigma']:.4g} m per axis"
    assert said["NEES"].startswith(f"{found['nees']:.4g} of the last pose; 0.22 to 9.35")
    assert said["map"] == f"{found['landmarks']:.4g} m (rmse of 6 landmarks in the end)"
    assert all((folder / f"{name}.png").read_bytes()[:4] == b"\x89PNG" for name in ("estimate", "offsets"))
    report = json.loads((folder / "estimate.json").read_text())
    assert {key: report[key] for key in found} == found
    assert report["options"]["azimuth"] == "absolute"
    made_again(folder, ["estimate.json", "estimate.png", "graph.npz", "offsets.png", "truth.npz"], tmp_path / "again")


@pytest.mark.usefixtures("threads")
def test_many_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = tmp_path / "runs.jsonl", tmp_path / "out"
    call = ["subsea", *ONE_LAP, "--estimator", "batch", "--seed", "3", "--runs", "2", "--resume", str(file)]
    said = table([*call, "--out", str(folder)], capsys)
    options = {"laps": 1, "known_start": True, "landmarks": "correlated", "azimuth": "increment", "known_landmarks": 0}
    expected = [of_seed(seed, "subsea", ["batch"], {**options, "noise_scale": 1.0}, {}) for seed in (3, 4)]
    report = json.loads((folder / "runs.json").read_text())
    assert report["runs"] == [{"seed": seed, **record} for seed, record in zip((3, 4), expected, strict=True)]
    assert said["batch"].split()[0] == f"{np.mean([r['batch']['ate'] for r in expected]):.3f}"
    data = file.read_bytes()
    file.write_bytes(data[:-5])
    assert "the last line is half written" in table(call, capsys)["note"]  # one seed runs again
    assert sorted(file.read_bytes().splitlines()) == sorted(data.splitlines())
    said = table(["compare", *ONE_LAP, "--estimators", "batch", "ekf", "--runs", "2"], capsys)
    assert float(said["batch"].split()[0]) < float(said["ekf"].split()[0]) < float(said["dead reckoning"].split()[0])


@pytest.mark.usefixtures("threads")
def test_seeds_that_fail_are_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With noise 32 times as large seeds 1 and 2 never see some landmarks, which a batch solution cannot place."""
    call = ["subsea", "--laps", "1", "--noise-scale", "32", "--estimator", "batch"]
    assert main([*call, "--runs", "3", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    said = dict(rows(out))
    assert said["runs"].startswith("1 of 3, seeds 0 to 2")
    assert said["failed"] == "seeds 1, 2, left out of the means"
    *_, line = err.splitlines()
    assert re.fullmatch(r"nls-sim: 2 of 3 runs failed\. seed 1: .*l0: x, y.*\(estimator batch\); seed 2: .*l4.*", line)
    report = json.loads((tmp_path / "runs.json").read_text())
    assert [run["seed"] for run in report["runs"]] == [0]
    assert [run["seed"] for run in report["failed"]] == [1, 2]
    assert report["runs"][0]["batch"]["ate"] == pytest.approx(float(said["batch"].split()[0]), abs=1e-3)


def test_one_line_for_a_mistake_of_estimators(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, named in (
        ("subsea --estimator kalman", "invalid choice: 'kalman'"),
        ("subsea --particles 9", "--particles belongs to fastslam1 or fastslam2, not to ekf"),
        ("lines --estimator online --lag 9", "--lag belongs to fixed-lag, not to online"),
        ("lines --estimator fastslam1 --particles 1", "particles: 1 is not possible"),
        ("lines --azimuth absolute", "--azimuth is no option of lines"),
        ("subsea --runs 0", "'0' is below 1"),
        ("subsea --resume runs", "--resume: 'runs' is not possible"),
        ("compare --world ring", "invalid choice: 'ring'"),
        ("compare --world lines --known-start", "--known-start is no option of the world lines"),
        ("compare --estimators ekf ekf", "--estimators: 'ekf ekf' is not possible"),
        ("compare --memory --runs 2", "--memory and --runs"),
        ("compare --rings 2", "--rings is no option of compare"),
    ):
        refused(arguments.split(), named, capsys)


@pytest.mark.skipif(sys.platform == "win32", reason="process groups are those of POSIX")
def test_stopped_halfway(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    call = ["subsea", *ONE_LAP, "--estimator", "batch", "--runs", "500", "--resume", str(file)]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits none
    run = subprocess.Popen([sys.executable, "-m", "sim", *call], start_new_session=True, stderr=subprocess.PIPE)
    signal.signal(signal.SIGINT, before)
    try:
        _until(lambda: file.exists() and file.read_bytes().count(b"\n") > 2)
        os.killpg(run.pid, signal.SIGINT)
        err = run.communicate(timeout=60)[1].decode()
        assert run.returncode == 130
        kept = f"nls-sim: interrupted while running subsea, finished runs are in {file}; nothing was written\n"
        assert err == kept
        _until(lambda: not _alive(run.pid))  # its workers are gone too
    finally:
        if _alive(run.pid):
            os.killpg(run.pid, signal.SIGKILL)
    whole = file.read_bytes().rpartition(b"\n")[0].splitlines()
    assert 2 < len(whole) < 501
    assert all(json.loads(line) for line in whole)


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end, "a minute was not enough"
        time.sleep(0.05)
