"""GTSAM: its own reader, the first pose held by a tight prior, two methods, two orderings, two linear solvers.

It starts from the file, chordal (LAGO in the plane) or by FastSync, which refuses noise that is not isotropic.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from peers import TOLERANCE, Files, combined

PACKAGE, COST = "gtsam", "gtsam"
ORDERINGS = ("COLAMD", "METIS")
VARIANTS = combined(("file", "chordal"), ("GN", "LM"), ORDERINGS)
VARIANTS += combined(("fastSync",), ("GN",), ORDERINGS)
VARIANTS += combined(("file", "chordal", "fastSync"), ("GN",), ORDERINGS, ("MULTIFRONTAL_SOLVER",))


class Run:
    def __init__(self, files: Files, variant: str) -> None:
        import gtsam

        self.gtsam, self.files = gtsam, files
        self.begin, self.method, self.ordering, *self.solver = variant.split(", ")
        self.said = {"version": f"GTSAM {version('gtsam')}"}

    def load(self) -> None:
        gtsam, space = self.gtsam, self.files.space
        self.graph, self.values = gtsam.readG2o(str(self.files.graph), space)
        first = min(self.values.keys())
        held = gtsam.noiseModel.Diagonal.Variances(np.full(6 if space else 3, 1e-8))
        prior, pose = (gtsam.PriorFactorPose3, "atPose3") if space else (gtsam.PriorFactorPose2, "atPose2")
        self.graph.add(prior(first, getattr(self.values, pose)(first), held))

    def start(self) -> None:
        if self.begin == "chordal":
            method = self.gtsam.InitializePose3 if self.files.space else self.gtsam.lago
            self.values = method.initialize(self.graph)
        elif self.begin == "fastSync":
            synchronize = self.gtsam.fastSyncPose3 if self.files.space else self.gtsam.fastSyncPose2
            self.values = synchronize(self.graph)

    def optimize(self) -> None:
        gtsam, newton = self.gtsam, self.method == "GN"
        parameters = gtsam.GaussNewtonParams() if newton else gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(TOLERANCE)
        parameters.setAbsoluteErrorTol(1e-12)
        parameters.setMaxIterations(self.files.most)
        parameters.setOrderingType(self.ordering)
        for solver in self.solver:
            parameters.setLinearSolverType(solver)
        optimizer = gtsam.GaussNewtonOptimizer if newton else gtsam.LevenbergMarquardtOptimizer
        run = optimizer(self.graph, self.values, parameters)
        self.solution = run.optimize()
        self.iterations = run.iterations()

    def cost(self) -> float:
        return 2 * float(self.graph.error(self.solution))

    def poses(self) -> tuple[Any, Any]:
        ids = np.array(sorted(self.solution.keys()), dtype=np.int64)
        if not self.files.space:
            return ids, self.gtsam.utilities.extractPose2(self.solution)
        poses = [self.solution.atPose3(key) for key in ids.tolist()]
        return ids, np.array([[*pose.translation(), *pose.rotation().toQuaternion().coeffs()] for pose in poses])

    def marginals(self) -> None:
        marginals = self.gtsam.Marginals(self.graph, self.solution)
        for key in sorted(self.solution.keys()):
            marginals.marginalCovariance(key)
