r"""Conjugate gradients: H x = r in passes over H and its preconditioner M.

    z = M^-1 r,   p = z + beta p,   alpha = r'z / p'H p,   x = x + alpha p,   r = r - alpha H p

In every step r'M^-1 r = r'z is known; it is over when that has fallen to its goal.

Source: M. Hestenes, E. Stiefel, "Methods of conjugate gradients for solving linear systems", 1952; Y. Saad, Iterative
Methods for Sparse Linear Systems, 2003, section 9.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from models.algebra import Array

__all__ = ["SURE", "Iterated", "Look", "conjugate"]

SURE = 0.01  # of the deviation of a random right side along any direction: what is left of it where it is solved

Look = Callable[[float, Array], None]


class Iterated(NamedTuple):
    """Where conjugate gradients led.

    Attributes
    ----------
    x : (n,) the solution.
    steps : taken.
    converged : whether it has reached its goal.
    flat : (n,) the direction p it ended with where p'H p was not above 0; None where it did not end so.
    """

    x: Array
    steps: int
    converged: bool
    flat: Array | None = None


def conjugate(
    times: Callable[[Array], Array],
    preconditioned: Callable[[Array], Array],
    r: Array,
    goal: Callable[[float], float],
    max_steps: int,
    look: Look | None = None,
) -> Iterated:
    """Solve H x = r.

    Parameters
    ----------
    times, preconditioned : H and M^-1 times an array (n,).
    r : (n,) right side.
    goal : from r'M^-1 r at the start, at which r'M^-1 r it is there.
    max_steps : not more.
    look : called in every step with r'M^-1 r and x (n,); may raise.

    Examples
    --------
    >>> import numpy as np
    >>> H = np.array([[4.0, 1.0], [1.0, 3.0]])
    >>> found = conjugate(lambda p: H @ p, lambda r: r, np.array([1.0, 2.0]), lambda first: 1e-20 * first, 9)
    >>> found.steps, found.converged, (H @ found.x).round(6).tolist()
    (2, True, [1.0, 2.0])
    """
    x, p, rz, least = np.zeros_like(r), np.zeros_like(r), 1.0, 0.0
    for step in range(max_steps + 1):
        z = preconditioned(r)
        before, rz = rz, np.einsum("n,n->", r, z)
        if step == 0:
            least = goal(rz)
        if rz <= least:  # what is not a number is not there
            return Iterated(x, step, True)
        if step == max_steps:
            return Iterated(x, step, False)
        if look is not None:
            look(rz, x)
        p = z + (rz / before if step else 0.0) * p
        Hp = times(p)
        curvature = np.einsum("n,n->", p, Hp)
        if not curvature > 0:
            return Iterated(x, step + 1, False, p)
        alpha = rz / curvature
        x += alpha * p
        r = r - alpha * Hp
    raise AssertionError
