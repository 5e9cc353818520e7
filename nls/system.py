"""The linear system A dx = b of one linearization, with labels, and H = A'A and A'b from the same blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from factors.robust import reweighted
from models.algebra import Array, apply, dot
from models.errors import EvaluationError
from nls.sparse.pattern import Pattern
from nls.values import Values


class LinearSystem:
    """Every whitened Jacobian block and error of one linearization point.

    Unpacks as ``A, b = system``. The step is dx = argmin |A dx - b|.

    Parameters
    ----------
    pattern : the numbering of rows and columns.
    blocks : per factor batch one (k, m, d) array per slot.
    b : (m,) whitened errors, times the root of their weight where a kernel is robust.
    chi2 : the cost at this point; |b|^2 when omitted, which it is without robust kernels.
    """

    def __init__(
        self, pattern: Pattern, blocks: Sequence[tuple[Array, ...]], b: Array, chi2: float | None = None
    ) -> None:
        self.pattern, self.blocks, self.b = pattern, blocks, b
        self.chi2 = float(np.square(b).sum()) if chi2 is None else chi2

    @classmethod
    def at(cls, pattern: Pattern, values: Values) -> LinearSystem:
        """Every whitened A_i and b_i at the values; one call per batch, or none where they are those that are kept."""
        X, *kept = pattern.answers.pop("linearization", [None])
        if X is not None and all(a is stack.X for a, stack in zip(X, values.stacks.values(), strict=False)):
            return cls(pattern, *kept)
        b = np.empty(pattern.m)
        blocks, chi2 = [], 0.0
        for batch in pattern.batches:
            A, b_batch = batch.model.linearize(*batch.arguments(values))
            kernel = batch.model.factor.kernel
            if kernel is None:
                chi2 += float(np.square(b_batch).sum())  # not b @ b: BLAS would start threads, and round differently
            else:
                A, b_batch, rho = reweighted(kernel, A, b_batch)
                chi2 += float(rho.sum())
            b[batch.rows] = b_batch.reshape(-1)
            blocks.append(A)
        return cls(pattern, blocks, b, chi2)

    def keep(self, values: Values) -> None:
        """Keep the numbers with the pattern for the next `at`, which may be where these values are."""
        X = [stack.X for stack in values.stacks.values()]
        self.pattern.answers["linearization"] = [X, self.blocks, self.b, self.chi2]

    def __repr__(self) -> str:
        return f"LinearSystem({self.pattern.m} x {self.pattern.n}, chi2 {self.chi2:.6g})"

    def __iter__(self) -> Iterator[sp.csr_array | Array]:
        return iter((self.A, self.b))

    def forget(self) -> None:
        """Drop all arrays, most of the memory of a solve, so that the next linearization lies in it.

        The pattern and chi2 stay.
        """
        for name in vars(self).keys() - {"pattern", "chi2"}:
            delattr(self, name)

    @cached_property
    def A(self) -> sp.csr_array:
        """Sparse (m, n) matrix of the free columns.

        ``A.data`` is one buffer in which every factor batch owns a contiguous slice. It is seen as (k, m, D) with D the
        widths of its slots side by side. Columns of held variables are left out of it when there are any.
        """
        pattern = self.pattern
        indices, indptr, places = pattern.structure
        data, begin = np.empty(pattern.numbers_in_A), 0
        for batch, A in zip(pattern.batches, self.blocks, strict=True):
            width = sum(A_k.shape[2] for A_k in A)
            end = begin + len(batch) * batch.model.dim * width
            np.concatenate(A, axis=2, out=data[begin:end].reshape(len(batch), batch.model.dim, width))
            begin = end
        return sp.csr_array((data if places is None else data[places], indices, indptr), shape=(pattern.m, pattern.n))

    @cached_property
    def balanced(self) -> LinearSystem:
        """A system of the same free directions with the weights taken out: every row of A and b over its weight.

        A row with a number larger than its weight, see `row_sizes`, is divided by that number. A row of smaller ones
        stays small: a Jacobian of rounding errors, or a measurement a robust kernel has rejected, measures nothing.
        """
        blocks, b = [], self.b.copy()
        for batch, A, (weights, sizes) in zip(self.pattern.batches, self.blocks, self.row_sizes, strict=True):
            rows = np.maximum(weights, sizes)
            rows = np.where(rows > 0, rows, 1.0)
            blocks.append(tuple(A_k / rows[:, :, None] for A_k in A))
            b[batch.rows] /= rows.reshape(-1)
        return LinearSystem(self.pattern, blocks, b)

    @cached_property
    def row_sizes(self) -> list[tuple[Array, Array]]:
        """Per batch the largest number in every row of the whitener and of A, both (k, m)."""
        out = []
        for batch, A in zip(self.pattern.batches, self.blocks, strict=True):
            W = np.abs(batch.model.W)
            weights = W if W.ndim == 2 else W.max(axis=2)
            sizes = np.max([np.abs(A_k).max(axis=2) for A_k in A], axis=0)
            out.append((np.broadcast_to(weights, sizes.shape), sizes))
        return out

    @cached_property
    def gradient(self) -> Array:
        """A'b, (n,): half the steepest descent direction of chi2."""
        b = [self.b[batch.rows].reshape(-1, batch.model.dim) for batch in self.pattern.batches]
        return self.pattern.by_column(
            [[apply(A_k.mT, b_k) for A_k in A] for A, b_k in zip(self.blocks, b, strict=True)]
        )

    @cached_property
    def H_blocks(self) -> Array:
        """The blocks of A'A, flat, as `nls.sparse.hessian` lays them out; infinite where squares overflow."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.pattern.blocks.fill(self.blocks)

    @cached_property
    def column_norms(self) -> Array:
        """Length of every column of A, (n,)."""
        with np.errstate(over="ignore"):
            return np.sqrt(self.pattern.by_column([[dot(A_k.mT, A_k.mT) for A_k in A] for A in self.blocks]))

    @property
    def scaled_gradient(self) -> float:
        """Largest cosine between b and a column of A: 0 at an optimum, whatever the units; at most 1."""
        scale = self.column_norms * np.sqrt(np.square(self.b).sum())
        cosines = np.abs(self.gradient) / np.where(scale > 0, scale, 1.0)
        return float(cosines.max(initial=0.0))

    def times(self, dx: Array) -> Array:
        """A dx (m,) without forming A."""
        pattern, out = self.pattern, np.empty(self.pattern.m)
        X = pattern.by_kind(dx)
        for batch, A in zip(pattern.batches, self.blocks, strict=True):
            slots = zip(batch.kinds, batch.index, A, strict=True)
            parts = [apply(A_k, X[kind].take(index, axis=0)) for kind, index, A_k in slots]
            out[batch.rows] = sum(parts[1:], parts[0]).reshape(-1)
        return out

    def overflow(self) -> EvaluationError:
        """The error for squares that are infinite: the measurement with the largest number in A."""
        sizes = [size.max(axis=1) for _, size in self.row_sizes]
        k = int(np.argmax([size.max(initial=0.0) for size in sizes]))
        index = int(np.argmax(sizes[k]))
        return EvaluationError(
            f"the squares of weights or Jacobians overflow: {self.scale(k, index)}; check its measurement, its sigmas "
            "or information, and units",
            self.pattern.batches[k].model.factor.name,
            [keys[[index]] for keys in self.pattern.batches[k].model.factor.keys],
            where="A'A",
        )

    def scale(self, batch: int, index: int, row: int | None = None) -> str:
        """One measurement, its sigma and its Jacobian in words; of the longest row when that is omitted."""
        model = self.pattern.batches[batch].model
        weights, sizes = self.row_sizes[batch]
        row = int(np.argmax(sizes[index])) if row is None else row
        weight, size = float(weights[index, row]), float(sizes[index, row])
        jacobian = f", Jacobian up to {size / weight:.3g}" if size > 10 * weight else ""
        return (
            f"{model.names[row]} of {model.factor.describe(index)}, sigma {1 / weight:.3g} (information "
            f"{weight * weight:.3g}{jacobian})"
        )

    def promised(self, dx: Array) -> float:
        """Fall of the linear model: |b|^2 - |A dx - b|^2 = 2 dx'A'b - |A dx|^2."""
        return float(2 * (dx @ self.gradient) - np.square(self.times(dx)).sum())

    @cached_property
    def H(self) -> sp.csc_array:
        """A'A (n, n), symmetric, columns in the order of A, filled from the blocks."""
        return self.pattern.hessian().symmetric(self.H_blocks)

    @property
    def rows(self) -> list[str]:
        """Which factor and component every row of A belongs to."""
        return [
            f"{batch.model.factor.describe(k)}: {name}"
            for batch in self.pattern.batches
            for k in range(len(batch))
            for name in batch.model.names
        ]

    def column(self, index: int) -> tuple[Keys, str]:
        """The variable of one column of A, and the name of its component."""
        variable, component = (int(owner[index]) for owner in self.pattern.column_owner())
        return self.pattern.key(variable), self.pattern.component_names(variable)[component]

    @property
    def cols(self) -> list[str]:
        """Which variable and tangent component every column of A belongs to."""
        variable, component = self.pattern.column_owner()
        names = {v: (repr(self.pattern.key(v)), self.pattern.component_names(v)) for v in dict.fromkeys(variable)}
        return [f"{names[v][0]}: {names[v][1][c]}" for v, c in zip(variable, component, strict=True)]
