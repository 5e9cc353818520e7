"""The linear system A dx = b of one linearization, with labels, and H = A'A and A'b from the same blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from models.algebra import Array, apply
from nls.hessian import Blocks

if TYPE_CHECKING:
    from nls.assemble import Index, Pattern
    from nls.linear import LinearSolver

__all__ = ["LinearSystem"]


class LinearSystem:
    """Every whitened Jacobian block and error of one linearization point.

    Unpacks as ``A, b = system``. The step is dx = argmin |A dx - b|.

    Parameters
    ----------
    pattern : the numbering of rows and columns.
    blocks : per factor batch one (k, m, d) array per slot.
    b : (m,) whitened errors.

    Attributes
    ----------
    chi2 : |b|^2.
    """

    def __init__(self, pattern: Pattern, blocks: Sequence[tuple[Array, ...]], b: Array) -> None:
        self.pattern, self.blocks, self.b = pattern, blocks, b
        self.chi2 = float(np.square(b).sum())  # not b @ b: BLAS would start threads for it, and round differently

    def __iter__(self) -> Iterator[sp.csr_array | Array]:
        return iter((self.A, self.b))

    @cached_property
    def A(self) -> sp.csr_array:
        """Sparse (m, n) matrix of the free columns.

        ``A.data`` is one buffer in which every factor batch owns a contiguous slice, seen as (k, m, D) with D the
        widths of its slots side by side. Columns of held variables are left out of it when there are any.
        """
        data = [np.concatenate(A, axis=-1).reshape(-1) for A in self.blocks] or [np.zeros(0)]
        indices, indptr, keep = self._structure
        values = np.concatenate(data)
        values = values if keep is None else values[keep]
        return sp.csr_array((values, indices, indptr), shape=(self.pattern.m, self.pattern.n))

    @cached_property
    def _structure(self) -> tuple[Index, Index, Index | None]:
        pattern = self.pattern
        indices, lengths = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
        for batch, A in zip(pattern.batches, self.blocks, strict=True):
            columns = np.concatenate(
                [self._columns(v, A_k.shape[2]) for v, A_k in zip(batch.variables, A, strict=True)], axis=1
            )  # (k, D), -1 where held
            full = np.repeat(columns[:, None], batch.model.dim, axis=1)
            indices.append(full.reshape(-1))
            lengths.append(np.repeat((columns >= 0).sum(axis=1), batch.model.dim))
        indices_all, counts = np.concatenate(indices), np.concatenate(lengths)
        keep = np.flatnonzero(indices_all >= 0) if pattern.held.any() else None
        indptr = np.concatenate([[0], np.cumsum(counts)])
        return (indices_all if keep is None else indices_all[keep]), indptr, keep

    def _columns(self, variables: Index, d: int) -> Index:
        """Columns (k, d) of the components of variables, -1 where they are held."""
        start = self.pattern.starts[variables][:, None]
        return np.where(start < 0, -1, start + np.arange(d))

    @cached_property
    def gradient(self) -> Array:
        """A'b, (n,): half the steepest descent direction of chi2."""
        return self._by_column(lambda A_k, b: apply(A_k.mT, b))

    @cached_property
    def column_norms(self) -> Array:
        """Length of every column of A, (n,)."""
        return np.sqrt(self._by_column(lambda A_k, b: np.square(A_k).sum(axis=1)))

    @property
    def scaled_gradient(self) -> float:
        """Largest cosine between b and a column of A: 0 at an optimum, whatever the units; at most 1."""
        scale = self.column_norms * np.sqrt(self.chi2)
        cosines = np.abs(self.gradient) / np.where(scale > 0, scale, 1.0)
        return float(cosines.max(initial=0.0))

    @cached_property
    def H(self) -> sp.csc_array:
        """A'A (n, n), symmetric, columns in the order of A, filled from the blocks."""
        blocks = Blocks(self.pattern)
        return blocks.structure().symmetric(blocks.fill(self))

    def solve(self, linear_solver: LinearSolver | None = None) -> Array:
        """The step dx = argmin |A dx - b|, (n,), by a solver of `nls.linear`; the best one installed when omitted.

        Raises
        ------
        SingularSystemError
            Something is free: there is no unique step.
        """
        from nls.linear import default_solver

        solver = linear_solver or default_solver()
        return solver.solve(solver.analyze(self.pattern), self).dx

    @property
    def rows(self) -> list[str]:
        """Which factor and component every row of A belongs to."""
        return [
            f"{batch.model.factor.describe(k)}: {name}"
            for batch in self.pattern.batches
            for k in range(len(batch))
            for name in np.array(batch.model.space.components)[batch.model.rows]
        ]

    @property
    def cols(self) -> list[str]:
        """Which variable and tangent component every column of A belongs to."""
        variable, component = self.pattern.column_owner()
        names = {v: (repr(self.pattern.key(v)), self.pattern.component_names(v)) for v in dict.fromkeys(variable)}
        return [f"{names[v][0]}: {names[v][1][c]}" for v, c in zip(variable, component, strict=True)]

    def _by_column(self, part: Callable[[Array, Array], Array]) -> Array:
        """Sum of part(A_k, b) (k, d) over all slots of all batches, in the free columns."""
        pattern = self.pattern
        sums = {kind: np.zeros((len(n), pattern.manifolds[kind].dim)) for kind, n in pattern.numbers.items()}
        for batch, A in zip(pattern.batches, self.blocks, strict=True):
            b = self.b[batch.rows].reshape(len(batch), batch.model.dim)
            for kind, incidence, A_k in zip(batch.kinds, batch.incidence, A, strict=True):
                sums[kind] += incidence @ np.ascontiguousarray(part(A_k, b))
        return pattern.restrict(np.concatenate([np.zeros(0), *(x.reshape(-1) for x in sums.values())]))
