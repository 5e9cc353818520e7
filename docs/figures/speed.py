"""Time from the file to the optimum on public pose graphs of 1,000 to 21,000 edges: leadline, g2o, Ceres and GTSAM.

The picture of the README; `python docs/figures/speed.py` writes it to docs/images/speed.png from the numbers in
benchmarks/results/posegraphs.json.
"""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

ROOT = Path(__file__).parents[2]
WIDTH = 1040  # pixels
EDGES = (1_000, 21_000)
PROGRAMS = {  # in the results: name, color, marker
    "gtsam": ("GTSAM", "0.6", "s"),
    "ceres_cpp": ("Ceres", "#35b779", "D"),
    "g2o_cpp": ("g2o", "#b2182b", "o"),
    "leadline": ("leadline", "#0b4f6c", "o"),
}


def make() -> tuple[list[Figure], list[float]]:
    """The picture: a row a graph, a mark a program."""
    sets = json.loads((ROOT / "benchmarks/results/posegraphs.json").read_text())["sets"]
    shown = [(s["edges"], name) for name, s in sets.items() if EDGES[0] <= s["edges"] <= EDGES[1]]
    shown = sorted(pair for pair in shown if not pair[1].endswith(" truth"))  # noise-free ones are in the table
    figure = Figure(figsize=(10.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for program, (title, color, marker) in PROGRAMS.items():
        ms = [_fastest(sets[name], program) for _, name in shown]
        size = 110 if program == "leadline" else 45
        axes.scatter(ms, range(len(shown)), size, color=color, marker=marker, label=title, zorder=3)
    axes.set_yticks(range(len(shown)), [f"{name}, {edges:,} edges" for edges, name in shown])
    axes.set(xscale="log", xlabel="processor time from the file to the optimum [ms], one thread; left is faster")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.grid(color="0.9")
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.legend(loc="lower right", reverse=True, fontsize=11)
    return [figure], [0.0]


def _fastest(found: dict, program: str) -> float:
    """Milliseconds of the fastest variant that reached the optimum; nan where none did."""
    variant = found["fastest"].get(program, "auto" if program == "leadline" else None)
    return found["runs"][program][variant]["total"] if variant else np.nan


if __name__ == "__main__":
    (figure,), _ = make()
    figure.savefig(ROOT / "docs/images/speed.png", dpi=WIDTH / figure.get_figwidth())
