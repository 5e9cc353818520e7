"""Table, figure and JSON of posegraphs.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from harness import RESULTS, Table, figure_first, line_of, markdown, spaced

STAGES = {  # key of Result.timings: title, whether it is shown for one iteration
    "build": ("pattern", False),
    "analyze": ("ordering + symbolic", False),
    "linearize": ("linearize", True),
    "assemble": ("assemble", True),
    "factorize": ("factorize", True),
    "solve": ("solve", True),
    "retract": ("retract", True),
}
HEAD = [
    "- a fresh process for every run, rounds interleaved, medians; libraries are imported before the clock starts",
    "- ms: processor time from the file to the optimum (load, initial guess, optimize), one thread; other work hardly "
    "changes it. The last table has wall times",
    "- the others stop when the cost falls by less than 1e-6 of it; leadline when an update promises that, or 1e-6 a "
    "degree of freedom where that is less",
    "- 'optimum': within 1e-6 of the lowest cost that a variant of that library reaches; 'another optimum': more than "
    "1 % above it; 'not converged': between",
    "- shown is the fastest variant that reached the lowest cost of its library. A variant ran only once if its first "
    "round took twice the fastest time, or ten times leadline's",
    "- chi2: every solution is evaluated here with g2o's residual and with GTSAM's. GTSAM's is Log, in space with 4 "
    "times the rotation information of the file",
    "- the cost that a library states is first compared with ours for its solution. A library that differs has no time",
    "- every library reads the same plain g2o file; compressed files, FR079 and the iSAM files were converted before. "
    "manhattan, CSAIL and kitti_00 have edges only: for C++ programs the file has an initial guess of every pose, too",
    "- peak: resident memory of the whole process at the end, libraries included",
]
PEERS = {
    "gtsam": "gtsam: `readG2o`, a tight prior on the first pose. Initial guess: the file's, chordal (in the plane "
    "LAGO, for diagonal noise only) or FastSync (for isotropic noise only). Methods: "
    "Gauss-Newton (GN) or Levenberg-Marquardt (LM), COLAMD or METIS, and GN also with the new MULTIFRONTAL_SOLVER",
    "g2o_cpp": "g2o_cpp: g2o's C++ libraries, with CHOLMOD; own reader, initial guess of file or spanning tree",
    "ceres_cpp": "ceres_cpp: Ceres' C++ library, with CHOLMOD; initial guess of the file. Reader and cost, with "
    "automatic derivatives, are ours: `benchmarks/peers/ceres_driver.cpp`",
}
PICTURE = "![A bar a set: time of leadline over that of g2o. Marks: over those of GTSAM and Ceres](posegraphs.png)"


def ms(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def line(name: str, found: dict[str, Any]) -> str:
    """One line for the terminal."""
    ours = found["runs"]["leadline"]["auto"]
    said = [f"{name:20s}{found['edges']:7,} edges   leadline {ms(ours.get('total', np.nan)):>6s} ms"]
    for peer, ratio in found["ratio"].items():
        best = found["fastest"][peer]
        said.append(f"{peer} {ms(found['runs'][peer][best]['total'])} ({best}) ratio {ratio:.2f}, one thread")
    return "   ".join(said)


def write(results: dict[str, Any], folder: Path) -> None:
    """posegraphs.md, posegraphs.json and, where g2o ran, posegraphs.png."""
    sets = results["sets"]
    lines = ["# Pose graphs from file to optimum", *results["machine"], f"- rounds: {results['rounds']}", *HEAD]
    if results["simulated"]:
        lines.append("- simulated worlds: LEADLINE_DATA names no folder of public sets")
    for peer, about in PEERS.items():
        runs = [run for found in sets.values() for run in found["runs"].get(peer, {}).values()]
        versions = {run["said"]["version"] for run in runs if "failed" not in run}
        lines += [f"- {'. '.join([about, *sorted(versions)])}"] if runs else []
    lines += [f"- {note}" for note in results["notes"]]
    lines += [PICTURE] if charted(sets) else []
    lines = figure_first([*lines, *fastest(sets), *matched(sets), *stages(sets)])
    shown = "\n".join(spaced(lines))
    (folder / "posegraphs.md").write_text("\n".join(spaced([*lines, *every(sets)])) + "\n")
    (folder / "posegraphs.json").write_text(json.dumps(results, indent=1) + "\n")
    draw(sets, folder / "posegraphs.png")
    print(f"\n{shown}\n")
    print("\n".join(beside(peer, sets) for peer in PEERS))


def beside(peer: str, sets: dict[str, Any]) -> str:
    """On how many sets a peer has a time, and on which of them leadline takes longer."""
    ratios = {name: found["ratio"][peer] for name, found in sets.items() if peer in found["ratio"]}
    if not ratios:
        return f"{peer}: not compared, it has a time on none of {len(sets)} sets"
    slower = ", ".join(f"{name} ({ratio:.2f} of its time)" for name, ratio in ratios.items() if ratio > 1)
    where = f"slower on {slower}" if slower else "faster on all of them"
    return f"{peer}: compared on {len(ratios)} of {len(sets)} sets; leadline is {where}"


def fastest(sets: dict[str, Any]) -> list[str]:
    """One row per set and library: its fastest variant that converged, and the ratio."""
    titles = ["set", "edges", "library", "variant", "ms", "leadline / it, one thread", "iterations", "chi2 (g2o)"]
    lines: list[str] = Table([*titles, "chi2 (GTSAM)", "peak, MB"], "lrllrrrrrr")
    for name, found in sets.items():
        for peer, variants in found["runs"].items():
            if peer not in found["fastest"]:
                why = next(iter(variants.values()))["failed"]
                lines.append(f"| {name} | {found['edges']:,} | {peer} | failed: {why} | | | | | | |")
                continue
            variant = found["fastest"][peer]
            run = variants[variant]
            title = run["said"]["start"] if peer == "leadline" else variant
            if run["outcome"] != "optimum":
                title += f" ({run['outcome']})"
            ratio = f"{found['ratio'][peer]:.2f}" if peer in found["ratio"] else ""
            cells = [name, f"{found['edges']:,}", peer, title, ms(run["total"]), ratio, run["iterations"]]
            chi2 = (f"{run['chi2'][c]:.7g}" for c in ("g2o", "gtsam"))
            lines.append(line_of([*cells, *chi2, f"{run['peak']:.0f}"]))
    worse = [f"{peer} on {name}" for name, found in sets.items() for peer in found["theirs_is_lower"]]
    return lines + ([f"A lower optimum than leadline's was reached by {', '.join(worse)}."] if worse else [])


def matched(sets: dict[str, Any]) -> list[str]:
    """How far every library is from the lowest cost of its kind after as many iterations as leadline takes."""
    rows = []
    for name, found in sets.items():
        ours = found["runs"]["leadline"]["auto"]
        for peer, chi2 in {"leadline": ours["chi2"], **found["matched"]}.items():
            cost = "gtsam" if peer == "gtsam" else "g2o"
            above = chi2[cost] / found["optimum"][cost] - 1
            rows.append([name, peer, found["fastest"][peer], ours["iterations"], f"{above:.1e}"])
    if len(rows) == len(sets):
        return []
    return [
        "## Costs after equally many iterations",
        "Fastest variant of every library. The optimum: the library's own cost, minimized from leadline's solution.",
        *markdown(["set", "library", "variant", "iterations", "cost above the optimum"], rows, names=3),
    ]


def charted(sets: dict[str, Any]) -> dict[str, Any]:
    """The noisy sets on which g2o ran, the largest first."""
    shown = {name: found for name, found in sets.items() if "g2o_cpp" in found["ratio"] and "truth" not in name}
    return dict(sorted(shown.items(), key=lambda item: -item[1]["edges"]))


def bars(sets: dict[str, Any]) -> list[str]:
    """The chart of the README: a bar a set, leadline's time over that of g2o; ten blocks are 1."""
    rows = []
    for name, found in charted(sets).items():
        ratio = found["ratio"]["g2o_cpp"]
        bar = ("█" * round(10 * ratio)).ljust(10, "·") if ratio < 4 else "█" * 39 + "▶"
        rows.append(f"{name:18s} {found['edges']:6,}  {bar} {ratio:.2f}")
    return rows


