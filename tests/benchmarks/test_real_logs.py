"""Dead reckoning on public logs against their truth, and what their readers refuse."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.evidence.logs import read_auv_dvl, read_caves, read_holoocean
from models import SE3
from models.errors import GraphFileError
from tests.combinations import for_all


@pytest.fixture
def logs(script: Callable[[str], Any]) -> Any:
    return script("real_logs")


@for_all(number=range(1, 8))
def test_auv_at_sea(number: int, data: Path, logs: Any) -> None:
    """400 s and 670 to 890 m: below 1 % of the distance, with the true attitude and with a simulated sensor."""
    log = read_auv_dvl(data / "underwater-auv-dvl", number)
    true, sensor = logs.auv_dvl(log, "true"), logs.auv_dvl(log, "sensor", number)
    assert 650 < true.distance < 900
    assert 0.2 < true.drift < 0.95
    assert 1.5 < true.ate < 4.0
    assert sensor.drift < 1.1
    assert sensor.ate != true.ate
    # positions in meters are those of the velocities, to 1 %: the times of the log are resampled
    dt = np.diff(log.t)[:, None]
    travelled = (0.5 * (log.v[1:] + log.v[:-1]) * dt).sum(axis=0)
    np.testing.assert_allclose(travelled, log.p[-1], atol=0.01 * true.distance)


def test_holoocean(data: Path, logs: Any) -> None:
    """Exact with the true attitude; by the gyro the heading goes; heights hold the depth."""
    log = read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    exact, gyro, graph = logs.holoocean(log)
    assert exact.drift < 0.05
    assert exact.ate < 0.015
    assert 10 < gyro.drift < 25
    assert gyro.height > 0.8
    assert graph.height < 0.03
    assert graph.ate < 0.9 * gyro.ate


def test_holoocean_legs_obey_the_noise_of_the_dvl(data: Path, logs: Any) -> None:
    """With the true attitude the rest is DVL noise: NEES of the positions inside 95 %, and only with the mounting."""
    log = read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    k = np.arange(0, len(log.t), 100)
    legs = logs.holoocean_legs(log, k, True)
    e = SE3.local(legs.z, SE3.between(log.X[k[:-1]], log.X[k[1:]]))[:, :3]
    nees = np.einsum("ki,kij,kj->k", e, np.linalg.inv(legs.Sigma[:, :3, :3]), e)
    assert len(nees) == 36
    assert abs(nees.mean() - 3) < 1.96 * np.sqrt(2 * 3 / len(nees))


def test_caves(data: Path, logs: Any) -> None:
    """A sixth of the time without bottom lock, said; the distances of the published track, and of the tape, are kept.

    The heading is the course of that track, so nothing is claimed about the heading.
    """
    log = read_caves(data / "underwater-caves")
    track, legs = logs.caves(log)
    assert (len(log.t), int(log.valid.sum()), log.t_track[0]) == (5564, 5082, 0.0)
    gaps = np.diff(log.t[log.valid])
    lost = np.diff(np.flatnonzero(log.valid)) > 1
    inside = gaps[lost].sum()
    assert legs.bridged.sum() == pytest.approx(inside, abs=10)  # less what lies before and behind the published track
    assert 320 < legs.bridged.sum() < 340
    reckoned = np.linalg.norm(np.diff(track.X[:, :2], axis=0), axis=1).sum()
    assert reckoned == pytest.approx(track.distance, rel=0.05)
    assert track.drift < 2
    assert track.ate < 4
    for a, b, tape, found, published, _ in logs.cones(log):
        assert abs(found - published) < 2.0, (a, b)
        assert abs(found - tape) < 3.2, (a, b)


def test_caves_depth(data: Path) -> None:
    """The published track has the depth of the sensor, one meter further down, to 5 cm."""
    log = read_caves(data / "underwater-caves")
    difference = np.interp(log.t_track, log.t_depth, log.depth) - log.track[:, 2]
    assert difference.mean() == pytest.approx(-1.004, abs=0.01)
    assert difference.std() < 0.06


def test_what_is_no_such_log(tmp_path: Path) -> None:
    header = "Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]\n"
    dvl, ins = tmp_path / "DVL_trajectory1.csv", tmp_path / "GT_trajectory1.csv"
    with pytest.raises(GraphFileError, match=r"DVL_trajectory1\.csv: cannot be read: No such file"):
        read_auv_dvl(tmp_path, 1)
    dvl.write_text("Time [s],DVL X [m/s]\n0,1\n")
    with pytest.raises(GraphFileError, match=r"DVL_trajectory1\.csv:1: has no column 'DVL Y \[m/s\]'"):
        read_auv_dvl(tmp_path, 1)
    dvl.write_text(header)
    with pytest.raises(GraphFileError, match="has no rows"):
        read_auv_dvl(tmp_path, 1)
    dvl.write_text(header + "0,1,2,3\n1,1,fast,3\n")
    with pytest.raises(GraphFileError, match=r"is no table of numbers after line 1: .*fast"):
        read_auv_dvl(tmp_path, 1)
    dvl.write_text(header + "0,1,2,3\n1,1,2,3\n")
    columns = import_module("benchmarks.evidence.logs.auv_dvl").INS
    ins.write_text(f"Time [s],{columns}\n0,0,0,0,0,0,0,0,0,0\n2,0,0,0,0,0,0,0,0,0\n")
    with pytest.raises(GraphFileError, match=r"its times are not those of GT_trajectory1\.csv"):
        read_auv_dvl(tmp_path, 1)


def test_what_is_no_holoocean_log(tmp_path: Path) -> None:
    step = ["R 0.1 1 0 0 0 1 0 0 0 1", "V 0.1 1 0 0", "P 0.1 1 2 3"]
    step += ["IMU 0.1 1 2 3 4 5 6", "DVL 0.1 1 0 0", "DEPTH 0.1 3"]
    path = tmp_path / "log.txt.gz"

    def written(lines: list[str]) -> Path:
        path.write_bytes(gzip.compress("\n".join(lines).encode()))
        return path

    log = read_holoocean(written(step + step))
    np.testing.assert_allclose(log.t, [0.0, 0.1])
    np.testing.assert_allclose(log.X, [[1, 2, 3, 0, 0, 0, 1]] * 2)
    np.testing.assert_allclose(log.f, [[4, 5, 6]] * 2)
    with pytest.raises(GraphFileError, match=r"log\.txt\.gz:7: expected R, dt and 9 numbers"):
        read_holoocean(written(step + step[1:]))
    with pytest.raises(GraphFileError, match=r"ends within a step: 8 lines"):
        read_holoocean(written(step + step[:2]))
    with pytest.raises(GraphFileError, match=r"log\.txt\.gz:6: 'deep' is not a number"):
        read_holoocean(written([*step[:5], "DEPTH 0.1 deep"]))
