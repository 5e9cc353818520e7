"""Time of leadline over that of g2o in C++, a bar a set: below 1 on large pose graphs, above 1 on most small ones.

The figures are those of benchmarks/results/posegraphs.json. Dots: the same over GTSAM and over Ceres in C++.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from nls.plot.style import CLOSURE, ECHO, ESTIMATE, REJECTED

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "posegraphs.json"
FASTER, SLOWER = ESTIMATE, REJECTED
DOTS = {"gtsam": ("over GTSAM", "s", ECHO), "ceres_cpp": ("over Ceres in C++", "D", CLOSURE)}
MOST = 50.0


def make() -> tuple[list[Figure], list[float]]:
    """One frame."""
    results = json.loads(RESULTS.read_text())
    sets = {name: found for name, found in results["programs"]["sets"].items() if "truth" not in name}
    names = sorted(sets, key=lambda name: sets[name]["edges"])
    ratios = np.array([sets[name]["ratio"]["g2o_cpp"] for name in names])
    figure = Figure(figsize=(9, 6.6), layout="constrained")
    axes = figure.subplots()
    axes.barh(range(len(names)), ratios - 1, left=1, height=0.7, color=np.where(ratios < 1, FASTER, SLOWER))
    for y, ratio in enumerate(ratios):
        axes.annotate(f"{ratio:.2f}", (1.01, y), xycoords=("axes fraction", "data"), va="center", fontsize=11)
    for peer, (label, marker, color) in DOTS.items():
        run = results["sets"] if peer == "gtsam" else sets
        others = [run[name]["ratio"].get(peer, np.nan) for name in names]
        axes.plot(others, range(len(names)), marker, color=color, markersize=5, markeredgecolor="w", label=label)
    axes.set(xscale="log", xlim=(0.015, MOST), ylim=(-0.6, len(names) - 0.4))
    ticks = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), [f"{name}, {sets[name]['edges']:,} edges" for name in names])
    axes.set_xlabel("time of leadline / time of the other, from file to optimum, one thread")
    axes.axvline(1, color="k", linewidth=1)
    axes.spines[["top", "right"]].set_visible(False)
    axes.annotate("leadline is faster", (0.97, 1.01), xycoords=("data", "axes fraction"), ha="right", color=FASTER)
    axes.annotate("g2o is faster", (1.03, 1.01), xycoords=("data", "axes fraction"), color=SLOWER)
    axes.legend(loc="upper right", frameon=False)
    return [figure], [1.0]
