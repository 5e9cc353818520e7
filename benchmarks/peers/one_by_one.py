"""GTSAM's wheel on a graph that is built measurement by measurement; run by benchmarks/one_by_one.py.

python benchmarks/peers/one_by_one.py CITY.npz
"""

from __future__ import annotations

import json
import sys
from time import process_time

import gtsam
import numpy as np


def main(path: str) -> None:
    with np.load(path) as file:
        i, j, z, X, sigmas = (file[name] for name in ("i", "j", "z", "X", "sigmas"))
    noise, graph = gtsam.noiseModel.Diagonal.Sigmas(sigmas), gtsam.NonlinearFactorGraph()
    numbers = list(zip(i.tolist(), j.tolist(), z.tolist(), strict=True))
    began = process_time()
    graph.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*X[0])))
    for a, b, step in numbers:
        graph.add(gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*step), noise))
    added = process_time()
    values = gtsam.Values()
    for k, pose in enumerate(X.tolist()):
        values.insert(k, gtsam.Pose2(*pose))
    result = gtsam.GaussNewtonOptimizer(graph, values, gtsam.GaussNewtonParams()).optimize()
    print(json.dumps([added - began, process_time() - added, 2 * graph.error(result)]))


if __name__ == "__main__":
    main(sys.argv[1])
