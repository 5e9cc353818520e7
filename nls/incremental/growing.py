"""Arrays and estimates that grow: rows are appended, room doubles, what is there is a view."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from models import Manifold
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphError
from nls.values import Stack

__all__ = ["Growing", "Variables"]


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

    def append(self, rows: npt.NDArray[Any], n: int) -> None:
        """Add n rows at the end: each its own (n, ...), or all the same (1, ...)."""
        begin = self._n
        self.grow(n)
        self._room[begin : self._n] = rows

    def grow(self, n: int) -> None:
        """Add n rows at the end that are written later."""
        end = self._n + n
        if end > len(self._room):
            room = np.empty((2 * end, *self._room.shape[1:]), self._room.dtype, self._order)
            room[: self._n] = self.rows
            self._room = room
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
        self._numbers.append(np.array([number]), 1)
        self._X.append(value[None], 1)
        self._columns.append(np.array([column]), 1)

    def mark(self) -> tuple[Array, Numbers, Index]:
        """Values, numbers and columns as they are."""
        return self.X.copy(order="F"), self.numbers, self.columns.copy()

    def back_to(self, mark: tuple[Array, Numbers, Index]) -> None:
        """Be as at a mark."""
        for part, rows in zip((self._X, self._numbers, self._columns), mark, strict=True):
            part.put(rows)
        self._find()

    def drop(self, rows: Mask) -> None:
        """Forget some of them (n,)."""
        for part in (self._X, self._numbers, self._columns):
            part.drop(rows)
        self._find()

    def _find(self) -> None:
        self.place = {number: row for row, number in enumerate(self.numbers.tolist())}

    def keys(self, rows: Mask) -> Keys:
        """Some of them (n,)."""
        return Keys(self.kind, self.numbers[rows])

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

    def move(self, X: Array, dx: Array) -> None:
        """Put all at X (n, size), moved by tangent steps (n, d)."""
        self.X[...] = self.manifold.retract(X, dx)

    def stack(self, rows: slice | Mask = slice(None)) -> Stack:
        """A copy of the estimate, or of some of it (n,)."""
        return Stack(self.kind, self.manifold, self.X[rows].copy(order="F"), self.numbers[rows].copy())
