"""Least squares on a factor graph: values, graph, A and b, solvers, files."""

from importlib import import_module
from types import ModuleType

from factors.keys import Keys, Kind, kinds
from models.errors import (
    EvaluationError,
    GraphError,
    GraphFileError,
    GraphWarning,
    JacobianError,
    LeadlineError,
    MissingSolverError,
    NoiseModelError,
    OptionError,
    ResourceLimitError,
    SingularGeometryError,
    UnderconstrainedError,
)
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.io import LoadReport, load, save
from nls.linear import LU, QR, Cholesky, DenseCholesky, DenseQR, LinearSolver, Pinv, backends
from nls.optimizers import Dogleg, GaussNewton, Iteration, LevenbergMarquardt, Optimizer, Result, Status, Stop
from nls.starts import initialize
from nls.system import LinearSystem
from nls.values import Values

__version__ = "0.1.0"


def __getattr__(name: str) -> ModuleType:
    """`nls.plot`, imported when it is first used."""
    if name == "plot":
        return import_module("nls.plot")
    raise AttributeError(f"module 'nls' has no attribute {name!r}")


__all__ = [
    "LU",
    "QR",
    "Cholesky",
    "DenseCholesky",
    "DenseQR",
    "Dogleg",
    "EvaluationError",
    "FactorGraph",
    "GaussNewton",
    "GraphError",
    "GraphFileError",
    "GraphWarning",
    "Iteration",
    "JacobianError",
    "Keys",
    "Kind",
    "LeadlineError",
    "LevenbergMarquardt",
    "LinearSolver",
    "LinearSystem",
    "LoadReport",
    "Marginals",
    "MissingSolverError",
    "NoiseModelError",
    "Optimizer",
    "OptionError",
    "Pinv",
    "ResourceLimitError",
    "Result",
    "SingularGeometryError",
    "Status",
    "Stop",
    "UnderconstrainedError",
    "Values",
    "backends",
    "initialize",
    "kinds",
    "load",
    "plot",
    "save",
]
