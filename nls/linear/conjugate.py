r"""Conjugate gradients for several right sides at once: H x_k = r_k in the same passes over H and its preconditioner M.

    z = M^-1 r,   p = z + beta p,   alpha = r'z / p'H p,   x = x + alpha p,   r = r - alpha H p

Of every right side r'M^-1 r = r'z is known in every step, and a side leaves when it has fallen to its goal. The
coefficients alpha and beta are those of the Lanczos process that comes with it.

Source: M. Hestenes, E. Stiefel, "Methods of conjugate gradients for solving linear systems", 1952; Y. Saad, Iterative
Methods for Sparse Linear Systems, 2003, sections 6.7.3 (Lanczos coefficients) and 9.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from models.algebra import Array
from models.options import check_between, check_whole

__all__ = ["SURE", "Iterated", "checked_settings", "conjugate"]

SURE = 0.01  # of the deviation of a random right side along any direction: what is left of it where it is solved

Look = Callable[[Array, Array], None]


class Iterated(NamedTuple):
    """Where conjugate gradients led.

    Attributes
    ----------
    x : (k, n) solutions, one a row.
    steps : taken.
    converged : whether every side has reached its goal.
    coefficients : (alpha, beta) of every step, by side.
    flat : (j, n) the directions p it ended with where p'H p was not above 0; None where it did not end so.
    """

    x: Array
    steps: int
    converged: bool
    coefficients: list[list[tuple[float, float]]]
    flat: Array | None = None


def checked_settings(tol: float, max_steps: int) -> tuple[float, int]:
    """The tolerance and the most steps of a solver.

    Raises
    ------
    OptionError
        A tolerance that is not between 0 and 1, or steps that are no whole number above 0.
    """
    tol = check_between("tol", tol, 0, 1, "a number above 0 and below 1")
    return tol, check_whole("max_steps", max_steps, 1, "a whole number above 0")


def conjugate(
    times: Callable[[Array], Array],
    preconditioned: Callable[[Array], Array],
    R: Array,
    goals: Callable[[Array], Array],
    max_steps: int,
    tried: int | None = None,
    look: Look | None = None,
) -> Iterated:
    """Solve H x_k = r_k for the rows of R.

    Parameters
    ----------
    times, preconditioned : H and M^-1 times every row of an array (j, n), j not above k.
    R : (k, n) right sides.
    goals : from r'M^-1 r (k,) at the start, at which r'M^-1 r (k,) each side is there.
    max_steps : not more.
    tried : steps after which their rate is believed, and it is over where it would take more than `max_steps` in all;
        None where all of these are to be taken.
    look : called in every step with r'M^-1 r of the sides that are not there yet, and x (k, n) of all; may raise.

    Examples
    --------
    >>> import numpy as np
    >>> H = np.array([[4.0, 1.0], [1.0, 3.0]])
    >>> found = conjugate(lambda P: P @ H, lambda R: R, np.array([[1.0, 2.0]]), lambda first: 1e-20 * first, 9)
    >>> found.steps, found.converged, (found.x @ H).round(6).tolist()
    (2, True, [[1.0, 2.0]])
    """
    R, x, P = R.copy(), np.zeros_like(R), np.zeros_like(R)
    rz, side = np.ones(len(R)), np.arange(len(R))  # side: the rows not there yet
    coefficients: list[list[tuple[float, float]]] = [[] for _ in side]
    for step in range(max_steps + 1):
        Z = preconditioned(R)
        before, rz = rz, np.einsum("kn,kn->k", R, Z)
        if step == 0:
            first, goal = rz, goals(rz)
        on = ~(rz <= goal[side])  # what is not a number is not there
        if not on.all():
            side, R, P, Z, rz, before = side[on], R[on], P[on], Z[on], rz[on], before[on]
        if not len(side):
            return Iterated(x, step, True, coefficients)
        if step == max_steps or (
            tried is not None and step >= tried and _needed(step, rz, first[side], goal[side]) > max_steps
        ):
            return Iterated(x, step, False, coefficients)
        if look is not None:
            look(rz, x)
        beta = rz / before if step else np.zeros(len(rz))
        P = Z + beta[:, None] * P
        HP = times(P)
        curvature = np.einsum("kn,kn->k", P, HP)
        if not (curvature > 0).all():
            return Iterated(x, step + 1, False, coefficients, P)
        alpha = rz / curvature
        x[side] += alpha[:, None] * P
        for k, a, b in zip(side.tolist(), alpha.tolist(), beta.tolist(), strict=True):
            coefficients[k].append((a, b))
        R = R - alpha[:, None] * HP
    raise AssertionError


def _needed(step: int, rz: Array, first: Array, goal: Array) -> float:
    """Steps in all, if the rest converges as fast as these did."""
    return float((step * np.log(goal / first) / np.log(np.minimum(rz / first, 0.99))).max())
