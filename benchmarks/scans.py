"""Time and memory of closing loops by scans as missions grow, all at once and while the vehicle drives.

    python benchmarks/scans.py [--quick] [--largest KEYFRAMES] [--out DIR]

A vehicle goes twice around each basin of a made-up harbor, basin after basin, a keyframe every meter with 100 points.
Each size is measured in fresh processes with one BLAS thread.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from harness import Table, child, exponent, make_page, peak_memory, positive, timed

SIZES = (250, 500, 1000, 2000, 4000)
POINTS = 100  # of a keyframe
SIDE, LAPS = 25, 2  # m of a basin; rounds of each
APART = 60.0  # m from basin to basin
SIGHT, FIELD = 25.0, np.radians(65)  # m; to either side
NOISE = 0.1  # m, of a point
DRIFT = 0.05  # of the way
ROUNDS = 2  # of closing
UPPER = 3  # sizes to which exponents are fitted
STAGES = ("pairs", "windows", "matching", "solving", "other")

Array = npt.NDArray[np.float64]


# --- the made-up mission ----------------------------------------------------------------------------------------------


def way(count: int) -> Array:
    """True poses (count, 3), 1 m apart: around squares, one beside the other."""
    x = np.zeros((count, 3))
    for k in range(1, count):
        px, py, yaw = x[k - 1]
        lap = k % (4 * SIDE * LAPS + int(APART))
        yaw = lap // SIDE % 4 * np.pi / 2 if lap < 4 * SIDE * LAPS else 0.0  # else on to the next one
        x[k] = px + np.cos(yaw), py + np.sin(yaw), yaw
    return x


def structures(poses: Array, rng: np.random.Generator) -> Array:
    """Points (m, 2) on piers of 3 to 12 m around the way, away from it."""
    low, high = poses[:, :2].min(axis=0) - 20, poses[:, :2].max(axis=0) + 20
    count = int(np.prod(high - low) / 80)
    start, angle, length = rng.uniform(low, high, (count, 2)), rng.uniform(0, np.pi, count), rng.uniform(3, 12, count)
    along = np.arange(0, 12, 0.25)
    points = start[:, None] + along[None, :, None] * np.column_stack([np.cos(angle), np.sin(angle)])[:, None]
    return np.asarray(points[along[None] < length[:, None]])


def mission(count: int) -> tuple[Array, Array, list[Array]]:
    """True poses (count, 3), reckoned ones, and the points (100, 2) of every keyframe in the frame of the vehicle."""
    from scipy.spatial import cKDTree

    from models import SE2

    rng = np.random.default_rng(0)
    truth = way(count)
    world = structures(truth, rng)
    steps = SE2.between(truth[:-1], truth[1:])
    drift = rng.normal(0, DRIFT, (count // 25 + 1, 2))[np.arange(count - 1) // 25]
    steps += np.column_stack([drift + rng.normal(0, 0.03, (count - 1, 2)), rng.normal(0, 0.002, count - 1)])
    reckoned = [truth[0]]
    for step in steps:
        reckoned.append(SE2.compose(reckoned[-1][None], step[None])[0])
    tree, scans = cKDTree(world), []
    for pose, near in zip(truth, tree.query_ball_point(truth[:, :2], SIGHT), strict=True):
        q = SE2.act(SE2.inverse(np.repeat(pose[None], len(near), axis=0)), world[near])
        ahead = np.flatnonzero(np.abs(np.arctan2(q[:, 1], q[:, 0])) < FIELD)
        rows = rng.permutation(ahead)[:POINTS]
        scans.append(q[rows] + rng.normal(0, NOISE, (len(rows), 2)))
    return truth, np.array(reckoned), scans


# --- one measurement, in a process of its own -------------------------------------------------------------------------


def all_at_once(keyframes: str) -> dict[str, Any]:
    """Seconds by stage of `close`, meters of the map from the truth, and peak memory."""
    from nls.missions.scans import Scans, close, closing, dead_reckoning

    truth, reckoned, points = mission(count := int(keyframes))
    scans = Scans(np.concatenate(points), np.repeat(np.arange(count), [len(p) for p in points]), count)
    seconds = dict.fromkeys(STAGES, 0.0)

    def watch(owner: Any, name: str, stage: str) -> None:
        inner = getattr(owner, name)

        def watched(*arguments: Any, **options: Any) -> Any:
            found, spent = timed(inner, *arguments, **options)
            seconds[stage] += spent
            return found

        setattr(owner, name, watched)

    for owner, name, stage in (
        (closing, "pairs", "pairs"),
        (closing, "half_widths", "windows"),
        (closing.Matches, "around", "matching"),
        (closing, "sequential_matches", "matching"),
        (closing, "chosen", "solving"),
    ):
        watch(owner, name, stage)
    before = peak_memory(reset=True)
    result, seconds["total"] = timed(lambda: close(*dead_reckoning(reckoned), scans, rounds=ROUNDS))
    seconds["other"] = seconds["total"] - sum(seconds[stage] for stage in STAGES)
    matches = result.matches
    x = result.rounds[-1].poses
    return {
        "keyframes": count,
        "seconds": seconds,
        "bytes": peak_memory() - before,
        "matched": sum(len(part.matches) for part in result.rounds),
        "closures": int(matches.kept.sum()),
        "reckoned": rmse(reckoned, truth),
        "off": rmse(x, truth),
    }


def while_driving(keyframes: str) -> dict[str, Any]:
    """Milliseconds of every keyframe, meters of the map from the truth in the end, and peak memory."""
    from nls.missions.scans import OnlineClosing

    truth, reckoned, points = mission(count := int(keyframes))
    before = peak_memory(reset=True)
    online, seconds = OnlineClosing(), np.zeros(count)
    for k in range(count):
        seconds[k] = timed(online.update, reckoned[k], points[k])[1]
    return {
        "keyframes": count,
        "total": float(seconds.sum()),
        "median": 1e3 * float(np.median(seconds)),
        "p99": 1e3 * float(np.quantile(seconds, 0.99)),
        "worst": 1e3 * float(seconds.max()),
        "last": 1e3 * float(seconds[-count // 10 :].mean()),
        "bytes": peak_memory() - before,
        "off": rmse(online.poses, truth),
    }


def rmse(poses: Array, truth: Array) -> float:
    """Of the positions, the first pose being known, m."""
    return float(np.sqrt(np.square(poses[:, :2] - truth[:, :2]).sum(axis=1).mean()))


# --- the report -------------------------------------------------------------------------------------------------------


def tables(whole: list[dict[str, Any]], online: list[dict[str, Any]]) -> list[str]:
    """Markdown: all at once, then while the vehicle drives, one row a size."""
    n = [run["keyframes"] for run in whole][-UPPER:]

    def laws(runs: list[Any], names: Sequence[str]) -> list[str]:
        return [f"{exponent(n, [run[name] for run in runs][-UPPER:]):.2f}" for name in names]

    lines = Table(
        ["keyframes", "matched", "closures", *STAGES, "**total, s**", "memory, MB", "reckoned, m", "map, m"], names=0
    )
    for run in whole:
        cells = [f"{run['keyframes']:,}", f"{run['matched']:,}", f"{run['closures']:,}"]
        cells += [f"{run['seconds'][stage]:.3g}" for stage in STAGES] + [f"**{run['seconds']['total']:.3g}**"]
        lines.add(*cells, f"{run['bytes'] / 1e6:,.0f}", f"{run['reckoned']:.2f}", f"{run['off']:.2f}")
    columns = ("keyframes", "total, s", "median, ms", "p99", "worst", "mean of the last tenth", "memory, MB", "map, m")
    others = Table(columns, names=0)
    for run in online:
        times = [f"{run[name]:.3g}" for name in ("total", "median", "p99", "worst", "last")]
        others.add(f"{run['keyframes']:,}", *times, f"{run['bytes'] / 1e6:,.0f}", f"{run['off']:.2f}")
    if len(n) == UPPER:
        seconds = laws([run["seconds"] for run in whole], (*STAGES, "total"))
        lines.append(f"| keyframes^p | | | {' | '.join([*seconds, *laws(whole, ['bytes'])])} | | |")
        online_laws = laws(online, ("total", "last", "bytes"))
        others.append("| keyframes^p | {} | | | | {} | {} | |".format(*online_laws))
    return [f"## All at once, {ROUNDS} rounds", *lines, "## While the vehicle drives", *others]


def page(quick: bool, largest: float) -> list[str]:
    """The page without its head."""
    sizes = [size for size in SIZES if size <= (SIZES[0] if quick else largest)]
    run = partial(child, sys.executable, __file__, "--child")
    whole, online = ([run(what, size) for size in sizes] for what in ("whole", "online"))
    return [
        f"- The harbor is simulated. The vehicle goes {LAPS} times around each basin and takes a keyframe of "
        f"{POINTS} points every meter",
        "- Times are processor times of one thread. Memory is the peak of a fresh process above its memory before "
        "the run",
        "- map: rms error of the positions, m, with the first pose known; reckoned: that error by dead reckoning",
        "- No loop closure joins two basins. So the error of the heading between them turns a map of several basins",
        "- pairs: the search for submaps that may overlap; windows: covariances of their relative poses",
        "- solving: includes the choice of closures",
        f"- keyframes^p: exponents fitted to the {UPPER} largest sizes",
        *tables(whole, online),
    ]


if __name__ == "__main__":
    make_page(
        *("Scans to a map: time and memory", page, {"whole": all_at_once, "online": while_driving}),
        quick=f"{SIZES[0]} keyframes alone",
        largest={"type": positive, "default": SIZES[-1], "metavar": "KEYFRAMES"},
    )
