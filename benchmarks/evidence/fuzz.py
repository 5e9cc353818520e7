"""Mutants of small valid files for every reader: a graph of what they say, or one sentence that names the file?

    python benchmarks/evidence/fuzz.py [--mutants N] [--seed N] [--jobs N]

A mutant is read twice. It is refused by an error of the library that names the file, or it is read. Anything else is a
fault: another exception, a warning that is no `GraphWarning`, a control character in a message, more than some seconds
or memory. Of what is read `fuzz_judges.py` tells whether it is another answer. One in ten is saved and read again; of
one in ten `nls info` and `nls explain` are run. A fault is printed with the bytes of its mutant.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import multiprocessing.connection
import re
import resource
import tempfile
import warnings
from collections import Counter, deque
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic, process_time
from typing import NamedTuple

import numpy as np
from fuzz_judges import judged
from fuzz_mutants import mutated
from fuzz_seeds import FOLDER, READERS, Reading, Seed, graph_reading, seeds
from script import make_page, markdown

import nls
import nls.io
from nls.cli import main as command

SLOW = 5.0  # s of processor time for a file of a few kilobytes
LARGE = 300 << 20  # bytes that a mutant may add to the memory of its process
LARGEST = 4 << 30  # of the process
HANGS = 120.0  # s after which a process is ended
CHUNK = 100  # mutants of a process
SOME = 10  # one in so many is also saved, and one given to the commands
ENDS = ("refused", "read", "other exception", "raw character", "other answer", "slow or large")
TO = ("g2o", "toro", "isam", "pyfg", "bal", "tum", "kitti", "csv", "npz")
RAW = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class End(NamedTuple):
    """What became of a mutant: one of `ENDS`, what is wrong with it, how it was made, and its changed files."""

    reader: str
    number: int
    end: str
    fault: str = ""
    made: str = ""
    files: tuple[tuple[str, bytes], ...] = ()

    def __str__(self) -> str:
        shown = "; ".join(f"{name}: {data!r:.3000}" for name, data in self.files)
        return f"{self.reader} {self.number} ({self.made}): {self.end}: {self.fault}\n    {shown}"


Known = dict[tuple[str, str], Reading]


class Fault(Exception):
    """An end that is none of refused and read."""

    def __init__(self, end: str, words: str) -> None:
        self.end = end
        super().__init__(words)


def mutant(all_seeds: list[Seed], reader: str, number: int, seed: int) -> tuple[Seed, str, dict[str, bytes]]:
    """A mutant by its number: its seed, how it was made, its files."""
    rng = np.random.default_rng([seed, READERS.index(reader), number])
    own = [one for one in all_seeds if one.reader == reader]
    chosen = own[number % len(own)]
    files = dict(chosen.files)
    names = list(files)
    name = names[int(rng.integers(len(names)))]
    others = [data for one in all_seeds for data in one.files.values()]
    made, files[name] = mutated(files[name], others, rng)
    return chosen, f"{chosen.name}, {name.rpartition('/')[2]}: {made}", files


def written(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        file = folder / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data)
    return folder


def refuse_raw(text: str) -> None:
    """No character reaches a terminal that it obeys, but tabs and ends of lines."""
    if raw := RAW.search(text):
        raise Fault("raw character", f"{raw[0]!r} in {text!r:.300}")


@contextlib.contextmanager
def watched(files: dict[str, bytes]) -> Iterator[None]:
    """Raise a fault for anything but an error that names one of the files."""
    try:
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("error")
            warnings.simplefilter("always", nls.GraphWarning)
            yield
    except nls.LeadlineError as error:
        names = {part for name in files for part in name.split("/")}
        refuse_raw(str(error))
        if not any(name in str(error) for name in names):
            raise Fault("other exception", f"names no file: {error!r}") from error
        raise
    except Fault:
        raise
    except Exception as error:  # broad: every other exception is a fault to report
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace is not None else ""
        raise Fault("other exception", f"{error!r:.300} at {where}") from error
    for note in notes:
        refuse_raw(str(note.message))


def tried(seed: Seed, given: Reading, files: dict[str, bytes], number: int, folder: Path) -> str:
    """Read a mutant twice and judge; the end without a fault.

    Raises
    ------
    Fault
        Anything that should not be.
    """
    answers: list[str] = []
    read, began, before = None, process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(2):
        try:
            with watched(files):
                read = seed.reading(folder)
            answers.append(read.whole)
        except nls.LeadlineError as error:
            answers.append(str(error))
    took = process_time() - began
    more = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    if took > SLOW or more > LARGE:
        raise Fault("slow or large", f"{took:.1f} s, {more >> 20} MiB more")
    if answers[0] != answers[1]:
        raise Fault("other answer", "read twice, two answers")
    if read is None:
        return "refused"
    if answer := judged(seed, given, files, read):
        raise Fault("other answer", answer)
    if read.graph is not None and number % SOME == 0:
        saved(seed, files, read, folder, TO[number // SOME % len(TO)])
    if seed.form in ("tagged", "bal", "json", "npz") and number % SOME == 2:
        (name, data), *_ = files.items()
        with watched(files):
            streamed = graph_reading(nls.io.load_stream(io.BytesIO(data), str(folder / name), dialect=seed.dialect))
        if streamed.whole.replace(str(folder), "") != read.whole:
            raise Fault("other answer", "a stream of the same bytes has another answer")
    if read.graph is not None and number % SOME == 1:
        commanded(seed, files, folder)
    return "read"


def saved(seed: Seed, files: dict[str, bytes], read: Reading, folder: Path, form: str) -> None:
    """Save as a native file, in the own format and in another one, and read the first two again."""
    assert read.graph is not None
    own = [seed.dialect] if seed.form in ("tagged", "bal") else []
    for dialect in ("json", *own, form):
        file = folder / f"saved.{dialect}"
        try:
            with watched({file.name: b"", **files}):
                nls.save(file, *read.graph, read.report, dialect)
        except nls.LeadlineError as error:
            if dialect == "json":
                raise Fault("other answer", f"not held by a native file: {error}") from error
            continue
        if dialect != "json" and dialect not in own:
            continue
        with watched({file.name: b""}):
            other = graph_reading(nls.load(file, dialect=dialect))
        same = (read.measurements, read.fixed) == (other.measurements, other.fixed)
        rounded = dialect.startswith(("isam", "toro"))  # without values, or as angles
        if not same or (read.variables != other.variables and not rounded):
            raise Fault("other answer", f"saved as {dialect} and read again it is another graph")


def commanded(seed: Seed, files: dict[str, bytes], folder: Path) -> None:
    """Run the two commands that say most about a graph."""
    name = FOLDER if seed.form == "tables" else next(iter(files))
    if not (folder / name).exists():
        return  # dives are given together
    how = ["--dialect", seed.dialect] if seed.dialect != "auto" else []
    for words in (["info"], ["explain"]):
        out = io.StringIO()
        with watched(files), contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            status = command([*words, str(folder / name), *how])
        refuse_raw(out.getvalue())
        if "internal error" in out.getvalue() or status not in (0, 1, 2):
            raise Fault("other exception", f"nls {words[0]} ends with {status}: {out.getvalue()[-300:]}")


def ended(all_seeds: list[Seed], known: Known, reader: str, number: int, seed: int) -> End:
    """What became of a mutant."""
    chosen, made, files = mutant(all_seeds, reader, number, seed)
    changed = tuple((name, data) for name, data in files.items() if data != chosen.files[name])
    with tempfile.TemporaryDirectory(prefix="fuzz") as name:
        folder = Path(name)
        written(folder, files)
        try:
            end, fault = tried(chosen, known[chosen.reader, chosen.name], files, number, folder), ""
        except Fault as error:
            end, fault = error.end, str(error).replace(name, "")
        except nls.LeadlineError as error:
            end, fault = "other answer", f"what was read is refused afterwards: {error}".replace(name, "")
    return End(reader, number, end, fault, made, changed if fault else ())


def readings(all_seeds: list[Seed]) -> Known:
    """The seeds as they are read."""
    known: Known = {}
    for seed in all_seeds:
        with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
            warnings.simplefilter("ignore", nls.GraphWarning)
            known[seed.reader, seed.name] = seed.reading(written(Path(name), seed.files))
    return known


def work(pipe: Connection, all_seeds: list[Seed], known: Known, tasks: list[tuple[str, int]], seed: int) -> None:
    """A process of its own: the ends of some mutants, one by one."""
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST, LARGEST))
    for reader, number in tasks:
        pipe.send(ended(all_seeds, known, reader, number, seed))
    pipe.close()


def ends(all_seeds: list[Seed], tasks: list[tuple[str, int]], seed: int, jobs: int) -> Iterator[End]:
    """What became of all mutants; a process that hangs or dies is a fault of the mutant it was at."""
    context, known = multiprocessing.get_context("fork"), readings(all_seeds)
    waiting = deque(tasks[k : k + CHUNK] for k in range(0, len(tasks), CHUNK))
    running: dict[Connection, tuple[multiprocessing.process.BaseProcess, deque[tuple[str, int]], float]] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            chunk = waiting.popleft()
            pipe, other = context.Pipe(duplex=False)
            process = context.Process(target=work, args=(other, all_seeds, known, chunk, seed))
            process.start()
            other.close()
            running[pipe] = process, deque(chunk), monotonic()
        ready = multiprocessing.connection.wait(list(running), timeout=1.0)
        for pipe in list(running):
            process, left, since = running[pipe]
            died = False
            if pipe in ready:
                try:
                    yield pipe.recv()
                    left.popleft()
                    running[pipe] = process, left, monotonic()
                    continue
                except EOFError:
                    died = True
            if died or monotonic() - since > HANGS:
                process.kill()
                process.join()
                del running[pipe]
                if left:
                    reader, number = left.popleft()
                    _, made, files = mutant(all_seeds, reader, number, seed)
                    end, words = ENDS[2 if died else -1], "the process died" if died else f"not done in {HANGS:g} s"
                    yield End(reader, number, end, words, made, tuple(files.items()))
                    if left:
                        waiting.append(list(left))


EXPLAINED = f"""\
A mutant is a small valid file, or one file of a folder, with bits, bytes, blocks, lines, words, numbers, \
names, encodings or control characters changed. It is read twice.

