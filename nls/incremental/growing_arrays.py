"""Arrays and estimates that grow: rows are appended, room doubles, what is there is a view.

Measurements of one sort are one batch that grows: they are linearized together, however they arrived.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping
from copy import copy
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from factors.base import Factor, Model
from factors.declared import factors_within, refuse_undeclared
from factors.joined import sort_of
from factors.keys import Keys
from factors.robust import Kernel
from factors.slices import changed
from models import Manifold
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphError
from nls.values import Stack, take


class Growing:
    """An array (n, ...) that grows by rows, components first in memory where that is asked for."""

    def __init__(self, rows: npt.NDArray[Any], order: Literal["C", "F"] = "C") -> None:
        self._order: Literal["C", "F"] = order
        self._room, self._n = np.array(rows, order=order), len(rows)

    def __getstate__(self) -> dict[str, Any]:
        """The rows, and for how many there is room: those that come later stand in memory as they would have."""
        return {"rows": self.rows, "room": len(self._room), "order": self._order}

    def __setstate__(self, state: dict[str, Any]) -> None:
        rows, self._order, self._n = state["rows"], state["order"], len(state["rows"])
        self._room = np.empty((state["room"], *rows.shape[1:]), rows.dtype, self._order)
        self._room[: self._n] = rows

    def __len__(self) -> int:
        return self._n

    @property
    def rows(self) -> Any:
        """The rows (n, ...), a view."""
        return self._room[: self._n]

    def append(self, rows: Any, n: int) -> None:
        """Add n rows at the end: each its own (n, ...), or one row or number for all."""
        begin, end = self._n, self._n + n
        if end > len(self._room):
            room = np.empty((2 * end, *self._room.shape[1:]), self._room.dtype, self._order)
            room[:begin] = self.rows
            self._room = room
        self._room[begin:end] = rows
        self._n = end

    def put(self, rows: npt.NDArray[Any]) -> None:
        """Have other rows; who holds the old ones keeps them."""
        self._room, self._n = rows, len(rows)

    def drop(self, rows: Mask) -> None:
        """Forget some rows (n,)."""
        self.put(np.array(self.rows[~rows], order=self._order))


class Variables:
    """The variables of one kind, in the order in which they joined.

    Attributes
    ----------
    kind, manifold : of all of them.
    place : row of every number.
    columns : (n,) first column of each in the preconditioner, behind all others where it is held.
    """

    def __init__(self, kind: str, manifold: Manifold) -> None:
        self.kind, self.manifold = kind, manifold
        self.place: dict[int, int] = {}
        self._X = Growing(manifold.identity(0), order="F")
        self._numbers = Growing(np.zeros(0, dtype=np.int64))
        self._columns = Growing(np.zeros(0, dtype=np.intp))

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def X(self) -> Array:
        """Values (n, size)."""
        return np.asarray(self._X.rows)

    @property
    def numbers(self) -> Numbers:
        return np.asarray(self._numbers.rows)

    @property
    def columns(self) -> Index:
        return np.asarray(self._columns.rows)

    def join(self, number: int, value: Array, column: int) -> None:
        """Add a variable at a value (size,)."""
        self.place[number] = len(self)
        for part, row in zip(self.parts(), (value, number, column), strict=True):
            part.append(row, 1)

    def put(self, X: Array) -> None:
        """Have other values (n, size); who holds the old ones keeps them."""
        self._X.put(X)

    def drop(self, rows: Mask) -> None:
        """Forget some of them (n,)."""
        for part in self.parts():
            part.drop(rows)
        self.find()

    def parts(self) -> tuple[Growing, ...]:
        """Everything that has a row a variable."""
        return self._X, self._numbers, self._columns

    def find(self) -> None:
        """Take the row of every number anew."""
        self.place = {number: row for row, number in enumerate(self.numbers.tolist())}

    def known(self, keys: Keys) -> Mask:
        """Which variables (k,) are there."""
        return np.array([number in self.place for number in keys.numbers.tolist()], dtype=bool)

    def index(self, keys: Keys) -> Index:
        """Rows (k,) of variables.

        Raises
        ------
        GraphError
            One that is not there.
        """
        try:
            return np.array([self.place[number] for number in keys.numbers.tolist()], dtype=np.intp)
        except KeyError as error:
            raise GraphError(f"{self.kind}{error.args[0]} is not in the estimate", [keys]) from None

    def stack(self, rows: slice | Mask = slice(None)) -> Stack:
        """A copy of the estimate, or of some of it (n,)."""
        return Stack(self.kind, self.manifold, self.X[rows].copy(order="F"), self.numbers[rows].copy())


SLIGHTLY = 1e-6  # part of s, for the slope of a weight
FLATTEST = 0.1  # of the curvature of weighted squares: flatter ones, and those that bend down, count as so much


class GrowingBatch:
    """A batch of measurements that grows, and its rows of A and b.

    Parameters
    ----------
    model : the first of them.
    variables : of every slot.

    Attributes
    ----------
    given : factors as they were given, and the part of each that is here, in the order of the rows.
    total : cost of all measurements at their linearization.
    entered : how many of them the preconditioner has taken.
    """

    def __init__(self, model: Model, variables: list[Variables]) -> None:
        self.given: list[tuple[Factor, Factor]] = []
        self.variables, self._first, self.kernel = variables, model, model.factor.kernel
        factor, m, D = model.factor, model.dim, sum(v.manifold.dim for v in variables)
        self._own = [Growing(own[:0]) for own in _own(factor)]
        self._index = [Growing(np.zeros(0, dtype=np.intp)) for _ in variables]
        self._z = Growing(model.framed_z[:0], "F")
        self._W = Growing(model.W[:0], "F" if model.W.shape[-1] <= 3 else "C")
        self._A, self._columns = Growing(np.zeros((0, m, D))), Growing(np.zeros((0, m, D), dtype=np.int32))
        self._b, self._cost = Growing(np.zeros((0, m))), Growing(np.zeros(0))
        self._linearized, self.entered, self.total = 0, 0, 0.0
        self._sparse: tuple[sp.csr_array, sp.csc_array] | None = None

    def __len__(self) -> int:
        return len(self._z)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "sort"} | {"_sparse": None}

    @property
    def factor(self) -> Factor:
        """The first measurements, as they were given."""
        return self._first.factor

    @cached_property
    def sort(self) -> Hashable:
        """What all its measurements have in common, `sort_of_model`."""
        return sort_of_model(self._first)

    def append(self, model: Model, given: Factor) -> None:
        """Add measurements whose variables are there, of a factor that was given."""
        self.given.append((given, model.factor))
        index = [v.index(keys) for v, keys in zip(self.variables, model.factor.keys, strict=True)]
        own = _own(model.factor) if self._own else []
        for part, rows in zip(self.parts(), [*index, *own, model.framed_z, model.W, 0, 0, 0, 0], strict=True):
            part.append(rows, len(model.z))
        self._sparse = None

    def touches(self, of: dict[str, Mask]) -> Mask:
        """Which measurements (n,) are about some of the variables, by kind; of an opaque factor all or none."""
        touched = np.zeros(len(self), dtype=bool)
        for v, index in zip(self.variables, self._index, strict=True):
            if v.kind in of:
                touched |= of[v.kind][index.rows]
        return np.full(len(self), touched.any()) if self.factor.opaque else touched

    def rows_of(self, variables: Variables) -> Iterator[Index]:
        """The variable (n,) of every measurement, for every slot of a kind."""
        return (index.rows for v, index in zip(self.variables, self._index, strict=True) if v is variables)

    def drop(self, rows: Mask) -> None:
        """Forget some measurements (n,)."""
        of = np.repeat(np.arange(len(self.given)), [len(factor) for _, factor in self.given])
        for k in np.unique(of[rows])[::-1].tolist():
            given, factor = self.given[k]
            rest = part(factor, ~rows[of == k])
            self.given[k : k + 1] = [] if rest is None else [(given, rest)]
        self._linearized -= int(np.count_nonzero(rows[: self._linearized]))
        self._sparse = None
        for own in self.parts():
            own.drop(rows)
        self.total = float(self._cost.rows.sum())

    def renumber(self, rows: dict[str, Index]) -> None:
        """The variables of some kinds have new rows."""
        for v, index in zip(self.variables, self._index, strict=True):
            if v.kind in rows:
                index.put(rows[v.kind][index.rows])

    def parts(self) -> Iterator[Growing]:
        """Everything that has a row a measurement."""
        yield from (*self._index, *self._own)
        yield from (self._z, self._W, self._A, self._columns, self._b, self._cost)

    def catch_up(self) -> float:
        """Linearize what has come since the last time; its cost."""
        rows = slice(self._linearized, len(self))
        if len(self) > self._linearized:
            self.place(rows)
            self.linearize(rows)
            self._linearized = len(self)
        return float(self._cost.rows[rows].sum())

    def model(self, rows: slice | Mask = slice(None)) -> Model:
        """The measurements, or some of them; views of the arrays that grow unless a mask (n,) chooses."""
        slots = zip(self.variables, self._index, strict=True)
        keys = tuple(Keys(v.kind, v.numbers[index.rows[rows]]) for v, index in slots)
        own = iter(self._own)
        factor = _changed(self.factor, keys, lambda _: next(own).rows[rows])
        model = self._first._replace(factor=factor, framed_z=self._z.rows[rows], W=self._W.rows[rows])
        factor._model = model
        return model

    @np.errstate(over="ignore", invalid="ignore")  # what is not finite is refused by name
    def linearize(self, rows: slice = slice(None), framed: Mapping[str, Array] | None = None) -> None:
        """Rows of A and b at the present values; of all variables also with their frames where these are known."""
        known = framed if framed and self.factor.framed else {v.kind: v.X for v in self.variables}
        X = [take(known[v.kind], index.rows[rows]) for v, index in zip(self.variables, self._index, strict=True)]
        model, rows_of_A = self.model(rows), self._A.rows[rows]
        again = framed is not None and self._linearized == len(self) and self.kernel is None
        e = self.factor.relinearize(model, X, rows_of_A) if again else None
        A, b = model.linearize(*X) if e is None else ((), model.whitened(e))
        cost = np.square(b).sum(axis=1)
        if self.kernel is not None:
            A, b, cost = _weighted(self.kernel, A, b)
        if A:
            side_by_side = np.concatenate([block.transpose(1, 2, 0) for block in A], axis=1)  # (m, D, k)
            rows_of_A.reshape(len(b), -1)[...] = side_by_side.reshape(-1, len(b)).T  # by three axes: twice as long
        self._b.rows[rows], self._cost.rows[rows] = b, cost
        self.total = float(self._cost.rows.sum())

    def place(self, rows: slice = slice(None)) -> None:
        """Take the columns of A anew from those of the variables."""
        at, self._sparse = 0, None
        for v, index in zip(self.variables, self._index, strict=True):
            d, first = v.manifold.dim, v.columns[index.rows[rows]]
            self._columns.rows[rows, :, at : at + d] = (first[:, None] + np.arange(d))[:, None]
            at += d

    @property
    def b(self) -> Array:
        """(n m,) errors."""
        return np.asarray(self._b.rows.reshape(-1))

    def A(self, width: int) -> tuple[sp.csr_array, sp.csc_array]:
        """(n m, width) rows of A, and A'; they follow what is linearized later."""
        if self._sparse is None:
            n, m, D = self._A.rows.shape
            indptr = np.arange(0, n * m * D + 1, D, dtype=np.int32)
            data, columns = self._A.rows.reshape(-1), self._columns.rows.reshape(-1)
            A = sp.csr_array((data, columns, indptr), shape=(n * m, width))
            At = A.T
            A.data = At.data = data  # SciPy copies what is less than half of the array it is a view of
            self._sparse = A, At
        return self._sparse

    def new_rows(self) -> tuple[Array, npt.NDArray[np.int32]]:
        """Rows of A and their columns (k, D) of the measurements that the preconditioner has not taken."""
        D, new = self._A.rows.shape[2], slice(self.entered, len(self))
        return self._A.rows[new].reshape(-1, D), self._columns.rows[new].reshape(-1, D)

    def blocks(self, rows: slice | Mask = slice(None)) -> tuple[Array, ...]:
        """A (n, m, d) of every slot, of all measurements or some."""
        return tuple(np.split(self._A.rows[rows], np.cumsum([v.manifold.dim for v in self.variables])[:-1], axis=2))


