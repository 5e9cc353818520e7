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
    rows = [np.vstack([np.arange(len(f)), np.full(len(f), k), *_newest(f, kinds)]) for k, f in enumerate(factors)]
    table = np.concatenate([np.empty((4, 0), int), *rows], axis=1)  # row, factor, number and kind of the newest pose
    if (table[3] < 0).all():
        raise GraphError(f"no measurement is of a pose, kind {' or '.join(kinds)}: there is nothing to step through")
    at = table[2] if lines is None else np.concatenate(lines)
    row, of, newest, kind_of, at = np.vstack([table, at])[:, np.lexsort((*table[[0, 1, 3]], at))]
    poses = np.flatnonzero(kind_of >= 0)
    pose = poses[np.maximum(np.searchsorted(poses, np.arange(len(of)), "right") - 1, 0)]  # of the last that has one
    begins = np.flatnonzero(np.diff(newest[pose]) | np.diff(kind_of[pose])) + 1
    for step, run in enumerate(np.split(np.arange(len(of)), begins), 1):
        arrived = [(k, row[run[of[run] == k]]) for k in np.unique(of[run]).tolist()]
        parts = [factors[k] if len(rows) == len(factors[k]) else factors[k][rows] for k, rows in arrived]
        key = Keys(kinds[kind_of[pose[run[0]]]], int(newest[pose[run[0]]]))
        yield Arrived(key, parts, step if lines is None else int(at[run[-1]]))


def _newest(factor: Factor, kinds: Sequence[str]) -> Index:
    """The newest pose of every measurement, its number and which of the kinds it is, (2, n); -1 where there is none."""
    poses = [keys for keys in factor.keys if keys.kind in kinds]
    if not poses:
        return np.full((2, len(factor)), -1)
    numbers = [keys.numbers for keys in poses if keys.kind == poses[-1].kind]
    return np.stack([np.max(numbers, axis=0), np.full(len(factor), kinds.index(poses[-1].kind))])
