"""g2o: start from the file or along a spanning tree, Gauss-Newton and Levenberg-Marquardt, Eigen's sparse Cholesky.

The wheel knows the tags of no graph file (`SparseOptimizer.load` returns True and no vertex), so its graph is built by
a Python loop, and only the start and the optimization are compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from peers import TOLERANCE, Files, combined

PACKAGE, COST, READS, MAX_EDGES = "g2o", "g2o", False, None
VARIANTS = combined(("file", "spanning tree"), ("GN", "LM"))


class Run:
    def __init__(self, files: Files, variant: str) -> None:
        import g2o

        self.g2o, self.files = g2o, files
        self.begin, self.method = variant.split(", ")
        self.arrays = files.read_arrays()
        self.said: dict[str, Any] = {}

    def load(self) -> None:
        g2o, given, group = self.g2o, self.arrays, "SE3" if self.files.space else "SE2"
        solver = getattr(g2o, f"BlockSolver{group}")(getattr(g2o, f"LinearSolverEigen{group}")())
        algorithm = g2o.OptimizationAlgorithmGaussNewton if self.method == "GN" else g2o.OptimizationAlgorithmLevenberg
        self.optimizer = g2o.SparseOptimizer()
        self.optimizer.set_algorithm(algorithm(solver))
        Vertex, Edge = getattr(g2o, f"Vertex{group}"), getattr(g2o, f"Edge{group}")
        self.vertices = {}
        for number, X in zip(given["ids"].tolist(), given["X"], strict=True):
            vertex = self.vertices[number] = Vertex()
            vertex.set_id(number)
            vertex.set_estimate(self.pose(X))
            self.optimizer.add_vertex(vertex)
        self.vertices[min(self.vertices)].set_fixed(True)
        ends = given["i"].tolist(), given["j"].tolist()
        for i, j, z, information in zip(*ends, given["z"], given["information"], strict=True):
            edge = Edge()
            edge.set_vertex(0, self.vertices[i])
            edge.set_vertex(1, self.vertices[j])
            edge.set_measurement(self.pose(z))
            edge.set_information(information)
            self.optimizer.add_edge(edge)

    def pose(self, X: Any) -> Any:
        if not self.files.space:
            return self.g2o.SE2(*X)
        return self.g2o.Isometry3d(self.g2o.Quaternion(X[6], X[3], X[4], X[5]), X[:3].reshape(3, 1))

    def start(self) -> None:
        self.optimizer.initialize_optimization()
        if self.begin == "spanning tree":
            self.optimizer.compute_initial_guess()

    def optimize(self) -> None:
        stop = self.g2o.SparseOptimizerTerminateAction()
        stop.set_gain_threshold(TOLERANCE)
        stop.set_max_iterations(self.files.most)
        self.optimizer.add_post_iteration_action(stop)
        self.iterations = self.optimizer.optimize(self.files.most)

    def cost(self) -> float:
        self.optimizer.compute_active_errors()
        return float(self.optimizer.active_chi2())

    def poses(self) -> tuple[Any, Any]:
        ids = np.array(sorted(self.vertices), dtype=np.int64)
        found = [self.vertices[number].estimate() for number in ids.tolist()]
        if not self.files.space:
            return ids, np.array([pose.vector() for pose in found])
        turned = [self.g2o.Quaternion(pose.matrix()[:3, :3]) for pose in found]
        return ids, np.array(
            [[*pose.matrix()[:3, 3], q.x(), q.y(), q.z(), q.w()] for pose, q in zip(found, turned, strict=True)]
        )