- *refused*: an error of the library names the file
- *other exception*: any other exception, and warnings that are not about graphs
- *raw character*: a control character in a message; some clear a terminal
- *other answer*: two different answers, other measurements than in the lines, or a wrong checksum
- *slow or large*: more than {SLOW:g} s or {LARGE >> 20} MiB
"""


def page(mutants: int, seed: int, jobs: int) -> list[str]:
    """The page without its head."""
    all_seeds = seeds()
    tasks = [(reader, k) for k in range(-(-mutants // len(READERS))) for reader in READERS][:mutants]
    counts: dict[str, Counter[str]] = {reader: Counter() for reader in READERS}
    faults = []
    for end in ends(all_seeds, tasks, seed, jobs):
        counts[end.reader][end.end] += 1
        if end.fault:
            print(end, flush=True)
            faults.append(re.sub(r"\s+", " ", f"{end.reader} {end.number}: {end.end}: {end.fault:.200}"))
    of = Counter(one.reader for one in all_seeds)
    every = ("**all**", of.total(), sum(counts.values(), Counter[str]()))
    rows = [(name, of[name], count) for name, count in counts.items()]
    cells = [[name, n, count.total(), *(count[end] for end in ENDS)] for name, n, count in [*rows, every]]
    table = markdown(["reader", "seeds", "mutants", *ENDS], cells)
    shown = ["Faults:", "\n".join(["```text", *faults, "```"])] if faults else []
    return [f"- random numbers of seed {seed}", *table, EXPLAINED, *shown]


if __name__ == "__main__":
    make_page(
        *("Damaged files for every reader", page),
        mutants=(20_000, "of all readers"),
        seed={"type": int, "default": 0, "help": "of the random numbers (default 0)"},
        jobs=(2, "processes at once"),
    )
