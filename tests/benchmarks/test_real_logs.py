"""Dead reckoning on public logs against their truth, what their readers refuse, and that every log has its mapping."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import SE3

SCRIPT = "real_logs"


def test_auv_at_sea(data: Path, evidence: Any) -> None:
    """400 s and 670 to 890 m: below 1 % of the distance, with the true attitude and with a simulated sensor."""
    log = evidence.read_auv_dvl(data / "underwater-auv-dvl", 3)
    true, sensor = evidence.auv_dvl(log, "true"), evidence.auv_dvl(log, "sensor", 3)
    assert 650 < true.distance < 900
    assert 0.2 < true.drift < 0.95
    assert 1.5 < true.ate < 4.0
    assert sensor.drift < 1.1
    assert sensor.ate != true.ate


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


def test_every_log_has_its_mapping_and_its_origin(script: Callable[[str], Any]) -> None:
    evidence = script("public_logs")
    text = (evidence.FOLDER / "logs.toml").read_text(encoding="utf-8")
    logs = [evidence.Log(**entry) for entry in tomllib.loads(text)["log"]]
    assert len({log.repository for log in logs}) >= 10
    mappings = {path.stem for path in evidence.FOLDER.glob("*.toml")} - {"logs"}
    assert mappings == {log.name for log in logs}
    for log in logs:
        clone, *shows = log.commands()
        assert log.repository in clone
        assert len(log.commit) == 40
        assert all(log.commit in show for show in shows)
