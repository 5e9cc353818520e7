r"""The covariance of a free gauge: the pseudo-inverse of A'A, from the covariance with one variable held.

    Sigma = P Sigma_held P',   P = I - Q Q',   Q an orthonormal basis of the gauge, (N, k)
          = Sigma_held - Q B' - B Q' + Q (Q'B) Q',   B = Sigma_held Q

so a block costs no more than the held one, once the k columns of B are solved for. The gauge is the null space of A:
with A = [A_f A_h], f the free columns and h the held ones, it is spanned by [-(A_f'A_f)^-1 A_f'A_h; I].

P S P' of *any* symmetric generalized inverse S of A'A is its pseudo-inverse: C. R. Rao, S. K. Mitra, Generalized
Inverse of Matrices and its Applications, 1971.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from models.errors import GraphError, ResourceLimitError
from nls.linear.factorization import Factorization, SingularSystemError
from nls.linear.free_gauge import free_directions, gauge_columns
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values


@dataclass(frozen=True)
class FreePart:
    """The map of the covariance from a held gauge to the free one.

    Parameters
    ----------
    Q : (N, k) basis of the gauge, a row per column of all variables; zero in the fixed ones.
    B : (N, k) Sigma_held Q.
    """

    Q: Array
    B: Array

    def moved(self, Sigma: Array, rows: Index, columns: Index) -> Array:
        """Blocks (..., r, c) of the covariance with the free gauge.

        Parameters
        ----------
        Sigma : (..., r, c) the same blocks with the gauge held.
        rows, columns : (..., r) and (..., c) where they are.
        """
        M = self.Q.T @ self.B
        Q_r, Q_c, B_r, B_c = self.Q[rows], self.Q[columns], self.B[rows], self.B[columns]
        return np.asarray(Sigma - Q_r @ B_c.mT - B_r @ Q_c.mT + Q_r @ ((M + M.T) / 2) @ Q_c.mT)


def free_part(
    held: Pattern,
    free: Pattern,
    factorization: Factorization,
    values: Values,
    memory_limit: float,
    others: sp.csr_array | None = None,
) -> FreePart:
    """The basis of the gauge and Sigma_held times it.

    Parameters
    ----------
    held, free : the graph with the gauge held, and without.
    factorization : of A'A of `held`.
    values : the linearization point.
    memory_limit : bytes of the dense columns.
    others : (n, q) directions that stay free with the gauge held, which belong to the null space, too.

    Raises
    ------
    GraphError
        The held variable is no free direction: a factor calls itself relative and is not.
    ResourceLimitError
        There are so many components that the columns would not fit.
    """
    gauge, complement = gauge_columns(held, free)
    count = len(gauge) + (0 if others is None else others.shape[1])
    needed = 6 * 8.0 * free.n * count
    if needed > memory_limit:
        raise ResourceLimitError(
            f"gauge 'free': {count} free directions of {free.n} unknowns need {needed / 1e9:.1f} GB, the limit is "
            f"{memory_limit / 1e9:.1f} GB; use gauge 'first'",
            needed,
            memory_limit,
            "free gauge",
        )
    A = LinearSystem.at(free, values).A
    try:
        unheld = factorization.solve((A[:, complement].T @ A[:, gauge]).toarray())
        directions = free_directions(A, gauge, complement, unheld)
    except SingularSystemError as error:
        raise GraphError(
            "gauge 'free': the variable held to compute it is no free direction of the measurements: a factor says "
            "relative=True and is not"
        ) from error
    if others is not None:
        directions = np.pad(directions, ((0, 0), (0, others.shape[1])))
        directions[complement, len(gauge) :] = others.toarray()
        directions = np.linalg.qr(directions)[0]
    of_all = np.flatnonzero(np.repeat(~free.held, free.dims))
    Q, B = np.zeros((2, int(free.dims.sum()), count))
    Q[of_all] = directions
    B[of_all[complement]] = factorization.solve(Q[of_all[complement]])
    return FreePart(Q, B)
