"""Monte-Carlo runs: the same records whatever the workers, files that survive, refusals."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.errors import GraphFileError, GraphWarning, OptionError, UnderconstrainedError
from sim.monte_carlo import FailedRunsError, Record, runs
from tests.nls.io.disk import small_disk


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
