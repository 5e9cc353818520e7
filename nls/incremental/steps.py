"""A graph as its measurements arrive: step by step, a step a run of measurements with the same newest pose."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models.algebra import Index
from models.errors import GraphError


@dataclass(frozen=True)
class Arrived:
    """One arrival: the measurements with the same newest pose.

    Attributes
    ----------
    line : of the last of them in the file; the number of the step, counted from 1, where there are no lines.
    """

    pose: Keys
    factors: list[Factor]
    line: int


def steps(
    factors: Sequence[Factor], lines: Sequence[Index] | None = None, kind: str | Sequence[str] = "x"
) -> Iterator[Arrived]:
    """The measurements of a graph in the order in which they arrive.

    Parameters
    ----------
    factors : of a graph.
    lines : of a file, (n,) for every factor: they arrive in this order. When omitted, in the order of the newest pose.
    kind : of the poses, whose numbers rise with time, or several. Between two kinds the second pose is the newest. A
        measurement of none arrives with the one before it.

    Raises
    ------
    GraphError
        No measurement is of a pose of these kinds.

    Examples
    --------
    >>> from factors import Between, Isotropic, Landmark
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> odometry = Between(x[[0, 1]], x[[1, 2]], [[1, 0, 0], [1, 0, 0]], Isotropic(0.1))
    >>> sightings = Landmark(x[[0, 2]], l[[0, 0]], [[2, 1], [0, 1]], Isotropic(0.1))
    >>> for step in steps([odometry, sightings]):
    ...     print(step.pose, step.factors)
    x0 [Landmark(x0, l0)]
    x1 [Between(x0, x1)]
    x2 [Between(x1, x2), Landmark(x2, l0)]
    """
    kinds = [kind] if isinstance(kind, str) else [*kind]
    factors = [factor for factor in factors if len(factor)]
    of = np.repeat(np.arange(len(factors)), [len(factor) for factor in factors])
    row = np.concatenate([np.arange(len(factor)) for factor in factors]) if factors else of
    newest, kind_of = np.concatenate([np.empty((2, 0), int), *(_newest(f, kinds) for f in factors)], axis=1)
    if (kind_of < 0).all():
        raise GraphError(f"no measurement is of a pose, kind {' or '.join(kinds)}: there is nothing to step through")
    at = newest if lines is None else np.concatenate(lines)
    order = np.lexsort((row, of, kind_of, at))
    newest, kind_of = newest[order], kind_of[order]
    before = np.maximum.accumulate(np.where(kind_of >= 0, np.arange(len(newest)), -1))
    before = np.where(before >= 0, before, np.argmax(kind_of >= 0))
    newest, kind_of = newest[before], kind_of[before]
    begins = np.flatnonzero(np.r_[True, (np.diff(newest) != 0) | (np.diff(kind_of) != 0)])
    runs = zip(newest[begins].tolist(), kind_of[begins].tolist(), np.split(order, begins[1:]), strict=True)
    for step, (number, of_kind, run) in enumerate(runs, 1):
        arrived = [(k, row[run[of[run] == k]]) for k in np.unique(of[run]).tolist()]
        parts = [factors[k] if len(rows) == len(factors[k]) else factors[k][rows] for k, rows in arrived]
        yield Arrived(Keys(kinds[of_kind], number), parts, step if lines is None else int(at[run].max()))


def _newest(factor: Factor, kinds: Sequence[str]) -> Index:
    """The newest pose of every measurement, its number and which of the kinds it is, (2, n); -1 where there is none."""
    newest = np.full((2, len(factor)), -1)
    for keys in factor.keys:
        if keys.kind in kinds:
            pose = np.stack([keys.numbers, np.full(len(keys), kinds.index(keys.kind))])
            later = (newest[1] != pose[1]) | (newest[0] < pose[0])
            newest[:, later] = pose[:, later]
    return newest