def stages(sets: dict[str, Any]) -> list[str]:
    """Where leadline's time goes, and all marginal covariances, on the sets that were asked for."""
    staged = {name: found for name, found in sets.items() if "marginals" in found}
    if not staged:
        return []
    times, covariances = [], []
    for name, found in staged.items():
        run = found["runs"]["leadline"]["auto"]
        per = max(run["iterations"], 1)
        spent = [run["timings"].get(k, 0.0) / (per if each else 1) for k, (_, each) in STAGES.items()]
        times.append([f"{name} ({per} iterations)", *map(ms, (run["wall"]["load"], run["wall"]["start"], *spent))])
        ours, theirs = found["marginals"]["leadline"], found["marginals"].get("gtsam")
        other = ("not installed", "") if theirs is None else (ms(theirs), f"{theirs / ours:.1f}")
        covariances.append([name, ms(ours), *other])
    return [
        "## Where leadline's time goes, ms of wall clock",
        *markdown(["set", "parse and build", "initial guess", *(title for title, _ in STAGES.values())], times),
        "From 'linearize' on: per iteration; there is one more evaluation than iterations, of the initial guess.",
        "## Covariances of all poses, ms of processor time",
        *markdown(["set", "leadline", "gtsam", "gtsam / leadline"], covariances),
        "Leadline and GTSAM each linearize, factorize and compute the covariance of every pose, at their own solution.",
    ]


