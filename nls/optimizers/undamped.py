"""The undamped step of a linearization, for methods that shorten it: what it would be, and what it promises."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.linear.base import SingularSystemError
from nls.optimizers.watch import AGREEMENT, ROUNDING_CHI2

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.optimizers.problem import Problem
    from nls.system import LinearSystem

__all__ = ["Undamped", "diagonal"]

FAINT = 1e-8  # of the diagonal of A'A: holds free directions still, and costs the others eight digits of nothing


def diagonal(system: LinearSystem) -> Array:
    """Diagonal of A'A (n,), and 1 for an unknown that nothing reacts to: what damping is measured by."""
    squares = np.square(system.column_norms)
    return np.where(squares > 0, squares, 1.0)


class Undamped:
    """Solves a linearization without damping, once, and judges whether chi2 can still fall there.

    Parameters
    ----------
    problem : what is optimized.

    Attributes
    ----------
    free : the last system, when it turned out to be singular.
    reach : max |dx| of the step that agreed last; 0 where something is free, and any length is as good.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.reach = problem, 0.0
        self.free: LinearSystem | None = None
        self._solved: tuple[LinearSystem, Array] | None = None

    def step(self, system: LinearSystem) -> Array:
        """dx = argmin |A dx - b|, computed once per system.

        Raises
        ------
        SingularSystemError
            There is none.
        """
        if self._solved is None or self._solved[0] is not system:
            self._solved = system, self.problem.solve(system)
        return self._solved[1]

    def agrees(self, system: LinearSystem, chi2_rtol: float) -> bool:
        """Whether the linear model, undamped, promises no fall of chi2 worth another step.

        A singular system is solved with the faintest damping, and remembered in `free`.
        """
        try:
            dx = self.step(system)
            self.free, self.reach = None, float(np.abs(dx).max(initial=0.0))
        except SingularSystemError:
            self.free, self.reach = system, 0.0
            dx = self.problem.solve(system, FAINT * diagonal(system))
        return float(dx @ system.gradient) <= AGREEMENT * chi2_rtol * system.chi2 + ROUNDING_CHI2
