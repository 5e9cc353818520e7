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
from factors.keys import Kind
from nls import FactorGraph, GraphFileError, GraphWarning
from tests.combinations import for_all

TAGGED = "every tag of the plane"


SCRIPT = "fuzz"


def test_valid_files_are_no_fault(evidence: Any, tmp_path: Path) -> None:
    """Each is read as it should be, saved and read again, and read as a stream."""
    seeds = evidence.seeds()
    known = evidence.readings(seeds)
    assert {seed.reader for seed in seeds} == set(evidence.READERS)
    for k, seed in enumerate(seeds):
        (tmp_path / str(k)).mkdir()
        folder = evidence.written(tmp_path / str(k), seed.files)
        assert evidence.tried(seed, known[seed.reader, seed.name], seed.files, 10 * k, folder)


def test_mutants_are_refused_or_read(evidence: Any) -> None:
    """A few of every reader, in a process of its own; the same ones by the same seed."""
    seeds, tasks = evidence.seeds(), [(reader, k) for reader in evidence.READERS for k in (3, 4)]
    ends = {end[:2]: end for end in evidence.ends(seeds, tasks, 7, 1)}
    assert ends.keys() == set(tasks)
    assert {end.end for end in ends.values()} >= {"refused", "read"}
    assert all(bool(end.fault) == (end.end not in ("refused", "read")) for end in ends.values())
    for reader in evidence.READERS:
        one, other = evidence.mutant(seeds, reader, 3, 7), evidence.mutant(seeds, reader, 3, 7)
        assert one[1:] == other[1:]
        assert one[1:] != evidence.mutant(seeds, reader, 3, 8)[1:]


def lost(graph: FactorGraph, values: Any, report: Any) -> Any:
    """A graph without its last measurement."""
    return graph.only([np.arange(len(f)) < len(f) - (f is graph.factors[-1]) for f in graph.factors]), values, report


def moved(graph: FactorGraph, values: Any, report: Any) -> Any:
    values[Kind("l")] = values.stack("l").X + 1
    return graph, values, report


def warned(graph: FactorGraph, values: Any, report: Any) -> Any:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return graph, values, report


def raw(graph: FactorGraph, values: Any, report: Any) -> Any:
    note = GraphWarning("")
    note.args = ("\x1b[2J",)  # which a warning by itself escapes
    warnings.warn(note, stacklevel=1)
    return graph, values, report


def unnamed(graph: FactorGraph, values: Any, report: Any) -> Any:
    raise GraphFileError("is wrong", "another file")


BROKEN = [
    (lost, "other answer: 16 lines of edges, 15 measurements"),
    (moved, "other answer: (0, 0) lines of vertices differ, (2, 2) variables"),
    (warned, "other exception: RuntimeWarning"),
    (raw, "raw character: '\\x1b'"),
    (unnamed, "other exception: names no file"),
]


@for_all(case=BROKEN)
def test_a_broken_reader_is_found_out(
    case: tuple[Callable[..., Any], str], evidence: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (seed,) = [seed for seed in evidence.seeds() if seed.name == TAGGED and seed.reader == "g2o"]
    given, load = evidence.readings([seed])[seed.reader, seed.name], nls.load
    folder = evidence.written(tmp_path, seed.files)
    with monkeypatch.context() as patch:
        patch.setattr(nls, "load", lambda *a, **b: case[0](*load(*a, **b)))
        with pytest.raises(evidence.Fault) as caught:
            evidence.tried(seed, given, seed.files, 9, folder)
    assert f"{caught.value.end}: {caught.value}".startswith(case[1])


def test_a_process_that_dies_or_hangs(evidence: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (seed,) = [seed for seed in evidence.seeds() if seed.name == TAGGED and seed.reader == "g2o"]
    read, data = seed.read, next(iter(seed.files.values()))

    def stuck(folder: Path) -> Any:
        content = next(folder.glob("seed*")).read_bytes()
        if content != data:
            os._exit(1) if len(content) < len(data) else time.sleep(60)
        return read(folder)

    monkeypatch.setattr(evidence, "HANGS", 1.0)
    ends = list(evidence.ends([replace(seed, read=stuck)], [("g2o", k) for k in range(4)], 0, 2))
    assert sorted(end.number for end in ends) == [0, 1, 2, 3]
    assert {end.end for end in ends} <= {"other exception", "slow or large"}
    assert {end.fault for end in ends} <= {"the process died", "not done in 1 s"}