def every(sets: dict[str, Any]) -> list[str]:
    """One row per variant that was run."""
    titles = ["set", "library", "variant", "ms", "wall, ms", "load", "start", "optimize", "iterations", "chi2 (g2o)"]
    lines = ["## Every variant", *Table([*titles, "chi2 (GTSAM)", "peak, MB", "outcome"], "lllrrrrrrrrrl")]
    for name, found in sets.items():
        for peer, variants in found["runs"].items():
            for variant, run in variants.items():
                if "failed" in run:
                    lines.append(f"| {name} | {peer} | {variant} |{' |' * 9} {run['failed'].replace('|', '/')} |")
                    continue
                cpu, wall = run["cpu"], sum(run["wall"].values())
                cells = [name, peer, variant, *map(ms, (run["total"], wall, *cpu.values())), run["iterations"]]
                cells += [f"{run['chi2'][c]:.9g}" for c in ("g2o", "gtsam")] + [f"{run['peak']:.0f}", run["outcome"]]
                lines.append(line_of(cells))
    return lines


def draw(sets: dict[str, Any], path: Path) -> None:
    """A bar a set: leadline's time over that of g2o. Marks: over GTSAM and Ceres, where they reach the optimum."""
    from matplotlib.figure import Figure

    from nls.plot.style import CLOSURE, ECHO, ESTIMATE, REJECTED

    shown = charted(sets)
    if not shown:
        return

    def ratio(found: dict[str, Any], peer: str) -> float:
        if peer not in found["ratio"] or found["runs"][peer][found["fastest"][peer]]["outcome"] != "optimum":
            return np.nan
        return float(found["ratio"][peer])

    def ratios(peer: str) -> np.ndarray[Any, Any]:
        return np.array([ratio(found, peer) for found in shown.values()])

    y, g2o = np.arange(len(shown)), ratios("g2o_cpp")
    figure = Figure(figsize=(8, 1.5 + 0.3 * len(shown)), layout="constrained")
    axes = figure.subplots()
    axes.barh(y, g2o - 1, left=1, height=0.7, color=np.where(g2o < 1, ESTIMATE, REJECTED))
    for row, number in zip(y, g2o, strict=True):
        axes.annotate(f"{number:.2f}", (1.01, row), xycoords=("axes fraction", "data"), va="center")
    for peer, label, marker, color in (("gtsam", "GTSAM", "s", ECHO), ("ceres_cpp", "Ceres in C++", "D", CLOSURE)):
        axes.plot(ratios(peer), y, marker, color=color, markersize=5, markeredgecolor="w", label=f"over {label}")
    ticks = (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
    axes.set(xscale="log", xlim=(0.02, 60), ylim=(len(shown) - 0.4, -0.6))
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_yticks(y, [f"{name}, {found['edges']:,} edges" for name, found in shown.items()])
    axes.set_xlabel("bars: processor time of leadline over g2o in C++, file to optimum, one thread")
    axes.axvline(1, color="k", linewidth=1)
    axes.spines[["top", "right"]].set_visible(False)
    axes.annotate("← leadline is faster", (0.93, 1.01), xycoords=("data", "axes fraction"), ha="right", color=ESTIMATE)
    axes.annotate("g2o is faster →", (1.07, 1.01), xycoords=("data", "axes fraction"), color=REJECTED)
    axes.legend(loc="lower left", frameon=False)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":  # the page and the picture anew from the numbers as they are, and the chart of the README
    results = json.loads((RESULTS / "posegraphs.json").read_text())
    write(results, RESULTS)
    print("\n".join(bars(results["sets"])))
