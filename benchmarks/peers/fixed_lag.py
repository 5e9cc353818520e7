"""GTSAM's incremental fixed-lag smoother on the worlds of benchmarks/evidence/window.py, in a process of its own.

    python benchmarks/peers/fixed_lag.py WORLDS.npz OUT.npz LAG

A landmark has the time of the last pose that saw it. Its landmarks leave as ours do, with that pose.
"""

from __future__ import annotations

import sys
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X


def drive(world: dict[str, Any], lag: int) -> tuple[Any, Any]:
    """The last pose (3,) and its covariance (3, 3)."""
    sigmas = {n[6:]: gtsam.noiseModel.Diagonal.Sigmas(world[n]) for n in world if n.startswith("sigma_")}
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.001)
    parameters.relinearizeSkip = 1
    smoother, latest = gtsam.IncrementalFixedLagSmoother(lag, parameters), gtsam.Pose2(*world["first"])
    for k in range(len(world["step"]) + 1):
        graph, values, times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {X(k): float(k)}
        if k == 0:
            graph.push_back(gtsam.PriorFactorPose2(X(0), latest, sigmas["first"]))
        else:
            step = gtsam.Pose2(*world["step"][k - 1])
            graph.push_back(gtsam.BetweenFactorPose2(X(k - 1), X(k), step, sigmas["step"]))
            latest = latest.compose(step)
        values.insert(X(k), latest)
        if k >= 5 and "match" in world:
            match = gtsam.Pose2(*world["match"][k - 5])
            graph.push_back(gtsam.BetweenFactorPose2(X(k - 5), X(k), match, sigmas["match"]))
        for row in np.flatnonzero(world.get("fixed", np.zeros(0)) == k).tolist():
            graph.push_back(gtsam.PoseTranslationPrior2D(X(k), world["fix"][row], sigmas["fix"]))
        for row in np.flatnonzero(world.get("pose", np.zeros(0)) == k).tolist():
            l, (bearing, distance) = int(world["landmark"][row]), world["seen"][row]
            if not smoother.getLinearizationPoint().exists(L(l)):
                values.insert(L(l), latest.transformFrom(distance * np.array([np.cos(bearing), np.sin(bearing)])))
            times[L(l)] = float(k)
            graph.push_back(gtsam.BearingRangeFactor2D(X(k), L(l), gtsam.Rot2(bearing), distance, sigmas["seen"]))
        smoother.update(graph, values, times)
        for _ in range(2):
            smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), {})
        latest = smoother.calculateEstimatePose2(X(k))
    return [latest.x(), latest.y(), latest.theta()], smoother.marginalCovariance(X(k))


def main(worlds: str, out: str, lag: str) -> None:
    with np.load(worlds) as file:
        count = int(file["count"])
        parts = [{n.partition("/")[2]: file[n] for n in file.files if n.startswith(f"{k}/")} for k in range(count)]
    found = [drive(world, int(lag)) for world in parts]
    np.savez(out, X=np.array([X for X, _ in found]), P=np.array([P for _, P in found]))


if __name__ == "__main__":
    main(*sys.argv[1:4])
