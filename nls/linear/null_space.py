r"""The null space of A in directions that can be read: of single variables, else of as few as may be.

Any basis of a null space is as good as another, and the one that a decomposition happens to return mixes everything
that is free. Of eight landmarks seen once, eight directions that move all of them. So first those of single variables,

    A_v u = 0        v: the columns of one variable, u a direction of it alone

which are found one by one, however many there are. Then the others, orthogonal to these, are combined so that each of k
directions is zero in k - 1 chosen unknowns. These are the pivots of a QR decomposition of the transposed basis. What
belongs to separate parts of the graph comes apart.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, gram
from nls.linear.default import best_decomposition
from nls.linear.factorization import NULL, Factorization, SingularSystemError
from nls.system import LinearSystem

SHIFTS = (1e-12, 1e-11, 1e-10)  # of the diagonal of A'A
MAX_DIRECTIONS, BLOCKS = 12, 8  # null directions looked for in one block; blocks; more are counted as "at least"


def null_directions(system: LinearSystem, singles: sp.csc_array) -> tuple[Array, bool]:
    """Free directions (n, k) besides those of single variables, at most 96 of them; and whether there may be more.

    Parameters
    ----------
    system : balanced.
    singles : (n, q) from `single_directions`.
    """
    basis, N = singles, np.zeros((singles.shape[0], 0))
    for _ in range(BLOCKS):
        s, V = weakest(system, basis)
        N = np.concatenate([N, V[:, s <= NULL]], axis=1)
        if (s > NULL).any() or len(s) < MAX_DIRECTIONS:
            return N, False
        U = V * np.where(system.column_norms > 0, system.column_norms, 1.0)[:, None]
        basis = sp.csc_array(sp.hstack([basis, sp.csc_array(U / np.linalg.norm(U, axis=0))]))
    return N, True


def weakest(system: LinearSystem, singles: sp.csc_array | None = None) -> tuple[Array, Array]:
    """The least singular values (k,) of A with columns scaled to length 1, at most 12, and their directions (n, k).

    Parameters
    ----------
    system : the linearization.
    singles : (n, q) from `single_directions`, which are looked for no more; none when omitted.

    Notes
    -----

    A is tall and sparse. A few rounds of inverse iteration on A'A + shift D^2 separate the free directions; D has the
    lengths of its columns. Small systems take the singular value decomposition of R in A = QR. Directions are in the
    units of the unknowns, each of length 1.
    """
    norms = system.column_norms
    scale = np.where(norms > 0, norms, 1.0)
    n = len(norms)
    S = sp.csc_array((n, 0)) if singles is None else singles
    if n <= 300:
        R = np.linalg.qr(sp.vstack([system.A @ sp.diags_array(1 / scale), S.T]).toarray(), mode="r")
        _, s, Vt = np.linalg.svd(np.pad(R, ((0, n - len(R)), (0, 0))))
        s, V = s[-MAX_DIRECTIONS:], Vt[-MAX_DIRECTIONS:].T
    else:
        inverse = _shifted(system, np.square(scale))
        V = np.linalg.qr(np.random.default_rng(0).normal(size=(n, MAX_DIRECTIONS)))[0]
        for _ in range(8):  # rounds of inverse iteration
            V = scale[:, None] * inverse.solve(scale[:, None] * (V - S @ (S.T @ V)))
            V = np.linalg.qr(V - S @ (S.T @ V))[0]
        _, s, Wt = np.linalg.svd(system.A @ (V / scale[:, None]), full_matrices=False)
        V = V @ Wt.T
    N = V / scale[:, None]
    return s, np.asarray(N / np.linalg.norm(N, axis=0))


def _shifted(system: LinearSystem, squares: Array) -> Factorization:
    """A'A + shift diag(squares), factorized by the best factorization installed: what is free is no obstacle then.

    BAL problem-49-7776, 23,757 unknowns: 1.0 s for all, 3.2 by SuperLU on scipy's A.T @ A. The least shift above the
    rounding of A'A is taken; 1e-12 may be too little for a large graph.
    """
    decomposition = best_decomposition(system.pattern.n)
    hessian, S = system.pattern.hessian(decomposition.order), system.H_blocks
    factorization = Factorization(hessian, decomposition(hessian))
    for shift in SHIFTS:
        shifted = S.copy()
        hessian.damp(shifted, shift * squares)
        try:
            pivots = factorization.decomposition.factorize(shifted)
        except SingularSystemError:
            continue
        if (pivots > 0).all():
            return factorization
    raise SingularSystemError("A'A is not positive definite beyond its rounding")


def single_directions(system: LinearSystem) -> sp.csc_array:
    """Free directions of single variables (n, k), each of length 1 with the columns of A scaled to length 1.

    Parameters
    ----------
    system : a column of zeros is a direction, too.
    """
    pattern, norms = system.pattern, np.where(system.column_norms > 0, system.column_norms, 1.0)
    A = system.A @ sp.diags_array(1 / norms)
    free = np.flatnonzero(pattern.starts >= 0)
    rows, numbers, count = [np.zeros(0, dtype=np.intp)], [np.zeros(0)], [np.zeros(1, dtype=np.intp)]
    for d in np.unique(pattern.dims[free]).tolist():
        variables = free[pattern.dims[free] == d]
        columns = pattern.starts[variables][:, None] + np.arange(d)  # (v, d)
        scale = norms[columns]
        w, V = np.linalg.eigh(own_information(system, variables, d) / (scale[:, :, None] * scale[:, None, :]))
        v, k = np.nonzero(w <= 1e-12)  # squares keep half of the digits, so only a candidate
        rows.append(columns[v].ravel())
        numbers.append(V[v, :, k].ravel())
        count.append(np.full(len(v), d))
    indptr = np.cumsum(np.concatenate(count))
    candidates = sp.csc_array((np.concatenate(numbers), np.concatenate(rows), indptr), (len(norms), len(indptr) - 1))
    lengths = np.sqrt(np.asarray((A @ candidates).power(2).sum(axis=0)).ravel())
    return sp.csc_array(candidates[:, np.flatnonzero(lengths <= NULL)])


def own_information(system: LinearSystem, variables: Index, d: int) -> Array:
    """A_v'A_v (k, d, d) of some variables (k,), all of d unknowns."""
    place = np.full(len(system.pattern.dims), -1)
    place[variables] = np.arange(len(variables))
    H = np.zeros((len(variables), d, d))
    for batch, blocks in zip(system.pattern.batches, system.blocks, strict=True):
        for index, A in zip(batch.variables, blocks, strict=True):
            at = place[index]
            if (rows := at >= 0).any():
                np.add.at(H, at[rows], gram(A[rows]))
    return H


