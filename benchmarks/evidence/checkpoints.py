"""Checkpoints of a smoother: damaged, killed while they are written, and of a shorter file.

    python benchmarks/evidence/checkpoints.py [--damages N] [--kills N] [--cuts N] [--out DIR]

A damaged one is refused in a sentence, or gives the same smoother. A stream that was killed goes on, and so does one
that had a shorter file: every line is equal to the bit to that of a stream that never stopped.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from script import make_page, markdown

import nls
import sim
from nls.cli import main as nls_main
from nls.incremental.checkpoint import smoother_bytes
from nls.incremental.steps import steps

WORLDS: dict[str, Callable[[np.random.Generator], sim.World]] = {
    "ring": lambda rng: sim.ring(rng, laps=4, per_lap=60),
    "manhattan": lambda rng: sim.manhattan(rng, 300),
    "sphere": lambda rng: sim.sphere(rng, rings=10, per_ring=15),
    "torus": lambda rng: sim.torus(rng, coils=10, per_coil=15),
    "grid3d": lambda rng: sim.grid3d(rng, 200),
}
OPTIONS: dict[str, dict[str, Any]] = {"all": {}, "lag 20": {"lag": 20}}
STREAMS = [(f"{name}, {how}", make, options) for name, make in WORLDS.items() for how, options in OPTIONS.items()]
DAMAGES = ("a bit", "a byte", "a block", "cut off")
COMMAND = [sys.executable, "-c", "from nls.cli import command; raise SystemExit(command())", "stream"]
LONGEST = 4.0  # s from the begin of a stream to its kill, at most


def driven(world: sim.World, options: dict[str, Any]) -> nls.Incremental:
    """The smoother at the end of a drive."""
    smoother = nls.Incremental(**options)
    for k, step in enumerate(steps(world.graph.factors)):
        smoother.update(step.factors, world.start if k == 0 else None)
    return smoother


def damaged(data: bytes, how: str, rng: np.random.Generator) -> bytes:
    """A file with one damage."""
    at = int(rng.integers(len(data)))
    if how == "cut off":
        return data[:at]
    if how == "a block":
        n = int(rng.integers(2, 4096))
        return data[:at] + rng.bytes(min(n, len(data) - at)) + data[at + n :]
    byte = bytes([data[at] ^ 1 << int(rng.integers(8))]) if how == "a bit" else rng.bytes(1)
    return data[:at] + byte + data[at + 1 :]


def verdict(path: Path, again_whole: bytes) -> str:
    """What became of a damaged file; the bytes are those that the undamaged smoother writes when it is read."""
    try:
        again = nls.Incremental.load(path)
    except nls.LeadlineError as error:
        return "refused" if str(path) in str(error) else "refused without its name"
    except Exception as error:  # what must not be: it is counted
        return f"exception {type(error).__name__}"
    return "the same" if smoother_bytes(again) == again_whole else "another answer"


def damaged_files(count: int, folder: Path) -> list[list[object]]:
    """A row for each of ten checkpoints."""
    rows = []
    for title, make, options in STREAMS:
        rng, path = np.random.default_rng(len(rows)), folder / "damaged"
        whole = smoother_bytes(driven(make(rng), options))
        path.write_bytes(whole)
        again_whole = smoother_bytes(nls.Incremental.load(path))
        found: Counter[str] = Counter()
        for k in range(count // len(STREAMS)):
            path.write_bytes(damaged(whole, DAMAGES[k % len(DAMAGES)], rng))
            found[verdict(path, again_whole)] += 1
        wrong = found.total() - found["refused"] - found["the same"]
        rows.append([title, f"{len(whole):,}", found.total(), found["refused"], found["the same"], wrong])
        if wrong:
            print(title, found, flush=True)
    return rows


def in_time(world: sim.World, path: Path) -> list[str]:
    """The lines of a file whose measurements stand in the order of time."""
    graph = nls.FactorGraph([factor for step in steps(world.graph.factors) for factor in step.factors])
    nls.save(path, graph, world.start)
    lines = [line for line in path.read_text().splitlines(keepends=True) if line.startswith("EDGE")]
    path.write_text("".join(lines))
    return lines


def printed(text: str) -> dict[int, dict[str, Any]]:
    """The steps of an output by their number, without the time they took."""
    found = [json.loads(line) for line in text.splitlines() if line.endswith("}")]  # the last may be cut off
    return {step["step"]: {name: v for name, v in step.items() if name != "milliseconds"} for step in found}


def streamed(*words: str | Path) -> str:
    """What ``nls stream`` prints; it must not fail."""
    out, complaint = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(complaint):
        status = nls_main(["stream", *map(str, words)])
    if status:
        raise RuntimeError(complaint.getvalue())
    return out.getvalue()


def cut_files(count: int, folder: Path) -> list[list[object]]:
    """A row for each sort of stream: a shorter file, then the whole one."""
    rows = []
    for title, make, options in STREAMS:
        rng, path, short = np.random.default_rng(len(rows)), folder / "whole.g2o", folder / "short.g2o"
        lines = in_time(make(rng), path)
        words = [word for option, value in options.items() for word in (f"--{option}", str(value))]
        whole, different, number = printed(streamed(path, *words)), 0, count // len(STREAMS)
        for k in rng.choice(np.arange(1, len(lines)), number, replace=False).tolist():
            state = folder / f"state-{len(rows)}-{k}"
            short.write_text("".join(lines[:k]))
            streamed(short, "--checkpoint", state, *words)
            again = printed(streamed(path, "--checkpoint", state, *words))
            different += again != {step: whole[step] for step in again} or max(again) != max(whole)
        rows.append([title, len(whole), number, different])
    return rows


def killed_streams(count: int, folder: Path) -> list[object]:
    """A row: kill -9 at random times, again and again until a stream ends, and then from the begin."""
    rng, path, state = np.random.default_rng(0), folder / "killed.g2o", folder / "state"
    in_time(sim.manhattan(rng, 2000), path)
    command = [*COMMAND, str(path), "--checkpoint", str(state)]
    whole = printed(subprocess.run(command[:-2], capture_output=True, text=True, check=True).stdout)
    killed = ended = different = lines = 0
    complaints: Counter[str] = Counter()
    while killed < count:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            out, complaint = process.communicate(timeout=float(rng.uniform(0, LONGEST)))
        except subprocess.TimeoutExpired:
            process.kill()
            out, complaint = process.communicate()
            killed += 1
        else:
            ended += 1
            state.unlink(missing_ok=True)
        steps_here = printed(out)
        lines += len(steps_here)
        different += sum(whole[step] != facts for step, facts in steps_here.items())
        complaints.update(complaint.splitlines()[:1])
    print(*complaints.items(), sep="\n", flush=True)
    return [killed, ended, f"{lines:,}", different, complaints.total(), len([*folder.glob("*.part")])]


LEGEND = """\
- *damages*: in turn a bit, a byte or a block of random bytes in its place, or the end cut off
- *the same*: the smoother that is read writes the same bytes, as where the date of an array is damaged
- *anything else*: another answer, an exception that is no sentence, a sentence without the name of the file
- *a shorter file*: its first lines, cut at a random one, then the whole file with the same checkpoint
- *kills*: of a stream of 2,000 poses, at random times; it goes on until it is killed again or ends
- *parts left over*: files that a kill left while they were written, beside the checkpoint, which is whole
"""


def page(damages: int, kills: int, cuts: int) -> Iterator[str]:
    """All three tables."""
    yield LEGEND
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield "## Damages"
        heads = ["checkpoint", "bytes", "damages", "refused", "the same", "anything else"]
        yield from markdown(heads, damaged_files(damages, folder))
        yield "## A shorter file, then the whole one"
        yield from markdown(["stream", "steps", "cuts", "not equal to the bit"], cut_files(cuts, folder))
        yield "## Kills"
        heads = ["kills", "streams that ended", "steps printed", "not equal to the bit", "complaints"]
        yield from markdown([*heads, "parts left over"], [killed_streams(kills, folder)], names=0)


if __name__ == "__main__":
    counts = {"damages": (2000, "of ten checkpoints"), "kills": (200, "at random times"), "cuts": (400, "of ten files")}
    make_page("Checkpoints", page, **counts)
