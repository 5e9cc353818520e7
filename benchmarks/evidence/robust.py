"""How often wrong loop closures are found out: planted ones in five public graphs, and real ones.

    LEADLINE_DATA=DIR python benchmarks/evidence/robust.py [--seeds 3] [--minutes 60] [--trials FILE] [--out DIR]

Wrong closures, single and in groups that agree with one another, are added to graphs whose right optimum is known.
With --trials every trial is kept in a file as it ends, and those that are there are not run again.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from robust_real import real
from robust_trials import FINE, HARD, HARD_SETS, OTHERS, OURS, PATIENCE, SHARES, SIZES, Task, Trial, planted, run, tasks
from wrong_closures import SETS, Array, X

import nls
from nls.plot.picture import write_picture

BENCHMARKS = Path(__file__).parents[1]
WORKERS = 2
SMALL = 1e-5  # of the extent
MANY = 0.5  # of all closures
DRAWN = Task("manhattan", 10, 0.5, 0)
ORANGE, BLUE, GREY = "#e07a2f", "#0b4f6c", "#606060"
STATISTICS: dict[str, Callable[[Trial], float]] = {
    "`strain`": lambda trial: trial.strain,
    "share of closures rejected": lambda trial: trial.rejected,
    "chi2 over degrees of freedom": lambda trial: trial.noise,
}


# --- the tables -------------------------------------------------------------------------------------------------------


def of(trials: list[Trial], method: str, **wanted: object) -> list[Trial]:
    """The trials of a method whose tasks have some attributes."""
    return [t for t in trials if t.task.method == method and all(getattr(t.task, k) == v for k, v in wanted.items())]


def ours_row(trials: list[Trial], task: Task) -> str:
    """A set with one share and size of groups, `nls.gnc`."""
    found = of(trials, OURS, name=task.name, size=task.size, share=task.share)
    off, strain = np.array([t.off for t in found]), np.array([t.strain for t in found])
    recall, precision, kept = 100 * np.mean([[t.recall, t.precision, t.kept] for t in found], axis=0)
    return (
        f"| {task.name} | {kind(task)} | {100 * task.share:.0f} | {sum(t.fine for t in found)} of {len(found)} | "
        f"{percent(np.median(off))} | {percent(off.max())} | {recall:.1f} | {precision:.1f} | {kept:.1f} | "
        f"{np.median(strain):.2f} | {strain.max():.2f} | {np.median([t.seconds for t in found]):.1f} |"
    )


def kind(task: Task) -> str:
    return "single" if task.size == 1 else f"groups of {task.size}"


def ours(trials: list[Trial], rows: list[Task]) -> list[str]:
    head = "| graph | wrong ones | % | solved | ATE % | worst | recall | precision | kept | strain | most | s |"
    there = [task for task in rows if of(trials, OURS, name=task.name, size=task.size, share=task.share)]
    return [head, "|:--|:--|" + "--:|" * 10, *(ours_row(trials, task) for task in there)]


def others(trials: list[Trial], rows: list[Task]) -> list[str]:
    """ATE of every method on the first seed."""
    lines = [
        "| graph | wrong ones | % | " + " | ".join([*OTHERS, OURS]) + " |",
        "|:--|:--|" + "--:|" * (2 + len(OTHERS)),
    ]
    for task in rows:
        cells = []
        for method in (*OTHERS, OURS):
            found = of(trials, method, name=task.name, size=task.size, share=task.share, seed=0)
            cells.append("not run" if not found else "given up" if np.isnan(found[0].off) else marked(found[0]))
        lines.append(f"| {task.name} | {kind(task)} | {100 * task.share:.0f} | " + " | ".join(cells) + " |")
    counts = []
    for method in (*OTHERS, OURS):
        found = [t for t in of(trials, method, seed=0) if (t.task.share, t.task.size) not in HARD]
        counts.append(f"{sum(t.fine for t in found)} of {len(found)}")
    return [*lines, "| solved | | | " + " | ".join(counts) + " |"]


def percent(off: float) -> str:
    """A share in percent; fractions of a thousandth mean nothing."""
    return f"{100 * off:.2g}" if off >= SMALL else f"< {100 * SMALL:g}"


def marked(trial: Trial) -> str:
    """ATE, bold where it is no solution."""
    return percent(trial.off) if trial.fine else f"**{percent(trial.off)}**"


def area(failed: np.ndarray, good: np.ndarray) -> float:
    """The chance that a failed trial has the larger number of a failed and a good one."""
    return float(((failed[:, None] > good) + 0.5 * (failed[:, None] == good)).mean())


def best_threshold(failed: np.ndarray, good: np.ndarray) -> float:
    """Where most of the failed ones are above, less the good ones that are."""
    at = np.sort(np.concatenate([failed, good]))
    gain = (failed[:, None] > at).mean(axis=0) - (good[:, None] > at).mean(axis=0)
    best = int(np.argmax(gain))
    return float(at[best : best + 2].mean())


def telling(trials: list[Trial]) -> list[str]:
    """How well a statistic of the report tells the failed trials from the good ones."""
    found = of(trials, OURS)
    many = [t for t in found if t.task.share >= MANY]
    failed = [t for t in found if not t.fine]
    if not failed or len(failed) == len(found):
        return [f"Of all {len(found)} trials {len(failed)} failed: nothing to tell apart."]
    lines = [
        f"Of all {len(found)} trials of both tables {len(failed)} failed. The ROC area is the chance that a failed "
        "trial has a larger number than a good one: 1 tells them all, 0.5 none. A threshold is the one with the most "
        "failed trials above it, less the good ones, in shares. The last column is for the "
        f"{len(many)} trials with as many wrong closures as right ones or more: where more are wrong more are rejected "
        "and more trials fail, which tells nothing about one graph.",
        "",
        "| statistic | ROC area | threshold | failed above it | good above it | area, many wrong |",
        "|:--|--:|--:|--:|--:|--:|",
    ]
    for name, statistic in STATISTICS.items():
        bad, good = (np.array([statistic(t) for t in found if t.fine == fine]) for fine in (False, True))
        hard = [np.array([statistic(t) for t in many if t.fine == fine]) for fine in (False, True)]
        at = best_threshold(bad, good)
        lines.append(
            f"| {name} | {area(bad, good):.2f} | {at:.3g} | {(bad > at).sum()} of {len(bad)} | "
            f"{(good > at).sum()} of {len(good)} | {area(*hard):.2f} |"
        )
    return lines


# --- the figure -------------------------------------------------------------------------------------------------------


def maps(data: Path) -> dict[str, tuple[Array, float]]:
    """Tracks (n, 2) of one graph by three ways, and how far each is off."""
    right, graph = planted(data, DRAWN)
    found = {
        "least squares": graph.optimize(nls.initialize(graph, right.start)[0]).values,
        OURS: nls.gnc(graph, right.start).result.values,
        "without wrong closures": right.best,
    }
    return {name: (values.stack(X).X[:, :2], right.off(values)) for name, values in found.items()}


def draw(tracks: dict[str, tuple[Array, float]], trials: list[Trial], path: Path) -> None:
    """One graph three times, and the ATE of all trials."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.15, 1))
    panels = zip(upper.subplots(1, len(tracks)), tracks.items(), (ORANGE, BLUE, "k"), strict=True)
    for axes, (name, (track, off)), color in panels:
        axes.plot(*track.T, color=color, linewidth=0.5)
        said = f": ATE {percent(off)} % of the extent" if off >= SMALL else ""
        axes.set(title=name + said, aspect="equal", xticks=[], yticks=[])
    upper.suptitle(f"{DRAWN.name}, as many wrong loop closures as right ones, in groups of {DRAWN.size} that agree")
    axes = lower.subplots()
    lanes = [(name, size) for name in SETS for size in SIZES]
    marks = {"plain": (ORANGE, "x", -0.27), "Cauchy(1)": (GREY, "+", 0.0), OURS: (BLUE, "o", 0.27)}
    for method, (color, mark, beside) in marks.items():
        found = [t for t in of(trials, method) if t.task.share in SHARES and t.task.size in SIZES]
        place = [lanes.index((t.task.name, t.task.size)) + beside + 0.4 * (t.task.share - 0.3) for t in found]
        off = np.maximum([t.off for t in found], SMALL)  # nan, given up, stays
        axes.plot(place, 100 * off, mark, color=color, ms=5, mfc="none", label=method)
    axes.axhline(100 * FINE, color="0.3", linewidth=0.8)
    axes.annotate(
        "solved: below 1 %", (0.995, 0.85 * 100 * FINE), xycoords=("axes fraction", "data"), ha="right", va="top"
    )
    axes.set(yscale="log", ylabel="ATE [% of the extent]", xlim=(-0.6, len(lanes) - 0.4), ylim=(50 * SMALL, 300))
    axes.set_xticks(range(len(lanes)), [f"{name}\n{kind(Task(name, size, 0, 0))}" for name, size in lanes], fontsize=8)
    axes.set_xlabel("of each kind from left to right 10, 30, 50 % wrong closures; missing: given up or not run")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="upper left", ncols=3)
    write_picture(path, figure)


