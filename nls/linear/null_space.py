r"""The null space of A in directions that can be read: of single variables, else of as few as may be.

Any basis of a null space is as good as another, and the one that a decomposition happens to return mixes everything
that is free. Of eight landmarks seen once, eight directions that move all of them. So first those of single variables,

    A_v u = 0        v: the columns of one variable, u a direction of it alone

which are found one by one, however many there are. Then the others, orthogonal to these, are combined so that each of k
directions is zero in k - 1 chosen unknowns. These are the pivots of a QR decomposition of the transposed basis. What
belongs to separate parts of the graph comes apart.

**Anchors** hold what the measurements leave free, and nothing else. N (n, k) is a basis of the null space of A. The k
unknowns are the pivots of a QR decomposition of N', so that their rows of N form an invertible matrix C N. A prior on
each of them gives

    S = (A'A + C'C)^-1 = S_0 + N M' + M N'

with some M for every strength of the priors, S_0 the pseudo-inverse of A'A. What no free direction moves, J N = 0,
keeps its covariance, J S J' = J S_0 J'. S is a generalized inverse of A'A: residuals stay what they are.

**The free gauge**: the shortest step, by any linear solver, with one variable of every component held.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from factors.noise import Isotropic
from factors.prior import Prior
from models.algebra import Array, Index, gram
from nls.linear.base import Analysis, LinearSolution, LinearSolver
from nls.linear.default import best_decomposition
from nls.linear.factorization import NULL, ROUNDING, Factorization, SingularSystemError
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

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


def column_lengths(system: LinearSystem) -> Array:
    """Lengths (n,) of the columns of A, 0 for what is rounding beside the longest column of its variable."""
    owner, _ = system.pattern.column_owner()
    largest = np.zeros(len(system.pattern.dims))
    np.maximum.at(largest, owner, system.column_norms)
    return np.where(system.column_norms > ROUNDING * largest[owner], system.column_norms, 0.0)


class FreeDirections:
    """Directions in which no measurement reacts, collected round by round, and the unknowns that hold them.

    Parameters
    ----------
    lengths : (n,) from `column_lengths`. A column of zeros is a free direction.

    Attributes
    ----------
    singles : (n, q) directions of one variable each, in units of the unknowns.
    combinations : (n, r) directions that move several.
    anchors : (q + r,) columns that are held.
    norms : (n,) lengths of the columns of A; 1 where a column is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Isotropic, Prior
    >>> from models import R
    >>> from nls import FactorGraph, Values, factorize, kinds
    >>> (l,) = kinds("l")
    >>> graph = FactorGraph([Prior(l[0], [1.0, 2.0], Isotropic(0.5), components=["x"])])
    >>> values = Values({l: (R(2), [[1.0, 2.0]])})
    >>> system = graph.linearize(values)
    >>> free = FreeDirections(column_lengths(system))
    >>> free.count, free.anchors.tolist()
    (1, [1])
    >>> held = LinearSystem.at(free.held(system.pattern, values), values)
    >>> factorize(held).solve(np.eye(2)).diagonal().tolist()
    [0.25, 1.0]
    """

    def __init__(self, lengths: Array) -> None:
        zero, n = np.flatnonzero(lengths == 0), len(lengths)
        self.norms = np.where(lengths == 0, 1.0, lengths)
        self.singles = sp.csc_array((np.ones(len(zero)), zero, np.arange(len(zero) + 1)), (n, len(zero)))
        self.combinations = np.zeros((n, 0))
        self.anchors: Index = zero

    @property
    def count(self) -> int:
        """How many directions there are."""
        return len(self.anchors)

    def collect(self, system: LinearSystem) -> bool:
        """Add the free directions of a singular system that has the priors of `held`; False where it has none."""
        norms, single = system.balanced.column_norms, single_directions(system.balanced)
        N, _ = null_directions(system.balanced, single)
        if not N.shape[1] and not single.shape[1]:
            return False
        directions = separated(N, single, norms) if N.shape[1] else N
        single = sp.csc_array(sp.diags_array(system.column_norms / norms) @ single)  # of length 1 by the weighted A
        single = sp.csc_array(single @ sp.diags_array(1 / np.sqrt(single.power(2).sum(axis=0))))
        self.anchors = np.concatenate([self.anchors, _pivots(directions, single, self.norms)])
        self.singles = sp.csc_array(sp.hstack([self.singles, sp.diags_array(1 / self.norms) @ single]))
        self.combinations = np.concatenate([self.combinations, directions], axis=1)
        return True

    def held(self, pattern: Pattern, values: Values) -> Pattern:
        """The pattern with a prior on every anchor, as strong as the measurements that touch it."""
        if not self.count:
            return pattern
        owner, component = pattern.column_owner()
        start = np.array([*pattern.offsets.values()])
        kind = np.searchsorted(start, owner[self.anchors], side="right") - 1
        priors = []
        for k, (name, manifold) in enumerate(pattern.manifolds.items()):
            for c, label in enumerate(manifold.components):
                members = self.anchors[(kind == k) & (component[self.anchors] == c)]
                if len(members):
                    rows = owner[members] - pattern.offsets[name]
                    keys = Keys(name, pattern.numbers[name][rows])
                    noise = Isotropic(1 / self.norms[members])
                    priors.append(Prior(keys, values.stack(name).X[rows], noise, components=(label,)))
        factors = [batch.model.factor for batch in pattern.batches]
        return Pattern([*factors, *priors], values).holding(pattern.held)


def _pivots(directions: Array, single: sp.csc_array, norms: Array) -> Index:
    """As many unknowns as directions, which hold all of these when they are held: N[pivots] is invertible.

    Those of single variables S first; then those of N - S S[pivots]^-1 N[pivots], which leave the first ones alone.
    """
    from scipy.linalg import qr

    out: list[Index] = [np.zeros(0, dtype=np.intp)]
    remainder = directions * norms[:, None]
    for begin, end in _runs(single):
        rows = single.indices[single.indptr[begin] : single.indptr[begin + 1]]
        S = single[rows][:, begin:end].toarray()
        pivots = qr(S.T, mode="r", pivoting=True)[1][: end - begin]
        remainder[rows] -= S @ np.linalg.solve(S[pivots], remainder[rows[pivots]])
        remainder[rows[pivots]] = 0.0  # but for rounding
        out.append(rows[pivots])
    if directions.shape[1]:
        out.append(qr(remainder.T, mode="r", pivoting=True)[1][: directions.shape[1]])
    return np.concatenate(out).astype(np.intp)


def _runs(single: sp.csc_array) -> list[tuple[int, int]]:
    """Directions (begin, end) of one variable, which follow each other."""
    first = single.indices[single.indptr[:-1]]
    ends = [*np.flatnonzero(first[1:] != first[:-1]) + 1, len(first)] if len(first) else []
    return list(zip([0, *ends], ends, strict=False))


def gauge_columns(held: Pattern, free: Pattern) -> tuple[Index, Index]:
    """Columns of `free` that `held` leaves out, the gauge, and all others."""
    gauge = np.flatnonzero(np.repeat(held.held & ~free.held, np.where(free.held, 0, free.dims)))
    return gauge, np.setdiff1d(np.arange(free.n), gauge)


def free_directions(A: sp.csr_array, gauge: Index, complement: Index, unheld: Array) -> Array:
    """Orthonormal basis (n, k) of the free gauge, N = [-pinv(A_f) A_h; I], from ``unheld``, pinv(A_f) A_h.

    Raises
    ------
    SingularSystemError
        The held columns are no free directions: N changes a measurement.
    """
    N = np.zeros((A.shape[1], len(gauge)))
    N[complement], N[gauge] = -unheld, np.eye(len(gauge))
    lengths = np.sqrt(A.copy().power(2).sum(axis=0))  # of A itself it would sort indices that all linearizations share
    U = N / np.linalg.norm(lengths[:, None] * N, axis=0)  # of length 1 in sigmas, whatever the units
    if np.abs(A @ U).max(initial=0.0) > 1e-6:  # sigmas; public pose graphs have at most 1e-10
        raise SingularSystemError("the fixed variable is not a free direction of the measurements")
    return np.asarray(np.linalg.qr(N)[0])


class FreeGauge(LinearSolver):
    """A linear solver whose step is the shortest of all minimizers, found with one variable per component held.

    With A = [A_f A_h], the columns of N = [-pinv(A_f) A_h; I] change no measurement: they are the gauge. The step of
    the solver with the held columns left out, minus its part along N, is pinv(A) b, by sparse means. The factorization
    of the step serves N as well, N_f = -(A_f'A_f)^-1 A_f'A_h; a solver that keeps none is called once per column.

    Parameters
    ----------
    solver : the linear solver for the free columns.
    held : the pattern with the gauge held; the pattern given to `analyze` has all its columns.
    """

    def __init__(self, solver: LinearSolver, held: Pattern) -> None:
        self.solver, self.held = solver, held
        self.name, self.exact, self.shortest = solver.name, solver.exact, solver.shortest

    def analyze(self, pattern: Pattern) -> FreeAnalysis:
        return FreeAnalysis(self, self.solver.analyze(self.held), *gauge_columns(self.held, pattern))

    def left(self, system: LinearSystem) -> Array | None:
        return self.solver.left(system)

    def held_system(self, system: LinearSystem) -> LinearSystem:
        return LinearSystem(self.held, system.blocks, system.b)


class FreeAnalysis(Analysis):
    """The analysis of a pattern by `FreeGauge`.

    Parameters
    ----------
    solver, analysis : of the free gauge; of the columns that are not held.
    gauge, complement : columns that are the gauge, and all others.
    """

    def __init__(self, solver: FreeGauge, analysis: Analysis, gauge: Index, complement: Index) -> None:
        super().__init__(solver.name)
        self.solver, self.analysis, self.gauge, self.complement = solver, analysis, gauge, complement

    @property
    def description(self) -> str:
        return self.analysis.description

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        held = self.solver.held_system(system)
        step = self.analysis.solve(held, None if damping is None else damping[self.complement])
        t0 = perf_counter()
        x = np.zeros(system.pattern.n)
        x[self.complement] = step.dx
        unheld = self.analysis.columns(held, system.A[:, self.gauge])
        Q = free_directions(system.A, self.gauge, self.complement, unheld)
        seconds = {**step.seconds, "solve": step.seconds.get("solve", 0.0) + perf_counter() - t0}
        return LinearSolution(x - Q @ (Q.T @ x), seconds)
