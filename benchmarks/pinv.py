"""What the pseudo-inverse costs: seven ways to solve one A dx = b, on pose graphs from 30 to 100,000 unknowns.

    python benchmarks/pinv.py [--quick] [--seconds 20] [--gigabytes 4] [--out DIR]

Textbooks write dx = A^+ b, and A^+ = (A'A)^-1 A'. These are two of the ways: A^+ by the singular value decomposition
exists for every A; the formula (A'A)^-1 A', taken literally, needs columns that do not depend on one another, and
squares the condition number.

Every measurement is a fresh process with one BLAS thread that is given A and b of a simulated city, linearized at the
true poses, and solves for the update. A solver stops where its next size is predicted to pass a limit, and says so.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from harness import PROCESSOR_TIME, exponent, fresh, last_words, make_page, markdown, peak_memory, timed

import sim
from nls.linear import SOLVERS
from nls.system import LinearSystem

SIZES = (30, 99, 300, 999, 3_000, 9_999, 30_000, 99_999)  # three unknowns a pose, the first pose held
QUICK = 3_000
DENSE = ("pinv", "formula", "dense-qr", "dense-cholesky")
SPARSE = ("qr", "lu", "cholesky")
TITLE = {
    "pinv": "pseudo-inverse by SVD",
    "formula": "(A'A)^-1 A'",
    "dense-qr": "dense QR",
    "dense-cholesky": "dense Cholesky",
    "qr": "sparse QR",
    "lu": "sparse LU",
    "cholesky": "sparse Cholesky",
}
REFERENCES = ("dense-qr", "qr", "cholesky", "lu", "dense-cholesky", "formula", "pinv")  # the most accurate first
RUNS, ENOUGH = 99, 1.0  # runs of one measurement at most; no further one after so many seconds
SMALL = 1e6  # bytes; less is lost in the memory a process has at hand


@dataclass
class Series:
    """Measurements of one solver, size by size, and why there are no more."""

    name: str
    n: list[int] = field(default_factory=list)  # unknowns
    seconds: list[float] = field(default_factory=list)  # of one solve, median
    bytes: list[float] = field(default_factory=list)  # that a solve adds to the process
    dx: list[npt.NDArray[np.float64]] = field(default_factory=list)  # the update
    stopped: str = ""  # why it ended; empty when every size was solved
    foreseen: tuple[int, float, float] | None = None  # the size it was not given, and seconds and bytes it would need


# --- one measurement, in a process of its own -------------------------------------------------------------------------


def measure(name: str, unknowns: str, folder: str) -> dict[str, float]:
    """Seconds and bytes of solving a system; the update is left in the folder."""

    def system(poses: int) -> LinearSystem:
        world = sim.manhattan(np.random.default_rng(1), n_poses=poses)
        world.graph.fix(next(iter(world.truth)))
        return world.graph.linearize(world.truth)

    def solve(given: LinearSystem) -> tuple[npt.NDArray[np.float64], float]:
        copy = LinearSystem(given.pattern, given.blocks, given.b)  # remembers nothing of an earlier solve
        copy.A  # noqa: B018 - A and b are given; everything made from them is timed
        return timed(update, copy)

    def update(given: LinearSystem) -> npt.NDArray[np.float64]:
        if solver is not None:
            return np.asarray(solver.analyze(given.pattern).solve(given).dx)
        A = given.A.toarray()
        return np.asarray(np.linalg.inv(A.T @ A) @ A.T @ given.b)

    kind: Any = SOLVERS.get(name)  # None: the formula
    solver = None if kind is None else kind(memory_limit=np.inf) if name in DENSE else kind()
    solve(system(50))  # libraries loaded
    given = system(int(unknowns) // 3 + 1)
    before = peak_memory(reset=True)
    runs = [solve(given)]
    added = max(peak_memory() - before, 0.0)
    while len(runs) < RUNS and sum(seconds for _, seconds in runs) < ENOUGH:
        runs.append(solve(given))
    np.save(Path(folder) / "dx.npy", runs[0][0])
    return {"seconds": float(np.median([s for _, s in runs])), "bytes": added}


# --- the series of one solver -----------------------------------------------------------------------------------------


def run(name: str, sizes: list[int], cells: dict[int, float], seconds: float, gigabytes: float) -> Series:
    """Measure a solver size by size, up to the one predicted to pass a limit."""
    series = Series(name)
    if name in SOLVERS and (missing := SOLVERS[name].missing()) is not None:
        series.stopped = f"{name} was not run: {missing}"
    for n in sizes:
        if series.stopped:
            break
        time, memory = predict(series, n, cells)
        if time > seconds or memory > gigabytes * 1e9:
            series.foreseen = n, time, memory
            last = series.n[-1] if series.n else 0
            series.stopped = f"{TITLE[name]} stops at {last:,} unknowns: {n:,} would need {need(series, seconds)}"
            break
        with tempfile.TemporaryDirectory() as folder:
            done = fresh(sys.executable, __file__, "--child", name, n, folder)
            if done.returncode and not series.n:
                raise SystemExit(f"{TITLE[name]} fails at {n:,} unknowns: {last_words(done)}")
            if done.returncode:
                series.stopped = f"{TITLE[name]} stops at {n:,} unknowns: {last_words(done)}"
                break
            found = json.loads(done.stdout)
            series.n.append(n)
            series.seconds.append(found["seconds"])
            series.bytes.append(max(found["bytes"], SMALL))
            series.dx.append(np.load(Path(folder) / "dx.npy"))
        foreseen = f"  ({time:.2g} s foreseen)" if time else ""
        print(f"  {name:15s}{n:8,}{found['seconds']:12.4g} s{found['bytes'] / 1e6:11.1f} MB{foreseen}", flush=True)
    if series.stopped:
        print(f"  {series.stopped}", flush=True)
    return series


def need(series: Series, seconds: float) -> str:
    """What the size that a solver was not given would need: the time where that is the reason, else the memory."""
    assert series.foreseen is not None
    _, time, memory = series.foreseen
    return f"{time:,.0f} s" if time > seconds else f"{memory / 1e9:,.1f} GB"


def predict(series: Series, n: int, cells: dict[int, float]) -> tuple[float, float]:
    """Seconds and bytes the size n will need, from the sizes before; zeros while nothing is known.

    Dense: time grows with m n^2, memory with the m n numbers of A. Sparse: the power law through the last two sizes,
    continued from the last one and taken at least linear.
    """
    if len(series.n) < 2:
        return 0.0, 0.0
    last = series.n[-1]
    if series.name in DENSE:
        more = cells[n] / cells[last]
        return series.seconds[-1] * more * n / last, series.bytes[-1] * more
    laws = ((y[-1], max(1.0, exponent(series.n[-2:], y[-2:]))) for y in (series.seconds, series.bytes))
    time, memory = (y * (n / last) ** power for y, power in laws)
    return time, memory


# --- the report -------------------------------------------------------------------------------------------------------


def table(found: list[Series]) -> list[str]:
    """Markdown: one row per size and solver, one per solver, then the sentences."""
    rows = []
    for n in sorted({n for s in found for n in s.n}):
        here = {s.name: (s.seconds[k], s.bytes[k], s.dx[k]) for s in found if n in s.n for k in [s.n.index(n)]}
        reference = next(name for name in REFERENCES if name in here)
        for name, (seconds, added, dx) in here.items():
            relative = f"{seconds / here['cholesky'][0]:,.1f}" if "cholesky" in here else ""
            off = "reference" if name == reference else f"{np.abs(dx - here[reference][2]).max():.1e}"
            mb = f"{added / 1e6:,.1f}" if added > SMALL else "< 1"
            rows.append([f"{n:,}", TITLE[name], f"{seconds:.3g}", relative, mb, off])
    laws = [
        [TITLE[s.name], f"{s.n[-1]:,}", *(f"n^{exponent(s.n[-3:], y[-3:]):.2f}" for y in (s.seconds, s.bytes))]
        for s in found
        if s.n
    ]
    return [
        *markdown(["unknowns", "solver", "seconds", "relative", "memory, MB", "difference of dx"], rows, "rlrrrr"),
        "",
        *markdown(["solver", "largest size", "time grows as", "memory grows as"], laws, "lrll"),
        "Exponents are fitted to the last three sizes of each solver.",
        *(f"- {s.stopped}." for s in found if s.stopped),
        *crossings(found),
    ]


def crossings(found: list[Series]) -> list[str]:
    """From which size on sparse Cholesky is faster than each dense solver."""
    at = {s.name: s for s in found if s.n}
    lines = []
    for name in (n for n in DENSE if n in at and "cholesky" in at):
        k = min(len(at[name].n), len(at["cholesky"].n))
        faster = np.array(at["cholesky"].seconds[:k]) < np.array(at[name].seconds[:k])
        first = int(np.flatnonzero(np.append(True, ~faster))[-1])  # the size after the last slower one
        if first < k:
            lines.append(f"- Sparse Cholesky is faster than {TITLE[name]} from {at[name].n[first]:,} unknowns on.")
    return lines


def notes() -> list[str]:
    """What the figures are."""
    return [
        PROCESSOR_TIME,
        "- graph: `sim.manhattan`, plane poses, seed 1, first pose fixed, linearized at the true poses",
        f"- seconds: from A and b to dx, ordering included; median of up to {RUNS} runs, as many as begin within "
        f"{ENOUGH:g} s; relative: to sparse Cholesky",
        "- memory: peak of the solve above the memory before it; a fresh process for every row",
        "- difference: largest |dx - dx of the reference|, m and rad; the reference is the first of "
        f"{', '.join(TITLE[name] for name in REFERENCES)} that reaches the size",
    ]


def draw(found: list[Series], path: Path, seconds: float, gigabytes: float) -> None:
    """Time and memory against unknowns, both axes logarithmic; arrows lead to what a solver was not given any more."""
    from matplotlib.figure import Figure

    from nls.plot.style import BEFORE, ESTIMATE

    figure = Figure(figsize=(11.5, 4.8), layout="constrained")
    figure.suptitle("One linear solve in seven ways; arrows lead to sizes that were not run")
    left, right = figure.subplots(1, 2)
    markers = dict(zip(TITLE, "oDs^XPv", strict=True))
    for s in (s for s in found if s.n):
        color, label = BEFORE if s.name in DENSE else ESTIMATE, TITLE[s.name]
        if s.foreseen is not None:
            n, time, memory = s.foreseen
            label += f"\n{n:,} would take {need(s, seconds)}"
            arrow = {"arrowstyle": "->", "color": color, "linestyle": ":", "shrinkA": 5}
            left.annotate("", (n, time), (s.n[-1], s.seconds[-1]), arrowprops=arrow)
            right.annotate("", (n, memory / 1e6), (s.n[-1], s.bytes[-1] / 1e6), arrowprops=arrow)
        for axes, y in ((left, s.seconds), (right, np.array(s.bytes) / 1e6)):
            axes.loglog(s.n, np.maximum(y, 1e-6), marker=markers[s.name], color=color, label=label, markersize=6)
    longest, largest = (max((s.foreseen[k] for s in found if s.foreseen), default=0.0) for k in (1, 2))
    for axes, limit, what in ((left, seconds, f"{seconds:g} s"), (right, 1e3 * gigabytes, f"{gigabytes:g} GB")):
        axes.axhline(limit, color="0.5", linewidth=0.8)
        axes.annotate(
            f"limit {what}", (0.01, limit), xycoords=("axes fraction", "data"), ha="left", va="bottom", color="0.4"
        )
        axes.set(xlabel="unknowns")
        axes.grid(alpha=0.3)
    left.set(ylabel="one linear solve, one thread [s]", ylim=(None, 3 * max(longest, seconds)))
    right.set(ylabel="memory added by the solve [MB]", ylim=(SMALL / 1e6, 3 * max(largest / 1e6, 1e3 * gigabytes)))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=9, labelspacing=0.9)
    figure.savefig(path, dpi=130)


def page(seconds: float, gigabytes: float, quick: bool, out: Path) -> list[str]:
    """The page without its head, and the picture beside it."""
    sizes = [n for n in SIZES if n <= QUICK or not quick]
    cells = {n: float(n) * sim.manhattan(np.random.default_rng(1), n_poses=n // 3 + 1).rows for n in sizes}
    found = [run(name, sizes, cells, seconds, gigabytes) for name in (*DENSE, *SPARSE)]
    draw(found, out / "pinv.png", seconds, gigabytes)
    picture = "![time and memory of one solve against unknowns, by solver](pinv.png)"
    return [*notes(), f"- limits: {seconds:g} s and {gigabytes:g} GB a solve", picture, *table(found)]


if __name__ == "__main__":
    make_page(
        *("The pseudo-inverse against sparse solvers", page, measure),
        seconds=(20.0, "a solver stops before a solve longer than this"),
        gigabytes=(4.0, "or before one that takes more memory"),
        quick=f"sizes up to {QUICK:,} unknowns",
    )
