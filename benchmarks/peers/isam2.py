"""iSAM2 of GTSAM on a pose graph, a pose at a time; run by benchmarks/incremental.py in a process of its own.

    python benchmarks/peers/isam2.py GRAPH.g2o OUT.npz THRESHOLD SKIP CHECK WHOLE

Every step gives the newest pose, every WHOLE-th all poses. Every CHECK-th is kept, outside of the clock. Factorization
is by Cholesky, and by QR where that fails: on manhattan it ends at pose 695 with IndeterminantLinearSystemException.
"""

from __future__ import annotations

import sys
from time import process_time
from typing import Any

import gtsam
import numpy as np


def main(graph: str, out: str, *numbers: float) -> None:
    try:
        drive(graph, out, "CHOLESKY", *numbers)
    except RuntimeError:
        drive(graph, out, "QR", *numbers)


def drive(graph: str, out: str, factorization: str, threshold: float, skip: int, check: int, whole: int) -> None:
    with open(graph, encoding="utf-8") as file:
        space = any(line.startswith("EDGE_SE3") for line in file)
    edges, _ = gtsam.readG2o(graph, space)
    arriving: dict[int, list[Any]] = {}
    for k in range(edges.size()):
        arriving.setdefault(max(edges.at(k).keys()), []).append(edges.at(k))
    pose, prior = (gtsam.Pose3, gtsam.PriorFactorPose3) if space else (gtsam.Pose2, gtsam.PriorFactorPose2)
    first = min(min(edges.at(k).keys()) for k in range(edges.size()))
    held = gtsam.noiseModel.Isotropic.Sigma(6 if space else 3, 1e-4)
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(threshold)
    parameters.relinearizeSkip = skip
    parameters.setFactorization(factorization)
    isam, latest = gtsam.ISAM2(parameters), pose()
    newest = isam.calculateEstimatePose3 if space else isam.calculateEstimatePose2
    seconds, kept = [], {}
    for n, key in enumerate(sorted(arriving)):
        began = process_time()
        graph_of_step, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if n == 0:
            graph_of_step.push_back(prior(first, pose(), held))
            values.insert(first, pose())
        step = next(f for f in arriving[key] if abs(f.keys()[0] - f.keys()[1]) == 1)
        forward = step.keys()[0] < step.keys()[1]
        values.insert(key, latest.compose(step.measured() if forward else step.measured().inverse()))
        for factor in arriving[key]:
            graph_of_step.push_back(factor)
        isam.update(graph_of_step, values)
        latest = newest(key)
        if n % whole == 0:
            isam.calculateEstimate()
        seconds.append(process_time() - began)
        if n % check == 0 or n == len(arriving) - 1:
            kept[f"X{key}"] = poses(isam.calculateEstimate(), space)
    np.savez(out, seconds=seconds, **kept)


def poses(values: Any, space: bool) -> Any:
    """(n, size) in the order of their keys."""
    if not space:
        return gtsam.utilities.extractPose2(values)
    stack = [values.atPose3(key) for key in sorted(values.keys())]
    return np.array([[*X.translation(), *X.rotation().toQuaternion().coeffs()] for X in stack])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), *map(int, sys.argv[4:7]))
