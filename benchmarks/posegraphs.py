"""Pose graphs from file to optimum: this library against others, every run a fresh process.

    python benchmarks/posegraphs.py [--quick] [--rounds 3] [--sets NAME ...] [--python PEER=PYTHON ...] [--out DIR]

Loads, initializes and optimizes every public pose graph in the folder that LEADLINE_DATA names (without it: simulated
worlds), with every contender of benchmarks/peers that is installed. The chi2 of every solution is evaluated here, in
one convention for all and in the contender's own. Results: posegraphs.md, .json and .png.

The C++ programs of g2o and Ceres are compiled where their headers are, and left out elsewhere:
    Ceres    the package libceres-dev of Debian and Ubuntu, with g++ and libblas-dev
    g2o      the package libg2o of ROS, or g2o's own build, installed; with CHOLMOD (libsuitesparse-dev) and Eigen
Libraries elsewhere than in the system's folders: CPLUS_INCLUDE_PATH, LIBRARY_PATH and LD_LIBRARY_PATH say where.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
import numpy.typing as npt
from peers import CONTENDERS, PROGRAMS, TOLERANCE, Files, programs
from pinv import ONE_THREAD, RESULTS, machine, peak_memory  # the script beside this one

PLANE, SPACE = "pose-graphs-2d/", "pose-graphs-3d/"
SETS = {  # name: file, dialect
    "manhattan": (PLANE + "manhattan.g2o", "auto"),
    "intel": (PLANE + "intel.g2o", "auto"),
    "CSAIL": (PLANE + "CSAIL.g2o", "auto"),
    "kitti_00": (PLANE + "kitti_00.g2o", "auto"),
    "city10000": (PLANE + "city10000.g2o.gz", "auto"),
    "ring": (PLANE + "ring.g2o", "auto"),
    "input_INTEL": (PLANE + "input_INTEL.g2o", "auto"),
    "input_M3500": (PLANE + "input_M3500_g2o.g2o", "auto"),
    "manhattanOlson3500": (PLANE + "manhattanOlson3500.g2o", "auto"),
    "FR079": (PLANE + "FR079_P_toro.graph", "auto"),
    "city10000 truth": (PLANE + "city10000_groundtruth_edges.txt", "isam"),
    "tinyGrid3D": (SPACE + "tinyGrid3D.g2o", "auto"),
    "smallGrid3D": (SPACE + "smallGrid3D.g2o", "auto"),
    "Klaus3": (SPACE + "Klaus3.g2o", "auto"),
    "parking-garage": (SPACE + "parking-garage.g2o.gz", "auto"),
    "sphere2500": (SPACE + "sphere2500.g2o.gz", "auto"),
    "torus3D": (SPACE + "torus3D.g2o.gz", "auto"),
    "sphere400": (SPACE + "sphere400.txt", "isam"),
    "sphere2500 truth": (SPACE + "sphere2500_groundtruth_edges.txt", "isam"),
}
QUICK = ("ring", "smallGrid3D")
STAGED = ("sphere2500", "city10000")  # of these also the stages and all marginals
STAGES = ("load", "start", "optimize")
NEAR, FAR = 2.0, 10.0  # slower than the fastest of its library, or than leadline, by such a factor: runs once only
NEGLIGIBLE = 1e-9  # chi2 per degree of freedom that no measurement can tell from zero
PATIENCE = 60.0  # s; a longer run is ended


@dataclass
class Problem:
    """A set ready for all contenders, and what evaluates their solutions."""

    name: str
    files: Files
    edges: int
    poses: int
    dof: int = 0
    graphs: dict[str, Any] = field(default_factory=dict)  # by convention
    values: Any = None

    def chi2(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64], convention: str) -> float:
        return float(self.graphs[convention].chi2(self.placed(ids, X)))

    def placed(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64]) -> Any:
        return self.values.replaced({"x": X[np.searchsorted(ids, self.values.stack("x").numbers)]})

    def optimum(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64], convention: str) -> float:
        """Where a solution leads in a convention, to the last digits."""
        import nls

        to_the_end = nls.GaussNewton(nls.Stop(chi2_rtol=1e-13, update_tol=1e-10))
        return float(self.graphs[convention].optimize(self.placed(ids, X), to_the_end).chi2_final)


# --- the sets ---------------------------------------------------------------------------------------------------------


def prepare(name: str, folder: Path, data: str | None) -> Problem:
    """Write a set as one plain g2o file, and its arrays."""
    import nls
    import sim
    from nls.io.files import read_bytes

    worlds = {
        "ring": lambda rng: sim.ring(rng, laps=4, per_lap=50),
        "smallGrid3D": lambda rng: sim.grid3d(rng, n_poses=125),
        "sphere2500": lambda rng: sim.sphere(rng, rings=50, per_ring=50),
        "city10000": lambda rng: sim.manhattan(rng, n_poses=10_000),
    }
    path = folder / f"{name.replace(' ', '-')}.g2o"
    if data is None:
        world = worlds[name](np.random.default_rng(1))
        nls.save(path, world.graph, world.start)
    else:
        source, dialect = Path(data) / SETS[name][0], SETS[name][1]
        graph, values, report = nls.load(source, dialect=dialect)
        if report.format == "g2o":
            path.write_bytes(read_bytes(source))  # unpacked
        else:
            nls.save(path, graph, values)
    graphs = {convention: nls.load(path, convention)[0] for convention in ("g2o", "gtsam")}
    graph, values, _ = nls.load(path)
    complete = path
    if b"VERTEX" not in path.read_bytes():
        nls.save(complete := folder / f"{path.stem}-complete.g2o", graph, values)
    stack, edges = values.stack("x"), graph.factors
    d = stack.manifold.dim
    np.savez(
        folder / f"{path.stem}.npz",
        ids=stack.numbers,
        X=stack.X,
        i=np.concatenate([f.keys[0].numbers for f in edges]),
        j=np.concatenate([f.keys[1].numbers for f in edges]),
        z=np.concatenate([f.z for f in edges]),
        information=np.concatenate([np.broadcast_to(f.noise.matrix, (len(f), d, d)) for f in edges]),
    )
    files = Files(path, complete, folder / f"{path.stem}.npz", d == 6)
    return Problem(name, files, len(graph), len(stack), d * (len(graph) - len(stack) + 1), graphs, values)


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
    record = {"cpu": cpu, "wall": wall, "iterations": run.iterations, "peak": peak, "said": run.said}
    out.with_suffix(".json").write_text(json.dumps(record))  # libraries print what they like


def launch(runner: str, contender: str, variant: str, files: Files, out: Path, marginals: bool) -> dict[str, Any]:
    """Run a child or a program; what went wrong is in its `failed`."""
    command = [runner, __file__, "--child", contender, variant, *map(str, (files.graph, files.complete, files.arrays))]
    command += [str(int(files.space)), str(out), str(int(marginals))]
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
    runs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for name, module in modules.items():
        if module.MAX_EDGES is None or problem.edges <= module.MAX_EDGES:
            runs[name] = {variant: [] for variant in module.VARIANTS}
    found: dict[str, Any] = {"edges": problem.edges, "poses": problem.poses, "dof": problem.dof}
    found |= {"dimension": 3 if problem.files.space else 2, "optimum": {}, "runs": {}}
    for k in range(rounds):
        first = {
            n: {v: total(r[0], modules[n].READS) for v, r in variants.items() if r} for n, variants in runs.items()
        }
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
                with np.load(out) as poses:
                    ids, X = poses["ids"], poses["X"]
                if not np.isfinite(X).all():
                    done[0] = {"failed": "ends at poses that are not finite"}
                    continue
                done[0]["chi2"] = {c: problem.chi2(ids, X, c) for c in problem.graphs}
                if name == "leadline":
                    found["optimum"] = {c: problem.optimum(ids, X, c) for c in problem.graphs}
    for name, variants in runs.items():
        found["runs"][name] = {variant: summary(done, modules[name].READS) for variant, done in variants.items()}
    judge(found, modules, problem.dof)
    if staged:
        found["marginals"] = marginals(problem, runners, found["fastest"], rounds, folder)
    return found


def total(run: dict[str, Any], reads: bool) -> float:
    """Processor time of a run, ms: without the loading, where that was done by a Python loop."""
    return np.inf if "failed" in run else sum(run["cpu"][stage] for stage in STAGES if reads or stage != "load")


def summary(done: list[dict[str, Any]], reads: bool) -> dict[str, Any]:
    """Medians over the rounds of one variant."""
    if "failed" in done[0]:
        return {"failed": done[0]["failed"]}
    good = [run for run in done if "failed" not in run]
    out = {k: done[0][k] for k in ("iterations", "chi2", "said")} | {"rounds": len(good)}
    for clock in ("cpu", "wall"):
        out[clock] = {stage: float(np.median([run[clock][stage] for run in good])) for stage in STAGES}
    out["total"] = float(np.median([total(run, reads) for run in good]))
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
            ours = found["runs"]["leadline"]["auto"]["cpu"]
            mine = sum(ours[stage] for stage in STAGES if modules[name].READS or stage != "load")
            found["ratio"][name] = mine / best[fastest]
            if found["optimum"][cost] > 1.01 * lowest + slack:
                found["theirs_is_lower"].append(name)


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
        elif name == "g2o":
            notes.append("g2o: not run; its wheel needs NumPy 1, see benchmarks/requirements-g2o.txt and --python g2o=")
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


def count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, got {text!r}")
    return int(text)


def main() -> int:
    if sys.argv[1:2] == ["--child"]:
        contender, variant, graph, complete, arrays, space, out, wanted = sys.argv[2:]
        files = Files(Path(graph), Path(complete), Path(arrays), space == "1")
        child(contender, variant, files, Path(out), wanted == "1")
        return 0
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    data = os.environ.get("LEADLINE_DATA")
    choices = tuple(SETS) if data else (*QUICK, *STAGED)
    parser.add_argument("--quick", action="store_true", help=f"two small sets, {' and '.join(QUICK)}")
    parser.add_argument("--rounds", type=count, default=3, help="runs of each contender; medians are shown")
    parser.add_argument("--sets", nargs="+", choices=choices, metavar="NAME", help=", ".join(choices))
    parser.add_argument("--python", nargs="+", type=interpreter, default=[], metavar="PEER=PYTHON", help="where it is")
    parser.add_argument(
        "--out", type=Path, default=RESULTS, metavar="DIR", help="folder for posegraphs.md, .json, .png"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    import posegraphs_report as report

    names = options.sets or (QUICK if options.quick else choices)
    results: dict[str, Any] = {"machine": machine(), "rounds": options.rounds, "notes": [], "sets": {}}
    results["simulated"] = data is None
    with tempfile.TemporaryDirectory() as compiled:
        runners, results["notes"] = installed(dict(options.python), Path(compiled))
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
