"""Names of variables: a kind ("x") and a number; `x[17]` is one variable, `x[index_array]` a whole batch."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from models.algebra import Numbers
from models.errors import GraphError

__all__ = ["Keys", "Kind", "kinds"]


class Keys:
    """A batch of variables of one kind, in order; one variable is a batch of 1 that prints as ``x17``.

    Parameters
    ----------
    kind : the name of the kind.
    numbers : whole number, or (n,) array of them.
    """

    __slots__ = ("kind", "numbers", "single")

    def __init__(self, kind: str, numbers: npt.ArrayLike) -> None:
        if not isinstance(kind, str):
            raise GraphError(f"Keys: expected the name of a kind such as 'x', got {kind!r:.60}")
        try:
            array = np.asarray(numbers)
        except ValueError as error:  # lists of different lengths
            raise GraphError(f"{kind}[...]: variable numbers must be one list of whole numbers; {error}") from error
        if array.dtype.kind not in "iu" and array.size:
            raise GraphError(f"{kind}[...]: variable numbers must be whole numbers, got {array.dtype} {array!r:.60}")
        if array.dtype.kind == "u" and array.size and array.max() > np.iinfo(np.int64).max:
            raise GraphError(f"{kind}[...]: variable number {array.max()} is above 2^63 - 1, the largest possible")
        if array.ndim > 1:
            raise GraphError(f"{kind}[...]: variable numbers have shape {array.shape}, expected (n,)")
        self.kind = kind
        self.single = array.ndim == 0
        self.numbers: Numbers = array.reshape(-1).astype(np.int64)
        self.numbers.setflags(write=False)  # graphs remember where they found these variables

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Keys]:
        return (Keys(self.kind, int(number)) for number in self.numbers)

    def __getitem__(self, index: npt.ArrayLike | slice) -> Keys:
        try:
            return Keys(self.kind, self.numbers[index if isinstance(index, slice) else np.asarray(index)])
        except (IndexError, ValueError, OverflowError) as error:
            raise GraphError(f"{self!r}[{index!r:.60}]: takes places 0 to {len(self) - 1}; {error}", [self]) from error

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Keys) and self.kind == other.kind and np.array_equal(self.numbers, other.numbers)

    def __hash__(self) -> int:
        return hash((self.kind, self.numbers.tobytes()))

    def __reduce__(self) -> tuple[Any, ...]:
        return Keys, (self.kind, int(self.numbers[0]) if self.single else self.numbers)

    def __repr__(self) -> str:
        if len(self) == 1:
            return f"{self.kind}{self.numbers[0]}"
        return f"{self.kind}{np.array2string(self.numbers, threshold=6, edgeitems=2, separator=', ')}"


class Kind:
    """A kind of variable; indexing it names variables.

    Examples
    --------
    >>> x, l = kinds("x", "l")
    >>> x[17], l[[3, 4]]
    (x17, l[3, 4])
    """

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        if not isinstance(name, str) or not name.isidentifier() or name[-1].isdigit():
            raise GraphError(
                f"kind {name!r}: expected a short name of letters, such as 'x', without a number at its end"
            )
        self.name = name

    def __getitem__(self, numbers: npt.ArrayLike | slice) -> Keys:
        if isinstance(numbers, slice):
            ends = (numbers.start, numbers.stop, numbers.step)
            if not all(end is None or (isinstance(end, int | np.integer) and abs(int(end)) < 2**63) for end in ends):
                shown = ":".join(f"{end!r:.30}" for end in ends if end is not None)
                raise GraphError(f"{self.name}[{shown}]: expected whole numbers below 2^63, as in {self.name}[0:10]")
            start, stop, step = numbers.start or 0, numbers.stop, numbers.step or 1
            if stop is None or stop < start or start < 0:
                raise GraphError(
                    f"{self.name}[{start}:{'' if stop is None else stop}]: a kind has no end to count from; give both "
                    f"ends, {self.name}[0:10]"
                )
            try:
                return Keys(self.name, np.arange(start, stop, step))
            except (ValueError, MemoryError) as error:
                raise GraphError(f"{self.name}[{start}:{stop}]: so many variables fit in no memory") from error
        return Keys(self.name, numbers)

    def __iter__(self) -> NoReturn:
        raise GraphError(f"{self.name} is a kind of variables without an end; name those you mean, {self.name}[0:10]")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Kind) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __reduce__(self) -> tuple[Any, ...]:
        return Kind, (self.name,)

    def __repr__(self) -> str:
        return self.name


def kinds(*names: str) -> tuple[Kind, ...]:
    """Kinds of variables by name: ``x, l = kinds("x", "l")``."""
    return tuple(Kind(name) for name in names)
