"""Linear solvers: one job, dx = argmin |A dx - b|, nine ways."""

from nls.linear.base import Analysis, LinearSolution, LinearSolver, NormalEquations
from nls.linear.cholesky import Cholesky
from nls.linear.default import best_decomposition, default_solver, factorize
from nls.linear.dense import DenseCholesky, DenseQR, Pinv
from nls.linear.factorization import Factorization
from nls.linear.lu import LU
from nls.linear.qr import QR
from nls.linear.schur import PCG, Schur, truncated_inverse
from nls.sparse.threads import openmp

__all__ = [
    "LU",
    "PCG",
    "QR",
    "SOLVERS",
    "Analysis",
    "Cholesky",
    "DenseCholesky",
    "DenseQR",
    "Factorization",
    "LinearSolution",
    "LinearSolver",
    "NormalEquations",
    "Pinv",
    "Schur",
    "backends",
    "best_decomposition",
    "default_solver",
    "factorize",
    "truncated_inverse",
]

_ALL = (Cholesky, Schur, PCG, QR, LU, DenseCholesky, DenseQR, Pinv)
SOLVERS: dict[str, type[LinearSolver]] = {solver.name: solver for solver in _ALL}


def backends() -> dict[str, str]:
    """Which linear solvers can run here, which is the default, and how the others are installed.

    Examples
    --------
    >>> import nls
    >>> nls.backends()["lu"]
    'available'
    """
    report = {name: solver.missing() or "available" for name, solver in SOLVERS.items()}
    report["default"] = default_solver().name
    if Cholesky.missing() is not None:
        report["openmp"] = "not used, as CHOLMOD is missing"
    elif openmp():
        report["openmp"] = "CHOLMOD runs on one thread during a factorization"
    else:
        report["openmp"] = "no GNU OpenMP library is loaded; the number of CHOLMOD's threads is left as it is"
    return report
