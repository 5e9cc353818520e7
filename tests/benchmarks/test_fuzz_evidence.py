"""The evidence about mutants of files: valid files are no fault, and a broken reader is found out."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
from factors.keys import Keys, Kind
from nls import FactorGraph, GraphFileError, GraphWarning
from tests.combinations import for_all

TAGGED = "every tag of the plane"


@pytest.fixture
def fuzz(script: Callable[[str], Any]) -> Any:
    return script("fuzz")


def test_valid_files_are_no_fault(fuzz: Any, tmp_path: Path) -> None:
    """Each is read as it should be, saved and read again, and read as a stream."""
    seeds = fuzz.seeds()
    known = fuzz.readings(seeds)
    assert {seed.reader for seed in seeds} == set(fuzz.READERS)
    for k, seed in enumerate(seeds):
        folder = tmp_path / str(k)
        folder.mkdir()
        for number in (10 * k, 2):
            assert fuzz.tried(seed, known[seed.reader, seed.name], seed.files, number, fuzz.written(folder, seed.files))


def test_mutants_are_refused_or_read(fuzz: Any) -> None:
    """A few of every reader, in a process of its own; the same ones by the same seed."""
    seeds, tasks = fuzz.seeds(), [(reader, k) for reader in fuzz.READERS for k in (3, 4, 5)]
    ends = {end[:2]: end for end in fuzz.ends(seeds, tasks, 7, 1)}
    assert ends.keys() == set(tasks)
    assert {end.end for end in ends.values()} >= {"refused", "read"}
    assert all(bool(end.fault) == (end.end not in ("refused", "read")) for end in ends.values())
    for reader in fuzz.READERS:
        one, other = fuzz.mutant(seeds, reader, 3, 7), fuzz.mutant(seeds, reader, 3, 7)
        assert one[1:] == other[1:]
        assert one[1:] != fuzz.mutant(seeds, reader, 3, 8)[1:]


def lost(graph: FactorGraph, values: Any, report: Any) -> Any:
    """A graph without its last measurement."""
    return graph.only([np.arange(len(f)) < len(f) - (f is graph.factors[-1]) for f in graph.factors]), values, report


def moved(graph: FactorGraph, values: Any, report: Any) -> Any:
    values[Kind("l")] = values.stack("l").X + 1
    return graph, values, report


def held(graph: FactorGraph, values: Any, report: Any) -> Any:
    graph.fix(Keys("x", [1]))
    return graph, values, report


def at_random(graph: FactorGraph, values: Any, report: Any) -> Any:
    return graph, values, replace(report, notes=[str(time.perf_counter_ns())])


def warned(graph: FactorGraph, values: Any, report: Any) -> Any:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return graph, values, report


def raw(graph: FactorGraph, values: Any, report: Any) -> Any:
    note = GraphWarning("")
    note.args = ("\x1b[2J",)  # which a warning by itself escapes
    warnings.warn(note, stacklevel=1)
    return graph, values, report


def failed(graph: FactorGraph, values: Any, report: Any) -> Any:
    raise ZeroDivisionError


def unnamed(graph: FactorGraph, values: Any, report: Any) -> Any:
    raise GraphFileError("is wrong", "another file")


BROKEN = [
    (lost, "other answer: 16 lines of edges, 15 measurements"),
    (moved, "other answer: (0, 0) lines of vertices differ, (2, 2) variables"),
    (held, "other answer: FIX names [0], ['x0', 'x1'] are held"),
    (at_random, "other answer: read twice"),
    (warned, "other exception: RuntimeWarning"),
    (raw, "raw character: '\\x1b'"),
    (failed, "other exception: ZeroDivisionError() at"),
    (unnamed, "other exception: names no file"),
]


@for_all(case=BROKEN)
def test_a_broken_reader_is_found_out(
    case: tuple[Callable[..., Any], str], fuzz: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (seed,) = [seed for seed in fuzz.seeds() if seed.name == TAGGED and seed.reader == "g2o"]
    given, load = fuzz.readings([seed])[seed.reader, seed.name], nls.load
    folder = fuzz.written(tmp_path, seed.files)
    with monkeypatch.context() as patch:
        patch.setattr(nls, "load", lambda *a, **b: case[0](*load(*a, **b)))
        with pytest.raises(fuzz.Fault) as caught:
            fuzz.tried(seed, given, seed.files, 9, folder)
    assert f"{caught.value.end}: {caught.value}".startswith(case[1])


def test_other_answers_of_other_forms(fuzz: Any, tmp_path: Path) -> None:
    """What a mutant says, and a reading that is still that of the seed."""
    judged = fuzz.judged
    seeds = {(seed.reader, seed.name): seed for seed in fuzz.seeds()}
    known = fuzz.readings(list(seeds.values()))

    def answer(reader: str, name: str, old: bytes, new: bytes, file: str = "") -> str:
        seed = seeds[reader, name]
        files = {n: data.replace(old, new, 1) if n.endswith(file) else data for n, data in seed.files.items()}
        assert files != seed.files
        return str(judged(seed, known[reader, name], files, known[reader, name]))

    assert answer("toro", "toro, plane", b"1.1 0.1", b"1.2 0.1").startswith("(1, 1) lines of vertices differ")
    assert answer("isam", "isam, space", b"POINT3 2", b"POINT9 2").startswith(
        "nothing is said about a line of b'POINT9'"
    )
    assert answer("isam", "isam, space", b"POINT3 2", b"# POINT3 2").startswith("4 lines of edges, 5")
    assert answer("g2o", TAGGED, b"FIX 0", b"FIX 0 1").startswith("FIX names [0, 1], ['x0'] are held")
    assert answer("pyfg", "pyfg", b"7.1 0.04", b"7.2 0.04").startswith("(1, 1) lines of edges differ")
    assert answer("pyfg", "pyfg", b"VERTEX_XY", b"# no\nVERTEX_XY") == ""
    assert answer("bal", "bal", b"10.5", b"10.6").startswith("1 observations differ")
    assert answer("bal", "bal", b"\n-5", b"\n-6").startswith("1 variables differ")
    assert answer("json", "pyfg", b'"numbers": [0]', b'"numbers": [0], "numbers": [0]').endswith("is there twice")
    assert answer("json", "pyfg", b'"times"', b'"tines"').startswith(".values.A.tines is only in what was given")
    assert "given 7.5, read 7.1" in answer("json", "pyfg", b"[7.1]", b"[7.5]")
    assert answer("poses, tum", "tum", b"2.5 2", b"2.5 2.0") == ""
    assert "written" in answer("poses, tum", "tum", b"2.5 2", b"2.5 3")
    assert "written" in answer("poses, kitti", "kitti", b"1.5", b"1.25")
    assert answer("poses, csv", "csv", b"1,1.5,1,", b"1,1.5,2,").startswith("x_m is")
    assert answer("mission", "odometry and sonar", b"5.0332", b"5.033200", "zpr.csv") == ""
    assert "nothing that was read does" in answer("mission", "odometry and sonar", b"5.0332", b"5.04", "zpr.csv")
    assert answer("import", "fixes", b"54.1031", b"54.1041", "log.csv").startswith("log.csv: ['lat'] differ")


def test_a_process_that_dies_or_hangs(fuzz: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (seed,) = [seed for seed in fuzz.seeds() if seed.name == TAGGED and seed.reader == "g2o"]
    read, data = seed.read, next(iter(seed.files.values()))

    def stuck(folder: Path) -> Any:
        content = next(folder.glob("seed*")).read_bytes()
        if content != data:
            os._exit(1) if len(content) < len(data) else time.sleep(60)
        return read(folder)

    monkeypatch.setattr(fuzz, "HANGS", 1.0)
    ends = list(fuzz.ends([replace(seed, read=stuck)], [("g2o", k) for k in range(4)], 0, 2))
    assert sorted(end.number for end in ends) == [0, 1, 2, 3]
    assert {end.end for end in ends} <= {"other exception", "slow or large"}
    assert {end.fault for end in ends} <= {"the process died", "not done in 1 s"}
