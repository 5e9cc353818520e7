"""Scenes for filters on the command line: tables, files, many seeds, one line for every mistake."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import sim
from sim.cli import main
from sim.estimators import ESTIMATORS, errors, of_seed, tracked

SMALL = ["--laps", "1", "--known-start"]


def table(out: str) -> dict[str, str]:
    return {line[:14].strip(): line[16:] for line in out.splitlines()}


def test_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert (
        main(["subsea", "--seed", "7", *SMALL, "--azimuth", "absolute", "--estimator", "batch", "--out", str(folder)])
        == 0
    )
    out, err = capsys.readouterr()
    assert err == ""
    world = sim.subsea(np.random.default_rng(7), laps=1, known_start=True, azimuth="absolute")
    found = errors(world, tracked(world, "batch"))
    said = table(out)
    assert said["world"] == "subsea, seed 7"
    assert said["poses"] == "91 in SE2"
    assert said["landmarks"] == f"6 in R(2), {len(world.sightings)} sightings"
    assert said["estimator"] == "batch"
    assert said["ATE"].startswith(f"{found['ate']:.4g} m, {found['aligned']:.4g} m after")
    assert said["final"] == f"{found['final']:.4g} m off; 3 sigma {3 * found['sigma']:.4g} m per axis"
    assert said["NEES"].startswith(f"{found['nees']:.4g} of the last pose; 0.22 to 9.35")
    assert sorted(p.name for p in folder.iterdir()) == ["README.txt", "estimate.json", "estimate.png"]
    assert (folder / "estimate.png").read_bytes()[:4] == b"\x89PNG"
    report = json.loads((folder / "estimate.json").read_text())
    assert {key: report[key] for key in found} == found
    assert report["options"]["azimuth"] == "absolute"
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    call = re.search(r"^Made by: nls-sim (.*)$", readme, re.MULTILINE)
    assert call is not None
    again = tmp_path / "again"
    assert main([*call[1].split(), "--out", str(again)]) == 0
    for file in folder.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()


def test_settings_reach_the_estimator(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["subsea", *SMALL, "--estimator", "fastslam2", "--particles", "5", "--seed", "2"]) == 0
    said = table(capsys.readouterr().out)
    assert said["estimator"] == "FastSLAM 2.0, 5 particles"
    world = sim.subsea(np.random.default_rng(2), laps=1, known_start=True)
    assert said["final"].startswith(f"{errors(world, tracked(world, 'fastslam2', particles=5))['final']:.4g} m")


def test_many_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = tmp_path / "runs.jsonl", tmp_path / "out"
    call = ["subsea", *SMALL, "--estimator", "batch", "--seed", "3", "--runs", "2", "--resume", str(file)]
    assert main([*call, "--out", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    options = {"laps": 1, "known_start": True, "landmarks": "correlated", "azimuth": "increment", "known_landmarks": 0}
    expected = [of_seed(seed, "subsea", ["batch"], {**options, "noise_scale": 1.0}, {}) for seed in (3, 4)]
    report = json.loads((folder / "runs.json").read_text())
    assert report["runs"] == [{"seed": seed, **record} for seed, record in zip((3, 4), expected, strict=True)]
    assert table(out)["batch"].split()[0] == f"{np.mean([r['batch']['ate'] for r in expected]):.3f}"
    data = file.read_bytes()
    file.write_bytes(data[:-5])
    assert main([*call]) == 0  # one seed runs again
    out, err = capsys.readouterr()
    assert err == ""
    assert "the last line is half written" in table(out)["note"]
    assert sorted(file.read_bytes().splitlines()) == sorted(data.splitlines())
    assert main([*call, "--noise-scale", "2"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"nls-sim: .*runs.jsonl:1: is not of this function and these options, .*\n", err)
    assert sorted(file.read_bytes().splitlines()) == sorted(data.splitlines())


def test_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = ["compare", "--world", "lines", "--laps", "1", "--estimators", "batch", "--out", str(tmp_path)]
    assert main(call) == 0
    said = table(capsys.readouterr().out)
    assert "ms/step" in said["estimator"]
    world = sim.lines(np.random.default_rng(0), laps=1)
    assert said["batch"].split()[0] == f"{errors(world, tracked(world, 'batch'))['ate']:.3f}"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["README.txt", "compare.json", "compare.png"]
    assert list(json.loads((tmp_path / "compare.json").read_text())["estimators"]) == ["batch"]
    readme = (tmp_path / "README.txt").read_text(encoding="utf-8")
    assert "Made by: nls-sim compare --seed 0 --world lines --laps 1 --estimators batch\n" in readme


def test_particles_that_have_become_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A singular covariance is said in the place of NEES; nothing stops."""
    few = ["fastslam1", "--particles", "2"]
    assert main(["compare", *SMALL, "--estimators", *few, "--out", str(tmp_path)]) == 0
    assert table(capsys.readouterr().out)["fastslam1"].split()[5] == "singular"
    assert (tmp_path / "compare.png").exists()
    assert "nees" not in json.loads((tmp_path / "compare.json").read_text())["estimators"]["fastslam1"]
    assert main(["subsea", *SMALL, "--estimator", *few, "--out", str(tmp_path)]) == 0
    assert table(capsys.readouterr().out)["NEES"].startswith("not defined: the covariance is singular")
    assert "nees" not in json.loads((tmp_path / "estimate.json").read_text())


