r"""Monte-Carlo: one function, many seeds, on all cores or on any `concurrent.futures.Executor`.

    runs(function, seeds)  ->  [function(seed) for seed in seeds]

A seed decides everything a run draws, and every run has one BLAS thread. So the records are the same bits whatever the
workers and their number. With `resume` each record is appended to a file at once, and a run that was killed goes on
where it stopped:

    {"function": "sim.estimators.errors", "arguments": ["subsea", "ekf"], "options": {}}
    {"seed": 3, "record": {"ate": 0.21, "nees": 2.9}}
    ...

Lines after the first are in the order of completion; what `runs` returns is in the order of the seeds.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from errno import ENOSPC
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import GraphFileError, GraphWarning, LeadlineError, OptionError
from models.listing import some
from models.options import check_whole
from nls.io.files import read_bytes, write_bytes
from nls.sparse.threads import single_thread

__all__ = ["FailedRunsError", "Record", "runs"]

Record = dict[str, Any]  # what json can hold
FAILURES = (LeadlineError, ArithmeticError, np.linalg.LinAlgError)  # of one seed; all else is a fault of the function
SHOWN = 5  # failed seeds in a message


class FailedRunsError(LeadlineError):
    """Some runs of a Monte-Carlo failed; all others were made.

    Attributes
    ----------
    records : of the runs that did not fail, by seed.
    failures : the error of each other run, by seed.
    """

    def __init__(self, records: dict[int, Record], failures: dict[int, Exception]) -> None:
        self.records, self.failures = records, failures
        seeds = some([f"seed {seed}: {sentence(error)}" for seed, error in failures.items()], SHOWN, "; ", " seeds")
        super().__init__(f"{len(failures)} of {len(records) + len(failures)} runs failed. {seeds}")


def runs(
    function: Callable[[int], Record],
    seeds: Iterable[int],
    executor: Executor | None = None,
    resume: str | Path | None = None,
    progress: bool = False,
) -> list[Record]:
    """The result of a function for every seed, in the order of the seeds.

    Parameters
    ----------
    function : of one seed; returns a dict of what JSON can hold, with finite numbers. It is sent to other processes: a
        function of a module, with its options in a `functools.partial`.
    seeds : whole numbers of at least 0, no two the same.
    executor : where the runs go; a process for every core when omitted. That of a cluster will do, such as
        ``dask.distributed.Client(...).get_executor()``.
    resume : a file of JSON lines that keeps the records, made when it is not there. Seeds it holds are not run again.
        One program at a time may use it.
    progress : show a bar, on a terminal only.

    Returns
    -------
    list of dict, each as JSON gives it back: tuples are lists.

    Raises
    ------
    OptionError
        Seeds that are none, a record JSON cannot hold, or with `resume` a function that cannot be told from others.
    GraphFileError
        A file that cannot be read or written, of another function or other options, or damaged.
    FailedRunsError
        Seeds for which the function raised an error of this library or of arithmetic, after all runs. It has the
        records of the other seeds; with `resume` only the failed seeds run again.
    Exception
        Any other error of the function, at once, with the seed as a note. Runs that have not begun are cancelled,
        records that are in the file stay there.

    Warns
    -----
    GraphWarning
        The last line of the file is half written: it is dropped and its seed is run again.

    Examples
    --------
    Threads in the place of processes, for a function that was made here:

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> import numpy as np
    >>> with ThreadPoolExecutor(2) as threads:
    ...     runs(lambda seed: {"mean": np.random.default_rng(seed).normal(size=10).mean()}, [2, 1], threads)
    [{'mean': -0.00685...}, {'mean': 0.2249...}]
    """
    seeds = list(seeds)
    for seed in seeds:
        check_whole("seeds", seed, 0, "whole numbers of at least 0")
    if len(set(seeds)) < len(seeds):
        raise OptionError("seeds", seeds, "every seed once")
    done = {} if resume is None else _records_of(Path(resume), _signature(function))
    todo = [int(seed) for seed in seeds if seed not in done]
    failures: dict[int, Exception] = {}
    with ExitStack() as stack:
        append = None if resume is None else stack.enter_context(_appending(Path(resume)))
        bar = stack.enter_context(_bar(len(seeds), len(seeds) - len(todo), progress))
        if executor is None and todo:
            executor = stack.enter_context(_all_cores(len(todo)))
        assert executor is not None or not todo
        with _uninterrupted():
            pending = {executor.submit(_run, function, seed): seed for seed in todo} if executor is not None else {}
        try:
            for future in as_completed(pending):
                seed = pending[future]
                if (error := future.exception()) is not None:
                    error.add_note(f"in the run of seed {seed}")
                    raise error
                text = future.result()
                bar.update()
                if isinstance(text, Exception):
                    failures[seed] = text
                    continue
                done[seed] = json.loads(text)
                if append is not None:
                    append(f'{{"seed": {seed}, "record": {text}}}\n')
        finally:  # after an error or Ctrl-C: what has not begun never does
            for future in pending:
                future.cancel()
    if failures:
        records = {seed: done[seed] for seed in seeds if seed in done}
        raise FailedRunsError(records, {seed: failures[seed] for seed in seeds if seed in failures})
    return [done[seed] for seed in seeds]


def sentence(error: Exception) -> str:
    """The kind of an error, for one that is not of this library, its message and its notes in one line."""
    kind = [] if isinstance(error, LeadlineError) else [f"{type(error).__name__}:"]
    return " ".join(" ".join([*kind, str(error), *getattr(error, "__notes__", [])]).split())


@single_thread()
def _run(function: Callable[[int], Record], seed: int) -> str | Exception:
    """The record of one seed as JSON, which gives every float back bit by bit; the error of a seed that failed."""
    try:
        record = function(seed)
    except FAILURES as error:
        return error
    if not isinstance(record, dict):
        raise OptionError("function", function, f"one that returns a dict; for seed {seed} it returned {record!r:.60}")
    try:
        return json.dumps(record, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise OptionError("function", function, f"one that returns finite numbers and words: {error}") from error


def _all_cores(runs: int) -> ProcessPoolExecutor:
    """New processes, not copies: a copy of a process with threads can hang."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ProcessPoolExecutor(min(cores, runs), get_context("spawn"), initializer=_obey)


