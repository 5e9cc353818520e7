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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from sim.cli import main
from sim.estimators import errors, of_seed, tracked
from sim.monte_carlo import runs
from tests.sim.commands import made_again, refused, rows, table

SMALL = ["--laps", "1", "--known-start"]


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in a thread: processes are the matter of other tests."""

    def here(*given: Any, **options: Any) -> Any:
        with ThreadPoolExecutor(1) as executor:
            return runs(*given, executor=executor, **options)

    monkeypatch.setattr("sim.cli_estimators.runs", here)


def test_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    call = ["subsea", "--seed", "7", *SMALL, "--azimuth", "absolute", "--estimator", "batch", "--out", str(folder)]
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
    call = ["subsea", *SMALL, "--estimator", "batch", "--seed", "3", "--runs", "2", "--resume", str(file)]
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
    said = table(["compare", *SMALL, "--estimators", "batch", "ekf", "--runs", "2"], capsys)
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


def test_one_line_for_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
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
    call = ["subsea", *SMALL, "--estimator", "batch", "--runs", "500", "--resume", str(file)]
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
