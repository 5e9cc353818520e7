"""New variables: held back until the measurements to known ones determine them, and where they begin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.keys import Keys, Kind
from factors.prior import Prior
from factors.sighting import Sighting
from models import LieGroup, Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, UnderconstrainedError
from models.manifolds.rn import Vectors
from nls.graph import FactorGraph
from nls.incremental.growing import Variables
from nls.starts.landmarks import DETERMINED, locate_points
from nls.values import Stack, Values

__all__ = ["Arrivals", "New", "Ready"]

Variable = tuple[str, int]  # kind, number


@dataclass(frozen=True)
class New:
    """A variable that joins the estimate, and its value (size,)."""

    key: Keys
    space: Manifold
    value: Array


@dataclass(frozen=True)
class Ready:
    """Measurements all of whose variables are in the estimate, and the factor as it was given."""

    given: Factor
    factor: Factor


class Arrivals:
    """Measurements that touch variables which are not in the estimate yet.

    Parameters
    ----------
    known : variables of the estimate, by kind; who joins is added by the caller.
    """

    def __init__(self, known: dict[str, Variables]) -> None:
        self._known = known
        self._spaces: dict[str, Manifold] = {}
        self._starts: dict[Variable, Array] = {}
        self._pending: list[tuple[Factor, Factor]] = []  # given, the part of it that waits

    def offer(self, values: Values) -> None:
        """Start values of variables to come.

        Raises
        ------
        GraphError
            A kind that is in another space here.
        """
        for kind, stack in values.stacks.items():
            space = self._space(kind) or stack.manifold
            if space is not stack.manifold:
                raise GraphError(f"{kind} is in {space}, its start values are in {stack.manifold}")
            self._spaces[kind] = space
            self._starts |= {(kind, n): X for n, X in zip(stack.numbers.tolist(), stack.X, strict=True)}

    def take(self, factors: Sequence[Factor]) -> Iterator[New | Ready]:
        """Variables that join, and the measurements that can be used; the caller adds each before it asks for more."""
        self._pending += [(factor, factor) for factor in factors]
        progress = True
        while progress and self._pending:
            progress, pending, self._pending = False, self._pending, []
            for given, factor in pending:
                ready = self._ready(factor)
                if ready.any():
                    yield Ready(given, factor if ready.all() else factor[ready])
                    progress = True
                if not ready.all():
                    self._pending.append((given, factor[~ready] if ready.any() else factor))
            for kind, number in self._unknown():
                new = self._begun(Keys(kind, number))
                if new is not None:
                    yield new
                    progress = True

    def drop(self, factor: Factor) -> bool:
        """Forget measurements that wait; whether there were any."""
        before = len(self._pending)
        self._pending = [(given, part) for given, part in self._pending if given is not factor]
        return len(self._pending) < before

    @property
    def waiting(self) -> tuple[Keys, ...]:
        """Variables that are measured and not determined yet."""
        return tuple(Keys(kind, number) for kind, number in self._unknown())

    def _space(self, kind: str) -> Manifold | None:
        return self._known[kind].manifold if kind in self._known else self._spaces.get(kind)

    def _is_known(self, keys: Keys) -> npt.NDArray[np.bool_]:
        variables = self._known.get(keys.kind)
        return np.zeros(len(keys), dtype=bool) if variables is None else variables.known(keys)

    def _ready(self, factor: Factor) -> npt.NDArray[np.bool_]:
        """Which measurements have all their variables in the estimate."""
        return np.asarray(np.logical_and.reduce([self._is_known(keys) for keys in factor.keys]))

    def _unknown(self) -> list[Variable]:
        """Variables that wait, in the order of their measurements."""
        order: dict[Variable, None] = {}
        for _, factor in self._pending:
            for keys in factor.keys:
                waits = ~self._is_known(keys)
                order |= dict.fromkeys((keys.kind, n) for n in keys.numbers[waits].tolist())
        return list(order)

    def _touching(self, key: Keys) -> list[tuple[Factor, int]]:
        """Measurements between a variable and the estimate, and the slot in which it is."""
        number, out = int(key.numbers[0]), []
        for _, factor in self._pending:
            for slot, keys in enumerate(factor.keys):
                if keys.kind == key.kind and (here := keys.numbers == number).any():
                    others = [self._is_known(k) for other, k in enumerate(factor.keys) if other != slot]
                    mask = np.logical_and.reduce([here, *others])
                    if mask.any():
                        out.append((factor if mask.all() else factor[mask], slot))
        return out

    def _begun(self, key: Keys) -> New | None:
        """A variable at its start value, if the measurements between it and the estimate determine it."""
        start = self._starts.get((key.kind, int(key.numbers[0])))
        touching = self._touching(key)
        space = self._space(key.kind) or self._target_space(touching)
        if space is None:
            return None
        if start is not None and not any(map(len, self._known.values())):
            return New(key, space, start)  # the first of all: measurements or the gauge hold it
        for factor, slot in touching:
            value = self._placed(factor, slot, space)
            if value is not None:
                return New(key, space, value if start is None else start)
        return self._determined(key, space, start, touching) if touching else None

    def _target_space(self, touching: list[tuple[Factor, int]]) -> Manifold | None:
        """The space of a point that is seen from poses."""
        for factor, slot in touching:
            pose = self._space(factor.keys[0].kind)
            if isinstance(factor, Sighting) and slot == 1 and isinstance(pose, LieGroup):
                return R(pose.point_dim)
        return None

    def _placed(self, factor: Factor, slot: int, space: Manifold) -> Array | None:
        """Where the first of some measurements alone puts the variable of a slot; None where it does not say."""
        first = factor if len(factor) == 1 else factor[[0]]
        spaces = [space if k == slot else self._known[keys.kind].manifold for k, keys in enumerate(first.keys)]
        model = first.bind(*spaces)
        W = model.W[0] if model.W.ndim == 3 else np.diag(model.W[0])
        if model.dim < space.dim or not np.linalg.det(W):
            return None
        if isinstance(first, Prior) and first.offset is None:
            return np.asarray(model.z[0])
        X = [None if k == slot else self._value(keys) for k, keys in enumerate(first.keys)]
        z = first.relative_poses(model)
        if z is not None and isinstance(space, LieGroup) and spaces[1 - slot] is space:
            known = X[1 - slot]
            assert known is not None
            return np.asarray((space.compose(known, z) if slot == 1 else space.compose(known, space.inverse(z)))[0])
        if isinstance(first, Sighting) and first.locates and slot == 1 and isinstance(spaces[0], LieGroup):
            S = first.sensor_pose(spaces[0], X[0], *X[2:])  # type: ignore[arg-type]
            return np.asarray(first.locate(spaces[0], S, model.z)[0])
        return None

    def _value(self, keys: Keys) -> Array:
        variables = self._known[keys.kind]
        return np.asarray(variables.X[variables.index(keys)])

    def _determined(
        self, key: Keys, space: Manifold, start: Array | None, touching: list[tuple[Factor, int]]
    ) -> New | None:
        """Where all measurements between it and the estimate put a variable; None where they leave something free."""
        graph = FactorGraph([factor for factor, _ in touching])
        numbers: dict[str, set[int]] = {}
        for factor, slot in touching:
            for k, keys in enumerate(factor.keys):
                if k != slot:
                    numbers.setdefault(keys.kind, set()).update(keys.numbers.tolist())
        stacks = {}
        for kind, members in numbers.items():
            others = Keys(kind, sorted(members))
            graph.fix(others)
            stacks[kind] = Stack(kind, self._known[kind].manifold, self._value(others), others.numbers)
        known = Values.of(stacks.values())
        for begin in self._candidates(start, space, known):
            values = _with(known, key, space, begin)
            if start is None and isinstance(space, Vectors):
                values = locate_points(graph, values)
                if (values[key[0]] == begin).all():
                    continue
            try:
                result = graph.optimize(values, gauge="none")
                H = graph.linearize(result.values).H.toarray()
            except (UnderconstrainedError, EvaluationError):
                continue
            scale = np.sqrt(H.diagonal())
            if result.converged and scale.all() and np.linalg.eigvalsh(H / np.outer(scale, scale))[0] > DETERMINED:
                return New(key, space, result.values[key[0]])
        return None

    def _candidates(self, start: Array | None, space: Manifold, known: Values) -> Iterator[Array]:
        """Where a variable may begin: as given, or where another of its space is."""
        if start is not None:
            yield start
            return
        if isinstance(space, Vectors):
            yield np.zeros(space.size)
        for stack in known.stacks.values():
            if stack.manifold is space:
                yield stack.X[-1]


def _with(values: Values, key: Keys, space: Manifold, X: Array) -> Values:
    """Values, and one more variable."""
    if key.kind in values.stacks:
        return values.extended(key, X[None])
    more = Values.of([*values.stacks.values()])
    more.add(Kind(key.kind), space, X[None], key.numbers)
    return more
