"""Leadline with its defaults."""

from __future__ import annotations

import warnings
from typing import Any

from peers import Files

PACKAGE, VARIANTS, COST = "nls", ("auto",), "g2o"


class Run:
    def __init__(self, files: Files, variant: str) -> None:
        import nls

        for name in nls.__all__:  # everything public is loaded, as by `import gtsam`
            getattr(nls, name)
        nls.backends()  # and the compiled solver
        warnings.simplefilter("ignore", nls.GraphWarning)
        self.nls, self.files, self.variant = nls, files, variant

    def load(self) -> None:
        self.graph, self.values, _ = self.nls.load(self.files.graph)

    def start(self) -> None:
        self.begin, self.method, _ = self.nls.initialize(self.graph, self.values, self.variant)

    def optimize(self) -> None:
        result = self.result = self.graph.optimize(self.begin)
        self.iterations = result.iterations
        self.said = {
            "start": self.method,
            "converged": result.converged,
            "dof": result.dof,
            "linear_solver": result.linear_solver,
            "timings": result.timings,
        }

    def cost(self) -> float:
        return float(self.result.chi2_final)

    def poses(self) -> tuple[Any, Any]:
        stack = self.result.values.stack("x")
        return stack.numbers, stack.X

    def marginals(self) -> None:
        (x,) = self.nls.kinds("x")
        self.nls.Marginals(self.graph, self.result.values).all(x, frame="body")
