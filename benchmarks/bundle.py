"""Many points: a public bundle adjustment against Ceres, and a camera and a sonar that see 20,000 points.

    python benchmarks/bundle.py [--quick] [--rounds 3] [--ceres PYTHON] [--out DIR]

Every run is a fresh process. The bundle adjustment is the set of `LEADLINE_DATA`; Ceres runs where PYTHON has pyceres
and pycolmap, whose cost is C++. Same residuals, same start, interleaved rounds; compared is the time to one chi2.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from harness import Table, child, line_of, make_page, peak_memory, timed

import nls
import sim
from factors import BundleProjection, Isotropic
from factors.bundle import CAMERA, LENS
from models import SO3, R

BAL = "bal/problem-49-7776-pre.txt.gz"
SOLVERS = ("cholesky", "schur", "pcg", "pcg, tol 0.1")  # of the rig
OURS = ("cholesky", "schur", "pcg, tol 0.1")
CERES = (("DENSE_SCHUR", 1), ("SPARSE_SCHUR", 1), ("ITERATIVE_SCHUR", 1), ("DENSE_SCHUR", 2))
RIGS = {"rig 50": (50, 2_000, 10), "rig 200": (200, 20_000, 10)}  # poses, points, views of each
SAME = 1.001  # times the highest and the lowest chi2 that any run ended at: to which all are timed
RUNS = 3


def linear_solver(name: str) -> Any:
    return {"cholesky": nls.Cholesky, "schur": nls.Schur, "pcg": nls.PCG, "pcg, tol 0.1": lambda: nls.PCG(0.1)}[name]()


# --- a bundle adjustment against Ceres --------------------------------------------------------------------------------


def prepare(source: Path, path: Path) -> str:
    """Write the set as arrays; what was left out, in words.

    COLMAP's residual is 0 for a point behind its camera, ours is that of the formula: points that are behind one of
    their cameras at the start are left out for both.
    """
    graph, values, _ = nls.load(source)
    (factor,) = graph.factors
    camera, _, point = (keys.numbers for keys in factor.keys)
    C, K, P = (np.ascontiguousarray(values.stack(kind).X) for kind in "ckl")
    R, t = SO3.rotation(SO3.exp(C[:, :3])), C[:, 3:]
    behind = np.matvec(R[camera], P[point])[:, 2] + t[camera, 2] >= 0
    left_out = np.unique(point[behind])
    kept = ~np.isin(point, left_out)
    _, point = np.unique(point[kept], return_inverse=True)
    given = {"camera": camera[kept], "point": point, "z": factor.z[kept], "P": np.delete(P, left_out, axis=0)}
    np.savez(path, C=C, K=K, R=R, t=t, **given)
    return f"{len(left_out)} of {len(P):,} points, {int((~kept).sum())} of {len(kept):,} observations"


def optimize_bundle(path: str, solver: str) -> dict[str, Any]:
    """One optimization of the arrays: the time from a graph that has met no values to the last step."""
    c, k, l = nls.kinds("c", "k", "l")
    with np.load(path) as given:
        i, j = given["camera"], given["point"]
        graph = nls.FactorGraph([BundleProjection(c[i], k[i], l[j], given["z"], Isotropic(1.0))])
        values = nls.Values({c: (CAMERA, given["C"]), k: (LENS, given["K"]), l: (R(3), given["P"])})
    linear, start = linear_solver(solver), graph.chi2(values)
    graph = nls.FactorGraph([graph.factors[0][:]])  # nothing of it has been bound
    graph.fix(c[0])
    trace = [(0.0, 0.0, start)]

    def record(step: nls.Iteration) -> None:
        trace.append((process_time() - cpu, perf_counter() - wall, step.chi2))

    cpu, wall = process_time(), perf_counter()
    result = graph.optimize(values, nls.LevenbergMarquardt(callback=record), linear)
    seconds = process_time() - cpu, perf_counter() - wall
    return {"trace": trace, "seconds": seconds, "timings": result.timings, "said": result.linear_solver}


def against_ceres(source: Path, rounds: int, ceres: str) -> list[str]:
    """Rounds of all contenders in turn, and their table."""
    ours = [(solver, "leadline", 1) for solver in OURS]
    has = subprocess.run([ceres, "-c", "import pyceres, pycolmap"], capture_output=True, check=False).returncode == 0
    theirs = [(solver, "Ceres", threads) for solver, threads in CERES] if has else []
    runs: dict[tuple[str, str, int], list[dict[str, Any]]] = {one: [] for one in [*ours, *theirs]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        left_out = prepare(source, path)
        for _ in range(rounds):
            for (solver, who, threads), done in runs.items():
                if who == "Ceres":
                    script = Path(__file__).with_name("bundle_ceres.py")
                    done.append(child(ceres, script, path, solver, threads))
                else:
                    done.append(child(sys.executable, __file__, "--child", "bundle", path, solver))
                print(f"  {who:9s}{solver:16s}{threads}  {done[-1]['seconds'][1]:8.2f} s", flush=True)
    ends = [one["trace"][-1][2] for done in runs.values() for one in done]
    common, lowest = SAME * max(ends), SAME * min(ends)
    first = next((one for one in runs if one[1] == "Ceres"), ours[0])
    best = min(reached(one, common)[0] for one in runs[first])
    version = runs[first][0].get("version", "")
    lines = [
        f"## {source.name.split('-pre')[0]}",
        f"- left out: {left_out}, behind a camera at the start, where COLMAP's residual is 0",
        f"- Ceres {version}, problem built by COLMAP's bundle adjuster, residuals and automatic derivatives in C++; "
        "quaternions where leadline has rotation vectors, 3 + 7 + 5 numbers a residual of which 1 + 2 are constant"
        if has
        else "- Ceres: not run, the Python given has no pyceres and pycolmap",
        f"- common chi2: {common:.1f}, {SAME} times the highest final chi2, so all runs reach it; lowest: "
        f"{lowest:.1f}, of the lowest one; Ceres stops when a step lowers chi2 by less than 1e-6 of it, leadline when "
        "the undamped update is below 1e-3 of its uncertainty, or after 100 steps",
        "- initial guess of the file, first camera fixed, scale not fixed (damping decides); no robust loss; "
        "Levenberg-Marquardt",
        f"- seconds: best of {rounds} interleaved rounds; other work changes processor time little, wall time much; "
        "leadline includes binding and ordering, Ceres is timed inside `Solve`",
        f"- relative: processor seconds to the common chi2, to {first[1]} {first[0]} with one thread",
        "| | linear solver | threads | steps | chi2 at the start | final chi2 | to the common: processor, s | wall, s "
        "| relative | to the lowest: processor, s | to the end: processor, s | wall, s |",
        f"|:--|:--|{'--:|' * 10}",
    ]
    for (solver, who, threads), done in runs.items():
        there, below = (np.min([reached(one, chi2) for one in done], axis=0) for chi2 in (common, lowest))
        every = np.min([one["seconds"] for one in done], axis=0)
        trace = done[0]["trace"]
        cells = [who, f"`{solver}`", str(threads), str(len(trace) - 1), f"{trace[0][2]:.2f}", f"{trace[-1][2]:.2f}"]
        cells += [f"{there[0]:.2f}", f"{there[1]:.2f}", f"{there[0] / best:.2f}"]
        cells += [f"{below[0]:.2f}" if np.isfinite(below[0]) else "not reached", f"{every[0]:.2f}", f"{every[1]:.2f}"]
        lines.append(line_of(cells))
    return lines


def reached(run: dict[str, Any], target: float) -> tuple[float, float]:
    """Processor and wall seconds to a chi2; infinite where it was not met."""
    return next(((cpu, wall) for cpu, wall, chi2 in run["trace"] if chi2 <= target), (np.inf, np.inf))


# --- a camera and a sonar ---------------------------------------------------------------------------------------------


def solve_rig(name: str, solver: str, path: str) -> dict[str, Any]:
    """One damped solve at the start, and whole optimizations; the estimate is left at the path."""
    poses, points, views = RIGS[name]
    world = sim.rig(np.random.default_rng(1), poses=poses, points=points, views=views)
    way, system = linear_solver(solver), world.graph.linearize(world.start)
    damping = 1e-4 * np.square(system.column_norms)
    before = peak_memory(reset=True)
    analyzed, analysis = timed(way.analyze, system.pattern)
    seconds = [timed(analyzed.solve, system, damping)[1] for _ in range(RUNS)]
    found = {"columns": system.pattern.n, "rows": system.pattern.m, "analysis": analysis}
    found |= {"solve": float(np.median(seconds)), "bytes": peak_memory() - before}
    del analyzed, system
    for method in (nls.GaussNewton(), nls.LevenbergMarquardt()):
        result, spent = timed(world.graph.optimize, world.start, method, linear_solver(solver))
        found[method.name] = {"seconds": spent, "steps": result.iterations, "chi2": result.chi2_final}
        found[method.name] |= {"said": result.linear_solver, "status": result.status.name, "dof": result.dof}
    np.savez(path, **{kind: np.asarray(stack.X)[:, :3] for kind, stack in result.values.stacks.items()})
    return found


def rigs(names: list[str]) -> list[str]:
    """All solvers on all rigs, and their table."""
    lines = [
        "## A camera and a sonar",
        "- `sim.rig`, seed 1: every point seen from 10 poses by both, the pose of the sonar unknown, first pose fixed",
        "- seconds: of the processor, one thread; solve: at the start, damped by 1e-4 of the diagonal, median of "
        f"{RUNS}",
        "- memory: peak of analysis and solves above the memory before them",
        "- difference: largest distance of a camera or point from that of `cholesky`, both by Levenberg-Marquardt",
        "- `pcg`: residual reduced to 1e-10; tol 0.1 is an inexact solver for Levenberg-Marquardt",
    ]
    titles = ["rig", "points", "unknowns", "numbers measured", "linear solver", "analysis, s", "solve, s", "memory, MB"]
    titles += ["Gauss-Newton, s", "steps", "Levenberg-Marquardt, s", "steps", "chi2 / dof", "difference, m"]
    table = Table(titles, "lrrrlrrrrrrrrr")
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            reference: dict[str, Any] = {}
            for solver in SOLVERS:
                path = Path(folder) / "estimate.npz"
                one = child(sys.executable, __file__, "--child", "rig", name, solver, path)
                with np.load(path) as arrays:
                    X = dict(arrays)
                reference = reference or X
                far = max(np.linalg.norm(X[kind] - reference[kind], axis=1).max() for kind in X)
                newton, marquardt = one["gauss-newton"], one["levenberg-marquardt"]
                cells = [name, f"{RIGS[name][1]:,}", f"{one['columns']:,}", f"{one['rows']:,}", f"`{solver}`"]
                cells += [f"{one['analysis']:.2f}", f"{one['solve']:.2f}", f"{one['bytes'] / 1e6:,.0f}"]
                for run in (newton, marquardt):
                    cells += [f"{run['seconds']:.1f}", str(run["steps"])]
                table.add(*cells, f"{marquardt['chi2'] / marquardt['dof']:.5f}", f"{far:.0e}")
    return [*lines, *table]


def page(rounds: int, ceres: str, quick: bool) -> list[str]:
    """Both parts; the first one where its data is."""
    data = Path(os.environ.get("LEADLINE_DATA", "")) / BAL
    lines = against_ceres(data, rounds, ceres) if data.exists() and not quick else []
    return lines + rigs(list(RIGS)[: 1 if quick else None])


if __name__ == "__main__":
    make_page(
        *("Many points: bundle adjustment", page, {"bundle": optimize_bundle, "rig": solve_rig}),
        rounds=(3, "of the bundle adjustment"),
        ceres={"default": sys.executable, "metavar": "PYTHON", "help": "one that has pyceres and pycolmap"},
        quick="the small rig only",
    )