def sort_of_model(model: Model) -> Hashable:
    """Equal where measurements can be rows of one `GrowingBatch`."""
    return model.manifolds, model.W.ndim, sort_of(model.factor)


def part(factor: Factor, mask: Mask) -> Factor | None:
    """Some measurements (n,) of a factor; None where there are none, or only its function knows them."""
    if not mask.any() or (factor.opaque and not mask.all()):
        return None
    return factor if mask.all() else factor[mask]


def _own(factor: Factor) -> list[Array]:
    """Arrays that measurements have of their own, one row each or (1, ...) for all, of factors within as well."""
    refuse_undeclared(factor)
    arrays: list[Array] = []
    _changed(factor, factor.keys, arrays.append)
    return [array if len(array) in (1, len(factor)) else array[None] for array in arrays]


def _changed(factor: Factor, keys: tuple[Keys, ...], change: Callable[[Array], Any]) -> Factor:
    """A factor with other keys, and with other arrays instead of those that measurements have of their own."""

    def own(item: Any) -> Any:
        return change(item) if isinstance(item, np.ndarray) and item.ndim else item

    whole = copy(factor)
    whole.keys = keys
    for name in factor.per_measurement:
        setattr(whole, name, changed(getattr(factor, name), own))
    for name, within in factors_within(factor).items():
        setattr(whole, name, _changed(within, keys[: len(within.keys)], change))
    return whole


def _weighted(kernel: Kernel, A: tuple[Array, ...], b: Array) -> tuple[tuple[Array, ...], Array, Array]:
    r"""A, b and costs (n,) with A'b half the downhill gradient of the cost, and A'A nearly half of its curvature.

    Weights alone overrate the curvature along the residual u = b / |b|, as they fall while it grows:

        A <- sqrt(w) (I - (1 - q) u u') A,   b <- sqrt(w) b / q,   q^2 = 1 + 2 s w'(s) / w(s), at least `FLATTEST`

    Source: B. Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 4.3.
    """
    s = np.square(b).sum(axis=1)
    w = kernel.weight(s)
    further = kernel.weight(s * (1 + SLIGHTLY))
    q = np.sqrt(np.maximum(1 + 2 * (further / np.where(w > 0, w, 1.0) - 1) / SLIGHTLY, FLATTEST))
    u, root = b / np.sqrt(np.where(s > 0, s, 1.0))[:, None], np.sqrt(w)
    flat = ((1 - q)[:, None] * u)[:, :, None]
    bent = [root[:, None, None] * (A_k - flat * np.einsum("nm,nmd->nd", u, A_k)[:, None]) for A_k in A]
    return tuple(bent), b * (root / q)[:, None], kernel.rho(s)
