"""Which loop closures to believe, decided anew from all that have come: `nls.gnc` beside a growing estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor, Model
from factors.joined import grouped, joined
from models.algebra import Mask
from models.errors import OptionError
from models.options import check_whole
from nls.graph import FactorGraph
from nls.posegraph import says_poses
from nls.robust import Robustified, gnc
from nls.values import Values

__all__ = ["Decision"]


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
                raise OptionError(
                    "Incremental: decide_every", every, "None with a lag: closures are judged along the whole path"
                )
        self.every = every
        self.rejected: list[tuple[Factor, Factor]] = []
        self._new = 0

    def mark(self) -> tuple[list[tuple[Factor, Factor]], int]:
        """What was rejected, and how many closures came since."""
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
