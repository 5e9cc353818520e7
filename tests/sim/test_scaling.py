"""What estimators cost against the number of landmarks: the rings, the laws, where it stops, the picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import sim.scaling
from models.errors import OptionError
from nls import kinds
from sim.estimators import errors, tracked
from sim.scaling import AGAIN, Cost, circuit, costs, exponent, scaling_rows
from tests.sim.commands import table

x, l = kinds("x", "l")


def test_a_ring_closes_and_its_poses_see_equally_many_landmarks_at_every_size() -> None:
    for landmarks in (100, 400):
        world = circuit(np.random.default_rng(2), landmarks)
        X, L = world.truth[x], world.truth[l]
        lap = world.poses - AGAIN - 1
        assert (len(L), 4 * lap) == (landmarks, landmarks)
        np.testing.assert_allclose(X[: AGAIN + 1, :2], X[lap:, :2], atol=1e-9)  # the second round begins
        seen = world.sightings
        assert np.unique(seen.keys[0].numbers, return_counts=True)[1].mean() == pytest.approx(13.6, abs=0.6)
        first = seen.keys[1].numbers[seen.keys[0].numbers <= lap]
        assert len(np.unique(first)) == landmarks  # nothing is new in the second round
        away = np.linalg.norm(X[seen.keys[0].numbers, :2] - L[seen.keys[1].numbers], axis=1)
        assert away.max() < 4.0
        assert np.abs(away - seen.z[:, 1]).max() < 5 * 0.2
        best = world.graph.optimize(world.start)
        assert best.converged
        assert world.ate(best.values) < 0.1
        assert world.graph.chi2(world.truth) == pytest.approx(world.rows, rel=0.1)
    with pytest.raises(OptionError, match="landmarks: 99 is not possible"):
        circuit(np.random.default_rng(0), 99)


def test_a_graph_costs_less_than_a_filter_and_grows_slower() -> None:
    """The start of it. At 1,600 to 6,400 landmarks: EKF m^1.87 a step; at 3,200 to 12,800: batch m^1.06 in all."""
    world = circuit(np.random.default_rng(3), 100)
    track = tracked(world, "ekf")
    assert len(track.landmarks) == 100  # known before the steps that are timed
    assert errors(world, track)["ate"] < 0.1
    ekf, batch = costs(0, ["ekf", "batch"], {}, 60.0, sizes=(100, 400))
    assert (ekf.name, ekf.landmarks, ekf.poses, ekf.stopped) == ("ekf", [100, 400], [46, 121], "")
    assert batch.landmarks == [100, 400]
    assert batch.total == pytest.approx([46 * batch.step[0], 121 * batch.step[1]])
    assert batch.total[1] < ekf.total[1] / 2  # with the search for a start
    assert batch.law("total") < ekf.law("total")
    assert 60 * ekf.step[1] < ekf.total[1] < 200 * ekf.step[1]


def grown(monkeypatch: pytest.MonkeyPatch, power: float) -> list[int]:
    """Steps that take (m / 100)^power s, without running anything; the landmarks of every run."""
    ran = []

    def times(world: sim.LandmarkWorld, name: str, settings: dict[str, int]) -> np.ndarray:
        ran.append(world.landmarks)
        each = np.full(world.poses, (world.landmarks / 100) ** power)
        each[:-AGAIN] = 0.0
        return each

    monkeypatch.setattr(sim.scaling, "_times", times)
    return ran


def test_it_stops_before_what_would_take_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = grown(monkeypatch, 2.0)
    (cost,) = costs(0, ["ekf"], {}, 1000.0, sizes=(100, 200, 400, 800))
    assert ran == cost.landmarks == [100, 200, 400]  # 20, 80 and 320 s; 1280 s are foreseen from the last two
    assert cost.step == pytest.approx([1, 4, 16])
    assert cost.total == pytest.approx([20, 80, 320])
    assert (cost.law("step"), cost.law("total")) == pytest.approx((2.0, 2.0))
    assert cost.stopped == "ekf stops before 800 landmarks, which would take about 1280 s"
    (cost,) = costs(0, ["ekf"], {}, 10.0, sizes=(100, 200, 400))
    assert cost.landmarks == [100, 200]  # a law needs two sizes
    ran = grown(monkeypatch, -1.0)  # what has grown cheaper is foreseen to grow as m
    (cost,) = costs(0, ["ekf"], {}, 25.0, sizes=(100, 200, 400, 800, 1600))
    assert cost.landmarks == [100, 200, 400, 800, 1600]


def test_the_table() -> None:
    slow = Cost("slow", [100, 200], [5, 9], [1.0, 4.0], [5.0, 36.0], "slow stops")
    fast = Cost("fast", [100, 200, 400, 800], [5, 9, 17, 33], [9.0, 1.0, 1.0, 1.0], [45.0, 9.0, 18.0, 36.0])
    rows = scaling_rows([slow, fast])
    assert rows[0][1].split() == ["poses", "slow", "fast"]
    words = [" ".join([label, *text.split()]) for label, text in rows]
    assert words[2:6] == ["100 5 1000 9000", "200 9 4000 1000", "400 17 1000", "800 33 1000"]
    assert [line for line in words if line.startswith("law")] == ["law m^2.00 m^0.00", "law m^2.85 m^1.00"]
    assert ("fitted to", "fast: 200, 400, 800 landmarks m") in rows  # not the first one, where it is slow
    assert rows[-1] == ("stopped", "slow stops")
    assert np.isnan(exponent([100], [1.0]))


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    ran = grown(monkeypatch, 1.0)
    monkeypatch.setattr("sim.cli_estimators.costs", lambda *given: costs(*given, sizes=(100, 200, 400)))
    call = ["compare", "--scaling", "50", "--estimators", "ekf", "fastslam1", "--particles", "5", "--out"]
    said = table([*call, str(tmp_path)], capsys)
    assert ran == [100, 100, 200, 200]
    assert said["stopped"] == "fastslam1 stops before 400 landmarks, which would take about 80 s"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["README.txt", "scaling.json", "scaling.png"]
    report = json.loads((tmp_path / "scaling.json").read_text())
    assert [each["name"] for each in report["estimators"]] == ["ekf", "fastslam1"]
    assert report["estimators"][0]["step"] == [1.0, 2.0]
    assert report["settings"] == {"particles": 5}
    said = (tmp_path / "README.txt").read_text(encoding="utf-8")
    assert "Made by: nls-sim compare --seed 0 --scaling 50.0 --estimators ekf fastslam1 --particles 5\n" in said