def test_comparison_over_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", *SMALL, "--estimators", "batch", "ekf", "--runs", "2"]) == 0
    said = table(capsys.readouterr().out)
    assert float(said["batch"].split()[0]) < float(said["ekf"].split()[0]) < float(said["dead reckoning"].split()[0])


def test_seeds_that_fail_are_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With noise 32 times as large seeds 1 and 2 never see some landmarks, which a batch solution cannot place."""
    call = ["subsea", "--laps", "1", "--noise-scale", "32", "--estimator", "batch"]
    assert main([*call, "--runs", "3", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    said = table(out)
    assert said["runs"].startswith("1 of 3, seeds 0 to 2")
    assert said["failed"] == "seeds 1, 2, left out of the means"
    *_, line = err.splitlines()
    assert re.fullmatch(r"nls-sim: 2 of 3 runs failed\. seed 1: .*l0: x, y.*\(estimator batch\); seed 2: .*l4.*", line)
    report = json.loads((tmp_path / "runs.json").read_text())
    assert [run["seed"] for run in report["runs"]] == [0]
    assert [run["seed"] for run in report["failed"]] == [1, 2]
    assert report["runs"][0]["batch"]["ate"] == pytest.approx(float(said["batch"].split()[0]), abs=1e-3)


def test_interrupted(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.cli_estimators.runs", interrupt)
    assert main(["subsea", *SMALL, "--runs", "2"]) == 130
    assert capsys.readouterr() == ("", "nls-sim: interrupted while running subsea; nothing was written\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["subsea", "--estimator", "kalman"], "invalid choice: 'kalman'"),
        (["subsea", "--laps", "0"], "--laps: 0 is not possible"),
        (["subsea", "--particles", "9"], "--particles belongs to fastslam1 or fastslam2, not to ekf; leave"),
        (["lines", "--estimator", "online", "--lag", "9"], "--lag belongs to fixed-lag, not to online; leave it out"),
        (["lines", "--estimator", "fastslam1", "--particles", "1"], "particles: 1 is not possible; give a whole"),
        (["lines", "--azimuth", "absolute"], "--azimuth is no option of lines"),
        (["subsea", "--runs", "0"], "'0' is below 1"),
        (["subsea", "--resume", "runs"], "--resume: 'runs' is not possible; give the name of a file, together"),
        (["compare", "--world", "ring"], "invalid choice: 'ring'"),
        (["compare", "--world", "lines", "--known-start"], "--known-start is no option of the world lines"),
        (["compare", "--estimators", "ekf", "ekf"], "--estimators: 'ekf ekf' is not possible; give every one once"),
        (["compare", "--memory", "--runs", "2"], "--memory and --runs do not go together"),
        (["compare", "--rings", "2"], "--rings is no option of compare; see nls-sim compare --help"),
    ],
)
def test_one_line_for_a_mistake(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = int(str(leave.code))
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert said in err
    assert re.fullmatch(r"nls-sim: .*\n", err)


@pytest.mark.parametrize("name", ["subsea", "lines", "compare"])
def test_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main([name, "--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert leave.value.code == 0
    for said in (*ESTIMATORS, "--runs N", "--resume FILE", "--particles N", "--laps N", "example"):
        assert said in out


@pytest.mark.skipif(sys.platform == "win32", reason="process groups are those of POSIX")
@pytest.mark.parametrize("how", ["Ctrl-C", "killed"])
def test_stopped_halfway(how: str, tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    call = ["subsea", *SMALL, "--estimator", "batch", "--runs", "500", "--resume", str(file)]
    run = subprocess.Popen([sys.executable, "-m", "sim", *call], start_new_session=True, stderr=subprocess.PIPE)
    try:
        _until(lambda: file.exists() and file.read_bytes().count(b"\n") > 3)
        if how == "Ctrl-C":
            os.killpg(run.pid, signal.SIGINT)
        else:
            run.kill()
        err = run.communicate(timeout=60)[1].decode()
        assert run.returncode == (130 if how == "Ctrl-C" else -signal.SIGKILL)
        kept = f"nls-sim: interrupted while running subsea, finished runs are in {file}; nothing was written\n"
        assert err == kept if how == "Ctrl-C" else True
        _until(lambda: not _alive(run.pid))  # its workers are gone too
    finally:
        if _alive(run.pid):
            os.killpg(run.pid, signal.SIGKILL)
    whole = file.read_bytes().rpartition(b"\n")[0].splitlines()
    assert 3 < len(whole) < 501
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
