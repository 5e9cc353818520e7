"""SymForce from Python: its C++ Levenberg-Marquardt; a Python linearization function per edge, start from the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from peers import TOLERANCE, Files
from peers.edges import edges

PACKAGE, COST, READS, MAX_EDGES = "cc_sym", "g2o", False, 1500
VARIANTS = ("file",)


class Run:
    def __init__(self, files: Files, variant: str) -> None:
        import cc_sym
        import sym

        self.cc_sym, self.sym, self.files = cc_sym, sym, files
        self.arrays = files.read_arrays()
        self.said: dict[str, Any] = {}

    def load(self) -> None:
        cc_sym, given, space = self.cc_sym, self.arrays, self.files.space
        self.values = cc_sym.Values()
        self.keys = {number: cc_sym.Key("x", number) for number in given["ids"].tolist()}
        for key, X in zip(self.keys.values(), given["X"], strict=True):
            self.values.set(key, self.sym.Pose3.from_storage([*X[3:], *X[:3]]) if space else X.copy())
        held = min(self.keys)
        factors = []
        for i, j, edge in zip(given["i"].tolist(), given["j"].tolist(), edges(given, space), strict=True):
            function = linearization(edge, self.keys[i], self.keys[j], i == held, j == held, space)
            factors.append(cc_sym.Factor(function, [self.keys[k] for k in (i, j) if k != held]))
        parameters = cc_sym.default_optimizer_params()
        parameters.iterations, parameters.early_exit_min_reduction = self.files.most, TOLERANCE
        self.optimizer = cc_sym.Optimizer(parameters, factors)

    def start(self) -> None:
        pass

    def optimize(self) -> None:
        self.stats = self.optimizer.optimize(self.values)
        self.iterations = len(self.stats.iterations) - 1

    def cost(self) -> float:
        return 2 * float(self.stats.iterations[self.stats.best_index].new_error)

    def poses(self) -> tuple[Any, Any]:
        found = [self.values.at(key) for key in self.keys.values()]
        if not self.files.space:
            return self.arrays["ids"], np.array(found)
        storage = np.array([pose.to_storage() for pose in found])
        return self.arrays["ids"], np.hstack([storage[:, 4:], storage[:, :4]])


def linearization(edge: Any, i: Any, j: Any, first: bool, second: bool, space: bool) -> Callable[[Any, Any], Any]:
    """Residual, Jacobian, Hessian (lower triangle is enough) and gradient of one edge."""
    swap = [3, 4, 5, 0, 1, 2]  # SymForce: rotation first

    def pose(values: Any, key: Any) -> Any:
        if not space:
            return values.at(key)
        storage = values.at(key).to_storage()
        return np.array([*storage[4:], *storage[:4]])

    def function(values: Any, _: Any) -> Any:
        r, Ji, Jj = edge(pose(values, i), pose(values, j))
        parts = [J[:, swap] if space else J for J, held in ((Ji, first), (Jj, second)) if not held]
        J = np.hstack(parts)
        return r, J, J.T @ J, J.T @ r

    return function
