"""Trials with wrong closures: what is tried on which graph, run by several processes, kept in a file as they end."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import numpy as np
from wrong_closures import SETS, Solved, solved, spoiled

import nls
from factors import Cauchy
from models.errors import UnderconstrainedError
from nls import FactorGraph, Values

OURS, OTHERS = "nls.gnc", ("plain", "Cauchy(1)", "GNC, all in")
SHARES, SIZES = (0.1, 0.3, 0.5), (1, 10)
HARD = ((0.5, 30), (0.5, 100), (0.7, 1), (0.7, 10))  # share, size
HARD_SETS = ("intel", "manhattan", "sphere2500")
PATIENCE = 20.0  # s of processor time after which another method is given up
FINE = 0.01  # of the extent: what is nearer to the right optimum is solved


@dataclass(frozen=True)
class Task:
    """A graph with wrong closures, and what is tried on it."""

    name: str
    size: int
    share: float
    seed: int
    method: str = OURS


@dataclass(frozen=True)
class Trial:
    """What came of a task; nan where a method does not say, or was given up.

    Attributes
    ----------
    off : ATE over the extent.
    recall, precision : share of the wrong ones that were rejected, of the rejected ones that are wrong.
    kept : share of the right closures that were kept.
    strain, noise, rejected : `Robustified.strain`, chi2 over degrees of freedom, share of all closures rejected.
    seconds : processor time.
    """

    task: Task
    off: float
    recall: float
    precision: float
    kept: float
    strain: float
    noise: float
    rejected: float
    seconds: float

    @property
    def fine(self) -> bool:
        return self.off < FINE


class GivenUpError(Exception):
    """A method took too long."""


@contextmanager
def patience(seconds: float) -> Iterator[None]:
    """At most so much processor time for what is inside."""

    def give_up(*_: object) -> None:
        raise GivenUpError

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def tasks(seeds: int) -> list[Task]:
    """The first seed of everything, and the others after it: a run that is ended early has a bit of all."""
    suite, hard, others = [], [], []
    for seed in range(seeds):
        suite.append([Task(name, size, share, seed) for name in SETS for size in SIZES for share in SHARES])
        hard.append([Task(name, size, share, seed) for name in HARD_SETS for share, size in HARD])
    for method in OTHERS:
        others += [Task(t.name, t.size, t.share, t.seed, method) for t in suite[0]]
    later = [t for again in (suite[1:], hard[1:]) for one in again for t in one]
    return [*suite[0], *hard[0], *others, *later]


def planted(data: Path, task: Task) -> tuple[Solved, FactorGraph]:
    """The right graph, and the one with wrong closures as its second factor."""
    right = solved(data / SETS[task.name])
    rng = np.random.default_rng([task.seed, task.size, round(100 * task.share)])
    return right, FactorGraph([right.edges, spoiled(right, task.share, task.size, rng)])


def estimate(method: str, graph: FactorGraph, start: Values) -> Values:
    """Methods that reject nothing by name, or begin with everything."""
    if method == "plain":
        return graph.optimize(nls.initialize(graph, start)[0]).values
    odometry = nls.initialize(graph, start, "odometry")[0]
    if method == "Cauchy(1)":
        return graph.robust(Cauchy(1.0)).optimize(odometry).values
    return nls.gnc(graph, odometry, preselect=False).result.values


def tried(data: Path, task: Task) -> Trial:
    """A trial."""
    right, graph = planted(data, task)
    nan, began = float("nan"), process_time()
    if task.method != OURS:
        try:
            with patience(PATIENCE):
                off = right.off(estimate(task.method, graph, right.start))
        except (GivenUpError, UnderconstrainedError):
            off = nan
        return Trial(task, off, nan, nan, nan, nan, nan, nan, process_time() - began)
    found = nls.gnc(graph, right.start)
    seconds, (of_right, of_wrong) = process_time() - began, (w == 0 for w in found.weights)
    rejected = int(of_right.sum() + of_wrong.sum())
    return Trial(
        task,
        off=right.off(found.result.values),
        recall=float(of_wrong.mean()),
        precision=float(of_wrong.sum()) / max(rejected, 1),
        kept=1 - float(of_right[right.loops].mean()),
        strain=found.strain,
        noise=found.result.chi2_final / found.result.dof,
        rejected=rejected / found.doubted,
        seconds=seconds,
    )


def kept_in(path: Path | None) -> list[Trial]:
    """Trials of an earlier run."""
    if path is None or not path.exists():
        return []
    lines: list[dict[str, Any]] = [json.loads(line) for line in path.read_text().splitlines()]
    return [Trial(**(each | {"task": Task(**each["task"])})) for each in lines]


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
                    with path.open("a") as file:
                        file.write(json.dumps(asdict(trial)) + "\n")
    asked = set(wanted)
    return [trial for trial in trials if trial.task in asked]
