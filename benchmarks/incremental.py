"""A map while the vehicle drives: `nls.Incremental` beside iSAM2, a pose at a time, every run a fresh process.

    LEADLINE_DATA=DIR python benchmarks/incremental.py [--sets NAME ...] [--rounds 3] [--gtsam PYTHON] [--out DIR]

Both give the newest pose at every step and all poses at every tenth. At every fiftieth chi2 is compared with the
minimum of what was measured up to then: the lowest of the batch solutions from a chordal start and from the poses of
every smoother of one convention. Where GTSAM is missing, and on logs with landmarks, our side runs alone; these have no
chordal start. w10000 is in GTSAM's wheel.

"fixed lag" is a long drive of which the newest poses are kept, beside GTSAM's `IncrementalFixedLagSmoother`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import numpy.typing as npt
from harness import GTSAM, Table, fresh, make_page, peak_memory
from posegraphs import SETS, prepare

import nls
import sim
from factors import Cauchy
from models import SE2
from nls.incremental.steps import steps

sys.path.append(str(Path(__file__).parent / "evidence"))
Array = npt.NDArray[np.float64]
NAMES = ("intel", "manhattan", "input_M3500", "city10000", "sphere2500")
WHEEL = "w10000"
LARGE = ("city10000", WHEEL)  # one round
SETTINGS = ((0.1, 10), (0.1, 1), (0.01, 10), (0.01, 1))  # relinearization threshold and skip of iSAM2
LOGS = ("plaza2", "Victoria Park", "MRCLAM 3", "hauv-floor", "hauv-floor 8 legs", "hauv-hull")
TOL, CHECK, WHOLE = 1e-3, 50, 10
DRIVE, LAG, POSES, EARLY = "fixed lag", 50, 20_000, 1000  # poses that are kept, in all, and up to the first memory
WINDOWS = ((0.1, 10, 1), (0.001, 1, 3))  # threshold and skip of GTSAM's smoother, and its updates a step
PATIENCE = 900.0  # s; a longer run is ended


def problem_of(name: str) -> tuple[Any, Any, str]:
    """Graph, values and the kind of the poses, of a log or a file."""
    data = Path(os.environ["LEADLINE_DATA"])
    if name == "plaza2":
        return *nls.load(data / "range-only" / "plaza2.pyfg.gz")[:2], "A"
    if name == "Victoria Park":
        return *nls.load(data / "victoria-park" / "victoria_park.txt", dialect="isam-covariance")[:2], "x"
    if name == "MRCLAM 3":
        from logs import read_mrclam
        from mrclam import mrclam

        world = mrclam(read_mrclam(data / "mrclam6", 3), name)
        sightings = world.sightings.robust(Cauchy(2.0))  # some name a wrong landmark
        return nls.FactorGraph([world.first, world.odometry, sightings]), world.start, "x"
    if name in LOGS:
        rng = np.random.default_rng(0)
        vehicle = sim.hauv_hull(rng) if name == "hauv-hull" else sim.hauv_floor(rng, legs=8 if "8" in name else 4)
        return vehicle.graph, vehicle.start, "x"
    return *nls.load(name)[:2], "x"


def drive(name: str, out: str) -> None:
    """Our side, in a process of its own."""
    graph, values, kind = problem_of(name)
    graph.pattern(values)  # bound, as GTSAM's factors are when they are read
    arriving = list(steps(graph.factors, kind=kind))
    smoother = nls.Incremental(TOL)
    first = nls.Keys(kind, values.stack(kind).numbers.min())
    smoother.update([], values.spaces().extended(first, values[first][None]))
    seconds, gaps, offs, kept = [], [], [], {}
    for n, step in enumerate(arriving):
        began = process_time()
        smoother.update(step.factors)
        smoother[step.pose]
        if n % WHOLE == 0:
            smoother.values  # noqa: B018
        seconds.append(process_time() - began)
        if n and (n % CHECK == 0 or n == len(arriving) - 1):
            poses = smoother.values.stack(kind)
            kept[f"X{step.pose.numbers[0]}"] = poses.X[np.argsort(poses.numbers)]
            gaps.append(smoother.gap)
            if name in LOGS:
                best = smoother.graph.optimize(smoother.values).chi2_final
                offs.append(((smoother.chi2 - best) / max(best, 1.0), smoother.chi2 - best))
    np.savez(out, seconds=seconds, gaps=gaps, offs=offs, **kept)


def drive_far(out: str) -> None:
    """Our side with a lag, in a process of its own."""
    world, smoother, seconds, memory = far(), nls.Incremental(TOL, lag=LAG), [], []
    graph = nls.FactorGraph(world.factors)
    graph.pattern(world.truth)  # bound
    first, last = nls.Keys("x", 0), nls.Keys("x", POSES - 1)
    smoother.update([], world.truth.spaces().extended(first, world.truth[first][None]))
    for n, step in enumerate(steps(graph.factors)):
        began = process_time()
        smoother.update(step.factors)
        smoother[step.pose]
        seconds.append(process_time() - began)
        if n in (EARLY, POSES - 1):
            memory.append(peak_memory(reset=True))
    np.savez(out, seconds=seconds, memory=memory, X=smoother[last], P=smoother.covariance(last, frame="body"))


def far() -> Any:
    """A long drive in circles: steps, scan matches and position fixes."""
    from window import matched

    return matched(0, POSES - 1, (5, 20))


def above(graph: Any, values: Any, kept: list[dict[int, Array]]) -> list[Array]:
    """chi2 above its minimum (k, 2) at some steps of several smoothers, of what was measured up to then.

    The part of the minimum, and the number.
    """
    stack = values.stack("x")
    numbers = np.sort(stack.numbers)
    (x,) = nls.kinds("x")
    out = []
    for number in sorted(kept[0]):
        masks = [np.max([keys.numbers for keys in factor.keys], axis=0) <= number for factor in graph.factors]
        prefix = graph.only(masks)
        here = [nls.Values({x: (stack.manifold, poses[number], numbers[numbers <= number])}) for poses in kept]
        starts = (*here, nls.starts.chordal(prefix, here[0]))
        best = min(prefix.optimize(start).chi2_final for start in starts)
        off = np.array([prefix.chi2(poses) - best for poses in here])
        out.append(np.stack([off / max(best, 1.0), off], axis=1))
    return list(np.stack(out, axis=1))


def run(command: list[str], out: Path) -> dict[str, Any] | None:
    """What a child left; None where it failed or took too long."""
    try:
        fresh(*command, timeout=PATIENCE).check_returncode()
    except subprocess.TimeoutExpired:
        return None
    except subprocess.CalledProcessError as error:
        print(error.stderr[-500:], file=sys.stderr)
        return None
    with np.load(out) as file:
        return dict(file)


def row(name: str, title: str, runs: list[dict[str, Any]], off: Array, ratio: str) -> list[str]:
    """Cells of the table: medians over the rounds."""
    total = np.median([float(f["seconds"].sum()) for f in runs])
    ms = 1e3 * np.median([f["seconds"] for f in runs], axis=0)
    cells = [name, title, f"{total:.2f}", ratio, f"{ms.mean():.2f}", f"{ms[-len(ms) // 10 :].mean():.2f}"]
    cells += [f"{np.quantile(ms, 0.99):.1f}", f"{ms.max():.0f}"]
    cells += [f"{100 * off[:, 0].max():.2g} %", f"{100 * off[-1, 0]:.2g} %"]
    gaps = runs[-1].get("gaps")
    return [*cells, "" if gaps is None else f"{int((off[:, 1] > gaps + 1e-9).sum())} of {len(gaps)}"]


def measured(name: str, rounds: int, gtsam: str | None, folder: Path) -> list[list[str]]:
    """The rows of a set: ours, and iSAM2 with each setting."""
    if name in LOGS:
        command = [sys.executable, __file__, "--child", "set", name, str(folder / "run.npz")]
        results = [r for _ in range(rounds) if (r := run(command, folder / "run.npz")) is not None]
        return [row(name, "leadline", results, results[-1]["offs"], "")] if results else []
    if name == WHEEL:
        if not gtsam:
            return []
        ask = [gtsam, "-c", f"import gtsam; print(gtsam.findExampleDataFile({WHEEL!r}))"]
        SETS[WHEEL] = subprocess.run(ask, check=True, capture_output=True, text=True).stdout.strip(), "toro"
    problem = prepare(name, folder, os.environ["LEADLINE_DATA"])
    path, out = problem.files.graph, folder / "run.npz"
    commands = {"leadline": [sys.executable, __file__, "--child", "set", str(path), str(out)]}
    for threshold, skip in SETTINGS if gtsam else ():
        script = Path(__file__).parent / "peers" / "isam2.py"
        numbers = [str(value) for value in (threshold, skip, CHECK, WHOLE)]
        commands[f"iSAM2 {threshold:g}, {skip}"] = [gtsam, "-P", str(script), str(path), str(out), *numbers]
    runs: dict[str, list[dict[str, Any]]] = {}
    for _ in range(1 if name in LARGE else rounds):
        for title, command in commands.items():
            if (result := run(command, out)) is not None:
                runs.setdefault(title, []).append(result)
    total = {title: float(np.median([r["seconds"].sum() for r in results])) for title, results in runs.items()}
    fastest = min((total[title] for title in total if title != "leadline"), default=float("nan"))
    off: dict[str, Array] = {}
    for convention in ("g2o", "gtsam"):
        titles = [title for title in runs if (title == "leadline") == (convention == "g2o")]
        kept = [{int(key[1:]): X for key, X in runs[t][-1].items() if key.startswith("X")} for t in titles]
        if kept:
            off |= zip(titles, above(problem.graphs[convention], problem.values, kept), strict=True)
    rows = []
    for title, results in runs.items():
        ratio = f"{total[title] / fastest:.2f}" if title == "leadline" and fastest == fastest else ""
        rows.append(row(name, title, results, off[title], ratio))
    return rows


def with_a_lag(gtsam: str | None, folder: Path) -> list[str]:
    """A long drive: ours, and GTSAM's smoother with each setting."""
    from window import fixed_lag

    titles = ["smoother", "s", "mean, ms", "first tenth", "middle", "last tenth", "p99", "largest"]
    table = Table([*titles, f"MB after {EARLY:,}", "MB in the end", "last pose off"])
    ours = run([sys.executable, __file__, "--child", DRIVE, str(folder / "run.npz")], folder / "run.npz")
    if ours is None:
        return []
    runs = {"leadline": ours}
    for threshold, skip, updates in WINDOWS if gtsam else ():  # a lag in seconds keeps one pose more
        theirs = fixed_lag(gtsam, [far()], LAG - 1, threshold, skip, updates)
        runs[f"GTSAM {threshold:g}, {skip}; updates: {updates}"] = {name: rows[0] for name, rows in theirs.items()}
    for title, one in runs.items():
        ms, off = 1e3 * one["seconds"], SE2.local(ours["X"], one["X"])
        first, middle, last = np.array_split(ms, 10)[0], np.array_split(ms, 5)[2], np.array_split(ms, 10)[9]
        means = (part.mean() for part in (ms, first, middle, last))
        cells = [title, f"{ms.sum() / 1e3:.1f}", *(f"{mean:.2f}" for mean in means)]
        cells += [f"{np.quantile(ms, 0.99):.2f}", f"{ms.max():.1f}", *(f"{size / 2**20:.1f}" for size in one["memory"])]
        table.add(*cells, "" if one is ours else f"{np.sqrt(off @ np.linalg.solve(ours['P'], off)):.3f}")
    return [
        "## Fixed lag",
        f"A drive of {POSES:,} poses in the plane; {LAG} are kept. The measurements are made by "
        "code, seed 0: a step, scan matches 5 and 20 poses back, and a position fix at every tenth pose.",
        *table,
        "- first tenth, middle, last tenth: mean ms of a step",
        f"- MB: memory of the process that is resident after {EARLY:,} poses and in the end. Ours keeps the "
        "last estimate of every pose that left",
        "- last pose off: from ours, in sigmas",
        "- GTSAM: `IncrementalFixedLagSmoother` of its wheel with its relinearization threshold and skip, and the "
        "updates of a step",
    ]


