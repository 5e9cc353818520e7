r"""The linear problem A dx = b of a graph that grows, kept at its present values.

Its factor F ~ A'A takes the rows of new measurements and is otherwise old. This factor is the preconditioner of
conjugate gradients on the exact A. Its age costs iterations, not accuracy. A new one is made, in a new order, when the
iterations due to its age have cost as much as making it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models import Manifold
from models.algebra import Array, Mask
from nls.gauge import choose_gauge, touched_variables
from nls.incremental.batch import GrowingBatch
from nls.incremental.growing import Variables
from nls.incremental.marginal import MarginalPrior, priors_left
from nls.incremental.preconditioner import Preconditioner
from nls.linear import best_decomposition
from nls.linear.singular import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["GrowingSystem"]

ROUGHLY = 0.1  # of the fall of a step, where another one follows anyway
OLD = 20.0  # times what F says of the rest of a fall: an old F has said a twelfth of it
AGED = 20  # iterations beyond the first of every solution, after which the preconditioner is made anew
ITERATIONS = 60
HALVES = 8  # of a step, at most


class GrowingSystem:
    """Variables and batches of measurements, and steps for them.

    Attributes
    ----------
    variables : by kind.
    iterations, factorizations : so far.
    """

    def __init__(self) -> None:
        self.variables: dict[str, Variables] = {}
        self.batches: list[GrowingBatch] = []
        self.iterations = self.factorizations = 0
        self._preconditioner: Preconditioner | None = None
        self._entered: list[int] = []  # measurements of every batch that are in it
        self._age = 0
        self._held = False
        self._part = 1.0  # of the last step

    def __getstate__(self) -> dict[str, Any]:
        """All but the factor, which is made anew."""
        return {**vars(self), "_preconditioner": None}

    @property
    def values(self) -> Values:
        """A copy of the estimate."""
        return Values.of(variables.stack() for variables in self.variables.values())

    @property
    def chi2(self) -> float:
        """Cost at the present values."""
        return sum(batch.cost() for batch in self.batches)

    @property
    def robust(self) -> bool:
        """Whether a kernel weighs some measurements."""
        return any(batch.kernel for batch in self.batches)

    def put(self, values: Values) -> None:
        """Take other values."""
        self.back_to((self.mark()[0], {kind: stack.X for kind, stack in values.stacks.items()}))

    def join(self, key: Keys, space: Manifold, value: Array) -> None:
        """Add a variable at a value (size,)."""
        if key.kind not in self.variables:
            self.variables[key.kind] = Variables(key.kind, space)
        variables = self.variables[key.kind]
        room = None if self._preconditioner is None else self._preconditioner.column(variables.manifold.dim)
        if room is None:
            self.renew()
        variables.join(int(key.numbers[0]), value, 0 if room is None else room)

    def enter(self, factor: Factor) -> tuple[GrowingBatch, slice]:
        """Add measurements of variables that are there; where they are."""
        variables = [self.variables[keys.kind] for keys in factor.keys]
        model = factor.bind(*(v.manifold for v in variables))
        batch = next((batch for batch in self.batches if batch.takes(model)), None)
        if batch is None:
            batch = GrowingBatch(model, variables)
            self.batches.append(batch)
            self._entered.append(0)
        if self._held and not factor.relative:
            self.renew()  # what was held for the gauge may move now
        return batch, batch.append(model)

    def catch_up(self) -> float:
        """Linearize what has come; its cost."""
        return sum(batch.catch_up() for batch in self.batches)

    def mark(self) -> tuple[list[int], dict[str, Array]]:
        """How many measurements there are, and where the variables are."""
        return [len(batch) for batch in self.batches], {kind: v.X.copy() for kind, v in self.variables.items()}

    def back_to(self, mark: tuple[list[int], dict[str, Array]]) -> None:
        """Be as at a mark."""
        measurements, X = mark
        del self.batches[len(measurements) :]
        del self._entered[len(measurements) :]
        for kind in set(self.variables) - set(X):
            del self.variables[kind]
        for kind, variables in self.variables.items():
            variables.keep(len(X[kind]))
            variables.X[...] = X[kind]
        for batch, n in zip(self.batches, measurements, strict=True):
            batch.keep(n)
            batch.linearize()
        self.renew()

    def drop(self, rows: list[Mask]) -> None:
        """Forget measurements (n,) of every batch."""
        for batch, mask in zip(self.batches, rows, strict=True):
            if mask.any():
                batch.drop(mask)
        self.batches = [batch for batch in self.batches if len(batch)]
        self._entered = [len(batch) for batch in self.batches]
        self.renew()

    def marginalize(self, gone: dict[str, Mask]) -> tuple[list[Mask], list[MarginalPrior]]:
        """Take out variables (n,) by kind; the measurements (n,) of every batch that went with them, and what they say.

        Raises
        ------
        UnderconstrainedError
            The measurements do not determine what leaves; all is as before.
        """
        rows = [batch.touches(gone) for batch in self.batches]
        factors = [batch.model(mask).factor for batch, mask in zip(self.batches, rows, strict=True) if mask.any()]
        leaving = [self.variables[kind].keys(mask) for kind, mask in gone.items()]
        priors = priors_left(factors, self.values, leaving)
        self.drop(rows)
        for kind, mask in gone.items():
            self.variables[kind].drop(mask)
        places = {kind: np.cumsum(~mask) - 1 for kind, mask in gone.items()}
        for batch in self.batches:
            batch.renumber(places)
        return rows, priors

    def renew(self) -> None:
        """Make the preconditioner anew before the next step."""
        self._preconditioner = None

    def step(self, enough: float) -> tuple[Array, float]:
        """The step dx with A'A dx = A'b by conjugate gradients, and by how much it lowers |A dx - b|^2.

        Parameters
        ----------
        enough : a fall that is not worth a digit.
        """
        self.catch_up()
        F = self._refreshed()
        rows = [batch.A(F.width) for batch in self.batches]
        dx = np.zeros(F.width)
        r = _sum([At @ batch.b for (_, At), batch in zip(rows, self.batches, strict=True)], F.n)
        z = F.solve(r)
        rz, d, fall = float(r @ z), z, 0.0
        if OLD * rz <= enough:
            return dx, OLD * max(rz, 0.0)
        for iteration in range(ITERATIONS):
            q = _sum([At @ (A @ d) for A, At in rows], F.n)
            alpha = rz / float(d @ q)
            dx += alpha * d
            r -= alpha * q
            fall += alpha * rz
            z = F.solve(r)
            before, rz = rz, float(r @ z)
            self.iterations += 1
            self._age += iteration > 0
            if OLD * rz <= enough - fall or (fall > enough and rz <= ROUGHLY * fall):
                break
            d = z + (rz / before) * d
        return dx, fall + OLD * rz

    def move(self, dx: Array) -> bool:
        """Move all variables by the whole step, or the first half of halves that lowers chi2; whether one does."""
        chi2, begin = self.chi2, {kind: v.X.copy() for kind, v in self.variables.items()}
        first = min(2 * self._part, 1.0)  # of a step like the last one
        for part in (*first * 0.5 ** np.arange(HALVES), 0.0):
            for kind, v in self.variables.items():
                v.move(begin[kind], part * dx[v.columns[:, None] + np.arange(v.manifold.dim)])
            for batch in self.batches:
                batch.linearize()
            if self.chi2 < chi2:
                self._part = part
                return True
        return False

    def _refreshed(self) -> Preconditioner:
        """The preconditioner with all measurements in it."""
        if self._preconditioner is None or self._age > AGED:
            self._preconditioner = self._factorized()
        else:
            F = self._preconditioner
            for batch, n in zip(self.batches, self._entered, strict=True):
                if n < len(batch):
                    F.add(*batch.new_rows(n))
        self._entered = [len(batch) for batch in self.batches]
        return self._preconditioner

    def _factorized(self) -> Preconditioner:
        """A'A at the present values, factorized in an order of little fill."""
        self.factorizations += 1
        self._age = 0
        values = self.values
        pattern = Pattern([batch.model().factor for batch in self.batches], values)
        untouched = ~touched_variables(pattern)  # the first of all, while its measurements wait for others
        gauge = choose_gauge("first", pattern, values, untouched)
        self._held = bool(gauge.held.any())
        pattern = pattern.holding(gauge.held)
        b = [batch.b for batch in self.batches]
        system = LinearSystem(pattern, [batch.blocks() for batch in self.batches], np.concatenate(b))
        hessian = pattern.hessian(best_decomposition().order)
        try:
            preconditioner = Preconditioner(hessian, system.H_blocks)
        except SingularSystemError as error:
            raise underconstrained(system, values) from error
        position = np.empty(hessian.n + 1, dtype=np.intp)
        position[hessian.permutation] = np.arange(hessian.n)
        position[-1] = preconditioner.n  # held
        for variables in self.variables.values():
            begin = pattern.offsets[variables.kind]
            variables.columns[:] = position[pattern.starts[begin : begin + len(variables)]]
        for batch in self.batches:
            batch.place()
        return preconditioner


def _sum(parts: list[Array], n: int) -> Array:
    """The sum of vectors, 0 in the columns of what is held."""
    total = sum(parts[1:], parts[0])
    total[n:] = 0.0
    return total