def _obey() -> None:
    """A process of the pool: Ctrl-C is for the one that started it, and where that one is killed it ends too.

    Nothing else would end it: it waits for work from a pipe whose other end it holds as well.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Processes that are started here ignore Ctrl-C from their first moment on, which `_obey` is too late for."""
    if threading.current_thread() is not threading.main_thread():  # no other may set what is done with signals
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _bar(total: int, initial: int, progress: bool) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, initial=initial, unit="run", leave=False, disable=None if progress else True)


def _signature(function: Callable[[int], Record]) -> dict[str, Any]:
    """The identity of a function and its options, as JSON gives it back: the first line of a file of its records."""
    arguments: tuple[Any, ...] = ()
    options: dict[str, Any] = {}
    bare = function
    while isinstance(bare, partial):
        arguments, options, bare = bare.args + arguments, bare.keywords | options, bare.func
    name = f"{getattr(bare, '__module__', '')}.{getattr(bare, '__qualname__', '')}"
    if not hasattr(bare, "__qualname__") or "<" in name:
        raise OptionError("function", function, "a function of a module: records of this one could be those of another")
    try:
        text = json.dumps({"function": name, "arguments": arguments, "options": options}, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise OptionError("function", function, f"a partial of numbers and words, to resume: {error}") from error
    signature: dict[str, Any] = json.loads(text)
    return signature


def _records_of(path: Path, signature: dict[str, Any]) -> dict[int, Record]:
    """Records by seed; the file is made, or rid of a last line that is not whole."""
    data = read_bytes(path) if path.exists() else b""
    head = json.dumps(signature).encode() + b"\n"
    whole = data[: data.rfind(b"\n") + 1]
    lines = whole.splitlines()
    if (not lines and not head.startswith(data)) or (lines and _object(path, 1, lines[0]) != signature):
        expected = head.decode().rstrip()
        raise GraphFileError(f"is not of this function and these options, {expected}; give another file", str(path), 1)
    if whole != data:
        warnings.warn(
            f"{path}: the last line is half written, of a run that was killed; it is dropped, its seed runs again",
            GraphWarning,
            stacklevel=3,
        )
    if not lines or whole != data:
        write_bytes(path, whole or head)
    done: dict[int, Record] = {}
    for number, line in enumerate(lines[1:], 2):
        entry = _object(path, number, line)
        seed, record = entry.get("seed"), entry.get("record")
        if set(entry) != {"seed", "record"} or not isinstance(seed, int) or not isinstance(record, dict):
            raise GraphFileError('is not a record; expected {"seed": 3, "record": {...}}', str(path), number)
        if done.setdefault(seed, record) != record:
            raise GraphFileError(f"seed {seed} has two records that differ; remove one", str(path), number)
    return done


def _object(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        entry = json.loads(line)
    except ValueError as error:  # not UTF-8 either
        raise GraphFileError(
            f"is not JSON: {error}; remove the line or give another file", str(path), number
        ) from error
    if not isinstance(entry, dict):
        raise GraphFileError("is not a JSON object; give a file that was written here", str(path), number)
    return entry


@contextmanager
def _appending(path: Path) -> Iterator[Callable[[str], None]]:
    """A writer that adds whole lines to a file, each with one call to the system."""
    file = os.open(path, os.O_WRONLY | os.O_APPEND)

    def append(line: str) -> None:
        """Add a line, and see it on the disk; of a line that does not fit nothing stays in the file."""
        data, before = line.encode(), os.fstat(file).st_size
        try:
            if os.write(file, data) != len(data):
                raise OSError(ENOSPC, os.strerror(ENOSPC))
            os.fsync(file)
        except OSError as error:
            os.ftruncate(file, before)
            raise GraphFileError(f"cannot be written: {error.strerror or error}", str(path)) from error

    try:
        yield append
    finally:
        os.close(file)
