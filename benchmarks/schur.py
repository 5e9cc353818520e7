"""What the order of elimination costs: landmarks first, AMD over all unknowns, and no order at all.

    python benchmarks/schur.py [--quick] [--gigabytes 8] [--flops 3e11] [--out DIR]
    python benchmarks/schur.py --mission "floor 5,000"

One row is one linear solve in a fresh process with one BLAS thread: a bundle adjustment where `LEADLINE_DATA` names the
folder of the data sets, and surveys of the sea floor by a hovering vehicle with an imaging sonar (`sim.hauv_floor`),
up to 5,000 poses and 20,000 landmarks. A solve that would pass a limit is not begun; its row says what it would take.
With --mission a whole survey is solved by Levenberg-Marquardt, from dead reckoning and from the start that solves it as
it grows; the elevation is kept in the aperture. It only prints.
"""

from __future__ import annotations

import os
import sys
from itertools import product
from math import radians
from pathlib import Path
from typing import Any, Literal

import numpy as np
from harness import PROCESSOR_TIME, Table, child, line_of, make_page, peak_memory, timed

import nls
import sim
from models.algebra import Index
from nls import FactorGraph, LevenbergMarquardt, LinearSystem, Values
from nls.linear import Cholesky, Schur
from nls.linear.cholesky import Cholmod
from nls.sparse.elimination import Elimination
from nls.sparse.fill import counted
from nls.starts import incremental

SOLVERS = {"schur": "landmarks first", "cholesky": "AMD over all", "natural": "none"}
BAL = "bal/problem-49-7776-pre.txt.gz"
FLOORS = {  # legs, poses a leg, points; two passes over legs of 0.25 m a pose
    "floor 250": (4, 25, 2_000),
    "floor 500": (8, 25, 3_600),
    "floor 1,000": (15, 25, 6_000),
    "floor 2,000": (31, 25, 11_000),
    "floor 5,000": (76, 25, 24_500),
}
RUNS = 3


def problem(name: str) -> tuple[FactorGraph, Values]:
    """The graph, and where it is linearized: the start of the bundle adjustment, the truth of a survey."""
    if name == "problem-49-7776":
        graph, values, _ = nls.load(Path(os.environ["LEADLINE_DATA"]) / BAL)
        return graph, values
    mission = survey(name, "free")
    return mission.graph, mission.truth


def linear_solver(name: str) -> Any:
    """`natural` is CHOLMOD with the unknowns in the order of the graph."""

    class Unordered(Cholmod):
        @staticmethod
        def order(u: Index, v: Index, V: int) -> Index:
            return np.arange(V)

    class Natural(Cholesky):
        name = "natural"
        decomposition = Unordered

    return {"schur": Schur, "cholesky": Cholesky, "natural": Natural}[name](memory_limit=np.inf)


def elimination(solver: str, system: LinearSystem) -> Any:
    """Order of the variables by a solver."""
    if solver == "schur":
        hessian = Schur(memory_limit=np.inf).analyze(system.pattern).factorization.hessian
        return hessian.elimination.variables
    order = linear_solver(solver).decomposition.order
    blocks = system.pattern.blocks
    return Elimination(blocks.u, blocks.v, len(blocks.dims), order).variables


def measure(name: str, solver: str, gigabytes: str, flops: str) -> dict[str, Any]:
    """Fill, seconds and bytes of one solver on one problem; no seconds where it would pass a limit."""
    graph, values = problem(name)
    system = graph.linearize(values)
    free = name == "problem-49-7776"  # its gauge and scale
    damping = 1e-4 * np.square(system.column_norms) if free else None
    blocks = system.pattern.blocks
    fill = counted(blocks.dims, blocks.u, blocks.v, elimination(solver, system))
    sizes = {kind: len(stack) for kind, stack in values.stacks.items()}
    contacts = max(len(factor) for factor in graph.factors)
    found: dict[str, Any] = {"sizes": sizes, "contacts": contacts, "nnz": fill.nnz, "flops": fill.flops}
    if fill.flops > float(flops) or 17 * fill.nnz > float(gigabytes) * 1e9:
        return found
    way = linear_solver(solver)
    before = peak_memory(reset=True)
    analyzed, found["analyze"] = timed(way.analyze, system.pattern)
    seconds: list[float] = []
    while len(seconds) < RUNS and sum(seconds) < 20:
        solved, spent = timed(analyzed.solve, system, damping)
        seconds.append(spent)
    added, residual = peak_memory() - before, normal_residual(system, solved.dx, damping)
    return found | {"solve": float(np.median(seconds)), "bytes": added, "residual": residual}


def normal_residual(system: LinearSystem, dx: Any, damping: Any) -> float:
    """Largest |A'(A dx - b) + damping dx|, each entry beside the length of its column and of b."""
    left = LinearSystem(system.pattern, system.blocks, system.b - system.times(dx)).gradient
    if damping is not None:
        left = left - damping * dx
    return float((np.abs(left) / (system.column_norms * np.linalg.norm(system.b))).max())