def carriers_of_singles(directions: sp.csc_array, least: float) -> list[Index]:
    """The unknowns that carry each of some directions, by at least this part of what the first of them does."""
    out = []
    for begin, end in zip(directions.indptr[:-1], directions.indptr[1:], strict=True):
        size = np.abs(directions.data[begin:end])
        out.append(directions.indices[begin:end][size >= least * size.max()])
    return out


def separated(N: Array, singles: sp.csc_array, scale: Array) -> Array:
    """Free directions besides those of single variables, each moving as few unknowns as possible.

    Parameters
    ----------
    N : (n, k) free directions, in the units of the unknowns.
    singles : (n, q) from `single_directions`.
    scale : (n,) the lengths of the columns of A.

    Returns
    -------
    (n, r) free directions: each leaves r - 1 unknowns alone that the others move.
    """
    from scipy.linalg import qr

    U = N * scale[:, None]
    U = U / np.linalg.norm(U, axis=0)
    U, s, _ = np.linalg.svd(U - singles @ (singles.T @ U), full_matrices=False)
    Q = U[:, s > 1e-4]  # less is rounding: all else belongs to single variables
    pivots = qr(Q.T, mode="r", pivoting=True)[1][: Q.shape[1]]
    return np.asarray(Q @ np.linalg.inv(Q[pivots]) / scale[:, None])
