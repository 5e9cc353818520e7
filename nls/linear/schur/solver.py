r"""Landmarks first: every one is eliminated by itself, and only the graph of poses is factorized.

    [H_ll H_lp; H_pl H_pp] [dx_l; dx_p] = [g_l; g_p]
    S = H_pp - H_pl H_ll^-1 H_lp
    S dx_p = g_p - H_pl H_ll^-1 g_l
    dx_l = H_ll^-1 (g_l - H_lp dx_p)

l are variables that share no factor with each other, so that H_ll is block diagonal; p are all others. The set is found
from the structure alone (`independent`): landmarks that are only seen from poses, the points of a bundle adjustment. S
is formed block by block (`nls.linear.schur.complement`) and factorized by the best decomposition installed. Its order
is that of the graph of p in which everything that sees one l is joined.

It is the Cholesky factorization of H in one particular order, and judged like every other. Pivots of H_ll and of S are
compared with the diagonal of H, and a free direction that rounding hides is looked for in A.

Source: D. C. Brown, "The bundle adjustment: progress and prospects", 1976; B. Triggs, P. McLauchlan, R. Hartley,
A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000, section 6.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, Mask
from models.errors import OptionError
from nls.linear.base import LinearSolution, NormalAnalysis, NormalEquations
from nls.linear.default import default_solver
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.limits import refuse_above
from nls.linear.schur.complement import Complement
from nls.linear.schur.inverses import BlockInverse, missing_directions
from nls.sparse.elimination import Elimination, connected
from nls.sparse.fill import refuse_larger
from nls.sparse.hessian import Blocks
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem

SEARCHED = 16  # kinds among which the best set is searched for


def independent(pattern: Pattern, blocks: Blocks) -> tuple[Mask, str]:
    """The free variables that can be eliminated one by one.

    All variables of the kinds of which no two variables share a factor; where several sets of kinds will do, the one
    with the most columns (of more than 16 such kinds one with many). In a graph without such a kind (a pose graph:
    poses are joined to poses) single variables, few neighbors first.

    Parameters
    ----------
    pattern : the numbering of the graph.
    blocks : which of its free variables share a factor.

    Returns
    -------
    gone : (V,) which of the free variables.
    sentence : in words.
    """
    names, u, v, V = list(pattern.numbers), blocks.u, blocks.v, len(blocks.dims)
    kind = np.repeat(np.arange(len(names)), [len(numbers) for numbers in pattern.numbers.values()])[~pattern.held]
    columns = np.bincount(kind, weights=blocks.dims, minlength=len(names)).astype(np.intp)
    joined = np.zeros((len(names), len(names)), dtype=bool)
    joined[kind[u], kind[v]] = joined[kind[v], kind[u]] = True
    chosen = _heaviest([k for k in range(len(names)) if columns[k] > 0 and not joined[k, k]], joined, columns)
    gone = np.isin(kind, chosen) if chosen else separate(u, v, V)
    count, total = np.bincount(kind[gone], minlength=len(names)), np.bincount(kind, minlength=len(names))
    parts = [
        names[k] if count[k] == total[k] else f"{count[k]:,} of {total[k]:,} {names[k]}" for k in np.flatnonzero(count)
    ]
    names_of_gone = " and ".join(parts) if parts else "nothing"
    return gone, f"{names_of_gone} eliminated: {int(blocks.dims[gone].sum()):,} of {int(blocks.dims.sum()):,} columns"


def _heaviest(kinds: Sequence[int], joined: Mask, columns: Index) -> list[int]:
    """The set of kinds, no two of them joined, with the most columns; the first of equals.

    A search takes time exponential in the number of kinds (24: 1 s; 40: half an hour). Of more than `SEARCHED` the one
    with the most columns is taken, and those it is joined to left out, until so few are left.
    """
    chosen: list[int] = []
    while len(kinds) > SEARCHED:
        most = max(kinds, key=lambda k: columns[k])
        chosen.append(most)
        kinds = [k for k in kinds if k != most and not joined[most, k]]
    return chosen + _searched(kinds, joined, columns)


def _searched(kinds: Sequence[int], joined: Mask, columns: Index) -> list[int]:
    """The best set with the first of the kinds, or the best without it."""
    if not kinds:
        return []
    first, tail = kinds[0], kinds[1:]
    apart = [k for k in tail if not joined[first, k]]
    with_first = [first, *_searched(apart, joined, columns)]
    if len(apart) == len(tail):
        return with_first
    left = _searched(tail, joined, columns)
    return with_first if columns[with_first].sum() >= columns[left].sum() else left


def twins(pattern: Pattern, blocks: Blocks, gone: Mask) -> Index:
    """A number (V,) for every free variable, the same for those that see the same eliminated ones in the same factors.

    Pose and lens of a camera are such twins where each has its own; a lens that all share is the twin of none.

    Parameters
    ----------
    pattern, blocks : as for `independent`.
    gone : (V,) which of the free variables are eliminated.
    """
    u, v, V = blocks.u, blocks.v, len(gone)
    pair = np.unique(np.concatenate([u * V + v, v * V + u])[np.concatenate([gone[v] > gone[u], gone[u] > gone[v]])])
    p, l = np.divmod(pair, max(V, 1))
    names = np.random.default_rng(0).integers(1 << 62, size=V, dtype=np.uint64)
    signature = np.zeros(V, dtype=np.uint64)  # sums that differ as the sets differ, but for a chance of 1e-19 a pair
    np.add.at(signature, p, names[l])
    number = np.full(len(pattern.held), -1, dtype=np.intp)  # of what is held: the last place of these three
    number[~pattern.held] = np.arange(V)
    gone, stays, signature = np.append(gone, False), np.append(~gone, False), np.append(signature, 0)
    joined = [np.zeros((2, 0), dtype=np.intp)]
    for batch in pattern.batches:
        slots = [number[variables] for variables in batch.variables]
        landmark = np.any([gone[i] for i in slots], axis=0)
        for a, b in combinations(slots, 2):
            same = landmark & stays[a] & stays[b] & (signature[a] == signature[b])
            joined.append(np.stack([a[same], b[same]]))
    a, b = np.concatenate(joined, axis=1)
    return connected(a, b, V)


def together(order: Index, group: Index) -> Index:
    """Variables in an order in which each group is together, where its first member was.

    Examples
    --------
    >>> import numpy as np
    >>> together(np.array([3, 0, 2, 1]), np.array([0, 1, 1, 0])).tolist()
    [3, 0, 2, 1]
    >>> together(np.array([3, 2, 0, 1]), np.array([0, 1, 1, 0])).tolist()
    [3, 0, 2, 1]
    """
    number = group[order]
    _, first, inverse = np.unique(number, return_index=True, return_inverse=True)
    return order[np.argsort(first[inverse], kind="stable")]


def separate(u: Index, v: Index, V: int) -> Mask:
    """A maximal set of nodes (V,) of which no two are neighbors; those of few neighbors first.

    In every round the nodes that come before all their neighbors are taken, and the neighbors left out. There are about
    log V rounds when nodes of equally many neighbors come in random order (fixed seed).

    Source: M. Luby, "A simple parallel algorithm for the maximal independent set problem", SIAM J. Comput. 15 (1986).

    Examples
    --------
    >>> import numpy as np
    >>> separate(np.array([0, 0, 0]), np.array([1, 2, 3]), 5).tolist()
    [False, True, True, True, True]
    """
    a, b = np.concatenate([u, v]), np.concatenate([v, u])
    rank = np.empty(V, dtype=np.intp)
    rank[np.lexsort((np.random.default_rng(0).permutation(V), np.bincount(a, minlength=V)))] = np.arange(V)
    chosen, left = np.zeros((2, V), dtype=bool)
    while len(a):
        before = np.full(V, V)
        np.minimum.at(before, a, rank[b])
        chosen[a[rank[a] < before[a]]] = True
        left[b[chosen[a]]] = True
        on = ~(chosen[a] | left[a] | left[b])
        a, b = a[on], b[on]
    return ~left


PER_PAIR = 60.0  # bytes at the peak per pair of neighbors of one eliminated variable, while the lists are sorted


class SchurDecomposition(Decomposition):
    """H = L L' of a `Hessian` whose first columns are eliminated block by block.

    Parameters
    ----------
    complement : S, its structure.
    exact : whether the blocks are inverted exactly, so that there is an L.

    Attributes
    ----------
    left_alone : directions on which the inverses of the latest blocks are 0.
    """

    left_alone = 0

    @staticmethod
    def order(u: Index, v: Index, V: int) -> Index:
        """Order of the variables that are kept, as S is factorized."""
        return default_solver().decomposition.order(u, v, V)

    def __init__(self, complement: Complement, exact: bool) -> None:
        self._complement, self._exact = complement, exact
        self._decomposition = default_solver().decomposition(complement.hessian)

    def factorize(self, S: Array) -> Array:
        with single_thread():
            filled = self._complement.fill(S)
        self._L, self._roots, self._H_pp = filled.L, filled.roots, filled.H_pp
        if not self._exact:
            self.left_alone = sum(map(missing_directions, self._roots))
        return np.concatenate([filled.pivots, self._decomposition.factorize(filled.flat)])

    def solve(self, g: Array) -> Array:
        n = self._complement.n
        y = self._blockwise(self._roots, g[:n])
        x = np.zeros(g.shape)
        x[n:] = self._reduced(g[n:] - (self._L @ y)[n:])
        x[:n] = self._blockwise([X.mT for X in self._roots], y - self._L.T @ x)
        return x

    def _reduced(self, g: Array) -> Array:
        """S^-1 g."""
        return self._decomposition.solve(g)

    def _blockwise(self, stacks: list[Array], g: Array) -> Array:
        """Every block times its rows of g."""
        parts = [
            np.matmul(X, g[group.columns].reshape(len(X), group.d, -1)).reshape(-1, *g.shape[1:])
            for group, X in zip(self._complement.groups, stacks, strict=True)
        ]
        return np.concatenate([*parts, g[:0]])

    def lower(self) -> tuple[sp.csc_array, Index]:
        if not self._exact:
            raise OptionError("block_inverse", "another than the exact inverse", "None: H has no factor L otherwise")
        n, (L, order) = self._complement.n, self._decomposition.lower()
        p = np.concatenate([np.arange(n), n + order])
        right = sp.csc_array((L.data, L.indices + n, L.indptr), shape=(len(p), len(order)))
        return sp.csc_array(sp.hstack([self._L[p], right])), p


class SchurAnalysis(NormalAnalysis):
    """H, its first columns eliminated block by block.

    Parameters
    ----------
    factorization, decomposition : of H, and how it is made.
    eliminated : which variables, in words.
    exact : whether the blocks are inverted exactly.
    """

    def __init__(
        self, factorization: Factorization, decomposition: SchurDecomposition, eliminated: str, exact: bool
    ) -> None:
        super().__init__(Schur.name, factorization)
        self._decomposition, self._eliminated, self._exact = decomposition, eliminated, exact

    @property
    def description(self) -> str:
        """Name, what is eliminated, and how many directions of that another inverse left alone in the latest solve."""
        left = "" if self._exact else f", {self._decomposition.left_alone:,} directions left alone"
        return f"{self.name}, {self._eliminated}{left}"

    def again(self, system: LinearSystem) -> LinearSolution | None:
        return super().again(system) if self._exact else None  # it is not this H that was factorized


class Schur(NormalEquations):
    """A'A dx = A'b by the Schur complement of all variables that share no factor with each other, such as landmarks.

    Which they are is found from the graph, and the result says it. Where no whole kind of variables will do, as in a
    pose graph, single ones are eliminated. On surveys a solve takes 0.9 to 1.3 times that of `Cholesky`, whose minimum
    degree finds almost the same order (benchmarks/results/schur.md). On a bundle adjustment where every camera has its
    own lens it takes 0.6 times (benchmarks/bundle.py); more on other graphs.

    Parameters
    ----------
    block_inverse : a function from the blocks of H_ll, (k, d, d), to what is taken for their inverses, symmetric and
        positive semi-definite; called once for every dimension d in every solve. Exact when omitted, and a singular
        block is refused. Another inverse gives another step than argmin |A dx - b|, and no covariances. The
        result says along how many directions nothing moved, and is STALLED where one is pulled by more than 5 sigmas.
    memory_limit : as in `Cholesky`.

    Raises
    ------
    OptionError
        An option that is not possible.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic, Landmark, Prior
    >>> from models import R, SE2
    >>> from nls import FactorGraph, Schur, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(1)), Between(x[0], x[1], [1, 0, 0], Isotropic(0.1))])
    >>> seen = graph.add(Landmark(x[[0, 1, 0, 1]], l[[0, 0, 1, 1]], [[2, 1], [1, 1], [3, 1], [2, 1]], Isotropic(0.1)))
    >>> start = Values({x: (SE2, np.zeros((2, 3))), l: (R(2), np.zeros((2, 2)))})
    >>> result = graph.optimize(start, linear_solver=Schur())
    >>> result.linear_solver, result.values[l].round(6).tolist()
    ('schur, l eliminated: 4 of 10 columns', [[2.0, 1.0], [3.0, 1.0]])
    """

    name = "schur"
    per_number = 37.0  # as measured for surveys of 2,000 (37) and 5,000 poses (34)

    def __init__(self, block_inverse: BlockInverse | None = None, memory_limit: float | None = None) -> None:
        super().__init__(memory_limit)
        if block_inverse is not None and not callable(block_inverse):
            raise OptionError("block_inverse", block_inverse, "a function of blocks (k, d, d), or None")
        self.block_inverse, self.exact = block_inverse, block_inverse is None

    def analyze(self, pattern: Pattern) -> SchurAnalysis:
        blocks = pattern.blocks
        gone, eliminated = independent(pattern, blocks)
        group = twins(pattern, blocks, gone)
        order = self._order(blocks, gone, group)
        hessian = pattern.hessian(order)
        refuse_above(self.memory_limit, max(self.per_number, default_solver().per_number), hessian, self.name)
        count = int(gone.sum())
        complement = Complement(hessian, count, group[order[count:]], self.block_inverse)
        decomposition = SchurDecomposition(complement, self.exact)
        return SchurAnalysis(Factorization(hessian, decomposition), decomposition, eliminated, self.exact)

    def __repr__(self) -> str:
        return "Schur()" if self.exact else "Schur(block_inverse=...)"

    def _order(self, blocks: Blocks, gone: Mask, group: Index) -> Index:
        """The eliminated variables by dimension, then the others as S is factorized, twins together.

        Raises
        ------
        ResourceLimitError
            One eliminated variable joins so many others that S would not fit.
        """
        first, survivors = np.flatnonzero(gone), np.flatnonzero(~gone)
        number = np.empty(len(gone), dtype=np.intp)
        number[first], number[survivors] = np.arange(len(first)), np.arange(len(survivors))
        u, v = blocks.u, blocks.v
        across, inside = gone[u] != gone[v], ~(gone[u] | gone[v])
        l, p = np.where(gone[u], u, v)[across], np.where(gone[u], v, u)[across]
        ones = np.ones(len(l), dtype=bool), (number[l], number[p])
        incidence = sp.csr_array(ones, shape=(len(first), len(survivors)))
        degree = np.diff(incidence.indptr)
        pairs = float((degree * (degree + 1.0) / 2).sum())
        eliminating = f"eliminating {len(first):,} variables connects {pairs:,.0f} pairs of others"
        words = f"linear solver {self.name!r}: {eliminating}, which needs"
        cure = "take linear solver 'cholesky', or allow more with memory_limit"
        refuse_larger(PER_PAIR * pairs, self.memory_limit, "Schur complement", words, cure, ".3g")
        joined = sp.coo_array(sp.tril(incidence.T @ incidence, -1))
        i, j = (np.concatenate([number[a[inside]], b]) for a, b in ((u, joined.row), (v, joined.col)))
        poses = Elimination(i, j, len(survivors), SchurDecomposition.order).variables if len(survivors) else survivors
        return np.concatenate([first[np.argsort(blocks.dims[first], kind="stable")], together(survivors[poses], group)])
