"""Linear solvers: one job, dx = argmin |A dx - b|, nine ways."""

from __future__ import annotations

from nls.linear.base import LinearSolution, LinearSolver
from nls.linear.cholesky import Cholesky, openmp_capped
from nls.linear.dense import DenseCholesky, DenseQR, Pinv
from nls.linear.lu import LU
from nls.linear.normal import Factorization, NormalEquations
from nls.linear.pcg import CholeskyPCG
from nls.linear.qr import QR
from nls.linear.schur import Schur
from nls.linear.schur_pcg import PCG

__all__ = [
    "LU",
    "PCG",
    "QR",
    "SOLVERS",
    "Cholesky",
    "CholeskyPCG",
    "DenseCholesky",
    "DenseQR",
    "LinearSolution",
    "LinearSolver",
    "Pinv",
    "Schur",
    "backends",
    "best_factorization",
    "default_solver",
]

SOLVERS: dict[str, type[LinearSolver]] = {
    solver.name: solver for solver in (Cholesky, CholeskyPCG, Schur, PCG, QR, LU, DenseCholesky, DenseQR, Pinv)
}


def default_solver() -> LinearSolver:
    """The best linear solver installed: CHOLMOD, or SuperLU without SuiteSparse."""
    return Cholesky() if Cholesky.missing() is None else LU()


def best_factorization() -> type[Factorization]:
    """The factorization of positive definite matrices behind the default solver."""
    solver = default_solver()
    assert isinstance(solver, NormalEquations)
    return solver.factorization


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
    report["openmp"] = (
        "kept to one thread during factorizations" if openmp_capped() else "not found: nothing is done about it"
    )
    return report
