r"""The inverse of H: all blocks that have one in H, from one pass over its factor; a substitute where H is singular.

Pairs of variables that nothing measures together get a block in H by a factor that measures nothing.

**Where something is free** there are other covariances: of determined variables, and of all with the shortest step as
the gauge.

With N (n, k) a basis of the free directions, A N = 0, a variable is determined when its rows of N are zero. Priors on
k unknowns hold the free directions; the covariance of a determined variable does not depend on them.

**The free gauge** has the pseudo-inverse of A'A, from the covariance with one variable held:

    Sigma = P Sigma_held P',   P = I - Q Q',   Q an orthonormal basis of the gauge, (N, k)
          = Sigma_held - Q B' - B Q' + Q (Q'B) Q',   B = Sigma_held Q

so a block costs no more than the held one, once the k columns of B are solved for. The gauge is the null space of A:
with A = [A_f A_h], f the free columns and h the held ones, it is spanned by [-(A_f'A_f)^-1 A_f'A_h; I].

P S P' of *any* symmetric generalized inverse S of A'A is its pseudo-inverse: C. R. Rao, S. K. Mitra, Generalized
Inverse of Matrices and its Applications, 1971.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse as sp

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic
from models import Manifold, R
from models.algebra import Array, Index, Mask
from models.errors import GraphError, UnderconstrainedError
from models.listing import some
from nls.linear import LinearSolver, factorize
from nls.linear.factorization import Factorization, SingularSystemError
from nls.linear.null_space import BLOCKS, FreeDirections, column_lengths, free_directions, gauge_columns
from nls.linear.underconstrained import underconstrained
from nls.sparse.fill import refuse_larger
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

ONE_BLOCK = 64  # columns of H^-1 solved for together; more marginals than that come out of the pass over all


class SelectedInverse:
    """Blocks of H^-1 of single variables, and of pairs that share a block of H; zero where a variable is held.

    Parameters
    ----------
    factorization : of H, whose variables are those that are not held.
    memory_limit : bytes the pass may take.
    held : (V,) of all variables.

    Raises
    ------
    ResourceLimitError
        It would take more.
    """

    def __init__(self, factorization: Factorization, memory_limit: float, held: Mask) -> None:
        self._free, self._number = ~held, np.cumsum(~held) - 1
        elimination, dims = factorization.hessian.elimination, factorization.hessian.dims
        u, v, every = elimination.u[elimination.blocks], elimination.v[elimination.blocks], np.arange(len(dims))
        low, high = np.append(every, np.minimum(u, v)), np.append(every, np.maximum(u, v))
        order = np.argsort(low * len(dims) + high)
        low, high, size = low[order], high[order], dims[low[order]] * dims[high[order]]
        self._variables, self._key, self._first = len(dims), low * len(dims) + high, np.cumsum(size) - size
        self._numbers = factorization.inverse_blocks(low, high, memory_limit)

    def lacks(self, u: Index, v: Index) -> Mask:
        """Which pairs (n,) of variables share no block, and neither is held."""
        apart = self._free[u] & self._free[v]
        key, place = self._places(self._number[u[apart]], self._number[v[apart]])
        apart[apart] = self._key[place] != key
        return apart

    def blocks(self, u: Index, v: Index, d: int, e: int) -> Array:
        """Blocks (n, d, e) of pairs (n,) of variables of these sizes: all u are of one kind, and all v."""
        Sigma, free = np.zeros((len(u), d, e)), self._free[u] & self._free[v]
        i, j = self._number[u[free]], self._number[v[free]]
        turned = i > j
        shape = (e, d) if turned.all() else (d, e)
        B: Array = self._numbers[self._first[self._places(i, j)[1], None] + np.arange(d * e)].reshape(-1, *shape)
        if turned.all():
            B = B.mT
        elif turned.any():
            B[turned] = B[turned].mT
        Sigma[free] = B
        return Sigma

    def _places(self, i: Index, j: Index) -> tuple[Index, Index]:
        """Keys of pairs (k,), and where they are or would be among those there are."""
        key = np.minimum(i, j) * self._variables + np.maximum(i, j)
        return key, np.minimum(np.searchsorted(self._key, key), len(self._key) - 1)


def dense_inverse(factorization: Factorization, columns: Index, memory_limit: float) -> Array:
    """Rows and columns (k,) of H^-1, a few columns of it solved for at a time; zero where a column is -1, held.

    Raises
    ------
    ResourceLimitError
        It would take more than the memory limit.
    """
    k, n = len(columns), int(factorization.hessian.dims.sum())
    words, cure = f"the joint covariance of {k} unknowns needs", "ask for fewer variables, or for marginals with all()"
    refuse_larger(8.0 * (4 * k * k + 3 * n * min(k, ONE_BLOCK)), memory_limit, "joint covariance", words, cure)
    Sigma, free = np.zeros((k, k)), np.flatnonzero(columns >= 0)
    for begin in range(0, len(free), ONE_BLOCK):
        span = free[begin : begin + ONE_BLOCK]
        E = np.zeros((n, len(span)))
        E[columns[span], np.arange(len(span))] = 1.0
        Sigma[free[:, None], span] = factorization.solve(E)[columns[free]]
    return Sigma


class Pair(Factor):
    """Two variables that share a factor, which measures nothing: so the selected inverse has their block."""

    slots = (None, None)
    relative = True

    def __init__(self, i: Keys, j: Keys) -> None:
        super().__init__([i, j], [0.0], Isotropic(1.0))

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(1)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return np.zeros((len(self), 1)), tuple(np.zeros((len(self), 1, manifold.dim)) for manifold in manifolds)


def paired(pairs: Sequence[tuple[Keys, Keys]]) -> list[Factor]:
    """A factor for every batch of pairs, each pair once; none of a variable with itself."""
    factors: list[Factor] = []
    for i, j in pairs:
        numbers = np.stack([i.numbers, j.numbers])
        numbers = np.unique(numbers[:, i.numbers != j.numbers] if i.kind == j.kind else numbers, axis=1)
        if numbers.size:
            factors.append(Pair(Keys(i.kind, numbers[0]), Keys(j.kind, numbers[1])))
    return factors


@dataclass(frozen=True)
class Undetermined:
    """The free directions at the linearization point.

    Parameters
    ----------
    N : (n, k) the directions, a row per column of A; exactly zero where a direction does not move the unknown.
    error : names all that is free, with cures.
    """

    N: sp.csr_array
    error: UnderconstrainedError

    @property
    def moved(self) -> Mask:
        """(n,) which unknowns a free direction moves."""
        return np.asarray(np.diff(self.N.indptr) > 0)

    def refuse(self, keys: Keys, columns: Index, used: Mask, names: tuple[str, ...]) -> None:
        """Refuse variables that are asked for and not determined.

        Parameters
        ----------
        keys : (q,) variables.
        columns : (q, d) of A; -1 where held.
        used : (q, d) the components that are asked for.
        names : (d,) of the components.

        Raises
        ------
        UnderconstrainedError
        """
        free = used & (columns >= 0) & self.moved[columns]
        members = np.flatnonzero(free.any(axis=1))
        if not len(members):
            return
        texts = [f"{keys[[k]]!r}: {', '.join(names[c] for c in np.flatnonzero(free[k]))}" for k in members]
        rows = np.unique(columns[free])
        k = len(np.unique(self.N[rows].indices))
        several = len(members) > 1
        moves = f"{'1 free direction moves' if k == 1 else f'{k} free directions move'} {'them' if several else 'it'}"
        raise UnderconstrainedError(
            f"{some(texts, 6, '; ', ' variables')}: not determined. {moves}, so {'they have' if several else 'it has'} "
            "no covariance. Ask for the other variables by number, or add what is missing",
            list(keys[members]),
            k,
            texts,
            advice=self.error.advice,
        )


def of_unmeasured(keys: Sequence[Keys]) -> UnderconstrainedError:
    """The error where variables are asked for that no measurement touches."""
    pronoun = "it" if len(keys) == 1 else "them"
    return UnderconstrainedError(
        f"{some(keys)}: no measurement touches {pronoun}, so there is no covariance; ask for the other variables by "
        "number, remove these, or add the factors that are missing",
        keys,
    )


def anchored_factorization(
    pattern: Pattern, values: Values, linear_solver: LinearSolver | None
) -> tuple[Pattern, Factorization, Undetermined]:
    """Factorization of a singular A'A with its free directions held.

    Parameters
    ----------
    pattern : the graph with the gauge held; its A'A is singular.
    values : the linearization point.
    linear_solver : as for `factorize`.

    Returns
    -------
    pattern : with the priors that hold the free directions.
    factorization : of A'A of that pattern.
    undetermined : the free directions.

    Raises
    ------
    UnderconstrainedError
        No variable is determined, or more directions are free than are looked for; names them.
    EvaluationError
        Squares of weights or Jacobians overflow.
    """
    system = LinearSystem.at(pattern, values)
    keeps_A = linear_solver if linear_solver is not None and linear_solver.name == "qr" else None
    error = underconstrained(system, solver=keeps_A)
    free = FreeDirections(column_lengths(system))
    for _ in range(BLOCKS):
        anchored = free.held(pattern, values)
        system = LinearSystem.at(anchored, values)
        try:
            factorization = factorize(system, linear_solver)
        except SingularSystemError:
            if not free.collect(system):
                raise error from None
            continue
        undetermined = Undetermined(_cleaned(free), error)
        if len(np.unique(pattern.column_owner()[0][undetermined.moved])) == int((~pattern.held).sum()):
            raise error
        return anchored, factorization, undetermined
    raise error


def _cleaned(free: FreeDirections) -> sp.csr_array:
    """All directions (n, k), with zeros for what they hardly move: motions are compared in sigmas."""
    N = sp.csc_array(sp.hstack([free.singles, sp.csc_array(free.combinations)]))
    U = abs(sp.diags_array(free.norms) @ N)
    U = sp.csr_array(U @ sp.diags_array(1 / U.max(axis=0).toarray().reshape(-1)))
    N = sp.csr_array(N)
    # 1e-8 of the largest motion, in sigmas; rounding beside a chain of 3,000 poses is 4e-11
    N.data[U.data <= 1e-8] = 0.0
    N.eliminate_zeros()
    return N


def used_components(J: Array | None, shape: tuple[int, int]) -> Mask:
    """(n, d) which components of the tangent space a view J (n, k, d) is made of; all where J is None."""
    return np.ones(shape, dtype=bool) if J is None else (J != 0).any(axis=1)


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
    words = f"gauge 'free': {count} free directions of {free.n} unknowns need"
    refuse_larger(6 * 8.0 * free.n * count, memory_limit, "free gauge", words, "use gauge 'first'")
    A = LinearSystem.at(free, values).A
    try:
        unheld = factorization.solve((A[:, complement].T @ A[:, gauge]).toarray())
        directions = free_directions(A, gauge, complement, unheld)
    except SingularSystemError as error:
        raise GraphError(
            "gauge 'free': fixing a variable removes no free direction: a factor declares relative=True, but is not "
            "relative"
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
