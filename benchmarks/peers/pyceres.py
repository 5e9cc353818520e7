"""Ceres from Python: Levenberg-Marquardt with sparse Cholesky; a Python cost function per edge, start from the file."""

from __future__ import annotations

from typing import Any

import numpy as np

from peers import TOLERANCE, Files
from peers.edges import edges, turn

PACKAGE, COST, READS, MAX_EDGES = "pyceres", "g2o", False, 1500
VARIANTS = ("file",)  # the wheel has SuiteSparse only


class Run:
    def __init__(self, files: Files, variant: str) -> None:
        import pyceres

        self.pyceres, self.files = pyceres, files
        self.arrays = files.read_arrays()
        self.said: dict[str, Any] = {}

    def load(self) -> None:
        pyceres, given = self.pyceres, self.arrays
        cost = cost_in_space(pyceres) if self.files.space else cost_in_the_plane(pyceres)
        self.X = [(X[:3].copy(), X[3:].copy()) if self.files.space else (X.copy(),) for X in given["X"]]
        index = dict(zip(given["ids"].tolist(), self.X, strict=True))
        self.problem, self.costs = pyceres.Problem(), []
        for i, j, edge in zip(given["i"].tolist(), given["j"].tolist(), edges(given, self.files.space), strict=True):
            self.costs.append(cost(edge))
            self.problem.add_residual_block(self.costs[-1], None, [*index[i], *index[j]])
        if self.files.space:
            for _, q in self.X:
                self.problem.set_manifold(q, pyceres.EigenQuaternionManifold())
        for block in index[min(index)]:
            self.problem.set_parameter_block_constant(block)

    def start(self) -> None:
        pass

    def optimize(self) -> None:
        pyceres = self.pyceres
        options, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        options.linear_solver_type = pyceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
        options.sparse_linear_algebra_library_type = pyceres.SparseLinearAlgebraLibraryType.SUITE_SPARSE
        options.function_tolerance, options.max_num_iterations, options.num_threads = TOLERANCE, self.files.most, 1
        options.gradient_tolerance = options.parameter_tolerance = 1e-15  # the cost alone decides, as elsewhere
        options.minimizer_progress_to_stdout, options.logging_type = False, pyceres.LoggingType.SILENT
        pyceres.solve(options, self.problem, summary)
        self.iterations = summary.num_successful_steps + summary.num_unsuccessful_steps - 1  # the start counts as one
        self.final_cost = summary.final_cost

    def cost(self) -> float:
        return 2 * float(self.final_cost)

    def poses(self) -> tuple[Any, Any]:
        return self.arrays["ids"], np.array([np.concatenate(blocks) for blocks in self.X])


def cost_in_the_plane(pyceres: Any) -> Any:
    class Cost(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, edge: Any) -> None:
            super().__init__()
            self.edge = edge
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([3, 3])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            r, *J = self.edge(*parameters)
            residuals[:] = r
            for given, wanted in zip(J, jacobians or (), strict=False):
                if wanted is not None:
                    wanted[:] = given.ravel()
            return True

    return Cost


def cost_in_space(pyceres: Any) -> Any:
    class Cost(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, edge: Any) -> None:
            super().__init__()
            self.edge = edge
            self.set_num_residuals(6)
            self.set_parameter_block_sizes([3, 4, 3, 4])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            X, Y = np.concatenate(parameters[:2]), np.concatenate(parameters[2:])
            r, Ji, Jj = self.edge(X, Y)
            residuals[:] = r
            if jacobians is not None:
                J = Ji[:, :3], Ji[:, 3:] @ turn(X[3:]), Jj[:, :3], Jj[:, 3:] @ turn(Y[3:])
                for given, wanted in zip(J, jacobians, strict=True):
                    if wanted is not None:
                        wanted[:] = given.ravel()
            return True

    return Cost
