r"""What the measurements leave free: all of it, found round by round, and anchors that take the freedom and no more.

Each free direction N_k gets a prior on one unknown that it moves, the pivots of a QR decomposition. As many priors as
directions: they hold what is free where it is and say nothing about the rest, whose covariances and residuals are
those of the pseudo-inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from factors import Isotropic, Prior
from factors.keys import Keys
from models.algebra import Array
from nls.analysis.linearization import Checked, Linearization
from nls.linear.null_space import null_space, separated, single_directions
from nls.linear.singular import SingularSystemError
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem

if TYPE_CHECKING:
    from collections.abc import Sequence

    from factors.base import Factor
    from models.algebra import Index
    from nls.values import Values

__all__ = ["Freedom", "freedom"]

ROUNDING = 1e-14  # of the longest column of the variable: a column this short is zero
ROUNDS = 8  # of at most 12 directions that move several variables; those of single variables are found all at once


@dataclass(frozen=True)
class Freedom:
    """The free directions, and every measurement against all others with these held.

    Attributes
    ----------
    checked : None where weights or scales differ too much for A'A although nothing is free.
    anchors : (f,) columns that were held.
    singles : (n, q) directions of one variable each, in units of the unknowns.
    combinations : (n, r) directions that move several.
    norms : (n,) lengths of the columns of A; 1 where a column is zero.
    scale : (N,) lengths with nothing held; 0 where a column is zero.
    more : there may be further ones.
    """

    checked: Checked | None
    anchors: Index
    singles: sp.csc_array
    combinations: Array
    norms: Array
    scale: Array
    more: bool

    @property
    def count(self) -> int:
        """Free directions found."""
        return int(self.singles.shape[1] + self.combinations.shape[1])


def freedom(factors: Sequence[Factor], pattern: Pattern, values: Values) -> Freedom:
    """All that is free at the values.

    Parameters
    ----------
    factors : of the graph.
    pattern : the graph with the gauge held.
    values : where it is linearized.
    """
    linear = Linearization(pattern, values)
    everything = pattern.holding(np.zeros_like(pattern.held))
    scale = LinearSystem(everything, linear.system.blocks, linear.system.b).column_norms
    owner, _ = everything.column_owner()
    largest = np.zeros(len(pattern.dims))
    np.maximum.at(largest, owner, scale)
    scale = np.where(scale > ROUNDING * largest[owner], scale, 0.0)
    norms = pattern.restrict(scale)
    zero, norms = np.flatnonzero(norms == 0), np.where(norms == 0, 1.0, norms)
    n = len(norms)
    singles = sp.csc_array((np.ones(len(zero)), zero, np.arange(len(zero) + 1)), (n, len(zero)))
    combinations, anchors = np.zeros((n, 0)), zero
    for turn in range(ROUNDS):
        if len(anchors):
            linear = Linearization(anchored(factors, pattern, values, anchors, norms), values)
        try:
            return Freedom(Checked(linear), anchors, singles, combinations, norms, scale, False)
        except SingularSystemError:
            pass
        directions, single = _null(linear.system, turn == 0)
        if not directions.shape[1] and not single.shape[1]:
            return Freedom(None, anchors, singles, combinations, norms, scale, False)
        anchors = np.concatenate([anchors, _pivots(directions, single, norms)])
        singles = sp.csc_array(sp.hstack([singles, sp.diags_array(1 / norms) @ single]))
        combinations = np.concatenate([combinations, directions], axis=1)
        if turn:  # twelve of more are mixtures; all of them come apart
            combinations = separated(combinations, sp.csc_array((n, 0)), norms)
    return Freedom(None, anchors, singles, combinations, norms, scale, True)


def anchored(factors: Sequence[Factor], pattern: Pattern, values: Values, columns: Index, norms: Array) -> Pattern:
    """The pattern with a prior on each of some unknowns, as strong as the measurements that touch it."""
    owner, component = pattern.column_owner()
    start = np.array([*pattern.offsets.values()])
    kind = np.searchsorted(start, owner[columns], side="right") - 1
    priors = []
    for k, (name, manifold) in enumerate(pattern.manifolds.items()):
        for c, label in enumerate(manifold.components):
            members = columns[(kind == k) & (component[columns] == c)]
            if len(members):
                rows = owner[members] - pattern.offsets[name]
                keys = Keys(name, pattern.numbers[name][rows])
                noise = Isotropic(1 / norms[members])
                priors.append(Prior(keys, values.stack(name).X[rows], noise, components=(label,)))
    return Pattern([*factors, *priors], values).holding(pattern.held)


def _null(system: LinearSystem, first: bool) -> tuple[Array, sp.csc_array]:
    """Free directions of several variables (n, r), and of single ones (n, q), columns of A scaled to length 1."""
    N, norms = null_space(system), system.balanced.column_norms
    single = single_directions(system.balanced) if first else sp.csc_array((len(norms), 0))
    directions = separated(N, single, norms) if N.shape[1] else N
    single = sp.csc_array(sp.diags_array(system.column_norms / norms) @ single)
    return directions, sp.csc_array(single @ sp.diags_array(1 / np.sqrt(single.power(2).sum(axis=0))))


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
