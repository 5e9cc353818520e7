"""What more threads would give: the library as it is, on one, beside OpenBLAS and CHOLMOD with two and four.

    python benchmarks/threads.py [--threads 1 2 4] [--sets NAME ...] [--rounds 5] [--out DIR]

Every run is a fresh process that optimizes the set once before it is timed. 'free' runs leave OpenBLAS and CHOLMOD the
threads they are given; `nls.sparse.threads` takes them down otherwise. Wall clocks need a machine without other work.
Result: threads.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from harness import ONE_THREAD, Table, child, make_page
from posegraphs_sets import SETS, STAGED, prepare

DATA = os.environ.get("LEADLINE_DATA")


def measure(file: str, free: str) -> list[float]:
    """Wall clock and processor time of an optimization, and wall clock of its factorizations, ms; chi2."""
    import nls
    from nls.sparse import threads

    if free == "1":
        threads._settings = list  # type: ignore[assignment] # nothing to take down
    graph, values, _ = nls.load(file)
    start = nls.initialize(graph, values)[0]
    graph.optimize(start)
    wall, cpu = perf_counter(), process_time()
    result = graph.optimize(start)
    times = [perf_counter() - wall, process_time() - cpu, result.timings["factorize"]]
    return [*(1e3 * seconds for seconds in times), result.chi2_final]


def page(threads: list[int], sets: list[str], rounds: int) -> list[str]:
    """The page without its head."""
    ways: list[tuple[bool, int]] = [(False, 1), *((True, count) for count in threads)]
    titles = ["set", "threads", "optimize: wall, ms", "processor, ms", "factorize: wall, ms", "chi2 as with one"]
    table = Table(titles, "llrrrl")
    for name in sets:
        with tempfile.TemporaryDirectory() as folder:
            file = prepare(name, Path(folder), DATA).files.graph
            command = (sys.executable, __file__, "--child", file)
            runs: list[list[Any]] = [
                [child(*command, int(free), **dict.fromkeys(ONE_THREAD, str(count))) for free, count in ways]
                for _ in range(rounds)
            ]
        medians = np.median(np.array(runs), axis=0)
        for (free, count), (wall, cpu, factorize, chi2) in zip(ways, medians, strict=True):
            title = f"{count}, free" if free else "the library's one"
            same = "to the bit" if chi2 == medians[0, 3] else f"to {abs(chi2 / medians[0, 3] - 1):.0e}"
            table.add(name, title, f"{wall:.0f}", f"{cpu:.0f}", f"{factorize:.0f}", same)
    return [f"- rounds: {rounds}, interleaved, medians", *table]


if __name__ == "__main__":
    choices = tuple(SETS) if DATA else STAGED
    names = {"nargs": "+", "choices": choices, "default": STAGED, "metavar": "NAME", "help": ", ".join(choices)}
    counts = {"nargs": "+", "type": int, "default": [1, 2, 4], "help": "of 'free' runs"}
    title, rounds = "Do more threads help?", (5, "interleaved; medians are shown")
    make_page(title, page, measure, threads=counts, sets=names, rounds=rounds)