def with_all(sets: list[str], rounds: int, gtsam: str | None, folder: Path) -> list[str]:
    """Sets of which both keep all poses."""
    titles = ["set", "smoother", "s", "ours / fastest", "mean, ms", "last tenth", "p99", "largest", "above at most"]
    table = Table([*titles, "above in the end", "beyond its gap"], names=2)
    for name in sets:
        for cells in measured(name, rounds, gtsam, folder):
            table.add(*cells)
    return [
        *table,
        f"- Figures are medians of {rounds} rounds ({' and '.join(LARGE)}: 1 round). Every run is a fresh "
        "process; the smoothers take turns",
        "- ms: processor time of a step, one thread; last tenth: mean of the last tenth of the steps",
        "- iSAM2: GTSAM's wheel with its relinearization threshold and skip, by Cholesky, or QR where Cholesky fails",
        f"- above: how far chi2 is above the batch minimum, at every {CHECK}th step",
        "- beyond its gap: how often chi2 exceeds the smoother's own estimate of its distance from the minimum",
    ]


def page(data: Path, sets: list[str], rounds: int, gtsam: str | None) -> list[str]:
    """The page without its head."""
    others = [name for name in sets if name != DRIVE]
    with tempfile.TemporaryDirectory() as folder:
        lines = with_all(others, rounds, gtsam, Path(folder)) if others else []
        return lines + (with_a_lag(gtsam, Path(folder)) if DRIVE in sets else [])


if __name__ == "__main__":
    default = [*NAMES, WHEEL, *LOGS, DRIVE]
    names = {"nargs": "+", "choices": [*SETS, WHEEL, *LOGS, DRIVE], "default": default, "metavar": "NAME"}
    make_page(
        *("Online SLAM beside iSAM2", page, {"set": drive, DRIVE: drive_far}),
        sets=names | {"help": "of public graphs and logs"},
        rounds=(3, "runs of each, interleaved"),
        gtsam=GTSAM,
    )
