"""The undamped step of a linearization, for methods that shorten it: faintly damped, and without any for a verdict."""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from nls.linear.null_space import weakest
from nls.linear.singular import NULL, SingularSystemError
from nls.optimizers.problem import Problem
from nls.system import LinearSystem

__all__ = ["FAINT", "Undamped"]

FAINT = 1e-14  # lambda that changes no step within its digits; 100 times as much, and again, where it does not suffice
LARGEST = 1e-8  # that a system which follows keeps
# A'A squares the condition of A: a direction that A sees with 1e-8 of a column is lost in it. Up to so many unknowns
# the weakest directions of A are looked at, those it sees by more than so much of a column, and followed where they
# promise a relative decrease of chi2 above this. A bundle has dozens of them, and little to gain.
SMALL, UNSEEN, GAIN = 300, 1e-10, 0.02
HOPELESS = 1e16  # lambda at which no step is left to try


class Undamped:
    """Solves a linearization with the faintest damping, once, or with none.

    Parameters
    ----------
    problem : what is optimized.
    damping : lambda of the first system; a tenth of it for each that follows, down to `FAINT`.

    Attributes
    ----------
    free : the system solved last without damping, when A has a null direction; None when it has none.
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
            self._solved[strict] = system, self._exact(system, D) if strict else self._faint(system, D)
        return self._solved[strict][1]

    def _exact(self, system: LinearSystem, D: Array) -> Array:
        """The step without damping; where A'A is singular, the faint one, or by A itself where that promises more."""
        try:
            dx, self.free = self.problem.solve(system), None
            return dx
        except SingularSystemError:
            dx, self.free = self._faint(system, D), system
        if len(dx) > SMALL or self.problem.solver.held_system(system) is not system:
            return dx
        s, N = weakest(system)
        if not (s <= NULL).any():
            self.free = None
        N = N[:, s > UNSEEN]
        A_N, residual = system.A @ N, system.b - system.times(dx)
        lengths = np.linalg.norm(A_N, axis=0)
        farther = np.asarray(dx + (N / lengths) @ np.linalg.lstsq(A_N / lengths, residual)[0])
        return farther if system.promised(farther) - system.promised(dx) > GAIN * system.chi2 else dx

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
