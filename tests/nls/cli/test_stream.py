"""``nls stream``: a line of JSON for every step, from files and pipes, and the same end after kill -9."""

from __future__ import annotations

import gzip
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
import sim
from nls.cli import main
from tests.nls.io.g2o_files import read
from tests.nls.io.io_files import SWITCHED_2

COMMAND = [sys.executable, "-c", "from nls.cli import command; raise SystemExit(command())", "stream"]
(x,) = nls.kinds("x")


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three laps of 50 poses, the lines in the order of time."""
    path = tmp_path_factory.mktemp("stream") / "ring.g2o"
    world = sim.ring(np.random.default_rng(0), laps=3, per_lap=50)
    nls.save(path, world.graph, world.truth)
    lines = path.read_text().splitlines()
    vertices = [line for line in lines if line.startswith("VERTEX")]
    edges = [line for line in lines if line.startswith("EDGE")]
    edges.sort(key=lambda line: max(map(int, line.split()[1:3])))
    path.write_text("\n".join([*vertices, *edges]) + "\n")
    return path


Run = Callable[..., tuple[list[dict[str, Any]], str, int]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """``nls stream`` in this process: the steps it prints, its complaint, and the exit status."""

    def streamed(*arguments: str | Path, given: bytes = b"") -> tuple[list[dict[str, Any]], str, int]:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(given))))
        capsys.readouterr()
        status = main(["stream", *map(str, arguments)])
        out, err = capsys.readouterr()
        return [json.loads(line) for line in out.splitlines()], err, status

    return streamed


def end(steps: Sequence[dict[str, Any]]) -> tuple[int, str, list[float], float]:
    last = steps[-1]
    return last["step"], last["variable"], last["estimate"], last["chi2"]


def without_time(steps: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in step.items() if name != "milliseconds"} for step in steps]


def test_every_step_of_a_file_is_at_the_optimum_and_a_pipe_says_the_same(ring: Path, run: Run) -> None:
    steps, complaint, status = run(ring, "--tol", "1e-9")
    assert (complaint, status) == ("", 0)
    assert [step["variable"] for step in steps] == [f"x{k}" for k in range(1, 150)]
    graph, values, _ = nls.load(ring)
    best = graph.optimize(values)
    assert 0 <= steps[-1]["chi2"] - best.chi2_final <= steps[-1]["gap"] <= 1e-9 * steps[-1]["chi2"]
    newest = x[149]
    np.testing.assert_allclose(steps[-1]["estimate"], best.values[newest], atol=1e-4)
    packed, *_ = run("-", "--tol", "1e-9", given=gzip.compress(ring.read_bytes()))
    assert end(packed) == end(steps)
    piped, *_ = run("-", "--tol", "1e-9", given=ring.read_bytes())
    assert list(dict.fromkeys(step["variable"] for step in piped)) == [step["variable"] for step in steps]
    np.testing.assert_allclose(end(piped)[2], end(steps)[2], atol=1e-4)  # what a pipe cuts in two is settled twice


def test_lines_that_come_one_by_one_are_answered_one_by_one(ring: Path) -> None:
    edges = [line for line in ring.read_text().splitlines(keepends=True) if line.startswith("EDGE")]
    with subprocess.Popen([*COMMAND, "-"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as vehicle:
        assert vehicle.stdin is not None
        assert vehicle.stdout is not None
        for k, line in enumerate(edges[:20]):
            vehicle.stdin.write(line)
            vehicle.stdin.flush()
            assert json.loads(vehicle.stdout.readline())["variable"] == f"x{k + 1}"
        vehicle.stdin.close()


@pytest.mark.parametrize("options", [[], ["--lag", "20"]], ids=["all", "lag"])
def test_killed_between_two_steps_it_ends_the_same(ring: Path, tmp_path: Path, run: Run, options: list[str]) -> None:
    expected, *_ = run(ring, *options)
    state = tmp_path / "state"
    killed = subprocess.Popen(
        [*COMMAND, "-", "--checkpoint", str(state), *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert killed.stdin is not None
    assert killed.stdout is not None
    lines = ring.read_bytes().splitlines(keepends=True)
    killed.stdin.write(b"".join(lines[: 150 + next(k for k, line in enumerate(lines[150:]) if b" 140 " in line)]))
    killed.stdin.flush()
    printed = [json.loads(killed.stdout.readline()) for _ in range(120)]
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    assert state.exists()
    again, complaint, status = run(ring, "--checkpoint", state, *options)
    assert (complaint, status) == ("", 0)
    assert again[0]["step"] == 101 <= printed[-1]["step"]
    assert without_time(again) == without_time(expected[100:])
    assert run(ring, "--checkpoint", state, *options) == ([], "", 0)


@pytest.mark.parametrize("options", [[], ["--lag", "20"], ["--robust", "huber:1"]], ids=["all", "lag", "kernel"])
def test_a_shorter_file_and_then_the_whole_are_equal_to_the_bit(
    ring: Path, tmp_path: Path, run: Run, options: list[str]
) -> None:
    """Also where the shorter one ends within a step, and where later lines have other whiteners."""
    path, short, lines = tmp_path / "whole.g2o", tmp_path / "short.g2o", ring.read_text().splitlines(keepends=True)
    for k in (190, 240, 280):
        words = lines[k].split()
        lines[k] = " ".join([*words[:7], f"{0.1 * float(words[6])!r}", *words[8:]]) + "\n"
    path.write_text("".join(lines))
    whole, *_ = run(path, *options)
    steps, edges = without_time(whole), [k for k, line in enumerate(lines) if line.startswith("EDGE")]
    within = [k for k in edges[1:] if lines[k].split()[2] == lines[k - 1].split()[2]]
    for k in [edges[1], *within[::5], *edges[97::31]]:
        state = tmp_path / f"state{k}"
        short.write_text("".join(lines[:k]).removesuffix("\n" * (k % 2)))
        before, *_ = run(short, "--checkpoint", state, *options)
        assert without_time(before[:-1]) == steps[: len(before) - 1]
        assert run(short, "--checkpoint", state, *options) == ([], "", 0)
        again, complaint, status = run(path, "--checkpoint", state, *options)
        assert (complaint, status) == ("", 0)
        assert without_time(again) == steps[len(before) - (k in within) :]
        assert run(path, "--checkpoint", state, *options) == ([], "", 0)


def test_the_state_of_a_stream_is_a_smoother(ring: Path, tmp_path: Path, run: Run) -> None:
    """The estimate before the last step of a file, which a longer one may complete."""
    steps, *_ = run(ring, "--checkpoint", tmp_path / "state")
    smoother = nls.Incremental.load(tmp_path / "state")
    assert smoother[x[148]].tolist() == steps[-2]["estimate"]
    assert x[149] not in smoother
    smoother.save(tmp_path / "other")
    assert "is a smoother that nls stream did not write" in run(ring, "--checkpoint", tmp_path / "other")[1]


def test_what_comes_behind_the_window_is_counted(tmp_path: Path, run: Run) -> None:
    path, information = tmp_path / "a.g2o", "1 0 0 1 0 1"
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0 {information}" for k in range(9)]
    late = [f"EDGE_SE2 {i} {j} {j - i} 0 0 {information}" for i, j in ((0, 9), (8, 9), (1, 4))]
    path.write_text("\n".join([*steps, *late]))
    found, _, status = run(path, "--lag", "3")
    assert status == 0
    assert "behind" not in found[-3]
    assert [step.get("behind") for step in found[-2:]] == [1, 2]
    np.testing.assert_allclose(found[-2]["estimate"], [9, 0, 0], atol=1e-9)
    assert (found[-1]["variable"], found[-1]["estimate"]) == ("x4", None)


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("", [], "is empty|no measurement"),
        ("VERTEX_SE2 0 0 0 0\n", [], "has no measurement: nothing to stream"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0\n", [], "stdin>:2: "),
        ("FIX 0\nFIX 3\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", [], "fixes 2 variables"),
        ("x" * 6_000_000, [], "has a line of more than 4,194,304 bytes"),
        ("1 1 1\n0 0 0 0\n", [], "is bundle adjustment (bal)"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", ["--tol", "-1"], "tol"),
    ],
)
def test_what_cannot_be_streamed_is_said_in_a_line(run: Run, text: str, options: list[str], said: str) -> None:
    _, complaint, status = run("-", *options, given=text.encode())
    assert status == 2
    assert complaint.count("\n") == 1
    assert any(part in complaint for part in said.split("|"))


def test_a_checkpoint_of_something_else_is_refused(ring: Path, tmp_path: Path, run: Run) -> None:
    state, other = tmp_path / "state", tmp_path / "other.g2o"
    run(ring, "--checkpoint", state)
    other.write_text(
        ring.read_text().replace("EDGE_SE2 0 1 ", "EDGE_SE2 0  1 ") + "EDGE_SE2 149 150 1 0 0 1 0 0 1 0 1\n"
    )
    assert "lines differ from the input" in run(other, "--checkpoint", state)[1]
    assert "was made without --lag, not with --lag 5;" in run(ring, "--lag", "5", "--checkpoint", state)[1]
    assert "made without --repair-information, not" in run(ring, "--repair-information", "--checkpoint", state)[1]


def test_a_gap_that_nobody_knows_is_null(run: Run, ring: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(smoother: nls.Incremental) -> None:
        smoother.gap = float("inf")

    monkeypatch.setattr(nls.Incremental, "settle", lost)
    steps, _, status = run(ring)
    assert status == 0
    assert None in [step["gap"] for step in steps]


@pytest.mark.filterwarnings("always")
def test_switches_and_ignored_lines_come_in_pieces(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pipe a block may end between a switch, its prior and its edge, or have left-out lines alone."""
    path = tmp_path / "switched.g2o"
    path.write_text(SWITCHED_2.replace("VERTEX_SWITCH 5", "EDGE_FOO 1 2\nVERTEX_SWITCH 5"))
    _, complaint, status = run(path)
    assert (status, "may connect variables: EDGE_FOO (1)" in complaint) == (2, True)
    whole, complaint, status = run(path, "--ignore-tags", "EDGE_FOO")
    assert (status, "EDGE_FOO (1, first on line 12)" in complaint) == (0, True)
    monkeypatch.setattr("nls.cli.stream.AT_ONCE", 30)
    pieces, complaint, status = run("-", "--ignore-tags", "EDGE_FOO,EDGE_FO", given=path.read_bytes())
    said = [words.removeprefix("nls: warning: <stdin>: ").split(": ")[0] for words in complaint.splitlines()]
    assert (status, said) == (0, ["lines with unknown tags were not used", "ignore_tags"])
    assert pieces[-1]["chi2"] == pytest.approx(whole[-1]["chi2"], rel=1e-2)
    graph, values, _ = read(SWITCHED_2)
    assert pieces[-1]["chi2"] == pytest.approx(graph.optimize(values).chi2_final, rel=1e-2)
    twice = path.read_text() + path.read_text().splitlines()[-1] + "\n"
    _, complaint, status = run("-", "--ignore-tags", "EDGE_FOO", given=twice.encode())
    assert (status, "needs switch 6 for itself alone" in complaint) == (2, True)


