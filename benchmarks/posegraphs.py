"""Pose graphs from file to optimum: this library against others, every run a fresh process.

    python benchmarks/posegraphs.py [--quick] [--rounds 3] [--sets NAME ...] [--python PEER=PYTHON ...]
                                    [--note TEXT] [--out DIR]
    python benchmarks/posegraphs.py --gate [--sets NAME ...] [--seconds 2] [--update] [--baselines FILE]

Loads, initializes and optimizes every public pose graph in the folder that LEADLINE_DATA names (without it: simulated
worlds), with every contender of benchmarks/peers that is installed. The chi2 of every solution is evaluated here, in
one convention for all and in the contender's own; one that computes another cost has no time. Results: posegraphs.md,
.json and .png. With --gate it times this library alone, see benchmarks/gate.py: has it become slower on a set?

The C++ programs of g2o and Ceres are compiled where their headers are, and left out elsewhere:
    Ceres    the package libceres-dev of Debian and Ubuntu, with g++ and libblas-dev
    g2o      the package libg2o of ROS, or g2o's own build, installed; with CHOLMOD (libsuitesparse-dev) and Eigen
Libraries elsewhere than in the system's folders: CPLUS_INCLUDE_PATH, LIBRARY_PATH and LD_LIBRARY_PATH say where.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
from gate import Clock, add_options, gate, refuse, stopwatch  # the scripts beside this one
from harness import ONE_THREAD, arguments, at_least_one, machine, peak_memory
from peers import CONTENDERS, PROGRAMS, TOLERANCE, Files, programs
from posegraphs_sets import QUICK, SETS, STAGED, Problem, prepare

BASELINES = Path(__file__).parent / "baselines_posegraphs.json"
STAGES = ("load", "start", "optimize")
NEAR, FAR = 2.0, 10.0  # slower than the fastest of its library, or than leadline, by such a factor: runs once only
SAME = 1e-5  # relative difference of a cost from the one evaluated here; six digits of a quaternion change it by 1e-6
NEGLIGIBLE = 1e-9  # chi2 per degree of freedom that no measurement can tell from zero
PATIENCE = 60.0  # s; a longer run is ended


# --- one run, in a process of its own ---------------------------------------------------------------------------------


def child(contender: str, variant: str, files: Files, out: Path, marginals: bool) -> None:
    """Load, start, optimize; leave the poses in a file, and the clocks in another."""
    run = import_module(f"peers.{contender}").Run(files, variant)
    cpu, wall = {}, {}

    def timed(stage: str) -> None:
        began, before = perf_counter(), process_time()
        getattr(run, stage)()
        cpu[stage], wall[stage] = 1e3 * (process_time() - before), 1e3 * (perf_counter() - began)

    for stage in STAGES:
        timed(stage)
    peak = peak_memory() / 1e6
    ids, X = run.poses()
    order = np.argsort(ids)
    np.savez(out, ids=np.asarray(ids)[order], X=np.asarray(X)[order])
    if marginals:
        timed("marginals")
    facts = {"iterations": run.iterations, "cost": run.cost(), "peak": peak, "said": run.said}
    record = {"cpu": cpu, "wall": wall, **facts}
    out.with_suffix(".json").write_text(json.dumps(record))  # libraries print what they like


def launch(runner: str, contender: str, variant: str, files: Files, out: Path, marginals: bool) -> dict[str, Any]:
    """Run a child or a program; what went wrong is in its `failed`."""
    command = [runner, __file__, "--child", contender, variant, *map(str, (files.graph, files.complete))]
    command += [str(int(files.space)), str(files.most), str(out), str(int(marginals))]
    if contender in PROGRAMS:
        command = programs.command(runner, variant, files, out)
    env = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | ONE_THREAD
    try:
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return {"failed": f"ended after {PATIENCE:g} s"}
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        lines = [line for line in lines if re.match(r"[\w.]*(Error|Exception)\b", line)] or lines
        return {"failed": lines[-1][:160] if lines else f"ended by signal {-done.returncode}"}
    return programs.collect(out) if contender in PROGRAMS else dict(json.loads(out.with_suffix(".json").read_text()))


# --- one set ----------------------------------------------------------------------------------------------------------


def compare(problem: Problem, runners: dict[str, str], rounds: int, staged: bool, folder: Path) -> dict[str, Any]:
    """Interleaved rounds of every contender and variant on one set; medians, chi2, and who is fastest."""
    modules = {name: import_module(f"peers.{name}") for name in runners}
    runs: dict[str, dict[str, list[dict[str, Any]]]] = {
        name: {variant: [] for variant in module.VARIANTS} for name, module in modules.items()
    }
    found: dict[str, Any] = {"edges": problem.edges, "poses": problem.poses, "dof": problem.dof}
    found |= {"dimension": 3 if problem.files.space else 2, "optimum": {}, "runs": {}}
    for k in range(rounds):
        first = {n: {v: total(r[0]) for v, r in variants.items() if r} for n, variants in runs.items()}
        for name, variants in runs.items():
            limit = NEAR * min(first[name].values(), default=np.inf)
            if k > 0 and name != "leadline":
                limit = min(limit, FAR * first["leadline"]["auto"])
            for variant, done in variants.items():
                if k > 0 and not first[name][variant] <= limit:
                    continue
                out = folder / f"{name}-{variant}.npz"
                done.append(launch(runners[name], name, variant, problem.files, out, False))
                if name == "leadline" and "failed" in done[-1]:
                    raise SystemExit(f"leadline failed on {problem.name}: {done[-1]['failed']}")
                if k > 0 or "failed" in done[0]:
                    continue
                done[0] = evaluated(problem, done[0], out, modules[name].COST)
                if name == "leadline":
                    found["optimum"] = {c: problem.optimum(*solution(out), c) for c in problem.graphs}
    for name, variants in runs.items():
        found["runs"][name] = {variant: summary(done) for variant, done in variants.items()}
    judge(found, modules, problem.dof)
    found["matched"] = matched(problem, runners, found["fastest"], runs["leadline"]["auto"][0]["iterations"], folder)
    if staged:
        found["marginals"] = marginals(problem, runners, found["fastest"], rounds, folder)
    return found


def solution(out: Path) -> tuple[Any, Any]:
    """Ids and poses that a run has left."""
    with np.load(out) as poses:
        return poses["ids"], poses["X"]


def evaluated(problem: Problem, run: dict[str, Any], out: Path, convention: str) -> dict[str, Any]:
    """A run with the chi2 of its solution, or why it cannot be compared."""
    ids, X = solution(out)
    if not np.isfinite(X).all():
        return {"failed": "ends at poses that are not finite"}
    chi2 = {c: problem.chi2(ids, X, c) for c in problem.graphs}
    if not math.isclose(run["cost"], chi2[convention], rel_tol=SAME, abs_tol=NEGLIGIBLE * max(problem.dof, 1)):
        return {"failed": f"its cost is {run['cost']:.9g} where {convention}'s is {chi2[convention]:.9g}"}
    return run | {"chi2": chi2}


def matched(
    problem: Problem, runners: dict[str, str], fastest: dict[str, str], most: int, folder: Path
) -> dict[str, dict[str, float]]:
    """The chi2 of peers after as many iterations as leadline takes, each by its fastest variant."""
    out, found = folder / "matched.npz", {}
    for name, variant in fastest.items():
        files = replace(problem.files, most=most)
        if name != "leadline" and "failed" not in launch(runners[name], name, variant, files, out, False):
            found[name] = {c: problem.chi2(*solution(out), c) for c in problem.graphs}
    return found


def total(run: dict[str, Any]) -> float:
    """Processor time of a run, ms."""
    return np.inf if "failed" in run else sum(run["cpu"][stage] for stage in STAGES)


def summary(done: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the rounds of one variant."""
    if "failed" in done[0]:
        return {"failed": done[0]["failed"]}
    good = [run for run in done if "failed" not in run]
    out = {k: done[0][k] for k in ("iterations", "cost", "chi2", "said")} | {"rounds": len(good)}
    for clock in ("cpu", "wall"):
        out[clock] = {stage: float(np.median([run[clock][stage] for run in good])) for stage in STAGES}
    out["total"] = float(np.median([total(run) for run in good]))
    out["peak"] = float(np.median([run["peak"] for run in good]))
    if "timings" in done[0]["said"]:
        parts = done[0]["said"]["timings"]
        out["timings"] = {p: 1e3 * float(np.median([run["said"]["timings"][p] for run in good])) for p in parts}
    return out


