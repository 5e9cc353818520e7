"""Least squares on a factor graph: values, graph, A and b, solvers, files.

Everything is imported when it is first used, so that ``import nls`` costs nothing and a program pays for what it needs.
"""

from nls.lazy import importer, refuse_shadows

TYPE_CHECKING = False  # to a type checker always true; the import of typing takes as long as all others of a start
if TYPE_CHECKING:
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
    from nls import plot
    from nls.analysis.variance_components import VarianceComponents, variance_components
    from nls.certificate import Certificate, certify
    from nls.covariance import Marginals
    from nls.explanation import Explanation, Finding, FindingKind, explain
    from nls.graph import FactorGraph
    from nls.incremental import Incremental
    from nls.io import LoadReport, load, save
    from nls.linear import (
        LU,
        PCG,
        QR,
        Cholesky,
        DenseCholesky,
        DenseQR,
        LinearSolver,
        Pinv,
        Schur,
        backends,
        factorize,
    )
    from nls.optimizers import (
        Dogleg,
        Fit,
        GaussNewton,
        Iteration,
        LevenbergMarquardt,
        Optimizer,
        Result,
        Status,
        Stop,
        gauss_newton_step,
    )
    from nls.robust import Robustified, gnc
    from nls.starts import initialize
    from nls.system import LinearSystem
    from nls.values import Values

__version__ = "0.1.0"

refuse_shadows()  # here and nowhere later: an error of one of their names would not say whose package it is

_WHERE = {
    "factors.keys": "Keys Kind kinds",
    "models.errors": "EvaluationError GraphError GraphFileError GraphWarning JacobianError LeadlineError "
    "MissingSolverError NoiseModelError OptionError ResourceLimitError SingularGeometryError UnderconstrainedError",
    "nls.analysis.variance_components": "VarianceComponents variance_components",
    "nls.certificate": "Certificate certify",
    "nls.covariance": "Marginals",
    "nls.explanation": "Explanation Finding FindingKind explain",
    "nls.graph": "FactorGraph",
    "nls.incremental": "Incremental",
    "nls.io": "LoadReport load save",
    "nls.linear": "LU PCG QR Cholesky DenseCholesky DenseQR LinearSolver Pinv Schur backends factorize",
    "nls.optimizers": "Dogleg Fit GaussNewton Iteration LevenbergMarquardt Optimizer Result Status Stop "
    "gauss_newton_step",
    "nls.robust": "Robustified gnc",
    "nls.starts": "initialize",
    "nls.system": "LinearSystem",
    "nls.values": "Values",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}

if not TYPE_CHECKING:
    __getattr__ = importer("nls", _MODULE)
    del importer, TYPE_CHECKING  # no names for users


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


__all__ = [
    "LU",
    "PCG",
    "QR",
    "Certificate",
    "Cholesky",
    "DenseCholesky",
    "DenseQR",
    "Dogleg",
    "EvaluationError",
    "Explanation",
    "FactorGraph",
    "Finding",
    "FindingKind",
    "Fit",
    "GaussNewton",
    "GraphError",
    "GraphFileError",
    "GraphWarning",
    "Incremental",
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
    "Robustified",
    "Schur",
    "SingularGeometryError",
    "Status",
    "Stop",
    "UnderconstrainedError",
    "Values",
    "VarianceComponents",
    "backends",
    "certify",
    "explain",
    "factorize",
    "gauss_newton_step",
    "gnc",
    "initialize",
    "kinds",
    "load",
    "plot",
    "save",
    "variance_components",
]
