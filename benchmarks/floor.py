"""How near is the library to its floor? Beside it a lean solver in NumPy and CHOLMOD, from the file to the optimum.

    python benchmarks/floor.py [--sets NAME ...] [--rounds 7] [--most RATIO] [--out DIR]

The lean solver is benchmarks/peers/lean.py. It has no labels, general factors, kernels or result, so it is a floor and
no target. Both read the same g2o file, start from a chordal relaxation, and have to reach the same chi2. The sets are
public ones in the folder that LEADLINE_DATA names, or simulated worlds. Result: floor.md.
"""

from __future__ import annotations

import cProfile
import math
import os
import pstats
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from harness import PROCESSOR_TIME, Table, child, make_page, positive
from peers import Files
from posegraphs_sets import QUICK, SETS, STAGED, prepare

DATA = os.environ.get("LEADLINE_DATA")
STAGES = ("load", "start", "optimize")
SOLVERS = {"leadline": "auto", "lean": "chordal"}
SAME = 1e-6  # relative difference of chi2
WARM = 5  # runs
QUIET = {"OMP_MAX_ACTIVE_LEVELS": "0"}  # CHOLMOD's threads; leadline takes them down itself


def measure(solver: str, file: str) -> dict[str, Any]:
    """Processor time of the first run and of later ones, ms by stage; calls of the second one."""
    contender = import_module(f"peers.{solver}").Run(Files(Path(file), Path(file), False), SOLVERS[solver])

    def solve() -> list[float]:
        clocks = [process_time()]
        for stage in STAGES:
            getattr(contender, stage)()
            clocks.append(process_time())
        return [1e3 * float(ms) for ms in np.diff(clocks)]

    cold, profile = solve(), cProfile.Profile()
    profile.runcall(solve)
    calls = pstats.Stats(profile).total_calls  # type: ignore[attr-defined]
    return {"cold": cold, "calls": calls, "warm": [solve() for _ in range(WARM)], "chi2": contender.cost()}


def page(sets: list[str], rounds: int, most: float | None) -> list[str]:
    """The page without its head."""
    titles = ["set", "edges", "cold: leadline, ms", "lean, ms", "ratio", "warm: leadline", "lean", "ratio"]
    table, over = Table([*titles, "calls: leadline", "lean", "chi2"]), []
    for name in sets:
        with tempfile.TemporaryDirectory() as folder:
            problem = prepare(name, Path(folder), DATA)
            runs: dict[str, list[Any]] = {solver: [] for solver in SOLVERS}
            for _ in range(rounds):
                for solver, done in runs.items():
                    done.append(child(sys.executable, __file__, "--child", solver, problem.files.graph, **QUIET))
        (ours, floor), times = (done[0] for done in runs.values()), []
        if not math.isclose(ours["chi2"], floor["chi2"], rel_tol=SAME):
            raise SystemExit(f"{name}: chi2 of leadline is {ours['chi2']:.9g}, of the lean solver {floor['chi2']:.9g}")
        for clock in ("cold", "warm"):
            stages = [np.median(np.reshape([run[clock] for run in done], (-1, 3)), axis=0) for done in runs.values()]
            totals = [
                np.median(np.reshape([run[clock] for run in done], (-1, 3)).sum(axis=1)) for done in runs.values()
            ]
            times += [*map(by_stage, totals, stages), f"**{totals[0] / totals[1]:.2f}**"]
            if most and clock == "cold" and totals[0] > most * totals[1]:
                over.append(f"{name} {totals[0] / totals[1]:.2f}")
        table.add(
            name, f"{problem.edges:,}", *times, f"{ours['calls']:,}", f"{floor['calls']:,}", f"{floor['chi2']:.7g}"
        )
    if over:
        raise SystemExit(f"more than {most:g} times the floor: {', '.join(over)}")
    return [
        PROCESSOR_TIME,
        f"- a fresh process for every run, rounds of both in turn: {rounds}; medians",
        "- ms: from the file to the optimum (load + start + optimize), everything imported before; the first run of its"
        f" process. Warm: the {WARM} last of {WARM + 2} runs",
        "- calls: of Python functions, as cProfile counts them in the second run",
        f"- chi2: of both to {SAME:g}",
        *table,
    ]


def by_stage(total: float, stages: np.ndarray[Any, Any]) -> str:
    """A time and its parts, ms."""
    return f"{total:.3g} ({' + '.join(f'{ms:.3g}' for ms in stages)})"


if __name__ == "__main__":
    choices = tuple(SETS) if DATA else (*QUICK, *STAGED)
    names = {"nargs": "+", "choices": choices, "default": choices, "metavar": "NAME", "help": ", ".join(choices)}
    limit = {"type": positive, "metavar": "RATIO", "help": "end with an error where leadline takes more than so many"}
    rounds = (7, "rounds of both in turn; medians are shown")
    make_page("How near is the library to its floor?", page, measure, sets=names, rounds=rounds, most=limit)