def judge(found: dict[str, Any], modules: dict[str, Any], dof: int) -> None:
    """Which variants reached the optimum of their own cost, the fastest of those, and the ratios to them."""
    found["fastest"], found["ratio"], found["theirs_is_lower"] = {}, {}, []
    slack = NEGLIGIBLE * max(dof, 1)
    for name, variants in found["runs"].items():
        cost = modules[name].COST
        ran = {variant: run for variant, run in variants.items() if "failed" not in run}
        lowest = min((run["chi2"][cost] for run in ran.values()), default=np.inf)
        if name == "leadline":
            lowest = min(lowest, found["optimum"][cost])
        for run in ran.values():
            own = run["chi2"][cost]
            if not own <= (1 + TOLERANCE) * lowest + slack:
                run["outcome"] = "another optimum" if own > 1.01 * lowest + slack else "not converged"
            elif lowest > 1.01 * found["optimum"][cost] + slack:
                run["outcome"] = "another optimum"
            else:
                run["outcome"] = "optimum"
        # the fastest that reached the lowest value of its kind, be that the optimum or another one
        best = {v: run["total"] for v, run in ran.items() if run["chi2"][cost] <= (1 + TOLERANCE) * lowest + slack}
        if not best:
            continue
        fastest = found["fastest"][name] = min(best, key=lambda v: best[v])
        if name != "leadline":
            found["ratio"][name] = found["runs"]["leadline"]["auto"]["total"] / best[fastest]
            if found["optimum"][cost] > 1.01 * lowest + slack:
                found["theirs_is_lower"].append(name)