def rows(names: list[str], gigabytes: float, flops: float) -> list[dict[str, Any]]:
    """All solvers on all problems, each in a process of its own."""
    found = []
    for name, solver in product(names, SOLVERS):
        measured = child(sys.executable, __file__, "--child", name, solver, gigabytes, flops)
        found.append({"name": name, "solver": solver, **measured})
        print(f"  {name:18s}{solver:10s}{measured.get('solve', float('nan')):10.3f} s", flush=True)
    return found


def table(found: list[dict[str, Any]]) -> list[str]:
    """Markdown: one row per problem and solver."""
    titles = "problem|poses|landmarks|contacts|order|analysis, s|solve, s|relative|numbers in R|10^9 flops|memory, MB"
    lines = Table([*titles.split("|"), "residual"], "lrrrlrrrrrrr")
    for one in found:
        poses, landmarks = (one["sizes"].get(kind, 0) for kind in ("x", "l"))
        poses = poses or one["sizes"]["c"]
        best = next(o for o in found if o["name"] == one["name"] and o["solver"] == "schur")["solve"]
        times, costs = ["-", "not run", "-"], ["-", "-"]
        if "solve" in one:
            times = [f"{one['analyze']:.2f}", f"{one['solve']:.3g}", f"{one['solve'] / best:.2f}"]
            costs = [f"{one['bytes'] / 1e6:,.0f}", f"{one['residual']:.0e}"]
        cells = [one["name"], f"{poses:,}", f"{landmarks:,}", f"{one['contacts']:,}", f"`{one['solver']}`", *times]
        lines.append(line_of([*cells, f"{one['nnz']:.3g}", f"{one['flops'] / 1e9:,.3g}", *costs]))
    return lines


def survey(name: str, elevation: Literal["free", "hinge"]) -> sim.Mission:
    """A survey of the sea floor."""
    legs, per_leg, points = FLOORS[name]
    rng = np.random.default_rng(1)
    return sim.hauv_floor(rng, legs=legs, per_leg=per_leg, points=points, aperture=radians(14), elevation=elevation)


def whole(name: str) -> list[str]:
    """Markdown: seconds of processor time from a start to the optimum of a survey, start by start."""
    mission = survey(name, "hinge")
    titles = ["start", "its seconds", "its chi2", "ATE, m", "steps", "their seconds", "chi2", "ATE, m"]
    lines = Table(titles)
    for start in ("dead reckoning", "incremental"):
        made = timed(incremental, mission.graph, mission.start) if start == "incremental" else (mission.start, 0.0)
        result, seconds = timed(mission.graph.optimize, made[0], LevenbergMarquardt())
        cells = [start, f"{made[1]:.1f}", f"{result.chi2_initial:.4g}", f"{mission.ate(made[0]):.3f}"]
        cells += [result.iterations, f"{seconds:.1f}", f"{result.chi2_final:.7g}"]
        lines.add(*cells, f"{mission.ate(result.values):.3f}")
    return lines


def page(gigabytes: float, flops: float, quick: bool, mission: str | None) -> list[str]:
    """The page without its head; a whole survey is printed alone."""
    if mission:
        print("\n".join([f"{mission}, seconds of one processor:", "", *whole(mission)]))
        raise SystemExit
    names = list(FLOORS)[: 1 if quick else None]
    data = os.environ.get("LEADLINE_DATA")
    if data and (Path(data) / BAL).exists() and not quick:
        names = ["problem-49-7776", *names]
    return [
        PROCESSOR_TIME,
        "- problem-49-7776: bundle adjustment, 49 cameras with their own focal length and distortion, at the start of "
        "the file. Damping: 1e-4 of the diagonal. Not run without the data set",
        "- floor: `sim.hauv_floor`, seed 1, two passes over legs of 6 m, 14 deg of elevation. Factors: `XYH`, "
        "`ZPR` and `RangeAzimuth`; elevation free, linearized at the truth",
        f"- order: {', '.join(f'`{solver}` {order}' for solver, order in SOLVERS.items())}. `natural` is the order of "
        "the graph: poses before landmarks in a survey",
        "- analysis: ordering and symbolic factorization, once per graph; solve: filling A'A, factorization, solution, "
        f"median of up to {RUNS} runs; relative: to `schur`",
        "- memory: peak of analysis and solve above the memory before them; a fresh process for every row",
        "- residual: largest cosine between A dx - b (damping included) and a column of A",
        f"- not run: more than {flops:g} flops, or than {gigabytes:g} GB at 17 bytes a number of R",
        *table(rows(names, gigabytes, flops)),
    ]


if __name__ == "__main__":
    make_page(
        *("The order of elimination", page, measure),
        gigabytes=(8.0, "no solve that would take more memory"),
        flops=(3e11, "or more multiplications and additions"),
        quick="the smallest survey only",
        mission={"choices": FLOORS, "help": "solve a whole survey instead, and print"},
    )
