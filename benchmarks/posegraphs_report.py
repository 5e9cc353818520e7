"""Table, figure and JSON of posegraphs.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

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
    "- ms: processor time from the file to the optimum (load + start + optimize), one thread; other work on the "
    "machine hardly changes it. Ratios are of processor times; wall clocks are in the last table",
    "- every optimization ends where the cost falls by less than 1e-6 of it. 'optimum': within 1e-6 of the lowest "
    "cost any variant of that library reaches; 'not converged': further; 'another optimum': more than 1 % higher",
    "- the variant shown is the fastest of those that reached the lowest cost of their library. A variant ran once "
    "if it took twice the time of the fastest in the first round, or ten times leadline's",
    "- chi2: of the solution, evaluated here, in g2o's residual for everybody and in GTSAM's. GTSAM's is Log, in "
    "space with 4 times the rotation information of the file",
    "- every solution is the optimum of its own cost. The cost that a library states for its solution is compared "
    "with that first. A library that differs has no time",
    "- every contender reads the same plain g2o file: compressed ones were unpacked, and FR079 and the iSAM files "
    "converted, beforehand; C++ programs read manhattan, CSAIL and kitti_00, which have edges only, with a start for "
    "every pose added",
    "- peak: resident memory of the whole process at the end, libraries included",
]
CALLS = "a Python function per edge is called back, which is where the time goes: it says nothing about"
PARTS = "ms and ratio are of start + optimize, on both sides"
PEERS = {
    "gtsam": "gtsam: `readG2o`, a tight prior on the first pose. Starts: the file's, chordal (in the plane LAGO, "
    "which refuses noise that is not diagonal) or FastSync (which refuses noise that is not isotropic). Methods: "
    "Gauss-Newton (GN) or Levenberg-Marquardt (LM), COLAMD or METIS, and GN also with the new MULTIFRONTAL_SOLVER",
    "g2o_cpp": "g2o_cpp: g2o's C++ libraries, with CHOLMOD; own reader, start from the file or along a spanning tree",
    "ceres_cpp": "ceres_cpp: Ceres' C++ library, with CHOLMOD; start from the file. The reader and the pose-graph "
    "cost, with automatic derivatives, are ours: `benchmarks/peers/ceres_driver.cpp`",
    "g2o": "g2o: the wheel registers no tag of the format (`load` returns True and reads nothing), so that a Python "
    f"loop builds its graph; {PARTS}",
    "pyceres": f"pyceres: has no pose-graph cost; {CALLS} Ceres in C++; sets below 1,500 edges only; {PARTS}",
    "symforce": f"symforce: {CALLS} SymForce in C++; sets below 1,500 edges only; {PARTS}",
}
DOTS = {"g2o_cpp": "g2o in C++", "g2o": "g2o's wheel, reading not counted"}


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
    """posegraphs.md, posegraphs.json and, where GTSAM ran, posegraphs.png."""
    sets = results["sets"]
    lines = ["# Pose graphs from file to optimum", "", *results["machine"], f"- rounds: {results['rounds']}", *HEAD]
    if results["simulated"]:
        lines.append("- simulated worlds: LEADLINE_DATA names no folder of public sets")
    ran = [peer for peer in PEERS if any(peer in found["runs"] for found in sets.values())]
    lines += [f"- {PEERS[peer]}" for peer in ran]
    lines += [f"- {note}" for note in results["notes"]]
    lines += ["", *fastest(sets), "", *matched(sets), "", *stages(sets), "", *every(sets)]
    (folder / "posegraphs.md").write_text("\n".join(lines) + "\n")
    (folder / "posegraphs.json").write_text(json.dumps(results, indent=1) + "\n")
    draw(sets, folder / "posegraphs.png")
    print("\n" + "\n".join(lines[: -len(every(sets))]))
    slower = [
        f"  {name}: {ratio:.2f} of {peer}"
        for name, found in sets.items()
        for peer, ratio in found["ratio"].items()
        if ratio > 1
    ]
    print("slower than a peer:\n" + "\n".join(slower) if slower else "faster than every peer on every set")


def fastest(sets: dict[str, Any]) -> list[str]:
    """One row per set and library: its fastest variant that converged, and the ratio."""
    lines = [
        "| set | edges | library | variant | ms | leadline / it, one thread | iterations "
        "| chi2 (g2o) | chi2 (GTSAM) | peak, MB |"
    ]
    lines.append("|:--|--:|:--|:--|--:|--:|--:|--:|--:|--:|")
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
            chi2 = " | ".join(f"{run['chi2'][c]:.7g}" for c in ("g2o", "gtsam"))
            cells = [name, f"{found['edges']:,}", peer, title, ms(run["total"]), ratio, str(run["iterations"])]
            lines.append(f"| {' | '.join(cells)} | {chi2} | {run['peak']:.0f} |")
    worse = [f"{peer} on {name}" for name, found in sets.items() for peer in found["theirs_is_lower"]]
    return lines + (["", f"A lower optimum than leadline's was reached by {', '.join(worse)}."] if worse else [])


def matched(sets: dict[str, Any]) -> list[str]:
    """How far every library is from the lowest cost of its kind after as many iterations as leadline takes."""
    rows = []
    for name, found in sets.items():
        ours = found["runs"]["leadline"]["auto"]
        for peer, chi2 in {"leadline": ours["chi2"], **found["matched"]}.items():
            cost = "gtsam" if peer == "gtsam" else "g2o"
            above = chi2[cost] / found["optimum"][cost] - 1
            rows.append(f"| {name} | {peer} | {found['fastest'][peer]} | {ours['iterations']} | {above:.1e} |")
    if len(rows) == len(sets):
        return []
    text = (
        "Every library by its fastest variant; relative to where leadline's solution leads in the library's own cost."
    )
    head = "| set | library | variant | iterations | cost above the optimum |"
    return ["## Costs after equally many iterations", "", text, "", head, "|:--|:--|:--|--:|--:|", *rows]


def bars(sets: dict[str, Any], peer: str) -> list[str]:
    """The chart of the README: a bar a set, leadline's time over a peer's, the largest set first; ten blocks are 1."""
    rows = []
    for name, found in sorted(sets.items(), key=lambda item: -item[1]["edges"]):
        if peer in found["ratio"] and "truth" not in name:
            ratio = found["ratio"][peer]
            bar = ("█" * round(10 * ratio)).ljust(10, "·") if ratio < 4 else "█" * 39 + "▶"
            rows.append(f"{name:18s} {found['edges']:6,}  {bar} {ratio:.2f}")
    return rows


def stages(sets: dict[str, Any]) -> list[str]:
    """Where leadline's time goes, and all marginal covariances, on the sets that were asked for."""
    staged = {name: found for name, found in sets.items() if "marginals" in found}
    if not staged:
        return []
    lines = ["## Where leadline's time goes, ms of wall clock", ""]
    lines += ["| set | parse and build | start | " + " | ".join(title for title, _ in STAGES.values()) + " |"]
    lines += ["|:--|" + "--:|" * (2 + len(STAGES))]
    for name, found in staged.items():
        run = found["runs"]["leadline"]["auto"]
        per = max(run["iterations"], 1)
        cells = [ms(run["wall"]["load"]), ms(run["wall"]["start"])]
        cells += [ms(run["timings"].get(k, 0.0) / (per if each else 1)) for k, (_, each) in STAGES.items()]
        lines.append(f"| {name} ({per} iterations) | {' | '.join(cells)} |")
    lines += ["", "From 'linearize' on: per iteration. The start is evaluated once more than there are iterations."]
    lines += [
        "",
        "## Covariances of all poses, ms of processor time",
        "",
        "| set | leadline | gtsam | gtsam / leadline |",
    ]
    lines += ["|:--|--:|--:|--:|"]
    for name, found in staged.items():
        ours, theirs = found["marginals"]["leadline"], found["marginals"].get("gtsam")
        other = "not installed | " if theirs is None else f"{ms(theirs)} | {theirs / ours:.1f}"
        lines.append(f"| {name} | {ms(ours)} | {other} |")
    return [*lines, "", "Both linearize, factorize and compute the covariance of every pose, at their own solution."]


