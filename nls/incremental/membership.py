"""Variables and measurements that leave a growing estimate, and those that arrive.

Rejected loop closures leave, and variables older than the lag. Of the measurements that arrive
some can be used, some wait for a variable, and some make variables join.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from factors.base import Factor, Model
from factors.joined import grouped, joined
from factors.keys import Keys
from factors.sighting import Sighting
from models import LieGroup, Manifold, R
from models.advice import Advice
from models.algebra import Mask
from models.errors import GraphError, LeadlineError, OptionError
from models.listing import some
from models.manifolds.rn import Vectors
from models.options import check_whole
from nls.graph import FactorGraph
from nls.incremental.growing_arrays import GrowingBatch, Variables, part
from nls.incremental.growing_system import GrowingSystem, anchors, touched
from nls.incremental.marginal import MarginalPrior
from nls.incremental.new_variables import Known, New, Variable, alone, points, together
from nls.posegraph import says_poses
from nls.robust import Robustified, gnc
from nls.values import Stack, Values


class Decision:
    """When closures are tested, and which were rejected the last time.

    Parameters
    ----------
    every : after so many new closures; never by itself where it is None.
    lag : of the smoother.

    Attributes
    ----------
    rejected : factors as they were given, and the part of each that is rejected.
    """

    def __init__(self, every: int | None, lag: int | None) -> None:
        if every is not None:
            check_whole("Incremental: decide_every", every, 1, "a whole number of closures of at least 1, or None")
            if lag is not None:
                expected = "None with a lag: closures are tested along the whole path"
                raise OptionError("Incremental: decide_every", every, expected)
        self.every = every
        self.rejected: list[tuple[Factor, Factor]] = []
        self._new = 0

    def is_due(self, factors: Sequence[Factor]) -> bool:
        """Whether enough closures have come, with those among some factors."""
        if self.every is None:
            return False
        for factor in factors:
            if says_poses(factor) and factor.keys[0].kind == factor.keys[1].kind:
                self._new += int((np.abs(factor.keys[0].numbers - factor.keys[1].numbers) > 1).sum())
        return self._new >= self.every

    def judge(self, models: Sequence[Model], values: Values, doubted: Mask | None) -> tuple[Robustified, list[Mask]]:
        """The choice among all that have come, and which measurements (n,) of each factor are kept.

        Parameters
        ----------
        models : all factors.
        values : the start.
        doubted : which of the factors (k,) may be wrong; the loop closures where it is None.
        """
        self._new = 0
        suspect = np.zeros(len(models), dtype=bool) if doubted is None else doubted
        parts = [[model for model, s in zip(models, suspect, strict=True) if s == which] for which in (False, True)]
        trusted, suspects = map(joined, parts)
        decided = gnc(FactorGraph([*trusted, *suspects]), values, doubted=None if doubted is None else suspects)
        kept: dict[int, Mask] = {}
        for group, weights in zip([*grouped(parts[0]), *grouped(parts[1])], decided.weights, strict=True):
            ends = np.cumsum([len(model.factor) for model in group])
            kept |= {id(model): part > 0 for model, part in zip(group, np.split(weights, ends[:-1]), strict=True)}
        return decided, [kept[id(model)] for model in models]


class Window:
    """How many poses are kept, and what has left.

    Parameters
    ----------
    lag : poses of a track that are kept; all where it is None.
    landmarks : ``leave``: a landmark leaves with the last pose that measured it. ``stay``: all of them stay.

    Attributes
    ----------
    behind : measurements of poses that had left: they are not used.
    """

    def __init__(self, lag: int | None, landmarks: Literal["leave", "stay"]) -> None:
        if lag is not None:
            check_whole("lag", lag, 1, "a whole number of poses of at least 1")
        if landmarks not in ("leave", "stay"):
            raise OptionError("landmarks", landmarks, "leave or stay")
        self.lag, self.landmarks = lag, landmarks
        self.behind: list[Factor] = []
        self._tracks, self._sensors = set[str](), set[str]()  # kinds that odometry joins; that no common motion moves
        self._left: dict[str, Variables] = {}

    def reached(self, factor: Factor) -> Factor | None:
        """The measurements of a factor that are about no pose that left; the others are `behind`."""
        if self.lag is None:
            return factor
        kinds = [keys.kind for keys in factor.keys]
        moved = [kind for slot, kind in enumerate(kinds) if slot not in factor.unmoved]
        self._sensors |= {kinds[slot] for slot in factor.unmoved}
        self._tracks |= {kind for kind in moved if moved.count(kind) > 1}
        left = [self._left[k.kind].known(k) for k in factor.keys if k.kind in self._tracks & self._left.keys()]
        late: Mask = np.logical_or.reduce([np.zeros(len(factor), dtype=bool), *left])
        rest = part(factor, ~late)
        if late.any():
            self.behind.append(factor if rest is None else factor[late])
        return rest

    def leaving(self, variables: dict[str, Variables], batches: Sequence[GrowingBatch]) -> dict[str, Mask]:
        """Which variables (n,) leave, by kind; empty where none does."""
        if self.lag is None:
            return {}
        old = {kind: np.arange(len(v)) < len(v) - self.lag for kind, v in variables.items() if kind in self._tracks}
        if self.landmarks == "leave" and any(mask.any() for mask in old.values()):
            new = {kind: ~mask for kind, mask in old.items()}
            measured = [batch for batch in batches if not isinstance(batch.factor, MarginalPrior)]
            for kind, v in variables.items():
                if kind not in old and kind not in self._sensors:
                    old[kind] = touched(v, measured, old) & ~touched(v, measured, new)
        return {kind: mask for kind, mask in old.items() if mask.any()}

    def leave(self, stacks: Iterable[Stack]) -> None:
        """Remember variables that leave."""
        for stack in stacks:
            left = self._left.setdefault(stack.kind, Variables(stack.kind, stack.manifold))
            for number, X in zip(stack.numbers.tolist(), stack.X, strict=True):
                if number not in left.place:
                    left.join(number, X, 0)
                left.X[left.place[number]] = X

    def left(self, variables: dict[str, Variables]) -> Values:
        """Variables that left, but for those that came back."""
        away = [(v, ~variables[kind].known(Keys(kind, v.numbers))) for kind, v in self._left.items()]
        return Values.of(v.stack(mask) for v, mask in away if mask.any())


class Arrivals:
    """Measurements of variables that are not in the estimate yet.

    Parameters
    ----------
    system : the estimate; who joins is added by the caller.
    window : what may still be measured.
    """

    def __init__(self, system: GrowingSystem, window: Window) -> None:
        self._known, self._window = Known(system), window
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
            known = self._known
            if known.space(kind) not in (None, stack.manifold):
                raise GraphError(f"{kind} is in {known.space(kind)}, its initial values are in {stack.manifold}")
            new = {(kind, n): X for n, X in zip(stack.numbers.tolist(), stack.X, strict=True)}
            self._known = replace(known, spaces=known.spaces | {kind: stack.manifold}, starts=known.starts | new)

    def anchors(self, factor: Factor) -> bool:
        """Whether a measurement determines what the gauge may hold."""
        spaces = tuple([self._known.space(keys.kind) for keys in factor.keys])
        return anchors(factor, spaces, self._known.spaces.values())  # all kinds of poses are among them

    def take(self, factors: Sequence[Factor]) -> Iterator[New | tuple[Factor, Factor]]:
        """Variables that join, and the measurements that can be used; the caller adds each before it asks for more."""
        self._pending += [(factor, factor) for factor in factors]
        self.reach()
        before = None if factors else self._known.count
        while self._pending and self._known.count != before:
            before = self._known.count
            yield from self._joining()
            yield from self._usable()
            if self._known.count == before and self._pending:
                yield from together(self._known, self._unknown(), [factor for _, factor in self._pending])

    def leave(self, stacks: list[Stack]) -> None:
        """Forget starts and waiting measurements of variables that leave."""
        self._window.leave(stacks)
        gone = {(stack.kind, number) for stack in stacks for number in stack.numbers.tolist()}
        self._known = replace(self._known, starts={v: X for v, X in self._known.starts.items() if v not in gone})
        self.reach()

    def reach(self) -> None:
        """Give up measurements of what left."""
        within = [(given, self._window.reached(factor)) for given, factor in self._pending]
        self._pending = [(given, factor) for given, factor in within if factor is not None]

    def _usable(self) -> Iterator[tuple[Factor, Factor]]:
        """Factors as given, and their measurements all of whose variables are in the estimate; the others wait on."""
        pending, self._pending = self._pending, []
        for given, factor in pending:
            ready = self._known.ready(factor)
            usable = part(factor, ready)
            if not ready.all():
                self._pending.append((given, factor if usable is None else factor[~ready]))
            if usable is not None:
                yield given, usable

    def _joining(self) -> Iterator[New]:
        """Variables that their measurements to the estimate determine, and the first of all."""
        waiting: dict[tuple[str, Manifold], dict[Variable, list[Factor]]] = {}
        unknown = self._unknown()
        self._tried = {variable: count for variable, count in self._tried.items() if variable in unknown}
        for variable, factors in unknown.items():
            key = Keys(*variable)
            touching = [*self._touching(key, factors)]
            space = self._known.space(key.kind) or self._target_space(touching)
            count = sum(int(mask.sum()) for _, _, mask in touching)
            if space is None or self._tried.get(variable) == count:
                continue
            measurements = [(m, slot) for factor, slot, mask in touching if (m := part(factor, mask)) is not None]
            if not self._known.count and variable in self._known.starts and all(f.relative for f in factors):
                yield New(key, space, self._known.starts[variable])  # the gauge holds it
            elif (new := alone(self._known, key, space, measurements)) is not None:
                yield new
            elif measurements:
                self._tried[variable] = count
                if isinstance(space, Vectors):
                    waiting.setdefault((key.kind, space), {})[variable] = [factor for factor, _ in measurements]
        for (_, space), of_kind in waiting.items():
            yield from points(self._known, space, of_kind)

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
            places = [(keys, self._known.place(keys.kind)) for keys in factor.keys]
            waits = ((keys.kind, n) for keys, place in places for n in keys.numbers.tolist() if n not in place)
            for variable in dict.fromkeys(waits):
                unknown.setdefault(variable, []).append(factor)
        return unknown

    def _touching(self, key: Keys, factors: list[Factor]) -> Iterator[tuple[Factor, int, Mask]]:
        """Factors of a variable, its slot, and which measurements (n,) are between it and the estimate."""
        for factor in factors:
            for slot, keys in enumerate(factor.keys):
                if keys.kind == key.kind and (mask := keys.numbers == key.numbers).any():
                    for others in factor.keys[:slot] + factor.keys[slot + 1 :]:
                        mask &= self._known.has(others)
                    yield factor, slot, mask

    def _target_space(self, touching: list[tuple[Factor, int, Mask]]) -> Manifold | None:
        """The space of a point that is seen from poses."""
        seers = (self._known.space(f.keys[0].kind) for f, slot, _ in touching if isinstance(f, Sighting) and slot == 1)
        return next((R(pose.point_dim) for pose in seers if isinstance(pose, LieGroup)), None)


def blame(error: LeadlineError, came: list[Factor], given: list[Factor]) -> None:
    """Name the measurements that an error is about: those that came, or else those that were given before."""
    for action, here in (("leave out", came), ("take out", given)):
        if blamed := [repr(factor) for factor in here if is_about(error, factor)]:
            return error.advise(Advice(action, (some(blamed),)))


def factors_of(given: Factor | Sequence[Factor], expected: str) -> list[Factor]:
    """A factor or several as a list; anything else is refused."""
    factors = [given] if isinstance(given, Factor) else list(given)
    for factor in factors:
        if not isinstance(factor, Factor):
            raise GraphError(f"Incremental.{expected}, got {factor!r:.80}")
    return factors


def refuse_others(factors: Sequence[Factor], given: Sequence[Factor]) -> None:
    """Refuse to remove what was not given."""
    known = {id(factor) for factor in given}
    for factor in (factor for factor in factors if id(factor) not in known):
        like = any(type(other) is type(factor) and other.keys == factor.keys for other in given)
        cure = ". `given` has another object of its type and variables: pass that one" if like else ""
        raise GraphError(f"Incremental.remove: {factor!r:.80} is not in the estimate{cure}", factor.keys)


def is_about(error: LeadlineError, factor: Factor) -> bool:
    """Whether an error names the type of a factor and all its variables, or no type and one of them."""
    named: Sequence[Keys] = getattr(error, "keys", ())
    touched = [any(key.kind == k.kind and np.isin(key.numbers, k.numbers).all() for k in factor.keys) for key in named]
    name = getattr(error, "factor", "")
    return name == factor.name and all(touched) if name else any(touched)
