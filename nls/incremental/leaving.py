"""Loop closures and variables that leave a growing estimate: not believed any more, or older than the lag."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from factors.base import Factor, Model
from factors.joined import grouped, joined
from models.algebra import Array, Mask
from models.errors import OptionError
from models.options import check_whole
from nls.graph import FactorGraph
from nls.incremental.growing import GrowingBatch, Variables, part
from nls.incremental.growing_system import touched
from nls.incremental.marginal import MarginalPrior
from nls.posegraph import says_poses
from nls.robust import Robustified, gnc
from nls.values import Stack, Values


class Decision:
    """When closures are judged, and which were rejected the last time.

    Parameters
    ----------
    every : after so many new closures; never by itself where it is None.
    lag : of the smoother.

    Attributes
    ----------
    rejected : factors as they were given, and the part of each that is not believed.
    """

    def __init__(self, every: int | None, lag: int | None) -> None:
        if every is not None:
            check_whole("Incremental: decide_every", every, 1, "a whole number of closures of at least 1, or None")
            if lag is not None:
                expected = "None with a lag: closures are judged along the whole path"
                raise OptionError("Incremental: decide_every", every, expected)
        self.every = every
        self.rejected: list[tuple[Factor, Factor]] = []
        self._new = 0

    def mark(self) -> tuple[list[tuple[Factor, Factor]], int]:
        """Rejected measurements, and how many closures came since."""
        return self.rejected, self._new

    def back_to(self, mark: tuple[list[tuple[Factor, Factor]], int]) -> None:
        """Be as at a mark."""
        self.rejected, self._new = mark

    def is_due(self, factors: Sequence[Factor]) -> bool:
        """Whether enough closures have come, with those among some factors."""
        if self.every is None:
            return False
        for factor in factors:
            if says_poses(factor) and factor.keys[0].kind == factor.keys[1].kind:
                self._new += int((np.abs(factor.keys[0].numbers - factor.keys[1].numbers) > 1).sum())
        return self._new >= self.every

    def judge(
        self, models: Sequence[Model], values: Values, doubted: Mask | None = None
    ) -> tuple[Robustified, list[Mask]]:
        """The choice among all that have come, and which measurements (n,) of each factor are believed.

        Parameters
        ----------
        models : all factors.
        values : the start.
        doubted : which of the factors (k,) may be wrong; the loop closures when omitted.
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
        self._tracks: set[str] = set()  # kinds that odometry joins
        self._sensors: set[str] = set()  # kinds that a motion of everything does not move
        self._left: dict[str, dict[int, Array]] = {}

    def mark(self) -> tuple[int, set[str], set[str]]:
        """How much is behind, and the sorts of kinds; what left is not in it."""
        return len(self.behind), {*self._tracks}, {*self._sensors}

    def back_to(self, mark: tuple[int, set[str], set[str]]) -> None:
        """Be as at a mark."""
        n, self._tracks, self._sensors = mark
        del self.behind[n:]

    def reached(self, factor: Factor) -> Factor | None:
        """The measurements of a factor that are about no pose that left; the others are `behind`."""
        if self.lag is None:
            return factor
        for slot, keys in enumerate(factor.keys):
            if slot in factor.unmoved:
                self._sensors.add(keys.kind)
            elif any(keys.kind == other.kind for other in factor.keys[:slot]):
                self._tracks.add(keys.kind)
        late = np.zeros(len(factor), dtype=bool)
        for keys in factor.keys:
            if keys.kind in self._tracks and (left := self._left.get(keys.kind)):
                late |= np.array([number in left for number in keys.numbers.tolist()], dtype=bool)
        if not late.any():
            return factor
        rest = part(factor, ~late)
        self.behind.append(factor if rest is None else factor[late])
        return rest

    def leaving(self, variables: dict[str, Variables], batches: Sequence[GrowingBatch]) -> dict[str, Mask]:
        """Which variables (n,) leave, by kind; empty where none does."""
        if self.lag is None:
            return {}
        old = {kind: np.arange(len(v)) < len(v) - self.lag for kind, v in variables.items() if kind in self._tracks}
        if not any(mask.any() for mask in old.values()) or self.landmarks == "stay":
            return {kind: mask for kind, mask in old.items() if mask.any()}
        new = {kind: ~mask for kind, mask in old.items()}
        measured = [batch for batch in batches if not isinstance(batch.factor, MarginalPrior)]
        for kind, v in variables.items():
            if kind not in old and kind not in self._sensors:
                old[kind] = touched(v, measured, old) & ~touched(v, measured, new)
        return {kind: mask for kind, mask in old.items() if mask.any()}

    def leave(self, stacks: Iterable[Stack]) -> None:
        """Remember variables that leave."""
        for stack in stacks:
            self._left.setdefault(stack.kind, {}).update(zip(stack.numbers.tolist(), stack.X, strict=True))

    def left(self, variables: dict[str, Variables]) -> Values:
        """Variables that left, but for those that came back."""
        stacks = []
        for kind, left in self._left.items():
            away = {number: X for number, X in left.items() if number not in variables[kind].place}
            if away:
                stacks.append(Stack(kind, variables[kind].manifold, np.stack([*away.values()]), np.array([*away])))
        return Values.of(stacks)
