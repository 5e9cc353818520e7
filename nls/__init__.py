"""Least squares on a factor graph: values, graph, A and b, solvers, files.

Everything is imported when it is first used, so that ``import nls`` costs nothing and a program pays for what it needs.
"""

from nls.lazy import importer, refuse_shadows

TYPE_CHECKING = False  # to a type checker always true; the import of typing takes as long as all others of a start
if TYPE_CHECKING:
    from factors.keys import Keys as Keys, Kind as Kind, kinds as kinds
    from models.errors import *  # noqa: F403  # all of them are public here
    from nls import plot as plot
    from nls.analysis.variance_components import (
        VarianceComponents as VarianceComponents,
        variance_components as variance_components,
    )
    from nls.certificate import Certificate as Certificate, certify as certify
    from nls.covariance import Marginals as Marginals
    from nls.explanation import (
        Explanation as Explanation,
        Finding as Finding,
        FindingKind as FindingKind,
        explain as explain,
    )
    from nls.graph import FactorGraph as FactorGraph
    from nls.incremental import Incremental as Incremental
    from nls.io import LoadReport as LoadReport, load as load, save as save
    from nls.linear import (
        LU as LU,
        PCG as PCG,
        QR as QR,
        Cholesky as Cholesky,
        DenseCholesky as DenseCholesky,
        DenseQR as DenseQR,
        LinearSolver as LinearSolver,
        Pinv as Pinv,
        Schur as Schur,
        backends as backends,
        factorize as factorize,
    )
    from nls.optimizers import (
        Dogleg as Dogleg,
        Fit as Fit,
        GaussNewton as GaussNewton,
        Iteration as Iteration,
        LevenbergMarquardt as LevenbergMarquardt,
        Optimizer as Optimizer,
        Result as Result,
        Status as Status,
        Stop as Stop,
        gauss_newton_step as gauss_newton_step,
    )
    from nls.robust import Robustified as Robustified, gnc as gnc
    from nls.starts import initialize as initialize
    from nls.system import LinearSystem as LinearSystem
    from nls.values import Values as Values

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

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = importer("nls", _WHERE, "plot")
    del importer, TYPE_CHECKING  # no names for users
