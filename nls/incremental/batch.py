"""Measurements of one sort in one batch that grows: linearized together, however they arrived."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from factors.base import Model
from factors.joined import alike
from factors.keys import Keys
from factors.robust import reweighted
from models.algebra import Array, Index, apply, components
from nls.incremental.growing import Growing, Variables
from nls.values import take

__all__ = ["GrowingBatch"]


class GrowingBatch:
    """A batch of measurements that grows.

    Parameters
    ----------
    model : the first of them.
    variables : of every slot.

    Attributes
    ----------
    A, b : whitened Jacobians (n, m, d) of every slot and errors (n, m) of the latest linearization, times the root of
        the weight of a robust kernel.
    """

    A: tuple[Array, ...]
    b: Array

    def __init__(self, model: Model, variables: list[Variables]) -> None:
        self.variables, self._first = variables, model
        self._index = [Growing(np.zeros(0, dtype=np.intp)) for _ in variables]
        self._numbers = [Growing(np.zeros(0, dtype=np.int64)) for _ in variables]
        self._z = Growing(model.z[:0], order="F")
        self._W = Growing(model.W[:0], order="F" if model.W.shape[-1] <= 3 else "C")
        factor = model.factor
        own = {name: getattr(factor, name) for name in factor.per_measurement}
        self._own = {k: Growing(v[:0]) for k, v in own.items() if isinstance(v, np.ndarray)}
        self._model: Model | None = None

    def __len__(self) -> int:
        return len(self._z)

    def takes(self, model: Model) -> bool:
        """Whether measurements are of this sort."""
        return model.W.ndim == self._first.W.ndim and alike(self._first, model)

    def append(self, model: Model) -> tuple[slice, float]:
        """Add measurements whose variables are there; which rows they have, and their cost at the present values."""
        begin, n, X = len(self), len(model.z), []
        for slot, keys in enumerate(model.factor.keys):
            index = self.variables[slot].index(keys)
            X.append(take(self.variables[slot].X, index))
            self._index[slot].append(index)
            self._numbers[slot].append(keys.numbers)
        self._z.append(model.z)
        self._W.append(np.broadcast_to(model.W, (n, *model.W.shape[1:])))
        for name, rows in self._own.items():
            value = getattr(model.factor, name)
            rows.append(np.broadcast_to(np.atleast_2d(value), (n, *rows.rows.shape[1:])))
        self._model = None
        s, kernel = np.square(model.error(*X)).sum(axis=1), self._first.factor.kernel
        return slice(begin, begin + n), float((s if kernel is None else kernel.rho(s)).sum())

    def silence(self, rows: slice) -> Array:
        """Take the weight of some measurements, which is returned: they say nothing any more."""
        W = np.array(self._W.rows[rows])
        self._W.rows[rows] = 0.0
        return W

    def restore(self, rows: slice, W: Array) -> None:
        """Give measurements their weight back."""
        self._W.rows[rows] = W

    @property
    def model(self) -> Model:
        """All of the measurements; views of the arrays that grow."""
        if self._model is None:
            factor = copy(self._first.factor)
            kinds = zip(self._first.factor.keys, self._numbers, strict=True)
            factor.keys = tuple(Keys(keys.kind, numbers.rows) for keys, numbers in kinds)
            for name, rows in self._own.items():
                setattr(factor, name, rows.rows)
            self._model = factor._model = replace(self._first, factor=factor, z=self._z.rows, W=self._W.rows)
        return self._model

    def index(self, slot: int) -> Index:
        """Row (n,) of the variable of a slot among those of its kind."""
        return np.asarray(self._index[slot].rows)

    def linearize(self) -> float:
        """A and b at the present values; returns the sum of their costs."""
        X = [take(v.X, self.index(slot)) for slot, v in enumerate(self.variables)]
        A, b = self.model.linearize(*X)
        kernel = self._first.factor.kernel
        if kernel is None:
            cost = float(np.square(b).sum())
        else:
            A, b, rho = reweighted(kernel, A, b)
            cost = float(rho.sum())
        self.A, self.b = A, b
        return cost

    def times(self, dx: dict[str, Array]) -> Array:
        """A dx (n, m), from steps (count, d) by kind."""
        slots = zip(self.variables, range(len(self.A)), self.A, strict=True)
        parts = [apply(A, take(dx[v.kind], self.index(slot))) for v, slot, A in slots]
        return sum(parts[1:], parts[0])

    def add_transposed(self, r: Array, total: dict[str, Array]) -> None:
        """Add A'r, of r (n, m), to sums (count, d) by kind."""
        for slot, (v, A) in enumerate(zip(self.variables, self.A, strict=True)):
            index, sums = self.index(slot), total[v.kind]
            for k, part in enumerate(components(apply(A.mT, r))):
                sums[:, k] += np.bincount(index, part, len(sums))

    def rows_of_A(self, rows: slice) -> tuple[list[tuple[Index, Array]], int]:
        """Per slot the first columns (k,) and blocks (k, m, d) of some measurements; and how many rows of A they are."""
        slots = [(v.columns[self.index(slot)[rows]], A[rows]) for slot, (v, A) in enumerate(zip(self.variables, self.A, strict=True))]
        return slots, slots[0][1].shape[0] * slots[0][1].shape[1]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_model": None}
