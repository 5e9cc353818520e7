r"""The rest of the columns of one variable when all others have explained as much of them as they can.

With the columns of A split into those of the variable and the rest, A = [A_k A_r], the part of A_k that no change of
the rest can imitate is

    E = A_k - A_r X,   X = argmin |A_k - A_r X|,     M = E'E = A_k'A_k - A_k'A_r (A_r'A_r)^+ A_r'A_k

M is the Schur complement of A'A onto the variable: its inverse is the covariance, the Cramer-Rao bound. E exists where
A_r itself is singular (a free gauge, a free scale, landmarks nothing determines): X is then one of many, E is the same
for all. M n = 0 where the variable can move by n, and the rest by -X n with it, and no measurement changes.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Index
from nls.linear.default import default_solver
from nls.linear.factorization import Factorization
from nls.linear.singular import SingularSystemError
from nls.system import LinearSystem

__all__ = ["unexplained"]

DAMPING = 1e-11  # of the diagonal of A_r'A_r, where A_r is singular: taken away again by repeating
ROUNDS = 30  # a direction of A_r of length 3e-6, columns scaled to 1, halves in each; none was seen so weak
SETTLED = 1e-13


def unexplained(system: LinearSystem, variable: int) -> tuple[Array, Array, Array, Index]:
    """A_k (m, d) of a free variable, X (n - d, d), E = A_k - A_r X (m, d), and which columns are the rest (n - d,).

    Parameters
    ----------
    system : a linearization, of any rank.
    variable : its place in the numbering of the pattern.
    """
    pattern = system.pattern
    columns = pattern.starts[variable] + np.arange(pattern.dims[variable])
    other_columns = np.setdiff1d(np.arange(pattern.n), columns)
    A_k, A_r = system.A[:, columns].toarray(), system.A[:, other_columns]
    held = pattern.held.copy()
    held[variable] = True
    factorization = _factorized(LinearSystem(pattern.holding(held), system.blocks, system.b))
    X, E = np.zeros((len(other_columns), len(columns))), A_k
    for _ in range(ROUNDS):
        step = factorization.solve(np.asarray(A_r.T @ E)) if len(other_columns) else X
        X = X + step
        last, E = E, A_k - A_r @ X
        if np.abs(last - E).max(initial=0.0) <= SETTLED * np.abs(A_k).max(initial=0.0):
            break
    return A_k, X, E, other_columns


def _factorized(system: LinearSystem) -> Factorization:
    """A_r'A_r factorized as it is; with a little damping where it is singular."""
    analysis = default_solver().analyze(system.pattern)
    try:
        return analysis.factorize(system)
    except SingularSystemError:
        squares = np.square(system.column_norms)
        return analysis.factorize(system, DAMPING * np.where(squares > 0, squares, 1.0))
