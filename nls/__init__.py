"""Least squares on a factor graph: values, graph, A and b, solvers, files."""

from factors.keys import Keys, Kind, kinds
from models.errors import (
    ConvergenceWarning,
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
from nls.graph import FactorGraph
from nls.io import LoadReport, load, save
from nls.linear import LU, QR, Cholesky, DenseCholesky, DenseQR, LinearSolver, Pinv, backends
from nls.optimizers import GaussNewton, Iteration, Result, Status, Stop
from nls.starts import initialize
from nls.system import LinearSystem
from nls.values import Values

__version__ = "0.1.0"

__all__ = [
    "LU",
    "QR",
    "Cholesky",
    "ConvergenceWarning",
    "DenseCholesky",
    "DenseQR",
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
    "LinearSolver",
    "LinearSystem",
    "LoadReport",
    "MissingSolverError",
    "NoiseModelError",
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
    "save",
]
