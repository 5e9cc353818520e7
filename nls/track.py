"""Relative poses along a trajectory: two poses that follow each other in number make odometry, all others a closure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors import Between, BetweenSensors

if TYPE_CHECKING:
    from models.algebra import Index
    from nls.sparse.pattern import Batch, Pattern

__all__ = ["closures", "steps"]


def steps(batch: Batch, pattern: Pattern) -> npt.NDArray[np.bool_]:
    """(k,) which measurements join two poses of one kind that follow each other in number: odometry."""
    return np.zeros(len(batch), dtype=bool) if not _relative(batch) else _apart(batch, pattern) == 1


def closures(batch: Batch, pattern: Pattern) -> npt.NDArray[np.bool_]:
    """(k,) which measurements join two poses that do not: loop closures, matches."""
    return np.zeros(len(batch), dtype=bool) if not _relative(batch) else _apart(batch, pattern) != 1


def _relative(batch: Batch) -> bool:
    return isinstance(batch.model.factor, Between | BetweenSensors)


def _apart(batch: Batch, pattern: Pattern) -> Index:
    """(k,) how many places apart the first two variables of a measurement are, 0 where they differ in kind."""
    if batch.kinds[0] != batch.kinds[1]:
        return np.zeros(len(batch), dtype=np.intp)
    numbers = pattern.numbers[batch.kinds[0]]
    place = np.empty(len(numbers), dtype=np.intp)
    place[np.argsort(numbers, kind="stable")] = np.arange(len(numbers))
    return np.asarray(np.abs(place[batch.index[0]] - place[batch.index[1]]))
