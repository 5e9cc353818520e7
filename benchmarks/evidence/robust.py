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
from wrong_closures import SETS, X

import nls
from nls import Values
from nls.plot.picture import write_picture

BENCHMARKS = Path(__file__).parents[1]
WORKERS = 2
DRAWN = Task("manhattan", 10, 0.5, 0)
ORANGE, BLUE, GREY = "#e07a2f", "#0b4f6c", "#909090"
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
    off, strain = 100 * np.array([t.off for t in found]), np.array([t.strain for t in found])
    recall, precision, kept = 100 * np.mean([[t.recall, t.precision, t.kept] for t in found], axis=0)
    return (
        f"| {task.name} | {kind(task)} | {100 * task.share:.0f} | {sum(t.fine for t in found)} of {len(found)} | "
        f"{np.median(off):.2g} | {off.max():.2g} | {recall:.1f} | {precision:.1f} | {kept:.1f} | "
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
            cells.append("not run" if not found else "given up" if np.isnan(found[0].off) else percent(found[0]))
        lines.append(f"| {task.name} | {kind(task)} | {100 * task.share:.0f} | " + " | ".join(cells) + " |")
    counts = []
    for method in (*OTHERS, OURS):
        found = [t for t in of(trials, method, seed=0) if (t.task.share, t.task.size) not in HARD]
        counts.append(f"{sum(t.fine for t in found)} of {len(found)}")
    return [*lines, "| solved | | | " + " | ".join(counts) + " |"]


def percent(trial: Trial) -> str:
    """ATE, bold where it is no solution."""
    off = f"{100 * trial.off:.2g}"
    return off if trial.fine else f"**{off}**"


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
    fine = np.array([t.fine for t in found])
    lines = [
        f"Over all {len(found)} trials of both tables, of which {(~fine).sum()} failed:",
        "",
        "| statistic | ROC area | threshold | failed above it | good above it |",
        "|:--|--:|--:|--:|--:|",
    ]
    for name, statistic in STATISTICS.items():
        number = np.array([statistic(t) for t in found])
        failed, good = number[~fine], number[fine]
        if not len(failed) or not len(good):
            return [f"Of all {len(found)} trials {(~fine).sum()} failed: nothing to tell apart."]
        at = best_threshold(failed, good)
        lines.append(
            f"| {name} | {area(failed, good):.2f} | {at:.3g} | {(failed > at).sum()} of {len(failed)} | "
            f"{(good > at).sum()} of {len(good)} |"
        )
    return lines


# --- the figure -------------------------------------------------------------------------------------------------------


def draw(data: Path, trials: list[Trial], path: Path) -> None:
    """One graph three times, and the ATE of all trials."""
    from matplotlib.figure import Figure

    right, graph = planted(data, DRAWN)
    plain = graph.optimize(nls.initialize(graph, right.start)[0]).values
    maps: dict[str, tuple[Values, str]] = {
        "least squares": (plain, ORANGE),
        OURS: (nls.gnc(graph, right.start).result.values, BLUE),
        "without wrong closures": (right.best, "k"),
    }
    figure = Figure(figsize=(12, 7.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.15, 1))
    for axes, (name, (values, color)) in zip(upper.subplots(1, 3), maps.items(), strict=True):
        axes.plot(*values.stack(X).X[:, :2].T, color=color, linewidth=0.5)
        off = "" if values is right.best else f": ATE {100 * right.off(values):.2g} % of the extent"
        axes.set(title=name + off, aspect="equal", xticks=[], yticks=[])
    wrong = len(graph.factors[1])
    upper.suptitle(f"{DRAWN.name}, {wrong} right loop closures and {wrong} wrong ones in groups of {DRAWN.size}")
    axes = lower.subplots()
    lanes = [(name, size) for name in SETS for size in SIZES]
    for n, (name, size) in enumerate(lanes):
        for method, color, mark, beside in (
            ("plain", ORANGE, "x", -0.2),
            ("Cauchy(1)", GREY, "+", 0.0),
            (OURS, BLUE, "o", 0.2),
        ):
            found = [t for t in of(trials, method, name=name, size=size) if t.task.share in SHARES]
            place = [n + beside + 0.25 * (t.task.share - 0.3) for t in found]
            label = method if n == 0 else None
            axes.plot(place, [100 * t.off for t in found], mark, color=color, ms=5, mfc="none", label=label)
    axes.axhline(100 * FINE, color="0.3", linewidth=0.8)
    axes.annotate("solved below 1 %", (1, 100 * FINE), xycoords=("axes fraction", "data"), ha="right", va="bottom")
    axes.set(yscale="log", ylabel="ATE [% of the extent]", xlim=(-0.6, len(lanes) - 0.4))
    axes.set_xticks(range(len(lanes)), [f"{name}\n{kind(Task(name, size, 0, 0))}" for name, size in lanes], fontsize=8)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
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
    draw(data, trials, options.out / "robust.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
