"""Trials with wrong closures: what is tried on which graph, run by several processes, kept in a file as they end."""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from time import monotonic, process_time
from typing import IO, Any, cast

import numpy as np
from wrong_closures import FINE, KINDS, SETS, TWENTY, Solved, few, solved, spoiled

import nls
from models.errors import UnderconstrainedError
from nls import FactorGraph

SHARES = (0.1, 0.3, 0.5, 0.8)  # of all closures, right and wrong
LARGE = ("M3500", "manhattan", "Olson", "sphere2500", "parking-garage", "torus3D", "city10000")  # fewer seeds
SLOW = ("sphere2500", "parking-garage", "torus3D", "city10000")  # up to minutes a trial: these come last
VERTIGO = ("random", "grouped", "local", "local in groups")  # the kinds of its generator
PROTOCOL = ("CSAIL", "FR079", "INTEL", "intel", "M3500", "sphere2500", "parking-garage")
RATIOS = tuple(k / 10 for k in range(1, 11))  # of the right closures
RUNS = 10
COUNTS = (10, 20, 80)  # wrong ones beside them
FEW_SETS = ("CSAIL", "FR079", "INTEL", "intel", "kitti_00", "M3500", "manhattan", "sphere2500")


@dataclass(frozen=True)
class Task:
    """A graph with wrong closures.

    Attributes
    ----------
    table : ``clean``, ``kinds``, ``protocol`` or ``few``.
    amount : wrong closures; of all closures in ``kinds``, of the right ones in ``protocol``, their number in ``few``.
    """

    table: str
    name: str
    kind: str
    amount: float
    seed: int


@dataclass(frozen=True)
class Trial:
    """What came of a task.

    Attributes
    ----------
    off : ATE over the extent; inf where there is no estimate.
    doubts : kinds of doubt the result states, or the error.
    right, lost, wrong, accepted : right closures and those rejected, wrong closures and those accepted.
    seconds : processor time.
    """

    task: Task
    off: float
    doubts: list[str]
    right: int
    lost: int
    wrong: int
    accepted: int
    seconds: float

    @property
    def outcome(self) -> str:
        """``solved``, ``doubtful`` or ``silent``, which is wrong without a word."""
        return "doubtful" if self.doubts else "solved" if self.off < FINE else "silent"


def tasks(seeds: int, large: int) -> list[Task]:
    """Clean graphs, small ones, large ones half wrong, the protocol, then the rest: what ends early has most of it.

    Parameters
    ----------
    seeds, large : of small graphs; of large ones, and of those with few closures.
    """
    small = [name for name in SETS if name not in LARGE]
    first = _kinds(LARGE, 0) if large else []
    wanted = [
        *(Task("clean", name, "none", 0.0, 0) for name in SETS),
        *(task for seed in range(seeds) for task in _kinds(small, seed)),
        *(task for task in first if task.amount == 0.5),
        *(task for seed in range(RUNS) for task in _protocol(small, seed)),
        *(task for task in first if task.amount != 0.5),
        *(task for seed in range(RUNS) for task in _protocol(LARGE, seed)),
        *(task for seed in range(large) for task in (*_few(seed), *(_kinds(LARGE, seed) if seed else ()))),
    ]
    return sorted(
        wanted, key=lambda task: task.name in SLOW and (task.table == "kinds" or task.kind == "alias in groups")
    )


def _few(seed: int) -> list[Task]:
    return [Task("few", name, kind, count, seed) for name in FEW_SETS for count in COUNTS for kind in KINDS]


def _kinds(names: Sequence[str], seed: int) -> list[Task]:
    return [Task("kinds", name, kind, share, seed) for name in names for share in SHARES for kind in KINDS]


def _protocol(names: Sequence[str], seed: int) -> list[Task]:
    """The kinds of the generator take turns."""
    return [
        Task("protocol", name, VERTIGO[seed % 4], ratio, seed) for name in PROTOCOL if name in names for ratio in RATIOS
    ]


def planted(data: Path, task: Task) -> tuple[Solved, FactorGraph]:
    """The right graph, and the one with wrong closures as its second factor."""
    right = solved(data / SETS[task.name])
    rng = np.random.default_rng(
        [task.seed, list(KINDS).index(task.kind) if task.amount else 0, round(100 * task.amount)]
    )
    if task.table == "few":
        right = few(right, TWENTY, rng)
        return right, FactorGraph([right.edges, spoiled(right, int(task.amount), task.kind, rng)])
    ratio = task.amount if task.table == "protocol" else task.amount / (1 - task.amount)
    wrong = round(ratio * int(right.loops.sum()))
    return right, FactorGraph([right.edges, spoiled(right, wrong, task.kind, rng)] if wrong else [right.edges])


def tried(data: Path, task: Task) -> Trial:
    """A trial."""
    right, graph = planted(data, task)
    began, loops = process_time(), int(right.loops.sum())
    try:
        found = nls.gnc(graph, right.start)
    except UnderconstrainedError as error:
        return Trial(
            task, np.inf, [type(error).__name__], loops, 0, len(graph) - len(right.edges), 0, process_time() - began
        )
    kept = [int(w.sum()) for w in found.weights]
    return Trial(
        task,
        off=right.off(found.result.values),
        doubts=[doubt.kind.name for doubt in found.doubts] + ([] if found.result.converged else ["NOT_CONVERGED"]),
        right=loops,
        lost=len(right.edges) - kept[0],
        wrong=len(graph) - len(right.edges),
        accepted=sum(kept[1:]),
        seconds=process_time() - began,
    )


def kept_in(path: Path | None) -> list[Trial]:
    """Trials of an earlier run."""
    if path is None or not path.exists():
        return []
    with _opened(path, "r") as file:
        lines: list[dict[str, Any]] = [json.loads(line) for line in file]
    return [Trial(**(line | {"task": Task(**line["task"])})) for line in lines]


def _opened(path: Path, mode: str) -> IO[str]:
    """A file of trials, compressed if its name says so."""
    return cast(IO[str], gzip.open(path, f"{mode}t")) if path.suffix == ".gz" else path.open(mode)


def run(data: Path, wanted: list[Task], path: Path | None, workers: int, minutes: float) -> list[Trial]:
    """All trials: those in the file, and those that can be begun in time; each is printed, and added to the file."""
    trials, until = kept_in(path), monotonic() + 60 * minutes
    there = {trial.task for trial in trials}
    waiting = [task for task in wanted if task not in there][::-1]
    running: set[Future[Trial]] = set()
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        while running or (waiting and monotonic() < until):
            while waiting and len(running) < workers and monotonic() < until:
                running.add(pool.submit(tried, data, waiting.pop()))
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for trial in (future.result() for future in done):
                trials.append(trial)
                print(trial, flush=True)
                if path is not None:
                    with _opened(path, "a") as file:
                        file.write(json.dumps(asdict(trial)) + "\n")
    asked = set(wanted)
    return [trial for trial in trials if trial.task in asked]
