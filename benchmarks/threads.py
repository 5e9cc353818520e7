"""What more threads would give: the library as it is, on one, beside OpenBLAS and CHOLMOD with two and four.

    python benchmarks/threads.py [--threads 1 2 4] [--sets NAME ...] [--rounds 5] [--out DIR]

Every run is a fresh process that optimizes the set once before it is timed. 'free' runs leave OpenBLAS and CHOLMOD the
threads they are given; `nls.sparse.threads` takes them down otherwise. Wall clocks need a machine without other work.
Result: threads.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from pinv import ONE_THREAD, RESULTS, machine, write_page  # the scripts beside this one
from posegraphs_sets import SETS, STAGED, prepare


def measure(file: str, free: bool) -> None:
    """Print wall clock and processor time of an optimization, and wall clock of its factorizations, ms; chi2."""
    import nls
    from nls.sparse import threads

    if free:
        threads._settings = list  # type: ignore[assignment] # nothing to take down
    graph, values, _ = nls.load(file)
    start = nls.initialize(graph, values)[0]
    graph.optimize(start)
    wall, cpu = perf_counter(), process_time()
    result = graph.optimize(start)
    times = [perf_counter() - wall, process_time() - cpu, result.timings["factorize"]]
    print(json.dumps([*(1e3 * seconds for seconds in times), result.chi2_final]))


def run(file: Path, free: bool, threads: int) -> list[float]:
    environment = os.environ | dict.fromkeys(ONE_THREAD, str(threads))
    command = [sys.executable, __file__, "--child", str(file), str(int(free))]
    return list(json.loads(subprocess.run(command, env=environment, check=True, capture_output=True).stdout))


def main() -> int:
    if sys.argv[1:2] == ["--child"]:
        measure(sys.argv[2], sys.argv[3] == "1")
        return 0
    data = os.environ.get("LEADLINE_DATA")
    choices = tuple(SETS) if data else STAGED
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2, 4], help="of 'free' runs")
    parser.add_argument("--sets", nargs="+", choices=choices, default=STAGED, metavar="NAME", help=", ".join(choices))
    parser.add_argument("--rounds", type=int, default=5, help="interleaved; medians are shown")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="DIR", help="folder for threads.md")
    options = parser.parse_args()
    ways: list[tuple[bool, int]] = [(False, 1), *((True, count) for count in options.threads)]
    lines = ["# What more threads would give", "", *machine(), f"- rounds: {options.rounds}, interleaved, medians"]
    lines += ["", "| set | threads | optimize: wall, ms | processor, ms | factorize: wall, ms | chi2 as with one |"]
    lines.append("|:--|:--|--:|--:|--:|:--|")
    for name in options.sets:
        with tempfile.TemporaryDirectory() as folder:
            file = prepare(name, Path(folder), data).files.graph
            runs: list[list[Any]] = [[run(file, *way) for way in ways] for _ in range(options.rounds)]
        medians = np.median(np.array(runs), axis=0)
        for (free, count), (wall, cpu, factorize, chi2) in zip(ways, medians, strict=True):
            title = f"{count}, free" if free else "the library's one"
            same = "to the bit" if chi2 == medians[0, 3] else f"to {abs(chi2 / medians[0, 3] - 1):.0e}"
            lines.append(f"| {name} | {title} | {wall:.0f} | {cpu:.0f} | {factorize:.0f} | {same} |")
    write_page(lines, options.out / "threads.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
