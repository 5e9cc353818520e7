"""Monte-Carlo runs: the same records whatever the workers, files that survive; costs by the number of landmarks."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim.scaling
from models.errors import GraphFileError, GraphWarning, OptionError, UnderconstrainedError
from nls import kinds
from sim.estimators import errors, tracked
from sim.monte_carlo import FailedRunsError, Record, runs
from sim.scaling import AGAIN, Cost, circuit, costs, exponent, scaling_rows
from tests.nls.io.disk import small_disk
from tests.sim.test_cli import table


def drawn(seed: int, size: int = 40) -> Record:
    """Numbers that depend on BLAS and on the order of nothing."""
    A = np.random.default_rng(seed).normal(size=(size, size))
    return {"seed": seed, "norm": float(np.linalg.norm(A @ A.T)), "first": A[0, :3].tolist(), "pair": (1, 0.1)}


def broken(seed: int) -> Record:
    """Fails for seed 2."""
    if seed == 2:
        raise ValueError("a bad seed")
    return {"seed": seed}


def singular(seed: int) -> Record:
    """Cannot be solved for seeds 1 and 3."""
    if seed == 1:
        raise UnderconstrainedError("x0 is free", keys=["x0"], values=np.zeros(3))
    if seed == 3:
        raise np.linalg.LinAlgError("Singular matrix")
    return {"seed": seed}


def not_finite(seed: int) -> Record:
    return {"x": float("nan")}


def no_record(seed: int) -> Any:
    return seed


@pytest.fixture
def threads() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(3) as executor:
        yield executor


def expected(seeds: list[int], **options: int) -> list[Record]:
    return [json.loads(json.dumps(drawn(seed, **options))) for seed in seeds]


def test_processes_and_threads_give_the_same_bits_in_the_order_of_the_seeds(threads: ThreadPoolExecutor) -> None:
    seeds = [7, 3, 11, 0]
    assert runs(drawn, seeds, threads) == expected(seeds)
    assert runs(drawn, seeds) == expected(seeds)
    assert runs(partial(drawn, size=5), seeds, threads) == expected(seeds, size=5)
    assert runs(drawn, []) == []


def test_what_was_killed_goes_on(tmp_path: Path, threads: ThreadPoolExecutor) -> None:
    file, calls = tmp_path / "runs.jsonl", []

    class Counting(ThreadPoolExecutor):
        def submit(self, function: Any, /, *args: Any, **options: Any) -> Future[Any]:
            calls.append(args[-1])
            return super().submit(function, *args, **options)

    whole = runs(drawn, range(4), threads, resume=file)
    data = file.read_bytes()
    lines = data.splitlines(keepends=True)
    assert json.loads(lines[0]) == {"function": f"{__name__}.drawn", "arguments": [], "options": {}}
    file.write_bytes(b"".join(lines[:3]) + lines[3][:20])  # two records, and a part of the third
    with Counting(1) as executor, pytest.warns(GraphWarning, match=r"runs.jsonl: the last line is half written"):
        assert runs(drawn, range(4), executor, resume=file) == whole
    held = {json.loads(line)["seed"] for line in lines[1:3]}
    assert set(calls) == set(range(4)) - held
    assert sorted(file.read_bytes().splitlines()) == sorted(data.splitlines())
    with Counting(1) as executor:  # more seeds than before: the new ones alone
        calls.clear()
        assert runs(drawn, [9, 1], executor, resume=file) == expected([9, 1])
    assert calls == [9]
    file.write_bytes(lines[0][:-9])  # killed within the first line
    with pytest.warns(GraphWarning, match="half written"):
        assert runs(drawn, [1], threads, resume=file) == expected([1])


def test_an_error_names_its_seed_and_keeps_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    with ThreadPoolExecutor(1) as executor, pytest.raises(ValueError, match="a bad seed") as caught:
        runs(broken, [0, 1, 2, 3], executor, resume=file)
    assert caught.value.__notes__ == ["in the run of seed 2"]
    kept = [json.loads(line)["seed"] for line in file.read_bytes().splitlines()[1:]]
    assert 0 in kept
    assert 2 not in kept


def test_seeds_that_fail_do_not_end_the_others(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    with ThreadPoolExecutor(2) as executor, pytest.raises(FailedRunsError) as caught:
        runs(singular, [4, 3, 2, 1, 0], executor, resume=file)
    assert caught.value.records == {seed: {"seed": seed} for seed in (4, 2, 0)}
    kinds = {seed: type(error) for seed, error in caught.value.failures.items()}
    assert kinds == {3: np.linalg.LinAlgError, 1: UnderconstrainedError}
    assert str(caught.value) == "2 of 5 runs failed. seed 3: LinAlgError: Singular matrix; seed 1: x0 is free"
    kept = {json.loads(line)["seed"] for line in file.read_bytes().splitlines()[1:]}
    assert kept == {0, 2, 4}
    assert caught.value.failures[1].keys == ("x0",)  # type: ignore[attr-defined]


def test_a_full_disk_leaves_whole_records(tmp_path: Path) -> None:
    """The limit cuts the second record: the error names the file, which keeps the first."""
    file = tmp_path / "runs.jsonl"
    with ThreadPoolExecutor(1) as executor:
        runs(drawn, [0], executor, resume=file)
        whole = file.read_bytes()
        with small_disk(len(whole) + 9), pytest.raises(GraphFileError, match=r"runs\.jsonl: cannot be written: \w+"):
            runs(drawn, [0, 1], executor, resume=file)
        assert file.read_bytes() == whole
        assert runs(drawn, [0, 1], executor, resume=file) == expected([0, 1])


def test_refusals(tmp_path: Path, threads: ThreadPoolExecutor) -> None:
    file = tmp_path / "runs.jsonl"
    for function, seeds, resume, said in (
        (drawn, [1, -1], None, "seeds: -1 is not possible"),
        (drawn, [1, 2.0], None, r"seeds: 2\.0 is not possible"),
        (drawn, [1, 2, 1], None, "every seed once"),
        (not_finite, [1], None, "finite numbers"),
        (no_record, [1], None, "for seed 1 it returned 1"),
        (lambda seed: {"seed": seed}, [1], file, "a function of a module"),
        (partial(drawn, size=np.zeros(3)), [1], file, "a partial of"),
    ):
        with pytest.raises(OptionError, match=said):
            runs(function, seeds, threads, resume=resume)
        assert not file.exists()


def test_a_file_of_something_else_is_left_alone(tmp_path: Path, threads: ThreadPoolExecutor) -> None:
    file = tmp_path / "runs.jsonl"
    runs(partial(drawn, size=4), [1, 2], threads, resume=file)
    good = file.read_bytes()
    head, *records = good.splitlines(keepends=True)
    for content, function, said in (
        (good, drawn, "runs.jsonl:1: is not of this function and these options, .*drawn"),
        (good, partial(drawn, size=5), r"runs.jsonl:1: is not of this function and these options, .*\"size\": 5"),
        (b"my notes", drawn, "runs.jsonl:1: is not of this function"),
        (b"my notes\nand more", drawn, "runs.jsonl:1: is not JSON"),
        (head + b"3\n", partial(drawn, size=4), "runs.jsonl:2: is not a JSON object"),
        (head + b'{"seed": 1}\n', partial(drawn, size=4), "runs.jsonl:2: is not a record"),
        (good + records[0].replace(b"norm", b"form"), partial(drawn, size=4), "runs.jsonl:4: seed . has two records"),
    ):
        file.write_bytes(content)
        with pytest.raises(GraphFileError, match=said):
            runs(function, [1, 2], threads, resume=file)
        assert file.read_bytes() == content


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
    ekf, batch = costs(0, ["ekf", "batch"], {}, 60.0, sizes=(100, 800))
    assert (ekf.name, ekf.landmarks, ekf.poses, ekf.stopped) == ("ekf", [100, 800], [46, 221], "")
    assert batch.landmarks == [100, 800]
    assert batch.total == pytest.approx([46 * batch.step[0], 221 * batch.step[1]])
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
