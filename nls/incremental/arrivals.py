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
from models.algebra import Mask
from models.errors import GraphError
from models.manifolds.rn import Vectors
from nls.incremental.beginnings import Known, New, Variable, alone, part, points, together
from nls.incremental.growing import Variables
from nls.values import Values

__all__ = ["Arrivals", "Ready"]


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
    """

    def __init__(self, variables: dict[str, Variables]) -> None:
        self._known = Known(variables)
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
            self._known.spaces[kind] = space
            self._known.starts |= {(kind, n): X for n, X in zip(stack.numbers.tolist(), stack.X, strict=True)}

    def take(self, factors: Sequence[Factor]) -> Iterator[New | Ready]:
        """Variables that join, and the measurements that can be used; the caller adds each before it asks for more."""
        self._pending += [(factor, factor) for factor in factors]
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
        touching = self._touching()
        waiting: dict[str, tuple[Manifold, dict[int, list[Factor]]]] = {}
        for variable in self._unknown():
            key, measurements = Keys(*variable), touching.get(variable, [])
            space = self._known.space(key.kind) or self._target_space(measurements)
            count = sum(len(factor) for factor, _ in measurements)
            if space is None or self._tried.get(variable) == count:
                continue
            start, empty = self._known.starts.get(variable), not any(map(len, self._known.variables.values()))
            if empty and start is not None and self._is_relative(key):
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
        """What is known of variables to come, and what waits."""
        known = self._known
        return replace(known, spaces=dict(known.spaces), starts=dict(known.starts)), list(self._pending)

    def back_to(self, mark: tuple[Known, list[tuple[Factor, Factor]]]) -> None:
        """Forget what came since a mark."""
        self._known, self._pending = mark

    def drop(self, factor: Factor) -> bool:
        """Forget measurements that wait; whether there were any."""
        before = len(self._pending)
        self._pending = [(given, rest) for given, rest in self._pending if given is not factor]
        return len(self._pending) < before

    @property
    def waiting(self) -> tuple[Keys, ...]:
        """Variables that are measured and not determined yet."""
        return tuple(Keys(kind, number) for kind, number in self._unknown())

    def _unknown(self) -> list[Variable]:
        """Variables that wait, in the order of their measurements."""
        order: dict[Variable, None] = {}
        for _, factor in self._pending:
            for keys in factor.keys:
                waits = ~self._known.has(keys)
                order |= dict.fromkeys((keys.kind, n) for n in keys.numbers[waits].tolist())
        return list(order)

    def _touching(self) -> dict[Variable, list[tuple[Factor, int]]]:
        """Measurements between a variable that waits and the estimate, and the slot in which it is."""
        touching: dict[Variable, list[tuple[Factor, int]]] = {}
        for _, factor in self._pending:
            known = np.array([self._known.has(keys) for keys in factor.keys])
            alone = (~known).sum(axis=0) == 1  # one variable waits, the others are there
            for slot, keys in enumerate(factor.keys):
                rows = alone & ~known[slot]
                for number in np.unique(keys.numbers[rows]).tolist():
                    if (measurements := part(factor, rows & (keys.numbers == number))) is not None:
                        touching.setdefault((keys.kind, number), []).append((measurements, slot))
        return touching

    def _is_relative(self, key: Keys) -> bool:
        """Whether all measurements of a variable are relative."""
        number = int(key.numbers[0])
        of_it = (f for _, f in self._pending for k in f.keys if k.kind == key.kind and number in k.numbers)
        return all(factor.relative for factor in of_it)

    def _target_space(self, touching: list[tuple[Factor, int]]) -> Manifold | None:
        """The space of a point that is seen from poses."""
        for factor, slot in touching:
            pose = self._known.space(factor.keys[0].kind)
            if isinstance(factor, Sighting) and slot == 1 and isinstance(pose, LieGroup):
                return R(pose.point_dim)
        return None