def every(sets: dict[str, Any]) -> list[str]:
    """One row per variant that was run."""
    lines = [
        "## Every variant",
        "",
        "| set | library | variant | ms | wall, ms | load | start | optimize | iterations ",
    ]
    lines[-1] += "| chi2 (g2o) | chi2 (GTSAM) | peak, MB | outcome |"
    lines.append("|:--|:--|:--|" + "--:|" * 9 + ":--|")
    for name, found in sets.items():
        for peer, variants in found["runs"].items():
            for variant, run in variants.items():
                if "failed" in run:
                    lines.append(f"| {name} | {peer} | {variant} |{' |' * 9} {run['failed'].replace('|', '/')} |")
                    continue
                cpu, wall = run["cpu"], sum(run["wall"].values())
                cells = [name, peer, variant, *map(ms, (run["total"], wall, *cpu.values())), str(run["iterations"])]
                cells += [f"{run['chi2'][c]:.9g}" for c in ("g2o", "gtsam")] + [f"{run['peak']:.0f}", run["outcome"]]
                lines.append(f"| {' | '.join(cells)} |")
    return lines


def draw(sets: dict[str, Any], path: Path) -> None:
    """A bar per set: leadline's time over that of GTSAM, sorted; dots: over that of others in compiled code."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator

    from nls.plot.style import BEFORE, CLOSURE, ESTIMATE, HELD, REJECTED

    shown = {name: found for name, found in sets.items() if "gtsam" in found["ratio"]}
    if not shown:
        return
    names = sorted(shown, key=lambda name: -shown[name]["ratio"]["gtsam"])
    bars = np.array([shown[name]["ratio"]["gtsam"] for name in names])
    dots = {peer: np.array([shown[name]["ratio"].get(peer, np.nan) for name in names]) for peer in DOTS}
    dots = {peer: ratios for peer, ratios in dots.items() if np.isfinite(ratios).any()}
    figure = Figure(figsize=(8, 1.6 + 0.32 * len(names)), layout="constrained")
    axes = figure.subplots()
    other = [shown[n]["runs"]["gtsam"][shown[n]["fastest"]["gtsam"]]["outcome"] != "optimum" for n in names]
    colors = np.where(other, HELD, np.where(bars < 1, ESTIMATE, REJECTED))
    axes.barh(range(len(names)), bars - 1, left=1, color=colors, height=0.7)
    for y, bar in enumerate(bars):
        axes.annotate(f"{bar:.2f}" + " *" * other[y], (1.01, y), xycoords=("axes fraction", "data"), va="center")
    for (peer, x), color in zip(dots.items(), (BEFORE, CLOSURE), strict=False):
        axes.plot(x, range(len(names)), "o", color=color, markeredgecolor="0.2", label=DOTS[peer])
    if dots:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.02), fontsize=9, frameon=False)
    axes.set_yticks(range(len(names)), [f"{name}  ({shown[name]['edges']:,} edges)" for name in names])
    ratios = np.concatenate([bars, *(x[np.isfinite(x)] for x in dots.values())])
    low, high = min(ratios.min() / 1.8, 0.5), max(ratios.max() * 1.6, 2.0)
    ticks = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200) if low <= t <= high]
    label = "processor time of leadline / of GTSAM, from file to optimum, one thread"
    label += "\n* GTSAM ends at another optimum" if any(other) else ""
    axes.set(xscale="log", xlim=(low, high), ylim=(-0.7, len(names) - 0.3), xlabel=label)
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticklabels([f"{t:g}" for t in ticks])
    axes.axvline(1, color="0.2", linewidth=1)
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    for x, side in ((0.0, "left"), (1.0, "right")):
        text = "← leadline is faster" if side == "left" else "GTSAM is faster →"
        axes.annotate(
            text, (x, 1.0), (0, 4), xycoords="axes fraction", textcoords="offset points", ha=side, color="0.3"
        )
    figure.savefig(path, dpi=130)


if __name__ == "__main__":  # the chart of the README, of the results as they are
    results = json.loads((Path(__file__).parent / "results" / "posegraphs.json").read_text())
    print("\n".join(bars(results["programs"]["sets"], "g2o_cpp")))
