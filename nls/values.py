"""Values: the estimate of every variable, one stacked array per kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from factors.keys import Keys, Kind
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphError
from models.html_table import html_table
from models.listing import some
from models.manifolds.base import Manifold

if TYPE_CHECKING:
    from factors.base import Factor, Model


class Stack:
    """All variables of one kind: their manifold, their numbers, and one (n, size) array, components first in memory.

    The array cannot be written to: what is made of it, such as frames, is kept.
    """

    def __init__(self, kind: str, manifold: Manifold, X: Array, numbers: Numbers) -> None:
        self.kind, self.manifold, self.numbers = kind, manifold, numbers
        self.X = _locked(X)
        self._framed: Array | None = None
        rising = bool(len(numbers)) and bool((numbers[1:] > numbers[:-1]).all())
        consecutive = rising and int(numbers[-1]) - int(numbers[0]) == len(numbers) - 1
        self._order = None if consecutive else np.argsort(numbers, kind="stable")
        self._sorted = numbers if self._order is None else numbers[self._order]
        if self._order is not None and (twice := self._sorted[1:] == self._sorted[:-1]).any():
            key = Keys(kind, int(self._sorted[1:][np.argmax(twice)]))
            raise GraphError(f"Values: {key} is given twice; a variable has one value", [key])

    def __len__(self) -> int:
        return len(self.numbers)

    def moved(self, X: Array) -> Stack:
        """The variables at other places."""
        stack = object.__new__(Stack)
        vars(stack).update(vars(self), X=_locked(X), _framed=None)
        return stack

    @property
    def framed(self) -> Array:
        """The elements with their frames, `Manifold.framed`, made once."""
        if self._framed is None:
            self._framed = self.manifold.framed(self.X)
            self.X = _locked(self._framed[:, : self.manifold.size])  # the numbers are kept once
        return self._framed

    def only(self, rows: slice | Mask) -> Stack:
        """Some of the variables (n,)."""
        return Stack(self.kind, self.manifold, self.X[rows], self.numbers[rows])

    def index(self, keys: Keys) -> Index:
        """Rows of the stack that hold these variables, (n,).

        Raises
        ------
        GraphError
            A variable that has no value here.
        """
        if not len(self):
            raise GraphError(f"{keys[[0]]} has no value: Values hold no variable of kind {self.kind}", [keys])
        if self._order is None:  # consecutive numbers: the row is a subtraction
            index: Index = (keys.numbers - self.numbers[0]).astype(np.intp)
            present = (keys.numbers >= self.numbers[0]) & (keys.numbers <= self.numbers[-1])
        else:
            place = np.minimum(np.searchsorted(self._sorted, keys.numbers), len(self) - 1)
            index = self._order[place]
            present = self._sorted[place] == keys.numbers
        if not present.all():
            missing = keys[~present]
            raise GraphError(
                f"{missing[[0]]} has no value ({len(missing)} such of kind {self.kind}); Values hold {len(self)} "
                f"variables from {self.kind}{self._sorted[0]} to {self.kind}{self._sorted[-1]}. Add an initial value, "
                "or leave out the factors that need it",
                [missing],
            )
        return index


class Values:
    """One value per variable: ``Values({x: (SE2, X0), l: (R(2), L0)})``.

    Parameters
    ----------
    stacks : per kind (a `Kind` or its name) a tuple (manifold, X) or (manifold, X, numbers): X is an (n, size) stack in
        the stored form of the manifold, numbers the n variable numbers, 0 .. n-1 when omitted.

    Raises
    ------
    GraphError
        Wrong shapes, numbers given twice, or no elements of the manifold.

    Notes
    -----
    The order of kinds, and of the rows in a stack, is the order of the columns of A. `add` is how values that were read
    from a file get a kind that is not in it.

    Examples
    --------
    >>> from models import SE2
    >>> from nls import Values, kinds
    >>> x, o = kinds("x", "o")
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]])})
    >>> values[x].shape, values[x[1]]
    ((2, 3), array([1., 0., 0.]))
    >>> values.add(o, SE2, [[0.5, 0, 0]])  # where a sensor is mounted
    >>> values, values[o[0]]
    (Values(x: 2 x SE2, o: 1 x SE2), array([0.5, 0. , 0. ]))
    """

    def __init__(self, stacks: Mapping[Any, tuple[Any, ...]] | None = None) -> None:
        self.stacks: dict[str, Stack] = {}
        if stacks is not None and not isinstance(stacks, Mapping):
            raise GraphError(f"Values: expected a dictionary such as {{x: (SE2, X0)}}, got {stacks!r:.60}")
        for kind, entry in ({} if stacks is None else stacks).items():
            name = kind.name if isinstance(kind, Kind) else Kind(str(kind)).name
            if not isinstance(entry, tuple) or len(entry) not in (2, 3):
                raise GraphError(f"Values: {name}: expected (manifold, X) or (manifold, X, numbers)")
            self.add(Kind(name), *entry)

    def add(self, kind: Kind, manifold: Manifold, X: npt.ArrayLike, numbers: npt.ArrayLike | None = None) -> None:
        """Add the variables of a kind there is none of yet.

        Parameters
        ----------
        kind : ``o`` of ``(o,) = kinds("o")``.
        manifold : the space of these variables.
        X : (n, size) stack in the stored form of the manifold, or one element.
        numbers : (n,) of the variables, 0 .. n-1 when omitted.

        Raises
        ------
        GraphError
            The kind is there already; wrong shapes, numbers given twice, or no elements of the manifold.
        """
        if not isinstance(kind, Kind):
            raise GraphError(f"Values: {kind!r:.60} is no kind of variable; expected o of (o,) = kinds('o')")
        name = kind.name
        if name in self.stacks:
            raise GraphError(f"Values: there are variables of kind {name} already; values[{name}[i]] = X moves them")
        if not isinstance(manifold, Manifold):
            raise GraphError(f"Values: {name}: {manifold!r:.60} is no space; expected SE2, SE3, R(2) ...")
        stack = manifold.stack(X)
        named = Keys(name, np.arange(len(stack)) if numbers is None else numbers).numbers
        if len(named) != len(stack):
            raise GraphError(f"Values: {name}: {len(stack)} elements and {len(named)} numbers")
        self.stacks[name] = Stack(name, manifold, stack, named)

    def extended(self, keys: Keys, X: Array) -> Values:
        """The values, and new variables of a kind there is already, at X (n, size) in its stored form."""
        stacks, old = dict(self.stacks), self.stacks[keys.kind]
        X, numbers = np.concatenate([old.X, X]), np.concatenate([old.numbers, keys.numbers])
        stacks[keys.kind] = Stack(old.kind, old.manifold, X, numbers)
        return Values.of(stacks.values())

    def __or__(self, other: Values) -> Values:
        """The variables of both, those of the left first in every kind.

        Raises
        ------
        GraphError
            A variable that both have, or a kind that is in two spaces.

        Examples
        --------
        >>> from models import SE2, R
        >>> from nls import Values, kinds
        >>> x, l = kinds("x", "l")
        >>> first = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]])})
        >>> first | Values({x: (SE2, [2, 0, 0], 2), l: (R(2), [5, 5])})
        Values(x: 3 x SE2, l: 1 x R(2))
        """
        if not isinstance(other, Values):
            return NotImplemented
        merged = Values.of([*self.stacks.values(), *(s for kind, s in other.stacks.items() if kind not in self.stacks)])
        for kind in filter(other.stacks.__contains__, self.stacks):
            ours, theirs = self.stacks[kind], other.stacks[kind]
            keys = Keys(kind, theirs.numbers)
            if ours.manifold is not theirs.manifold:
                raise GraphError(f"Values | Values: {kind} is in {ours.manifold} and in {theirs.manifold}", [keys])
            if (both := np.isin(keys.numbers, ours.numbers)).any():
                cure = "a value that is there is moved by values[key] = X, and a new variable needs another number"
                raise GraphError(f"Values | Values: both hold {some(list(keys[both]))}; {cure}", [keys[both]])
            merged = merged.extended(keys, theirs.X)
        return merged

    @classmethod
    def of(cls, stacks: Iterable[Stack]) -> Self:
        """Values of stacks whose elements were checked before."""
        values = cls()
        values.stacks = {stack.kind: stack for stack in stacks}
        return values

    def stack(self, kind: Kind | str) -> Stack:
        """The stack of a kind, a `Kind` or its name.

        Raises
        ------
        GraphError
            There is none.
        """
        name = kind.name if isinstance(kind, Kind) else kind
        if not isinstance(name, str) or name not in self.stacks:
            raise GraphError(
                f"no variable of kind {name!r:.60} has a value; Values hold kinds {list(self.stacks)}. Add initial "
                "values with `Values.add`, or leave out the factors that need them"
            )
        return self.stacks[name]

    def __getitem__(self, key: Kind | Keys) -> Array:
        """A copy of the stack of a kind, of one variable, or of a batch of them."""
        if isinstance(key, Kind):
            return np.array(self.stack(key).X, order="C")
        stack = self.stack(_keys(key).kind)
        X = np.array(stack.X[stack.index(key)], order="C")
        return X[0] if key.single else X

    def __setitem__(self, key: Kind | Keys, X: npt.ArrayLike) -> None:
        stack = self.stack(key.name if isinstance(key, Kind) else _keys(key).kind)
        index = np.arange(len(stack)) if isinstance(key, Kind) else stack.index(key)
        Y = stack.manifold.stack(X)
        if len(Y) not in (1, len(index)):
            raise GraphError(f"{len(Y)} elements for {key!r}, expected {len(index)}", [key])
        X_new = stack.X.copy(order="F")  # other Values may share the stack
        X_new[index] = Y
        self.stacks[stack.kind] = stack.moved(X_new)

    def __contains__(self, key: Keys) -> bool:
        return _keys(key).kind in self.stacks and bool(np.isin(key.numbers, self.stacks[key.kind].numbers).all())

    def __iter__(self) -> Iterator[Keys]:
        """All variables, kind by kind."""
        return (key for stack in self.stacks.values() for key in Keys(stack.kind, stack.numbers))

    def __len__(self) -> int:
        return sum(len(stack) for stack in self.stacks.values())

    @property
    def stated(self) -> Values:
        """The values that were given; those that are made from measurements `OnDemand` are not."""
        return self

    @property
    def dim(self) -> int:
        """Degrees of freedom of all variables together."""
        return sum(len(stack) * stack.manifold.dim for stack in self.stacks.values())

    @property
    def coordinates(self) -> Array:
        """(dim,) how far from the neutral element every variable is, `Manifold.coordinates`."""
        steps = [stack.manifold.coordinates(stack.X).reshape(-1) for stack in self.stacks.values()]
        return np.concatenate(steps) if steps else np.zeros(0)

    def spaces(self) -> Values:
        """No values, of the same kinds."""
        return Values.of(s.only(slice(0)) for s in self.stacks.values())

    def copy(self) -> Values:
        """An independent copy; it shares what it has, as new values never overwrite old ones."""
        return Values.of(self.stacks.values())

    def replaced(self, X: Mapping[Any, Array]) -> Values:
        """The variables with other stacks (n, size) for some kinds (a `Kind` or its name).

        The stacks are taken as they are, without a copy: leave them alone afterwards.

        Raises
        ------
        GraphError
            A kind there is none of.
        """
        X = {kind.name if isinstance(kind, Kind) else kind: stack for kind, stack in X.items()}
        for kind in X:
            self.stack(kind)
        return Values.of(stack.moved(X[n]) if n in X else stack for n, stack in self.stacks.items())

    def retract(self, delta: Array) -> Values:
        """Every variable moved by its part of one tangent step.

        Parameters
        ----------
        delta : (dim,) array, kind by kind, variable by variable: the columns of A with nothing held.

        Raises
        ------
        GraphError
            Another shape.
        """
        if not isinstance(delta, np.ndarray) or delta.shape != (self.dim,):
            raise GraphError(f"retract: expected an array of shape ({self.dim},), got {delta!r:.60}")
        moved, start = [], 0
        for stack in self.stacks.values():
            end = start + len(stack) * stack.manifold.dim
            step = delta[start:end].reshape(len(stack), stack.manifold.dim)
            moved.append(stack.moved(stack.manifold.retract(stack.X, step)))
            start = end
        return Values.of(moved)

    def gather(self, factor: Factor) -> tuple[Model, tuple[Array, ...]]:
        """The factor bound to its manifolds, and the values of its variables, one (n, size) stack per slot."""
        stacks = [self.stack(k.kind) for k in factor.keys]
        model = factor.bind(*(stack.manifold for stack in stacks))
        return model, tuple(take(stack.X, stack.index(k)) for stack, k in zip(stacks, factor.keys, strict=True))

    def __repr__(self) -> str:
        return "Values(" + ", ".join(f"{s.kind}: {len(s)} x {s.manifold}" for s in self.stacks.values()) + ")"

    def _repr_html_(self) -> str:
        rows = [
            (s.kind, str(len(s)), str(s.manifold), ", ".join(s.manifold.components), _shown(s, 0), _shown(s, -1))
            for s in self.stacks.values()
        ]
        heads = ("kind", "variables", "space", "components", "the first", "the last")
        return html_table(f"{len(self)} variables, {self.dim} degrees of freedom", heads, rows)


class OnDemand(Values):
    """Values that are made from others when somebody first asks for them.

    Parameters
    ----------
    given : the same variables as far as they are known, such as a trajectory by its first pose.
    make : from the given ones all; it cannot fail.
    """

    def __init__(self, given: Values, make: Callable[[Values], Values]) -> None:
        self._given, self._make = given, make

    @cached_property
    def _made(self) -> dict[str, Stack]:
        return self._make(self._given).stacks

    @cached_property
    def stacks(self) -> dict[str, Stack]:  # type: ignore[override]
        return dict(self._made)

    @property
    def stated(self) -> Values:
        """The given ones, until somebody changes a value or adds some."""
        return self if vars(self).get("stacks") != vars(self).get("_made") else self._given

    def __reduce__(self) -> tuple[Any, ...]:
        return Values.of, (list(self.stacks.values()),)


def refuse_other(function: str, graph: object, values: object) -> None:
    """Refuse arguments other than a graph and its values.

    Raises
    ------
    GraphError
        Says so where the two are swapped.
    """
    if not hasattr(graph, "factors") or not isinstance(values, Values):
        swapped = "; swap them" if isinstance(graph, Values) and hasattr(values, "factors") else ""
        raise GraphError(f"{function}: expected a graph and its values, got {graph!r:.40} and {values!r:.40}{swapped}")


def _shown(stack: Stack, k: int) -> str:
    """An element of a stack with four digits."""
    return np.array2string(np.asarray(stack.X[k]), precision=4, suppress_small=True) if len(stack) else ""


def _keys(key: object) -> Keys:
    if not isinstance(key, Keys):
        raise GraphError(f"Values: {key!r:.60} names no variable; expected x[0], x[i] or the kind x")
    return key


def _locked(X: Array) -> Array:
    """An array components first in memory that cannot be written to."""
    locked = np.asfortranarray(X).view()
    locked.flags.writeable = False
    return locked


def take(X: Array, index: Index) -> Array:
    """Rows of a stack kept components first (`numpy.take` is 4 times faster than indexing with an array)."""
    return X.T.take(index, axis=1).T
