"""A graph that is built measurement by measurement: what adding and the first solve cost, beside GTSAM's wheel.

    python benchmarks/one_by_one.py [--edges 100000] [--rounds 3] [--gtsam PYTHON] [--out DIR]

A simulated city; the start is the chordal one, the same for all, and all take Gauss-Newton. Every run is a process of
its own with one thread.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
from harness import GTSAM, PROCESSOR_TIME, Table, child, make_page

SIGMAS = (0.05, 0.05, 0.01)
TITLES = {"batch": "ours, one batch", "single": "ours, one by one", "gtsam": "GTSAM from Python, one by one"}


def prepare(edges: int, path: Path) -> int:
    """Write the measurements and the start of a city; how many."""
    import sim
    from nls.starts import chordal

    world = sim.manhattan(np.random.default_rng(0), n_poses=round(edges / 1.6))
    factors = world.graph.factors
    i, j = (np.concatenate([factor.keys[slot].numbers for factor in factors]) for slot in (0, 1))
    z = np.concatenate([factor.z for factor in factors])
    X = chordal(world.graph, world.start).stack("x").X
    np.savez(path, i=i, j=j, z=z, X=X, sigmas=SIGMAS)
    return len(z)


def run(way: str, path: str) -> tuple[float, float, float]:
    """Seconds of adding, seconds of the first solve, chi2."""
    import nls
    from factors import Between, Diagonal
    from models import SE2

    with np.load(path) as file:
        i, j, z, X = (file[name] for name in ("i", "j", "z", "X"))
    (x,) = nls.kinds("x")
    noise, graph = Diagonal(SIGMAS), nls.FactorGraph(fixed=[x[0]])
    numbers = list(zip(i.tolist(), j.tolist(), z.tolist(), strict=True))
    began = process_time()
    if way == "batch":
        graph.add(Between(x[i], x[j], z, noise))
    else:
        for a, b, step in numbers:
            graph.add(Between(x[a], x[b], step, noise))
    added = process_time()
    result = graph.optimize(nls.Values({x: (SE2, X)}), nls.GaussNewton())
    return added - began, process_time() - added, result.chi2_final


def page(edges: int, rounds: int, gtsam: str | None) -> list[str]:
    """The page without its head."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "city.npz"
        count = prepare(edges, path)
        commands = {way: [sys.executable, __file__, "--child", way, path] for way in ("batch", "single")}
        if gtsam:
            commands["gtsam"] = [gtsam, "-P", Path(__file__).parent / "peers" / "one_by_one.py", path]
        rows: dict[str, list[list[float]]] = {way: [] for way in commands}
        for _ in range(rounds):
            for way, command in commands.items():
                rows[way].append(child(*command))
    table = Table(["way", "add, s", "first solve, s", "chi2"])
    for way, runs in rows.items():
        add, solve, chi2 = (median(column) for column in zip(*runs, strict=True))
        table.add(TITLES[way], f"{add:.2f}", f"{solve:.2f}", f"{chi2:.6g}")
    joined = "The first solve merges single measurements into batches; the next solve is as fast as that of a batch."
    return [PROCESSOR_TIME, f"- {count:,} measurements between poses of the plane", *table, joined]


if __name__ == "__main__":
    counts = {"edges": (100_000, "measurements, about"), "rounds": (3, "runs of each, interleaved")}
    make_page("A graph built measurement by measurement", page, run, **counts, gtsam=GTSAM)
