r"""Smoothing as measurements arrive, at the optimum of all of them after every update.

The gradient g = A'b is exact, at the present values. Only the factor of A'A is kept from update to update, and takes
the rows of new measurements. The old factor is the preconditioner of conjugate gradients on the exact A'A:

    A'A dx = g by conjugate gradients,   x <- x [+] dx,   until gap <= 0.8 tol chi2

The gap, a bound on how far chi2 is above its minimum, is four times the decrease of |A dx - b|^2 in the same
iterations. On public graphs and logs chi2 itself decreases by up to 3 times as much.

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
from typing import Any, Literal

import numpy as np

from factors.base import Factor, Model
from factors.joined import joined
from factors.keys import Keys
from models.algebra import Array, Mask
from models.errors import GraphError, LeadlineError, UnderconstrainedError
from models.options import check_between
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.incremental.arrivals import Arrivals
from nls.incremental.batch import GrowingBatch
from nls.incremental.beginnings import New, part
from nls.incremental.decision import Decision
from nls.incremental.growing_system import GrowingSystem
from nls.incremental.window import Window
from nls.linear.updatable import updatable_class
from nls.robust import Robustified
from nls.sparse.threads import single_thread
from nls.values import Values

__all__ = ["Incremental"]

HONEST = 4.0  # times the fall of a quadratic model; of public graphs and logs chi2 falls by up to 3 times as much
SETTLED = 0.8  # of the tolerance: a smaller gap is no reason for another step
PASSES = 30
SLOW, SLOWEST = 0.9, 0.95  # rates of reweighting: of a first pass, where none is known; of others at most


class Incremental:
    """The estimate of all variables so far, at the optimum of all measurements so far.

    Parameters
    ----------
    tol : relative, a part of chi2: after every update the gap is at most tol * max(chi2, 1).
    lag : how many poses are kept, the newest; all where it is None. The information of an older one about the others
        stays, linearized where it left (`nls.incremental.marginal`). One that is not determined stays longer.
    landmarks : ``leave``: a landmark leaves with the last pose that measured it, so that the cost of a step stays the
        same for ever; measured again it is a new one. ``stay``: landmarks stay, and close loops.

    decide_every : `decide` which loop closures to believe whenever so many have come; a pose graph's alone.

    Attributes
    ----------
    gap : absolute, in units of chi2: chi2 is above its minimum by no more. With robust kernels an estimate, from how
        fast the weights settle.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> from models import SE2
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=30)
    >>> odometry, closures = world.graph.factors
    >>> x, = nls.kinds("x")
    >>> smoother = nls.Incremental()
    >>> for k, step in enumerate(odometry):
    ...     seen = closures[closures.keys[1].numbers == k + 1]
    ...     smoother.update([step, seen], nls.Values({x: (SE2, [[0, 0, 0]])}) if k == 0 else None)
    >>> best = world.graph.optimize(smoother.values)
    >>> smoother.chi2 - best.chi2_final <= smoother.gap <= 1e-3 * smoother.chi2
    True
    """

    def __init__(
        self,
        tol: float = 1e-3,
        lag: int | None = None,
        landmarks: Literal["leave", "stay"] = "leave",
        decide_every: int | None = None,
    ) -> None:
        self.tol = check_between("tol", tol, 0, 1, "a number between 0 and 1, such as 1e-3")
        self.gap = 0.0
        self.passes = self.batch_solutions = 0
        self._system = GrowingSystem()
        self._window, self._decision = Window(lag, landmarks), Decision(decide_every, lag)
        self._arrivals = Arrivals(self._system.variables, self._window)
        self._places: list[tuple[Factor, Factor, GrowingBatch, slice]] = []  # given, the part of it, where it is
        self._undecided: list[Factor] = []  # absolute measurements that are too few to let the gauge go

    def update(self, factors: Factor | Sequence[Factor], values: Values | None = None) -> None:
        """Take measurements, and settle where they change something.

        Parameters
        ----------
        factors : as they arrive; of new variables, too.
        values : start values of new variables; the first of every kind needs one, which says its space. Those of the
            others follow from the measurements.

        Raises
        ------
        GraphError, NoiseModelError, EvaluationError
            A measurement that cannot be used. All is as before the call.
        """
        factors = [factors] if isinstance(factors, Factor) else list(factors)
        for factor in factors:
            if not isinstance(factor, Factor):
                raise GraphError(f"Incremental.update: expected factors such as Between(...), got {factor!r:.80}")
        factors = [*self._undecided, *factors]
        relative = [factor for factor in factors if factor.relative]
        try:
            self._attempt(factors, values)
        except UnderconstrainedError:  # what held the gauge was let go for too few absolute measurements
            if len(relative) == len(factors):
                raise
            self._attempt(relative, values)
            self._undecided = [factor for factor in factors if not factor.relative]
        else:
            self._undecided = []
        self._leave()
        if self._decision.is_due(factors):
            self.decide()

    def _leave(self) -> None:
        """Marginalize what is older than the window."""
        gone = self._window.leaving(self._system.variables, self._system.batches)
        if not gone:
            return
        self.gap += self._system.catch_up()
        batches, variables = self._system.batches, self._system.variables
        stacks = [variables[kind].stack(mask) for kind, mask in gone.items()]
        try:
            rows, priors = self._system.marginalize(gone)
        except UnderconstrainedError:
            return  # not determined yet: it stays for another step
        self._window.leave(stacks)
        self._forget(dict(zip(map(id, batches), rows, strict=True)))
        self._places += [(prior, prior, *self._system.enter(prior)) for prior in priors]
        self._system.catch_up()
        self._arrivals.reach()

    def decide(self, doubted: Sequence[Factor] | None = None) -> Robustified:
        """Judge all loop closures that have come by `nls.gnc`: take out those it rejects, take in again the others.

        Parameters
        ----------
        doubted : factors as they were given whose measurements may be wrong, all others are trusted. Needed where the
            graph is no pose graph: where steps have biases, or landmarks are seen.

        Returns
        -------
        Robustified
            What was decided, of which closures, and the doubts; `rejected` lists what was taken out.

        Raises
        ------
        GraphError
            No pose graph, or one without closures; nothing that is doubted has come.
        """
        count = len(self._places)
        pairs = [*((given, factor) for given, factor, _, _ in self._places), *self._decision.rejected]
        named = None if doubted is None else {id(factor) for factor in doubted}
        suspect = None if named is None else np.array([id(given) in named for given, _ in pairs], dtype=bool)
        decided, keeps = self._decision.judge([self._bound_model(factor) for _, factor in pairs], self.values, suspect)
        parts = [(g, f, keep) for (g, f), keep in zip(pairs, keeps, strict=True)]
        self._decision.rejected = [(g, out) for g, f, keep in parts if (out := part(f, ~keep)) is not None]
        dropped = {id(batch): np.zeros(len(batch), dtype=bool) for batch in self._system.batches}
        for (_, _, batch, rows), keep in zip(self._places, keeps[:count], strict=True):
            dropped[id(batch)][rows] = ~keep
        self._system.drop([dropped[id(batch)] for batch in self._system.batches])
        self._forget(dropped)
        for given, factor, keep in parts[count:]:
            if (again := part(factor, keep)) is not None:
                self._places.append((given, again, *self._system.enter(again)))
        self._system.put(decided.result.values)
        self.settle()
        return decided

    def _forget(self, dropped: dict[int, Mask]) -> None:
        """Measurements (n,) of some batches are dropped."""
        places = []
        for given, factor, batch, rows in self._places:
            gone = dropped[id(batch)]
            if (kept := part(factor, ~gone[rows])) is not None:
                begin = int(np.count_nonzero(~gone[: rows.start]))
                places.append((given, kept, batch, slice(begin, begin + len(kept))))
        self._places = places

    def _attempt(self, factors: list[Factor], values: Values | None) -> None:
        """Take measurements; where that fails all is as before."""
        system, arrivals, places, gap = self._system.mark(), self._arrivals.mark(), len(self._places), self.gap
        behind = len(self._window.behind)
        try:
            self._take(factors, values)
        except LeadlineError:
            self._system.back_to(system)
            self._arrivals.back_to(arrivals)
            del self._places[places:], self._window.behind[behind:]
            self.gap = gap
            raise

    def _take(self, factors: list[Factor], values: Values | None) -> None:
        """Add variables and measurements, and settle."""
        if values is not None:
            self._arrivals.offer(values)
        exact, residuals = None, False
        for arrival in self._arrivals.take(factors):
            if isinstance(arrival, New):
                exact = arrival.measurement
                self._system.join(arrival.key, arrival.space, arrival.value)
            else:
                batch, rows = self._system.enter(arrival.factor)
                self._places.append((arrival.given, arrival.factor, batch, rows))
                residuals = residuals or arrival.factor is not exact
        if residuals:
            self.gap += self._system.catch_up()
        if self.gap > self._allowed(1.0):
            self.settle()

    @property
    def chi2(self) -> float:
        """Of all measurements at the present values."""
        return self._system.chi2

    def _allowed(self, part: float) -> float:
        """So much of the tolerance."""
        return part * self.tol * max(self.chi2, 1.0)

    @single_thread()
    def settle(self) -> None:
        """Move to the optimum, within the tolerance."""
        last = 0.0
        for share in (1.0, *(SETTLED,) * PASSES):
            self.passes += 1
            dx, fall = self._system.step(self._allowed(SETTLED) / HONEST)
            self.gap = self._bound(fall, last)
            if self.gap <= self._allowed(share):
                return
            if not self._system.move(dx):
                break
            last = fall
        self._solve_batch()

    def _bound(self, fall: float, last: float = 0.0) -> float:
        """The gap, from a fall: under kernels with those to come, at the rate from the last to this one."""
        if not self._system.robust:
            return HONEST * fall
        rate = min(fall / last, SLOWEST) if last > 0 else SLOW
        return fall * max(HONEST, 1 / (1 - rate))

    def _solve_batch(self) -> None:
        """Solve the whole graph from the present values, where these steps do not arrive."""
        self.batch_solutions += 1
        self._system.put(self.graph.optimize(self.values).values)
        _, fall = self._system.step(self._allowed(SETTLED) / HONEST)
        self.gap = self._bound(fall)

    def remove(self, factors: Factor | Sequence[Factor]) -> None:
        """Take out measurements that were given, all or none of them, and settle.

        Parameters
        ----------
        factors : the objects that were given to `update`.

        Raises
        ------
        GraphError
            They were not given, or were taken out before. All is as before the call.
        UnderconstrainedError
            Something is free without them; they stay.
        """
        factors = [factors] if isinstance(factors, Factor) else list(factors)
        here = [*self.pending, *(place[0] for place in (*self._places, *self._decision.rejected))]
        given, out = {id(factor) for factor in here}, {id(factor) for factor in factors}
        for factor in factors:
            if not isinstance(factor, Factor):
                raise GraphError(f"Incremental.remove: expected factors that were given to update, got {factor!r:.80}")
            if id(factor) not in given:
                like = any(type(other) is type(factor) and other.keys == factor.keys for other in here)
                cure = ". Another object of its type and variables is: pass that one" if like else ""
                raise GraphError(
                    f"Incremental.remove: {factor!r:.80} is not in the estimate{cure}", factor.keys, factor.name
                )
        system, gap, places = self._system.mark(), self.gap, self._places
        weights = [(batch, rows, batch.silence(rows)) for of, _, batch, rows in places if id(of) in out]
        self._system.renew()
        self._places = [place for place in places if id(place[0]) not in out]  # a batch solution is without them, too
        try:
            self.settle()
        except LeadlineError:
            self._system.back_to(system)
            for batch, rows, W in weights:
                batch.weigh(rows, W)
            self._places, self.gap = places, gap
            raise
        self._undecided = [factor for factor in self._undecided if id(factor) not in out]
        self._decision.rejected = [part for part in self._decision.rejected if id(part[0]) not in out]
        for factor in factors:
            self._arrivals.drop(factor)

    @property
    def values(self) -> Values:
        """A copy of the estimate."""
        return self._system.values

    def __contains__(self, key: Keys) -> bool:
        """Whether a variable is in the estimate: it does not wait, and has not left."""
        variables = self._system.variables.get(key.kind)
        return variables is not None and bool(variables.known(key).all())

    def __getitem__(self, keys: Keys) -> Array:
        """The estimate of a variable, or of several of a kind."""
        variables = self._system.variables.get(keys.kind)
        if variables is None:
            raise GraphError(f"{keys[[0]]} is not in the estimate", [keys])
        X = np.array(variables.X[variables.index(keys)], order="C")
        return X[0] if keys.single else X

    @property
    def graph(self) -> FactorGraph:
        """The measurements that are in the estimate."""
        return FactorGraph(joined([self._bound_model(factor) for _, factor, _, _ in self._places]))

    def _bound_model(self, factor: Factor) -> Model:
        """A factor in the spaces of its variables."""
        return factor.bind(*(self._system.variables[keys.kind].manifold for keys in factor.keys))

    @property
    def rejected(self) -> tuple[Factor, ...]:
        """Loop closures that the last decision took out."""
        return tuple(factor for _, factor in self._decision.rejected)

    @property
    def left(self) -> Values:
        """Variables that left the window, where they were then."""
        return self._window.left(self._system.variables)

    @property
    def behind(self) -> tuple[Factor, ...]:
        """Measurements of poses that had left when they came: they are not used."""
        return tuple(self._window.behind)

    @property
    def waiting(self) -> tuple[Keys, ...]:
        """Variables that are measured, and not determined by the measurements so far."""
        return self._arrivals.waiting

    @property
    def pending(self) -> tuple[Factor, ...]:
        """Given measurements that are not used yet: they wait for a variable, or are too few to hold the map."""
        return *self._arrivals.pending, *self._undecided

    def marginals(self) -> Marginals:
        """All covariances at the present values."""
        return Marginals(FactorGraph([batch.model().factor for batch in self._system.batches]), self.values)

    def covariance(self, keys: Keys, **options: Any) -> Array:
        """Covariance of a variable, or of several: `Marginals.covariance` at the present values."""
        return self.marginals().covariance(keys, **options)

    @property
    def linear_solver(self) -> str:
        """How the factor of A'A takes new rows."""
        return updatable_class().name

    def __repr__(self) -> str:
        count = sum(len(variables) for variables in self._system.variables.values())
        return f"Incremental({count} variables, {len(self._places)} factors, chi2 {self.chi2:.6g}, gap {self.gap:.2g})"