# --- the page ---------------------------------------------------------------------------------------------------------


def page(trials: list[Trial], closures: list[str]) -> list[str]:
    """The page below its head."""
    suite = [Task(name, size, share, 0) for name in SETS for size in SIZES for share in SHARES]
    hard = [Task(name, size, share, 0) for name in HARD_SETS for share, size in HARD]
    found = [t for task in suite for t in of(trials, OURS, name=task.name, size=task.size, share=task.share)]
    return [
        "- one BLAS thread, processor time, two trials at a time",
        "- *%*: of all closures, right and wrong, that are wrong; 50 means as many wrong as right ones",
        "- *solved*: ATE from the optimum without wrong closures, rigidly aligned, is below "
        f"{100 * FINE:g} % of the longest side of the map's box; *ATE %* is its median, *worst* the largest",
        "- *recall*, *precision*: percent of the wrong closures that were rejected, of the rejected ones that are "
        "wrong; *kept*: percent of the right closures kept",
        "- *strain*: median and largest of what `nls.gnc` says of itself; *s*: median",
        "",
        "A wrong closure carries measurement and weight of a right one, drawn at random, to two other poses. In a "
        "group the next ones say the same thing of the poses next to those, with the residuals of right ones: they "
        "agree, as where one place looks like another.",
        "",
        "## Random and grouped wrong closures",
        "",
        f"**{sum(t.fine for t in found)} of {len(found)} trials solved.** `{OURS}` with its defaults:",
        "",
        *ours(trials, suite),
        "",
        "![maps of one trial, and the error of all trials](robust.png)",
        "",
        "## Other methods on the first seed",
        "",
        "ATE in percent of the extent, bold where not solved. *plain*: least squares from the default start; "
        "*Cauchy(1)*: that kernel on every measurement, from odometry; *GNC, all in*: `nls.gnc(..., preselect=False)`, "
        f"from odometry. These three are given up after {PATIENCE:g} s of processor time each: many wrong closures "
        "fill the Cholesky factor of a graph in space.",
        "",
        *others(trials, suite),
        "",
        "## Harder ones",
        "",
        "Larger groups, and more wrong closures than right ones.",
        "",
        *ours(trials, hard),
        "",
        "## Does it know when it failed?",
        "",
        *telling(trials),
        "",
        "## Real closures",
        "",
        *closures,
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="trials of every kind (default 3)")
    parser.add_argument("--minutes", type=float, default=60.0, help="no trial begins after so many (default 60)")
    parser.add_argument(
        "--trials", type=Path, default=None, metavar="FILE", help="keeps every trial; those in it stand"
    )
    parser.add_argument(
        "--out", type=Path, default=BENCHMARKS / "results", metavar="DIR", help="for robust.md and .png"
    )
    options = parser.parse_args()
    if options.seeds < 1:
        parser.error(f"--seeds: expected a number of 1 or more, got {options.seeds}")
    if not (name := os.environ.get("LEADLINE_DATA")):
        print("robust: the public graphs are not shipped: set LEADLINE_DATA to the folder that holds them")
        return 0
    sys.path.insert(0, str(BENCHMARKS))
    from pinv import ONE_THREAD, machine, write_page

    os.environ.update(ONE_THREAD)  # for the workers
    data, head = Path(name), machine()
    trials = run(data, tasks(options.seeds), options.trials, WORKERS, options.minutes)
    lines = ["# Wrong loop closures", "", *head, *page(trials, real(data / "robust-real"))]
    write_page(lines, options.out / "robust.md")
    draw(maps(data), trials, options.out / "robust.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
