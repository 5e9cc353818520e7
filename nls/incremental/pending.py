"""Measurements that arrive: which can be used, which wait for a variable, and which variables join."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from factors.sighting import Sighting
from models import LieGroup, Manifold, R
from models.advice import Advice
from models.algebra import Mask
from models.errors import GraphError, LeadlineError
from models.listing import some
from models.manifolds.rn import Vectors
from nls.incremental.growing import Variables, part
from nls.incremental.leaving import Window
from nls.incremental.new_variables import Known, New, Variable, alone, points, together
from nls.values import Values


@dataclass(frozen=True)
class Ready:
    """Measurements all of whose variables are in the estimate, and the factor as it was given."""

    given: Factor
    factor: Factor


class Arrivals:
    """Measurements of variables that are not in the estimate yet.

    Parameters
    ----------
    variables : of the estimate, by kind; who joins is added by the caller.
    window : what may still be measured.
    """

    def __init__(self, variables: dict[str, Variables], window: Window) -> None:
        self._known, self._window = Known(variables), window
        self._pending: list[tuple[Factor, Factor]] = []  # given, the part of it that waits
        self._tried: dict[Variable, int] = {}  # with how many measurements that determine too little

    def offer(self, values: Values) -> None:
        """Start values of variables to come.

        Raises
        ------
        GraphError
            A kind that is in another space here.
        """
        for kind, stack in values.stacks.items():
            space = self._known.space(kind) or stack.manifold
            if space is not stack.manifold:
                raise GraphError(f"{kind} is in {space}, its start values are in {stack.manifold}")
            new = {(kind, n): X for n, X in zip(stack.numbers.tolist(), stack.X, strict=True)}
            spaces, starts = self._known.spaces | {kind: space}, self._known.starts | new
            self._known = replace(self._known, spaces=spaces, starts=starts)

    def take(self, factors: Sequence[Factor]) -> Iterator[New | Ready]:
        """Variables that join, and the measurements that can be used; the caller adds each before it asks for more."""
        self._pending += [(factor, factor) for factor in factors]
        self.reach()
        progress = bool(factors)
        while progress and self._pending:
            progress = False
            arrivals: Iterator[New | Ready] = chain(self._usable(), self._joining())
            for arrival in arrivals:
                progress = True
                yield arrival
            if not progress:
                new = together(self._known, self._unknown(), [factor for _, factor in self._pending])
                progress = bool(new)
                yield from new

    def reach(self) -> None:
        """Give up measurements of what left."""
        within = [(given, self._window.reached(factor)) for given, factor in self._pending]
        self._pending = [(given, factor) for given, factor in within if factor is not None]

    def _usable(self) -> Iterator[Ready]:
        """Measurements all of whose variables are in the estimate; the others wait on."""
        pending, self._pending = self._pending, []
        for given, factor in pending:
            ready: Mask = np.logical_and.reduce([self._known.has(keys) for keys in factor.keys])
            usable = part(factor, ready)
            if not ready.all():
                self._pending.append((given, factor if usable is None else factor[~ready]))
            if usable is not None:
                yield Ready(given, usable)

    def _joining(self) -> Iterator[New]:
        """Variables that their measurements to the estimate determine, and the first of all."""
        waiting: dict[str, tuple[Manifold, dict[int, list[Factor]]]] = {}
        for variable, factors in self._unknown().items():
            key = Keys(*variable)
            measurements = self._touching(key, factors)
            space = self._known.space(key.kind) or self._target_space(measurements)
            count = sum(len(factor) for factor, _ in measurements)
            if space is None or self._tried.get(variable) == count:
                continue
            start, empty = self._known.starts.get(variable), not any(map(len, self._known.variables.values()))
            if empty and start is not None and all(factor.relative for factor in factors):
                yield New(key, space, start)  # the gauge holds it
            elif (new := alone(self._known, key, space, measurements)) is not None:
                yield new
            elif measurements:
                self._tried[variable] = count
                if isinstance(space, Vectors):
                    of_kind = waiting.setdefault(key.kind, (space, {}))[1]
                    of_kind[variable[1]] = [factor for factor, _ in measurements]
        for kind, (space, of_kind) in waiting.items():
            yield from points(self._known, kind, space, of_kind)

    def mark(self) -> tuple[Known, list[tuple[Factor, Factor]]]:
        """Variables to come, and waiting measurements."""
        return self._known, self._pending.copy()

    def back_to(self, mark: tuple[Known, list[tuple[Factor, Factor]]]) -> None:
        """Forget what came since a mark."""
        self._known, self._pending = mark
        self._tried.clear()

    @property
    def pending(self) -> tuple[Factor, ...]:
        """Factors, as they were given, of which something waits."""
        return tuple(given for given, _ in self._pending)

    def drop(self, factors: set[int]) -> None:
        """Forget what waits of some factors, by their `id`."""
        self._pending = [(given, rest) for given, rest in self._pending if id(given) not in factors]
        self._tried.clear()

    @property
    def waiting(self) -> tuple[Keys, ...]:
        """Variables that are measured and not determined yet."""
        return tuple(Keys(kind, number) for kind, number in self._unknown())

    def _unknown(self) -> dict[Variable, list[Factor]]:
        """Variables that wait, in the order of their measurements, and the factors these are in."""
        unknown: dict[Variable, list[Factor]] = {}
        for _, factor in self._pending:
            waits = ((keys.kind, n) for keys in factor.keys for n in keys.numbers[~self._known.has(keys)].tolist())
            for variable in dict.fromkeys(waits):
                unknown.setdefault(variable, []).append(factor)
        return unknown

    def _touching(self, key: Keys, factors: list[Factor]) -> list[tuple[Factor, int]]:
        """Measurements between a variable and the estimate, and the slot in which it is."""
        number, touching = int(key.numbers[0]), []
        for factor in factors:
            for slot, keys in enumerate(factor.keys):
                if keys.kind == key.kind:
                    mask: Mask = keys.numbers == number
                    for other, k in enumerate(factor.keys):
                        if other != slot:
                            mask &= self._known.has(k)
                    if (measurements := part(factor, mask)) is not None:
                        touching.append((measurements, slot))
        return touching

    def _target_space(self, touching: list[tuple[Factor, int]]) -> Manifold | None:
        """The space of a point that is seen from poses."""
        for factor, slot in touching:
            pose = self._known.space(factor.keys[0].kind)
            if isinstance(factor, Sighting) and slot == 1 and isinstance(pose, LieGroup):
                return R(pose.point_dim)
        return None


def blame(error: LeadlineError, came: list[Factor], given: list[Factor]) -> None:
    """Name the measurements that an error is about: those that came, or else those that were given before."""
    for action, here in (("leave out", came), ("take out", given)):
        if blamed := [factor for factor in here if is_about(error, factor)]:
            error.advise(Advice(action, (some([repr(factor) for factor in blamed]),)))
            return


def factors_of(given: Factor | Sequence[Factor], expected: str) -> list[Factor]:
    """A factor or several as a list; what is none is refused, in words of what was expected."""
    factors = [given] if isinstance(given, Factor) else list(given)
    for factor in factors:
        if not isinstance(factor, Factor):
            raise GraphError(f"Incremental.{expected}, got {factor!r:.80}")
    return factors


def refuse_others(factors: Sequence[Factor], given: Sequence[Factor]) -> None:
    """Refuse to remove what was not given."""
    known = {id(factor) for factor in given}
    for factor in factors:
        if id(factor) not in known:
            like = any(type(other) is type(factor) and other.keys == factor.keys for other in given)
            cure = ". Another object of its type and variables is, in `given`: pass that one" if like else ""
            raise GraphError(f"Incremental.remove: {factor!r:.80} is not in the estimate{cure}", factor.keys)


def is_about(error: LeadlineError, factor: Factor) -> bool:
    """Whether an error names the type of a factor and all its variables, or no type and one of them."""
    named: Sequence[Keys] = getattr(error, "keys", ())
    touched = [any(key.kind == k.kind and np.isin(key.numbers, k.numbers).all() for k in factor.keys) for key in named]
    name = getattr(error, "factor", "")
    return name == factor.name and all(touched) if name else any(touched)
