"""What all marginal covariances cost: one pass over the Cholesky factor, against solving for columns of the inverse.

    python benchmarks/marginals.py [--quick] [--out DIR]

Both use the same factorization, one thread, and give the same numbers: the table says how far they differ. Column
solves take 60 columns at a time, of as many poses as that is, until every pose is done (the columns of one pose at a
time take twice as long). The public sets sphere2500, city10000 and
torus3D are taken from the folder that LEADLINE_DATA names; without it, simulated worlds of those sizes. --quick: one
small world.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import POSE_GRAPHS, Table, make_page, timed

RUNS, COLUMNS = 5, 60  # columns: a multiple of 3 and of 6
SETS = ("sphere2500", "city10000", "torus3D")


def problems(quick: bool) -> dict[str, Callable[[], Any]]:
    """Names and what gives graph and values."""
    import nls
    import sim

    def simulated(make: Callable[..., Any], **sizes: int) -> Callable[[], Any]:
        def world() -> Any:
            made = make(np.random.default_rng(1), **sizes)
            return made.graph, made.truth

        return world

    if quick:
        return {"sphere of 500 (simulated)": simulated(sim.sphere, rings=20, per_ring=25)}
    folder = os.environ.get("LEADLINE_DATA")
    if folder:
        return {name: lambda path=Path(folder, POSE_GRAPHS[name]): nls.load(path)[:2] for name in SETS}
    return {
        "sphere of 2,500 (simulated)": simulated(sim.sphere, rings=50, per_ring=50),
        "city of 10,000 (simulated)": simulated(sim.manhattan, n_poses=10_000),
    }


def median_time(what: Callable[[], Any], runs: int = RUNS) -> tuple[float, Any]:
    """Median processor time of some runs, s, and the last result."""
    found, seconds = zip(*(timed(what) for _ in range(runs)), strict=True)
    return float(np.median(seconds)), found[-1]


def row(name: str, graph: Any, values: Any, solver: Any, solve_columns: bool) -> list[str]:
    """Measure one problem with one factorization."""
    from nls.gauge import choose_gauge, fixed_variables
    from nls.sparse.threads import single_thread
    from nls.system import LinearSystem

    every = graph.pattern(values)
    pattern = every.holding(choose_gauge("first", every, values, fixed_variables(graph.fixed, values)).held)
    state, S = solver.analyze(pattern).factorization, LinearSystem.at(pattern, values).H_blocks
    every_one = np.arange(len(state.hessian.dims))
    with single_thread():
        factorize, _ = median_time(lambda: state.factorize(S))
        ours, flat = median_time(lambda: state.inverse_blocks(every_one, every_one, np.inf))
    n, d = pattern.n, int(state.hessian.dims[0])
    cells = [name, solver.name, f"{len(values):,}", f"{n:,}", f"{state.lower()[0].nnz:,}"]
    cells += [f"{1e3 * factorize:.0f}", f"{ours:.3f}"]
    if solve_columns:

        def columns() -> Any:
            out = np.empty((n // d, d, d))
            for begin in range(0, n, COLUMNS):
                block = np.arange(begin, min(begin + COLUMNS, n))
                E = np.zeros((n, len(block)))
                E[block, np.arange(len(block))] = 1.0
                square = state.solve(E)[block].reshape(len(block) // d, d, len(block) // d, d)
                k = np.arange(len(block) // d)
                out[begin // d + k] = square[k, :, k, :]
            return out

        with single_thread():
            expected, seconds = timed(columns)
        scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
        off = np.abs((flat.reshape(-1, d, d) - expected) / scale).max()
        return [*cells, f"{seconds:.1f}", f"{seconds / ours:.0f}", f"{off:.0e}"]
    return [*cells, "", "", ""]


def page(quick: bool) -> list[str]:
    """The page without its head."""
    from nls.linear import LU, Cholesky

    titles = ["graph", "factor", "poses", "unknowns", "numbers in L", "factorize, ms", "one pass, s"]
    table = Table([*titles, "column solves, s", "times", "difference"], names=2)
    for name, load in problems(quick).items():
        graph, values = load()
        for solver in (Cholesky(), LU()):
            if solver.missing() is not None:
                table.add(name, solver.name, "not installed" + 7 * " |")
                continue
            columns = solver.name == "cholesky" or Cholesky.missing() is not None
            table.add(*row(name, graph, values, solver, columns))
    return [
        f"- processor time with one thread; median of {RUNS} runs, the column solves once",
        "- one pass: from the factor to the diagonal block of every variable; column solves: the same factor, "
        f"{COLUMNS} columns at a time, the blocks of every pose kept",
        "- linearized at the values of the file, first pose fixed; difference: relative to the largest number of each "
        "block",
        *table,
    ]


if __name__ == "__main__":
    title = "All marginal covariances: one pass against column solves"
    make_page(title, page, quick="one small simulated world")
