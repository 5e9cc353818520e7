r"""Anchors that hold what the measurements leave free, and nothing else.

N (n, k) is a basis of the null space of A. The k unknowns are the pivots of a QR decomposition of N', so that their
rows of N form an invertible matrix C N. A prior on each of them gives

    S = (A'A + C'C)^-1 = S_0 + N M' + M N'

with some M for every strength of the priors, S_0 the pseudo-inverse of A'A. What no free direction moves, J N = 0,
keeps its covariance, J S J' = J S_0 J'. S is a generalized inverse of A'A: residuals stay what they are.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from factors.noise import Isotropic
from factors.prior import Prior
from models.algebra import Array, Index
from nls.linear.factorization import ROUNDING
from nls.linear.null_space import null_directions, separated, single_directions
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values


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
