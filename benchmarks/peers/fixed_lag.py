"""GTSAM's incremental fixed-lag smoother on the worlds of benchmarks/evidence/window.py, in a process of its own.

    python benchmarks/peers/fixed_lag.py WORLDS.npz OUT.npz LAG [THRESHOLD SKIP UPDATES]

A landmark has the time of the last pose that saw it. Its landmarks leave as ours do, with that pose. The numbers are
iSAM2's relinearization threshold and skip, and the updates of a step.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import process_time
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

sys.path.append(str(Path(__file__).parents[1]))
from harness import peak_memory

EARLY = 1000  # steps, for memory


def drive(world: dict[str, Any], lag: int, threshold: float, skip: int, updates: int) -> dict[str, Any]:
    """The last pose X (3,) and its covariance P (3, 3); processor time of every step, s, and memory, bytes."""
    sigmas = {n[6:]: gtsam.noiseModel.Diagonal.Sigmas(world[n]) for n in world if n.startswith("sigma_")}
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(threshold)
    parameters.relinearizeSkip = skip
    smoother, latest = gtsam.IncrementalFixedLagSmoother(lag, parameters), gtsam.Pose2(*world["first"])
    matches = {int(name.split()[1]): z for name, z in world.items() if name.startswith("match ")}  # by poses back
    seconds, memory = [], []
    for k in range(len(world["step"]) + 1):
        graph, values, times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {X(k): float(k)}
        if k == 0:
            graph.push_back(gtsam.PriorFactorPose2(X(0), latest, sigmas["first"]))
        else:
            step = gtsam.Pose2(*world["step"][k - 1])
            graph.push_back(gtsam.BetweenFactorPose2(X(k - 1), X(k), step, sigmas["step"]))
            latest = latest.compose(step)
        values.insert(X(k), latest)
        for back, z in matches.items():
            if k >= back:
                match = gtsam.Pose2(*z[k - back])
                graph.push_back(gtsam.BetweenFactorPose2(X(k - back), X(k), match, sigmas["match"]))
        for row in np.flatnonzero(world.get("fixed", np.zeros(0)) == k).tolist():
            graph.push_back(gtsam.PoseTranslationPrior2D(X(k), world["fix"][row], sigmas["fix"]))
        for row in np.flatnonzero(world.get("pose", np.zeros(0)) == k).tolist():
            l, (bearing, distance) = int(world["landmark"][row]), world["seen"][row]
            if not smoother.getLinearizationPoint().exists(L(l)):
                values.insert(L(l), latest.transformFrom(distance * np.array([np.cos(bearing), np.sin(bearing)])))
            times[L(l)] = float(k)
            graph.push_back(gtsam.BearingRangeFactor2D(X(k), L(l), gtsam.Rot2(bearing), distance, sigmas["seen"]))
        began = process_time()
        smoother.update(graph, values, times)
        for _ in range(updates - 1):
            smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), {})
        latest = smoother.calculateEstimatePose2(X(k))
        seconds.append(process_time() - began)
        if k in (EARLY, len(world["step"])):
            memory.append(peak_memory(reset=True))
    last = [latest.x(), latest.y(), latest.theta()]
    return {"X": last, "P": smoother.marginalCovariance(X(k)), "seconds": seconds, "memory": memory}


def main(worlds: str, out: str, lag: str, threshold: str = "0.001", skip: str = "1", updates: str = "3") -> None:
    with np.load(worlds) as file:
        count = int(file["count"])
        parts = [{n.partition("/")[2]: file[n] for n in file.files if n.startswith(f"{k}/")} for k in range(count)]
    runs = [drive(world, int(lag), float(threshold), int(skip), int(updates)) for world in parts]
    np.savez(out, **{name: np.array([run[name] for run in runs]) for name in runs[0]})


if __name__ == "__main__":
    main(*sys.argv[1:])
