r"""Smoothing as measurements arrive, at the optimum of all of them after every update.

The gradient g = A'b is exact, at the present values. Only the factor of A'A is kept from update to update, and takes
the rows of new measurements. It is the preconditioner of conjugate gradients on the exact A'A:

    z = F^-1 g,   gap = g'z         how far chi2 is above its minimum, F near A'A
    dx by conjugate gradients, x <- x [+] dx, until gap <= 0.3 tol chi2

A new pose whose odometry fits exactly changes nothing, and a new measurement of residual r cannot lower the minimum:

    gap_new <= gap + |r|^2

so nothing is solved while that is within tol of chi2. F is made anew, in a new order, when the iterations that its age
costs have cost as much as making it.

Source: M. Kaess, H. Johannsson, R. Roberts, V. Ila, J. Leonard, F. Dellaert, "iSAM2: incremental smoothing and mapping
using the Bayes tree", IJRR 31(2), 2012, for the problem; there the linearization of parts stays old and chi2 above its
minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from factors.base import Factor, Model
from factors.joined import joined
from factors.keys import Keys
from models.algebra import Array, Index
from models.errors import GraphError, OptionError
from models.options import is_number
from nls.covariance import Marginals
from nls.gauge import choose_gauge
from nls.graph import FactorGraph
from nls.incremental.arrivals import Arrivals, New
from nls.incremental.batch import GrowingBatch
from nls.incremental.growing import Variables
from nls.incremental.preconditioner import Preconditioner, stacked
from nls.linear import best_decomposition
from nls.linear.singular import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Incremental"]

SETTLED = 0.3  # of the tolerance: gap is that of the preconditioner
SOLVED = 0.01  # of the gap: the linear problem is solved to that
AGED = 20  # iterations beyond the first of every solution, after which the preconditioner is made anew
PASSES, ITERATIONS = 30, 60


class Incremental:
    """The estimate of all variables so far, at the optimum of all measurements so far.

    Parameters
    ----------
    tol : chi2 stays within this part of its minimum; of 1 where chi2 is less.

    Attributes
    ----------
    chi2 : of all measurements at the present values.
    gap : chi2 is above its minimum by no more.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=30)
    >>> odometry, closures = world.graph.factors
    >>> (x,) = nls.kinds("x")
    >>> smoother = nls.Incremental()
    >>> for k, step in enumerate(odometry):
    ...     seen = closures[closures.keys[1].numbers == k + 1]
    ...     smoother.update([step, seen], nls.Values({x: (sim.SE2, [[0, 0, 0]])}) if k == 0 else None)
    >>> best = world.graph.optimize(smoother.values)
    >>> smoother.chi2 - best.chi2_final <= smoother.gap <= 1e-3 * smoother.chi2
    True
    """

    def __init__(self, tol: float = 1e-3) -> None:
        if not is_number(tol) or not 0 < tol < 1:
            raise OptionError("tol", tol, "a number between 0 and 1, such as 1e-3")
        self.tol, self.chi2, self.gap = float(tol), 0.0, 0.0
        self.passes = self.iterations = self.factorizations = self.batch_solutions = 0
        self._variables: dict[str, Variables] = {}
        self._batches: list[GrowingBatch] = []
        self._arrivals = Arrivals(self._variables)
        self._places: list[tuple[Factor, Factor, GrowingBatch, slice]] = []  # given, the part of it, where it is
        self._preconditioner: Preconditioner | None = None
        self._entered: list[int] = []  # measurements of every batch that are in it
        self._age = 0
        self._held = False

    def update(self, factors: Factor | Sequence[Factor], values: Values | None = None) -> None:
        """Take measurements, and settle where they change something.

        Parameters
        ----------
        factors : as they arrive; of new variables, too.
        values : start values of new variables; the first of every kind needs one, which says its space. Those of the
            others follow from the measurements.
        """
        factors = [factors] if isinstance(factors, Factor) else list(factors)
        for factor in factors:
            if not isinstance(factor, Factor):
                raise GraphError(f"Incremental.update: expected factors such as Between(...), got {factor!r:.80}")
        if values is not None:
            self._arrivals.offer(values)
        for arrival in self._arrivals.take(factors):
            if isinstance(arrival, New):
                self._join(arrival)
            else:
                self._enter(arrival.given, arrival.factor)
        if self.gap > self.tol * max(self.chi2, 1.0):
            self.settle()

    def _join(self, new: New) -> None:
        """Add a variable."""
        kind = new.key.kind
        variables = self._variables.setdefault(kind, Variables(kind, new.space))
        column = None if self._preconditioner is None else self._preconditioner.column(new.space.dim)
        if column is None:
            self._preconditioner = None
        variables.join(int(new.key.numbers[0]), new.value, -1 if column is None else column)

    def _enter(self, given: Factor, factor: Factor) -> None:
        """Add measurements of variables that are there."""
        variables = [self._variables[keys.kind] for keys in factor.keys]
        model = factor.bind(*(v.manifold for v in variables))
        batch = next((batch for batch in self._batches if batch.takes(model)), None)
        if batch is None:
            batch = GrowingBatch(model, variables)
            self._batches.append(batch)
            self._entered.append(0)
        rows, cost = batch.append(model)
        self._places.append((given, factor, batch, rows))
        self.chi2 += cost
        self.gap += cost
        if self._held and not factor.relative:
            self._preconditioner = None  # what was held for the gauge may move now

    @single_thread()
    def settle(self) -> None:
        """Move to the optimum, within the tolerance."""
        self._linearize()
        for _ in range(PASSES):
            self.passes += 1
            dx, self.gap = self._solved(self._refreshed())
            if self.gap <= SETTLED * self.tol * max(self.chi2, 1.0):
                return
            for kind, variables in self._variables.items():
                variables.move(dx[kind])
            self._linearize()
        self._solve_batch()

    def _solved(self, F: Preconditioner) -> tuple[dict[str, Array], float]:
        """The step dx with A'A dx = A'b by conjugate gradients, by kind, and by how much it lowers |A dx - b|^2."""
        r = self._flat(self._gradient())
        z = F.solve(r)
        rz = float(r @ z)
        if not rz > 0:
            return self._zeros(), 0.0  # at the minimum to the last digit
        dx, d, fall = np.zeros_like(r), z, 0.0
        enough = SETTLED**2 * self.tol * max(self.chi2, 1.0)
        for iteration in range(ITERATIONS):
            q = self._flat(self._hessian_times(self._by_kind(d)))
            alpha = rz / float(d @ q)
            dx += alpha * d
            r -= alpha * q
            fall += alpha * rz
            z = F.solve(r)
            before, rz = rz, float(r @ z)
            self.iterations += 1
            self._age += iteration > 0
            if rz <= max(SOLVED * fall, SOLVED * enough):
                break
            d = z + (rz / before) * d
        return self._by_kind(dx), fall + rz

    def _refreshed(self) -> Preconditioner:
        """The preconditioner with all measurements in it."""
        if self._preconditioner is None or self._age > AGED:
            self._preconditioner = self._factorized()
            self._age = 0
        else:
            new = [(batch, slice(n, None)) for batch, n in zip(self._batches, self._entered, strict=True) if n < len(batch)]
            if new:
                self._preconditioner.add(stacked([batch.rows_of_A(rows) for batch, rows in new], self._preconditioner.n))
        self._entered = [len(batch) for batch in self._batches]
        return self._preconditioner

    def _factorized(self) -> Preconditioner:
        """A'A at the present values, factorized in an order of little fill."""
        self.factorizations += 1
        values = self.values
        pattern = Pattern([batch.model.factor for batch in self._batches], values)
        gauge = choose_gauge("first", pattern, values, np.zeros(len(pattern.dims), dtype=bool))
        self._held = bool(gauge.held.any())
        pattern = pattern.holding(gauge.held)
        b = [batch.b.reshape(-1) for batch in self._batches]
        system = LinearSystem(pattern, [batch.A for batch in self._batches], np.concatenate(b))
        hessian = pattern.hessian(best_decomposition().order)
        try:
            preconditioner = Preconditioner(hessian, system.H_blocks)
        except SingularSystemError as error:
            raise underconstrained(system, values) from error
        position = np.empty(hessian.n + 1, dtype=np.intp)
        position[hessian.permutation] = np.arange(hessian.n)
        position[-1] = -1  # held
        for variables in self._variables.values():
            begin = pattern.offsets[variables.kind]
            variables.columns[:] = position[pattern.starts[begin : begin + len(variables)]]
        return preconditioner

    def _linearize(self) -> None:
        self.chi2 = sum(batch.linearize() for batch in self._batches)

    def _gradient(self) -> dict[str, Array]:
        """A'b (count, d) by kind."""
        total = self._zeros()
        for batch in self._batches:
            batch.add_transposed(batch.b, total)
        return total

    def _hessian_times(self, dx: dict[str, Array]) -> dict[str, Array]:
        """A'A dx (count, d) by kind."""
        total = self._zeros()
        for batch in self._batches:
            batch.add_transposed(batch.times(dx), total)
        return total

    def _zeros(self) -> dict[str, Array]:
        return {kind: np.zeros((len(v), v.manifold.dim), order="F") for kind, v in self._variables.items()}

    def _columns(self, variables: Variables) -> tuple[Any, Index]:
        """Which variables are free, and their columns (k, d)."""
        first = variables.columns
        free = slice(None) if (first >= 0).all() else first >= 0
        return free, first[free][:, None] + np.arange(variables.manifold.dim)

    def _flat(self, parts: dict[str, Array]) -> Array:
        """Numbers of all variables in the columns of the preconditioner."""
        assert self._preconditioner is not None
        out = np.zeros(self._preconditioner.n)
        for kind, variables in self._variables.items():
            free, columns = self._columns(variables)
            out[columns] = parts[kind][free]
        return out

    def _by_kind(self, flat: Array) -> dict[str, Array]:
        """The inverse: zero where a variable is held."""
        out = self._zeros()
        for kind, variables in self._variables.items():
            free, columns = self._columns(variables)
            out[kind][free] = flat[columns]
        return out

    def _solve_batch(self) -> None:
        """Solve the whole graph from the present values, where these steps do not arrive."""
        self.batch_solutions += 1
        result = self.graph.optimize(self.values)
        for kind, variables in self._variables.items():
            variables.X[...] = result.values.stacks[kind].X
        self._preconditioner = None
        self._linearize()
        _, self.gap = self._solved(self._refreshed())

    def remove(self, factor: Factor) -> None:
        """Take out measurements that were given, and settle.

        Raises
        ------
        GraphError
            They were not given, or were taken out before.
        UnderconstrainedError
            Something is free without them; they stay.
        """
        waiting = self._arrivals.drop(factor)
        places = [place for place in self._places if place[0] is factor]
        if not places and not waiting:
            raise GraphError(f"Incremental.remove: {factor!r:.80} is not in the estimate", factor.keys, factor.name)
        weights = [(batch, rows, batch.silence(rows)) for _, _, batch, rows in places]
        self._preconditioner = None
        try:
            self.settle()
        except Exception:
            for batch, rows, W in weights:
                batch.restore(rows, W)
            raise
        self._places = [place for place in self._places if place[0] is not factor]

    @property
    def values(self) -> Values:
        """A copy of the estimate."""
        return Values.of(variables.stack() for variables in self._variables.values())

    def __getitem__(self, keys: Keys) -> Array:
        """The estimate of a variable, or of several of a kind."""
        variables = self._variables.get(keys.kind)
        if variables is None:
            raise GraphError(f"{keys[[0]]} is not in the estimate", [keys])
        X = np.array(variables.X[variables.index(keys)], order="C")
        return X[0] if keys.single else X

    @property
    def graph(self) -> FactorGraph:
        """The measurements that are in the estimate."""
        models: list[Model] = [f.bind(*(self._variables[k.kind].manifold for k in f.keys)) for _, f, _, _ in self._places]
        return FactorGraph(joined(models))

    @property
    def waiting(self) -> tuple[Keys, ...]:
        """Variables that are measured, and not determined by the measurements so far."""
        return self._arrivals.waiting

    def covariance(self, keys: Keys, **options: Any) -> Array:
        """Covariance of a variable, or of several: `Marginals.covariance` at the present values."""
        return Marginals(self.graph, self.values).covariance(keys, **options)

    def __repr__(self) -> str:
        count = sum(len(variables) for variables in self._variables.values())
        return f"Incremental({count} variables, {len(self._places)} factors, chi2 {self.chi2:.6g}, gap {self.gap:.2g})"
