"""Where time and memory go as graphs grow: every stage from file to optimum, at 1,000 to 1,000,000 edges.

    python benchmarks/scaling.py [--quick] [--largest EDGES] [--only WORLD ...] [--out DIR]
                                 [--seconds 120] [--gigabytes 12]

Simulated worlds in the plane and in space are written as .g2o files and solved, each in a fresh process with one BLAS
thread. A world stops where its next size is predicted to pass a limit, and says so.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import wraps
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any

import numpy as np
from harness import Table, exponent, fresh, last_words, line_of, machine, make_page, peak_memory, positive

LARGEST, QUICK = 1_000_000, 10_000
WORLDS = {
    "manhattan": "plane: a city (`sim.manhattan`)",
    "sphere": "space: a sphere (`sim.sphere`)",
    "grid3d": "space: a filled cube (`sim.grid3d`)",
}
STAGES = ("read", "init", "build", "analyze", "linearize", "assemble", "factorize", "solve", "retract", "other")
TOO_LONG = 3  # exit status of a measurement that was ended
ENOUGH = 2.0  # times the limit: a size that takes longer than predicted is ended there
SHORT = 0.01  # s; the law of a stage that takes less is not told
UPPER = 3  # sizes to which exponents are fitted


@dataclass
class Series:
    """Measurements of one world, size by size, and why there are no more."""

    world: str
    runs: list[dict[str, Any]] = field(default_factory=list)
    stopped: str = ""  # empty when every size was solved

    def of(self, what: str, stage: str) -> list[float]:
        """Seconds, wall or bytes of a stage, by size."""
        return [run[what][stage] for run in self.runs]

    @property
    def edges(self) -> list[int]:
        return [run["edges"] for run in self.runs]


# --- one measurement, in processes of its own -------------------------------------------------------------------------


def write(world: str, edges: str, file: str) -> None:
    """Simulate a world of about so many edges and write its graph with the odometry as the start."""
    import nls
    import sim

    edges = int(edges)
    side = max(4, round(math.sqrt(edges / 2)))
    sizes: dict[str, dict[str, Any]] = {
        "manhattan": {"n_poses": round(edges / 1.6)},
        "sphere": {"rings": side, "per_ring": side, "radius": float(side)},  # poses as dense at every size
        "grid3d": {"n_poses": round(edges / 2)},
    }
    made = getattr(sim, world)(np.random.default_rng(1), **sizes[world])
    nls.save(file, made.graph, made.start)


class Meter:
    """Processor time, wall time and peak memory by stage. A stage within another is counted for itself alone."""

    def __init__(self) -> None:
        self.seconds, self.wall, self.bytes = (dict.fromkeys(STAGES, 0.0) for _ in range(3))
        self._stack = ["other"]
        self._since = process_time(), perf_counter()
        peak_memory(reset=True)

    def _charge(self) -> None:
        """Charge what was used since the last call to the stage that ran."""
        stage, now = self._stack[-1], (process_time(), perf_counter())
        self.seconds[stage] += now[0] - self._since[0]
        self.wall[stage] += now[1] - self._since[1]
        self.bytes[stage] = max(self.bytes[stage], peak_memory())
        peak_memory(reset=True)
        self._since = process_time(), perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self._charge()
        # reading and starting build and solve systems of their own, which belong to them
        self._stack.append(self._stack[-1] if self._stack[-1] in ("read", "init") else name)
        try:
            yield
        finally:
            self._charge()
            self._stack.pop()

    def watch(self, owner: object, method: str, name: str) -> None:
        """Count every call of a method, or of a function of a module, as a stage."""
        inner: Callable[..., Any] = getattr(owner, method)

        @wraps(inner)
        def timed(*args: Any, **options: Any) -> Any:
            with self.stage(name):
                return inner(*args, **options)

        setattr(owner, method, timed)

    def total(self) -> dict[str, dict[str, float]]:
        """All of it, with the sums; bytes: the peak of the process while a stage ran."""
        self._charge()
        for sums in (self.seconds, self.wall):
            sums["total"] = sum(sums.values())
        self.bytes["total"] = max(self.bytes.values())
        return {"seconds": self.seconds, "wall": self.wall, "bytes": self.bytes}


def end_after(seconds: float) -> None:
    """End this process when it has taken so much processor time. (RLIMIT_CPU makes the clock tick in steps of 4 ms.)"""
    while process_time() < seconds:
        sleep(1.0)
    os._exit(TOO_LONG)


def measure(world: str, path: str, seconds: str, gigabytes: str) -> dict[str, Any]:
    """Load, start and solve a file."""
    file = Path(path)
    threading.Thread(target=end_after, args=[ENOUGH * float(seconds)], daemon=True).start()
    import nls
    import nls.graph
    from nls.linear import default_solver
    from nls.linear.base import NormalAnalysis, SparseSolver
    from nls.linear.factorization import Factorization
    from nls.sparse.hessian import Blocks
    from nls.sparse.pattern import Pattern
    from nls.system import LinearSystem
    from nls.values import Values

    solver: Any = type(default_solver())
    small = file.with_name("small.g2o")  # solved first: libraries loaded
    write(world, 60, small)
    graph, values, _ = nls.load(small)
    graph.optimize(nls.initialize(graph, values)[0])
    meter = Meter()
    for owner, method, stage in (
        (nls.graph, "choose_gauge", "build"),
        (Pattern, "holding", "build"),
        (SparseSolver, "analyze", "analyze"),
        (LinearSystem, "at", "linearize"),
        (NormalAnalysis, "solve", "assemble"),  # what it does besides factorizing and solving
        (Blocks, "fill", "assemble"),
        (Factorization, "factorize", "factorize"),
        (Factorization, "solve", "solve"),
        (Values, "retract", "retract"),
    ):
        meter.watch(owner, method, stage)
    try:
        with meter.stage("read"):
            graph, values, _ = nls.load(file)
        with meter.stage("init"):
            start, init, tried = nls.initialize(graph, values)
        result = graph.optimize(start, linear_solver=solver(memory_limit=1e9 * float(gigabytes)))
    except nls.ResourceLimitError as refused:
        return {"refused": str(refused).split(";")[0]}
    found = {
        "edges": len(graph),
        "variables": len(values),
        "file_bytes": file.stat().st_size,
        "init": init,
        "starts": tried,
        "iterations": result.iterations,
        "converged": result.converged,
        "chi2": result.chi2_final,
        "dof": result.dof,
        "linear_solver": result.linear_solver,
    }
    return found | meter.total()


# --- the series of one world ------------------------------------------------------------------------------------------


def run(world: str, sizes: list[int], seconds: float, gigabytes: float) -> Series:
    """Measure a world size by size, up to the one predicted to pass a limit."""
    series, process = Series(world), (sys.executable, __file__, "--child")
    for size in sizes:
        time, memory = predict(series, size)
        if time > seconds or memory > gigabytes * 1e9:
            need = f"{time:,.0f} s" if time > seconds else f"{memory / 1e9:,.0f} GB"
            series.stopped = f"{size:,} edges were not started: they would need about {need}"
            break
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "graph.g2o"
            made = fresh(*process, "write", world, size, file)
            done = made if made.returncode else fresh(*process, "measure", world, file, seconds, gigabytes)
        if done.returncode:
            ended = f"ended after {ENOUGH * seconds:,.0f} s" if done.returncode == TOO_LONG else last_words(done)
            series.stopped = f"{size:,} edges: {ended}"
            break
        found = json.loads(done.stdout)
        if "refused" in found:
            series.stopped = f"{size:,} edges were refused: {found['refused']}"
            break
        series.runs.append(found)
        total, peak = found["seconds"]["total"], found["bytes"]["total"] / 1e9
        foreseen = f"  ({time:.1f} s, {memory / 1e9:.2f} GB foreseen)" if time else ""
        print(f"  {world:10s}{found['edges']:11,}{total:9.2f} s{peak:8.2f} GB{foreseen}", flush=True)
    if series.stopped:
        print(f"  {world}: {series.stopped}", flush=True)
    return series


def predict(series: Series, size: int) -> tuple[float, float]:
    """Seconds and bytes a size will need, from the last two; zeros while nothing is known.

    Every stage grows by its own power law: what is small today and grows fastest will be the sum. Its exponent is taken
    between 1 and 3, that of a dense factorization, and as 1 where the stage is too short to tell.
    """
    if len(series.runs) < 2:
        return 0.0, 0.0
    last, more, time = series.edges[-2:], size / series.edges[-1], 0.0
    for stage in STAGES:
        y = series.of("seconds", stage)[-2:]
        p = exponent(last, y) if y[-1] > SHORT else 1.0
        time += y[-1] * more ** min(max(p, 1.0), 3.0)
    peak = series.of("bytes", "total")[-2:]
    return time, peak[-1] * more ** exponent(last, peak)


# --- the report -------------------------------------------------------------------------------------------------------


def law(series: Series, what: str, stage: str) -> str:
    """p of y ~ edges^p at the upper sizes; empty for what takes no time worth a law."""
    y = series.of(what, stage)[-UPPER:]
    if len(y) < UPPER or y[-1] < SHORT:
        return ""
    return f"{exponent(series.edges[-UPPER:], y):.2f}"


def table(series: Series) -> list[str]:
    """Markdown: seconds by stage, then memory by stage, one row a size."""
    all_stages = (*STAGES, "total")
    lines = Table(["edges", "variables", *STAGES, "**total**", "wall", "iterations", "chi2 / dof"], names=0)
    memory = Table(["edges", *STAGES, "**total**"], names=0)
    for r in series.runs:
        *seconds, total = (f"{r['seconds'][s]:.3g}" for s in all_stages)
        quality = f"{r['chi2'] / r['dof']:.3f}" + ("" if r["converged"] else ", not converged")
        wall = f"{r['wall']['total']:.3g}"
        edges = f"{r['edges']:,}"
        lines.append(line_of([edges, f"{r['variables']:,}", *seconds, f"**{total}**", wall, r["iterations"], quality]))
        *peaks, peak = (f"{r['bytes'][s] / 1e6:,.0f}" for s in all_stages)
        memory.append(line_of([edges, *peaks, f"**{peak}**"]))
    seconds, peaks = ([law(series, what, s) for s in all_stages] for what in ("seconds", "bytes"))
    lines.append(f"| edges^p | | {' | '.join(seconds)} | | | |")
    memory.append(line_of(["edges^p", *peaks]))
    title = "Peak memory of the process while a stage ran, MB:"
    page = [f"## {WORLDS[series.world]}", *lines, title, *memory]
    return [*page, f"{series.stopped}."] if series.stopped else page


COLORED = ("linearize", "factorize", "init", "read", "assemble")  # the others are grey


def draw(found: list[Series], path: Path, seconds: float, largest: int) -> None:
    """Seconds of every stage against edges, both axes logarithmic; the same axes for every world."""
    from matplotlib.figure import Figure

    from nls.plot.style import SERIES, SIGHT, TRUE

    found = [s for s in found if s.runs]
    figure = Figure(figsize=(3.9 * len(found), 4.6), layout="constrained")
    panels = figure.subplots(1, len(found), sharex=True, sharey=True, squeeze=False)[0]
    lowest, colors = 1e-3, {"total": TRUE, **dict(zip(COLORED, SERIES, strict=False))}
    for axes, s in zip(panels, found, strict=True):
        ends: list[tuple[float, str, str]] = []
        for stage in (*STAGES, "total"):
            y = np.array(s.of("seconds", stage))
            color = colors.get(stage, SIGHT)
            bold = stage in colors
            axes.loglog(s.edges, y, "-", color=color, linewidth=3.2 if stage == "total" else 2.0 if bold else 1.0)
            if bold and y[-1] > lowest:
                p = law(s, "seconds", stage)
                ends.append((float(y[-1]), f"{stage}  $\\propto n^{{{p}}}$" if p else stage, color))
        place = 0.0
        for y_end, text, color in sorted(ends):  # labels at the ends of the lines, none above another
            place = max(math.log10(y_end), place + 0.22) if place else math.log10(y_end)
            axes.annotate(text, (s.edges[-1], y_end), xytext=(1.4 * s.edges[-1], 10**place), va="center", color=color)
        axes.axhline(seconds, color="0.5", linewidth=0.8, linestyle="--")
        axes.set(title=WORLDS[s.world].replace("`", ""), xlabel="edges n", ylim=(lowest, 3 * seconds))
        axes.set(xlim=(800, 100 * largest), xticks=10.0 ** np.arange(3, math.floor(math.log10(largest)) + 1))
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("processor time, one thread [s]")
    panels[0].annotate(f"limit {seconds:g} s", (1000, seconds), va="bottom", color="0.4")
    panels[-1].annotate("grey: the other stages", (0.98, 0.02), xycoords="axes fraction", ha="right")
    figure.savefig(path, dpi=120)


# --- command line -----------------------------------------------------------------------------------------------------


def page(out: Path, quick: bool, largest: float | None, seconds: float, gigabytes: float, only: list[str]) -> list[str]:
    """All tables; beside them the numbers and the figure."""
    largest = largest or (QUICK if quick else LARGEST)
    sizes = [n for k in range(3, 10) for n in (10**k, 3 * 10**k) if n <= largest]
    head = [
        "- seconds of processor time with one thread, which other work on the machine hardly changes; wall: by the "
        "clock",
        "- a fresh process for every row; seed 1; read: the .g2o file to graph and values; init: `nls.initialize`, "
        "which takes the best of the file's, the odometry's and the chordal initial guess; the rest: `graph.optimize` "
        "with its defaults",
        f"- edges^p: fitted to the last {UPPER} sizes",
        f"- limits: {seconds:g} s and {gigabytes:g} GB from file to optimum",
    ]
    record: dict[str, Any] = {"machine": [*machine(), *head], "limits": [seconds, gigabytes]}
    found = [run(world, sizes, seconds, gigabytes) for world in only]
    record["worlds"] = [asdict(s) for s in found]
    (out / "scaling.json").write_text(json.dumps(record, indent=1) + "\n")
    draw(found, out / "scaling.png", seconds, max(sizes))
    picture = "![processor time by stage against edges, three worlds](scaling.png)"
    return [*head, picture, *(line for s in found for line in table(s))]


def edges(text: str) -> float:
    """The largest size."""
    if (value := positive(text)) < 1000:
        raise argparse.ArgumentTypeError(f"expected at least 1,000 edges, got {text!r}")
    return value


if __name__ == "__main__":
    make_page(
        *("Time and memory as graphs grow", page, {"measure": measure, "write": write}),
        quick=f"sizes up to {QUICK:,} edges",
        largest={"type": edges, "metavar": "EDGES", "help": f"default {LARGEST:,}"},
        seconds=(120.0, "a size predicted to take longer is left out"),
        gigabytes=(12.0, "or one that takes more memory"),
        only={"nargs": "+", "choices": WORLDS, "default": list(WORLDS), "help": "these worlds alone"},
    )