def test_a_number_that_two_blocks_take_for_two_things_is_refused(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a block without an edge of its pose, a position of RTAB-Map would be one of a landmark: the pose loses it."""
    edges = [
        f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0 0 0 0 1 {' '.join(map(str, np.eye(6)[np.triu_indices(6)]))}" for k in range(3)
    ]
    text = "\n".join([*edges, *(f"EDGE_POINTXYZ_PRIOR {k} 0 {k} 0 1 0 0 1 0 1" for k in range(3)), ""]).encode()
    whole, complaint, status = run("-", given=text)
    assert (status, complaint, {step["variable"][0] for step in whole}) == (0, "", {"x"})
    monkeypatch.setattr("nls.cli.stream.AT_ONCE", len(edges[0]) + 1)
    pieces, complaint, status = run("-", given=text)
    assert (status, len(pieces)) == (2, 3)
    assert "has one number for x0 in one part of the stream and l0 in another" in complaint


def test_ids_and_keys_of_one_name_in_two_blocks_are_refused(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one block they all stay numbers; in two, x1 would be a robot here and a key of GTSAM there."""
    head = ord("x") << 56
    edges = [f"EDGE_SE2 {i} {j} 1 0 0 1 0 0 1 0 1\n" for i, j in ((0, 1), (1, head), (head, head | 1))]
    assert run("-", given="".join(edges).encode())[2] == 0
    monkeypatch.setattr("nls.cli.stream.AT_ONCE", len(edges[0]))
    steps, complaint, status = run("-", given=(edges[0] + edges[2]).encode())
    assert (status, len(steps)) == (2, 1)
    assert "uses x as an id and as a key of GTSAM" in complaint


def test_lines_of_a_pipe_are_counted_as_the_reader_does(tmp_path: Path, run: Run) -> None:
    r"""Each line ends in \r\r\n, as of text that was written twice as such: in a file two lines, in a pipe one."""
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0.{k} 1 0 0 1 0 1\r\r\n".encode() for k in range(9)]
    state, path = tmp_path / "state", tmp_path / "whole.g2o"
    assert len(run("-", "--checkpoint", state, given=b"".join(lines[:6]))[0]) == 6
    path.write_bytes(b"".join(lines))
    refused = "its first 6 lines differ"
    assert refused in run(path, "--checkpoint", state)[1]
    assert refused in run("-", "--checkpoint", state, given=b"".join([*lines[:4], *lines[5:]]))[1]
    steps, complaint, status = run("-", "--checkpoint", state, given=b"".join(lines))
    assert ([step["variable"] for step in steps], complaint, status) == (["x7", "x8", "x9"], "", 0)