def clocks(problem: Problem) -> tuple[Clock, Clock]:
    """From file to optimum by this library; the same words, and one iteration by CHOLMOD and SciPy alone."""
    from guard import Piece, Reference, words

    import nls
    from nls.sparse.threads import single_thread

    def solve() -> Any:
        graph, values, _ = nls.load(problem.files.graph)
        return graph.optimize(nls.initialize(graph, values)[0]).values

    reference = Reference(Piece(SimpleNamespace(graph=problem.graphs["g2o"], truth=solve())))
    yardstick = single_thread()(lambda: (words(problem.files.graph), reference.iteration()))
    return stopwatch(solve), stopwatch(yardstick)


def marginals(
    problem: Problem, runners: dict[str, str], fastest: dict[str, str], rounds: int, folder: Path
) -> dict[str, float]:
    """Processor time of the covariances of all poses, ms, of those that compute them."""
    clocks: dict[str, list[float]] = {name: [] for name in ("leadline", "gtsam") if name in fastest}
    for _ in range(rounds):
        for name, clock in clocks.items():
            run = launch(runners[name], name, fastest[name], problem.files, folder / "marginals.npz", True)
            clock += [run["cpu"]["marginals"]] if "failed" not in run else []
    return {name: float(np.median(clock)) for name, clock in clocks.items() if clock}


# --- command line -----------------------------------------------------------------------------------------------------


def installed(pythons: dict[str, str], folder: Path) -> tuple[dict[str, str], list[str]]:
    """The interpreter or program of every contender that can run, and sentences about the others."""
    can, notes = {}, []
    for name in CONTENDERS:
        module = import_module(f"peers.{name}")
        if name in pythons:
            can[name] = pythons[name]
        elif name in PROGRAMS:
            try:
                source = Path(module.__file__ or "").with_name(module.SOURCE)
                can[name] = str(programs.compiled(source, module.LIBRARIES, folder))
            except programs.NotCompiledError as error:
                notes.append(f"{name}: not run; {error}; the head of benchmarks/posegraphs.py says what it needs")
        elif importlib.util.find_spec(module.PACKAGE) is None:
            notes.append(f"{name}: not installed; pip install -r benchmarks/requirements.txt")
        else:
            can[name] = sys.executable
    return can, notes


def interpreter(text: str) -> tuple[str, str]:
    name, _, path = text.partition("=")
    peers = [peer for peer in CONTENDERS if peer not in PROGRAMS]
    if name not in peers or not os.access(path, os.X_OK):
        raise argparse.ArgumentTypeError(f"expected PEER=PYTHON with PEER of {', '.join(peers)}, got {text!r}")
    return name, path


def main() -> int:
    if sys.argv[1:2] == ["--child"]:
        contender, variant, graph, complete, space, most, out, wanted = sys.argv[2:]
        files = Files(Path(graph), Path(complete), space == "1", int(most))
        child(contender, variant, files, Path(out), wanted == "1")
        return 0
    parser = arguments(__doc__, "posegraphs.md, .json and .png")
    data = os.environ.get("LEADLINE_DATA")
    choices = tuple(SETS) if data else (*QUICK, *STAGED)
    parser.add_argument("--quick", action="store_true", help=f"two small sets, {' and '.join(QUICK)}")
    parser.add_argument("--rounds", type=at_least_one, default=3, help="runs of each contender; medians are shown")
    parser.add_argument("--sets", nargs="+", choices=choices, metavar="NAME", help=", ".join(choices))
    parser.add_argument("--python", nargs="+", type=interpreter, default=[], metavar="PEER=PYTHON", help="where it is")
    parser.add_argument("--note", action="append", default=[], metavar="TEXT", help="for the page: how g2o was built")
    parser.add_argument("--gate", action="store_true", help="compare this library's speed with the baselines")
    add_options(parser, BASELINES)
    options = parser.parse_args()
    names = options.sets or (QUICK if options.quick else choices)
    if options.gate or options.update:
        refuse(parser, options, bool(options.sets or options.quick))
        if not data:
            parser.error("the baselines are of the public sets: LEADLINE_DATA has to name their folder")
        with tempfile.TemporaryDirectory() as folder:
            return gate("posegraphs", {n: clocks(prepare(n, Path(folder), data)) for n in names}, options)
    options.out.mkdir(parents=True, exist_ok=True)
    import posegraphs_report as report

    results: dict[str, Any] = {"machine": machine(), "rounds": options.rounds, "notes": [], "sets": {}}
    results["simulated"] = data is None
    with tempfile.TemporaryDirectory() as compiled:
        runners, missing = installed(dict(options.python), Path(compiled))
        results["notes"] = options.note + missing
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                problem = prepare(name, Path(folder), data)
                staged = name in STAGED or options.quick
                found = results["sets"][name] = compare(problem, runners, options.rounds, staged, Path(folder))
            print(f"  {report.line(name, found)}", flush=True)
    report.write(results, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
