r"""Every measurement against the prediction of all others, from one linearization.

With P = (sum w_i A_i'A_i)^-1 over all measurements, dx = P sum w_i A_i'b_i the step to the minimum,

    e_i = b_i - A_i dx     what the fit leaves of measurement i, in sigmas
    C_i = A_i P A_i'       the covariance of what the fit says about it, (m, m)

and without measurement i, exactly where the problem is linear,

    e_i <- (I - w_i C_i)^-1 e_i,   C_i <- C_i (I - w_i C_i)^-1

Any two variables of one factor are neighbors in A'A. So the blocks of P that C_i needs come out of one pass over its
Cholesky factor (`nls.sparse.takahashi`). Taking a measurement out changes all others by products of its m columns P
A_i'. Several measurements are one whose A_i are stacked. W. Baarda, "A testing procedure for use in geodetic networks",
1968; the redundancy numbers tr(I - C_i) are in P. Teunissen, "Testing theory: an introduction", 2000.

**Judged** one by one and by kind:

    t_i = e_i' (I - C_i)^-1 e_i  ~  chi2(m_i)      under the model, without measurement i (w_i = 1)
    dof = sum_i m_i - tr(w_i C_i)                  of a kind: its numbers, less what it has spent on the unknowns

With a weight w_i < 1 of a robust kernel the covariance of the residual without i is

    (I - w_i C_i)^-1 (I + (1 - w_i) C_i)

In the axes of C_i, with eigenvalues c, both are sums. Where 1 - w c vanishes nothing else checks that direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.algebra import Array, Index, Mask, apply, product
from models.chi_squared import chi2_gate
from nls.linear import factorize
from nls.linear.limits import default_limit
from nls.posegraph import closures, odometry
from nls.sparse.pattern import Batch, Pattern, measuring
from nls.system import LinearSystem
from nls.values import Values


class Linearization:
    """Whitened Jacobians A, errors b and weights w of every batch, and the weighted system of them.

    Parameters
    ----------
    pattern : the numbering, with the gauge held.
    values : where to linearize.
    accepted : (k,) per batch, which measurements count; all when omitted.

    Attributes
    ----------
    A, b, w : per batch the blocks (k, m, d) of every slot, errors (k, m), weights (k,): of the robust kernel, or 1.
    system : sqrt(w) A dx = sqrt(w) b.
    """

    def __init__(self, pattern: Pattern, values: Values, accepted: Sequence[Array] | None = None) -> None:
        self.pattern, self.A, self.b, self.w = pattern, [], [], []
        blocks, rows = [], np.empty(pattern.m)
        for k, batch in enumerate(pattern.batches):
            model, X = values.gather(batch.model.factor)
            A, b = model.linearize(*X)
            kernel = model.factor.kernel
            w = np.ones(len(b)) if kernel is None else kernel.weight(np.square(b).sum(axis=1))
            if accepted is not None and k < len(accepted):
                w = w * accepted[k]
            root = np.sqrt(w)
            plain = bool((w == 1).all())
            blocks.append(A if plain else tuple(A_k * root[:, None, None] for A_k in A))
            rows[batch.rows] = (b if plain else b * root[:, None]).reshape(-1)
            self.A.append(A)
            self.b.append(b)
            self.w.append(w)
        self.system = LinearSystem(pattern, blocks, rows)


@dataclass
class Together:
    """Several measurements as one.

    Attributes
    ----------
    batch, index : (k,) number of the batch, in rising order, and of the measurement in it.
    C : covariance of the prediction of all their numbers; taking others out changes it.
    """

    batch: Index
    index: Index
    C: Array


class Checked:
    """Every measurement against all others.

    Parameters
    ----------
    linear : a linearization of full rank.

    Attributes
    ----------
    w, e, C : per batch the weights (k,), residuals (k, m) and covariances of the prediction (k, m, m).
    dx : (n,) the step to the minimum of the linear problem.
    promised : by how much chi2 falls in that step, if the problem is linear.
    diagonal : (d, d) covariances of the free variables, one after the other, row by row.
    """

    def __init__(self, linear: Linearization) -> None:
        self.linear, pattern = linear, linear.pattern
        self.factorization = factorize(linear.system)
        self.dx = self.factorization.solve(linear.system.gradient)
        self.promised = linear.system.promised(self.dx)
        X = pattern.by_kind(self.dx)
        self.w = [w.copy() for w in linear.w]
        self.e = []
        for batch, A, b in zip(pattern.batches, linear.A, linear.b, strict=True):
            moved = [apply(A_k, X[kind][at]) for A_k, kind, at in zip(A, batch.kinds, batch.index, strict=True)]
            self.e.append(b - sum(moved[1:], moved[0]))
        self._removals: list[tuple[Array, Array]] = []
        self._together: list[Together] = []
        self._predictions()

    def _predictions(self) -> None:
        """C of all measurements, from the blocks of P of their variables."""
        pattern, dims = self.linear.pattern, self.linear.pattern.blocks.dims
        number = np.where(pattern.held, -1, np.cumsum(~pattern.held) - 1)
        every = np.arange(len(dims))
        rows, columns = [every], [every]
        for batch in pattern.batches:
            for a, b in combinations(range(len(batch.variables)), 2):
                i, j = number[batch.variables[a]], number[batch.variables[b]]
                both = (i >= 0) & (j >= 0)
                rows.append(i[both])
                columns.append(j[both])
        blocks = self.factorization.inverse_blocks(np.concatenate(rows), np.concatenate(columns), default_limit())
        sizes = [int((dims[i] * dims[j]).sum()) for i, j in zip(rows, columns, strict=True)]
        parts = iter(np.split(blocks, np.cumsum(sizes)[:-1]))
        self.diagonal = next(parts)
        begin = np.cumsum(dims**2) - dims**2
        self.C = []
        for batch, A in zip(pattern.batches, self.linear.A, strict=True):
            C = np.zeros((len(batch), batch.model.dim, batch.model.dim))
            free = [number[v] >= 0 for v in batch.variables]
            for A_a, v, here in zip(A, batch.variables, free, strict=True):
                d = A_a.shape[2]
                P = self.diagonal[begin[number[v[here]], None] + np.arange(d * d)].reshape(-1, d, d)
                C[here] += product(product(A_a[here], P), A_a[here].mT)
            for a, b in combinations(range(len(A)), 2):
                both = free[a] & free[b]
                P = next(parts).reshape(-1, A[a].shape[2], A[b].shape[2])
                half = product(product(A[a][both], P), A[b][both].mT)
                C[both] += half + half.mT
            self.C.append((C + C.mT) / 2)

    def together(self, batch: Index, index: Index) -> Together:
        """Several measurements (k,) as one: of which batch, in rising order, and which in it."""
        joint = Together(batch, index, self._columns(batch, index)[1])
        self._together.append(joint)
        return joint

    def roots(self, batch: Index, index: Index) -> Array:
        """Root of the weight of every number of some measurements."""
        every = [np.broadcast_to(np.sqrt(w)[:, None], e.shape) for w, e in zip(self.w, self.e, strict=True)]
        return stacked(every, batch, index)

    def take_out(self, batch: Index | int, index: Index | int) -> None:
        """All others without some measurements: e, C and w as if the linear problem had been solved again."""
        batch, index = np.atleast_1d(batch, index)
        U, C = self._columns(batch, index)
        e, root = stacked(self.e, batch, index), self.roots(batch, index)
        K = root[:, None] * np.linalg.inv(np.eye(len(e)) - root[:, None] * C * root) * root
        self._removals.append((U, K))
        G = self._times(U)
        for k, G_k in enumerate(G):
            self.e[k] = self.e[k] + G_k @ (K @ e)
            self.C[k] = self.C[k] + G_k @ K @ G_k.mT
        for joint in self._together:
            B = stacked(G, joint.batch, joint.index)
            joint.C = joint.C + B @ K @ B.T
        for k in np.unique(batch):
            self.w[k][index[batch == k]] = 0.0

    def _columns(self, batch: Index, index: Index) -> tuple[Array, Array]:
        """P A' (n, m) and A P A' (m, m) of some measurements, P without those taken out."""
        pattern, parts = self.linear.pattern, []
        for k in np.unique(batch):
            at, m = index[batch == k], pattern.batches[k].model.dim
            A = np.zeros((pattern.n, len(at), m))
            for A_k, variables in zip(self.linear.A[k], pattern.batches[k].variables, strict=True):
                start, d = pattern.starts[variables[at]], A_k.shape[2]
                free = np.flatnonzero(start >= 0)
                A[start[free, None] + np.arange(d), free[:, None]] += A_k[at[free]].mT
            parts.append(A.reshape(pattern.n, len(at) * m))
        columns = np.concatenate(parts, axis=1)
        U = self.factorization.solve(columns)
        for V, K in self._removals:
            U += V @ (K @ (V.T @ columns))
        touched = columns.any(axis=1)
        C = columns[touched].T @ U[touched]
        return U, (C + C.T) / 2

    def _times(self, U: Array) -> list[Array]:
        """A U by batch, (k, m, columns)."""
        pattern, out = self.linear.pattern, []
        for batch, A in zip(pattern.batches, self.linear.A, strict=True):
            G = np.zeros((len(batch), batch.model.dim, U.shape[1]))
            for A_k, variables in zip(A, batch.variables, strict=True):
                start, d = pattern.starts[variables], A_k.shape[2]
                free = start >= 0
                G[free] += A_k[free] @ U[start[free, None] + np.arange(d)]
            out.append(G)
        return out


def stacked(arrays: Sequence[Array], batch: Index, index: Index) -> Array:
    """Rows of some measurements, one after the other, from arrays (k, m, ...) or (k,) by batch."""
    return np.concatenate([arrays[k][index[batch == k]].reshape(-1, *arrays[k].shape[2:]) for k in np.unique(batch)])


UNCHECKED = 1e-6  # redundancy; an error there must be a thousand sigmas to leave one in the residual
UNSEEN_REDUNDANCY = 1e-9  # redundancy of a direction; what is less is rounding


@dataclass(frozen=True)
class Tested:
    """The measurements of one batch.

    Attributes
    ----------
    t : (k,) squared distance from the prediction of all others, in its sigmas.
    m : (k,) numbers that all others check, the degrees of freedom of t.
    rows : (k,) numbers that measure something.
    dof : (k,) share of the degrees of freedom of chi2.
    checked : (k,) whether all its numbers are checked.
    """

    t: Array
    m: Index
    rows: Index
    dof: Array
    checked: Mask


def tested(batch: Batch, e: Array, C: Array, w: Array) -> Tested:
    """t and redundancy of the measurements of a batch, from residuals e (k, m), C (k, m, m) and weights (k,)."""
    t, r = left_out(e, C, w)
    redundant, rows = r > UNCHECKED, measuring(batch.model)
    idle = C.shape[1] - rows  # zero rows: nothing spent, nothing redundant
    m = np.maximum(redundant.sum(axis=1) - idle, 0)
    return Tested(t, m, rows, r.sum(axis=1) - idle, np.asarray(redundant.all(axis=1)))


def left_out(e: Array, C: Array, w: Array) -> tuple[Array, Array]:
    """t (k,) and redundancy along the axes of C (k, m), from residuals e (k, m), C (k, m, m) and weights (k,)."""
    c, V = np.linalg.eigh(C)
    r = 1 - w[:, None] * c
    along = np.square(np.matvec(V.mT, e))
    variance = np.where(r > UNCHECKED, r * (1 + (1 - w)[:, None] * c), np.inf)
    return (along / variance).sum(axis=1), r


def kinds_of(pattern: Pattern, count: int) -> dict[str, list[tuple[int, Index]]]:
    """Measurements by kind: factor type, relative poses in steps and closures if there are both; (batch, indices)."""
    out: dict[str, list[tuple[int, Index]]] = {}
    split = list(zip(pattern.batches, odometry(pattern), closures(pattern), strict=True))[:count]
    mixed = {batch.model.factor.name for batch, _, closing in split if closing.any()}
    for k, (batch, along, closing) in enumerate(split):
        name = batch.model.factor.name
        if batch.model.factor.limit_only:
            continue
        sides = {name: np.ones(len(batch), dtype=bool)}
        if name in mixed:
            sides = {f"{name}, steps": along, f"{name}, closures": closing, name: ~along & ~closing}
        for side, mask in sides.items():
            if mask.any():
                out.setdefault(side, []).append((k, np.flatnonzero(mask)))
    return out


def spoiled(tests: list[Tested], kind: list[tuple[int, Index]]) -> float:
    """The factor by which variances of a kind are too small, from the median of its t, which outliers do not move.

    nan where there are too few to say.
    """
    t = np.concatenate([tests[k].t[indices] for k, indices in kind])
    m = np.concatenate([tests[k].m[indices] for k, indices in kind])
    if (m > 0).sum() < 3:
        return float("nan")
    return middle_variance(t[m > 0], m[m > 0])


def middle_variance(t: Array, m: Index) -> float:
    """The median of some squared distances t (n,), each over the median of chi2 of its m (n,) numbers, m > 0."""
    medians = np.ones(int(m.max()) + 1)
    medians[1:] = [chi2_gate(d, 0.5) for d in range(1, len(medians))]
    return float(np.median(t / medians[m]))


def checks(checked: Checked, count: int) -> list[Tested]:
    """Of every batch of measurements."""
    batches = checked.linear.pattern.batches[:count]
    return [tested(*arguments) for arguments in zip(batches, checked.e, checked.C, checked.w, strict=False)]
