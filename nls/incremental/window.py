"""The newest poses and what they measure: which variables leave a smoother with a lag, and what comes too late."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from factors.base import Factor
from models.algebra import Array, Mask
from models.errors import OptionError
from models.options import check_whole
from nls.incremental.batch import GrowingBatch, touched
from nls.incremental.beginnings import part
from nls.incremental.growing import Variables
from nls.incremental.marginal import MarginalPrior
from nls.values import Stack, Values

__all__ = ["Window"]


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
