"""Dead reckoning on public logs against their truth, and what their readers refuse."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import SE3
from models.errors import GraphFileError
from tests.combinations import for_all


@pytest.fixture
def evidence(script: Callable[[str], Any]) -> Any:
    return script("real_logs")


@for_all(number=range(1, 8))
def test_auv_at_sea(number: int, data: Path, evidence: Any, script: Callable[[str], Any]) -> None:
    """400 s and 670 to 890 m: below 1 % of the distance, with the true attitude and with a simulated sensor."""
    log = evidence.read_auv_dvl(data / "underwater-auv-dvl", number)
    true, sensor = evidence.auv_dvl(log, "true"), evidence.auv_dvl(log, "sensor", number)
    assert 650 < true.distance < 900
    assert 0.2 < true.drift < 0.95
    assert 1.5 < true.ate < 4.0
    assert sensor.drift < 1.1
    assert sensor.ate != true.ate
    # positions in meters are those of the velocities, to 1 %: the times of the log are resampled
    dt = np.diff(log.t)[:, None]
    path, axes = data / "underwater-auv-dvl" / f"GT_trajectory{number}.csv", ("North", "East", "Down")
    v = script("logs.table").columns(path, [f"V {axis} [m/s]" for axis in axes])
    travelled = (0.5 * (v[1:] + v[:-1]) * dt).sum(axis=0)
    np.testing.assert_allclose(travelled, log.p[-1], atol=0.01 * true.distance)


def test_holoocean(data: Path, evidence: Any) -> None:
    """Exact with the true attitude; by the gyro the heading goes; heights hold the depth."""
    log = evidence.read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    exact, gyro, graph = evidence.holoocean(log)
    assert exact.drift < 0.05
    assert exact.ate < 0.015
    assert 10 < gyro.drift < 25
    assert gyro.height > 0.8
    assert graph.height < 0.03
    assert graph.ate < 0.9 * gyro.ate


def test_holoocean_legs_obey_the_noise_of_the_dvl(data: Path, evidence: Any) -> None:
    """With the true attitude the rest is DVL noise: NEES of the positions inside 95 %, and only with the mounting."""
    log = evidence.read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    k = np.arange(0, len(log.t), 100)
    legs = evidence.holoocean_legs(log, k, True)
    e = SE3.local(legs.z, SE3.between(log.X[k[:-1]], log.X[k[1:]]))[:, :3]
    nees = np.einsum("ki,kij,kj->k", e, np.linalg.inv(legs.Sigma[:, :3, :3]), e)
    assert len(nees) == 36
    assert abs(nees.mean() - 3) < 1.96 * np.sqrt(2 * 3 / len(nees))


def test_caves(data: Path, evidence: Any) -> None:
    """A sixth of the time without bottom lock, said; the distances of the published track, and of the tape, are kept.

    The heading is the course of that track, so nothing is claimed about the heading.
    """
    log = evidence.read_caves(data / "underwater-caves")
    track, legs = evidence.caves(log)
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
    for a, b, tape, found, published, _ in evidence.cones(log):
        assert abs(found - published) < 2.0, (a, b)
        assert abs(found - tape) < 3.2, (a, b)


def test_caves_depth(data: Path, evidence: Any) -> None:
    """The published track has the depth of the sensor, one meter further down, to 5 cm."""
    log = evidence.read_caves(data / "underwater-caves")
    difference = np.interp(log.t_track, log.t_depth, log.depth) - log.track[:, 2]
    assert difference.mean() == pytest.approx(-1.004, abs=0.01)
    assert difference.std() < 0.06


def test_two_logs_of_other_times(tmp_path: Path, evidence: Any) -> None:
    """What `nls import` refuses is tested there; it allows two clocks."""
    (tmp_path / "DVL_trajectory1.csv").write_text("Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]\n0,1,2,3\n1,1,2,3\n")
    columns = "Time [s],Longitude [rad],Latitude [rad],Altitude [m],Roll [rad],Pitch [rad],Yaw [rad]"
    (tmp_path / "GT_trajectory1.csv").write_text(f"{columns}\n0,0,0,0,0,0,0\n2,0,0,0,0,0,0\n")
    with pytest.raises(GraphFileError, match=r"its times are not those of GT_trajectory1\.csv"):
        evidence.read_auv_dvl(tmp_path, 1)


def test_columns_that_are_no_numbers(tmp_path: Path, script: Callable[[str], Any]) -> None:
    columns, path = script("logs.table").columns, tmp_path / "cones.csv"
    with pytest.raises(GraphFileError, match=r"cones\.csv: cannot be read: No such file"):
        columns(path, ("cone", "x [m]"))
    for text, words in (
        ("cone\n0\n", r"cones\.csv:1: has no column 'x \[m\]'"),
        ("cone,x [m]\n", "has no rows"),
        ("cone,x [m]\n0,1\n1,fast\n", r"is no table of numbers after line 1: .*fast"),
    ):
        path.write_text(text)
        with pytest.raises(GraphFileError, match=words):
            columns(path, ("cone", "x [m]"))


def test_what_is_no_holoocean_log(tmp_path: Path, evidence: Any) -> None:
    step = ["R 0.1 1 0 0 0 1 0 0 0 1", "V 0.1 1 0 0", "P 0.1 1 2 3"]
    step += ["IMU 0.1 1 2 3 4 5 6", "DVL 0.1 1 0 0", "DEPTH 0.1 3"]
    path = tmp_path / "log.txt.gz"

    def written(lines: list[str]) -> Path:
        path.write_bytes(gzip.compress("\n".join(lines).encode()))
        return path

    log = evidence.read_holoocean(written(step + step))
    np.testing.assert_allclose(log.t, [0.0, 0.1])
    np.testing.assert_allclose(log.X, [[1, 2, 3, 0, 0, 0, 1]] * 2)
    np.testing.assert_allclose(log.f, [[4, 5, 6]] * 2)
    with pytest.raises(GraphFileError, match=r"log\.txt\.gz:7: expected R, dt and 9 numbers"):
        evidence.read_holoocean(written(step + step[1:]))
    with pytest.raises(GraphFileError, match=r"ends within a step: 8 lines"):
        evidence.read_holoocean(written(step + step[:2]))
    with pytest.raises(GraphFileError, match=r"log\.txt\.gz:6: 'deep' is not a number"):
        evidence.read_holoocean(written([*step[:5], "DEPTH 0.1 deep"]))
