"""The undamped step of a linearization, for methods that shorten it: faintly damped, and without any for a verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nls.linear.singular import SingularSystemError

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.optimizers.problem import Problem
    from nls.system import LinearSystem

__all__ = ["FAINT", "HOPELESS", "Undamped"]

FAINT = 1e-14  # lambda that changes no step within its digits; 100 times as much, and again, where it does not suffice
LARGEST = 1e-8  # that a system which follows keeps
HOPELESS = 1e16  # lambda at which no step is left to try


class Undamped:
    """Solves a linearization with the faintest damping, once, or with none.

    Parameters
    ----------
    problem : what is optimized.
    damping : lambda of the first system; a tenth of it for each that follows, down to `FAINT`.

    Attributes
    ----------
    free : the system solved last without damping, when it is singular; None when it is not.
    damping : lambda of the latest system.
    """

    def __init__(self, problem: Problem, damping: float = FAINT) -> None:
        self.problem, self.damping, self._least = problem, 10 * damping, FAINT
        self.free: LinearSystem | None = None
        self._solved: dict[bool, tuple[LinearSystem, Array]] = {}

    def step(self, system: LinearSystem, D: Array, strict: bool = False) -> Array:
        """dx = argmin |A dx - b|^2 + lambda |D dx|^2 with the least lambda that works; computed once per system.

        Parameters
        ----------
        system, D : the linearization; lengths of the columns of A, which damping is measured by.
        strict : with lambda = 0 where there is such a step. Otherwise that is not tried: it would double the
            factorizations of a graph that is free throughout.

        Raises
        ------
        SingularSystemError
            None works.
        """
        if self._solved.get(strict, (None,))[0] is not system:
            dx = self._exact(system) if strict else None
            self._solved[strict] = system, self._faint(system, D) if dx is None else dx
        return self._solved[strict][1]

    def _exact(self, system: LinearSystem) -> Array | None:
        try:
            dx, self.free = self.problem.solve(system), None
        except SingularSystemError:
            dx, self.free = None, system
        return dx

    def _faint(self, system: LinearSystem, D: Array) -> Array:
        self.damping = max(self.damping / 10, self._least)
        while True:
            try:
                return self.problem.solve(system, self.damping * D**2)
            except SingularSystemError:
                self.damping *= 100
                self._least = min(self.damping, LARGEST)
                if self.damping > HOPELESS:
                    raise
