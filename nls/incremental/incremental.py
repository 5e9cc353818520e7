r"""Smoothing as measurements arrive, near the optimum of all of them after every update.

The gradient g = A'b is exact, at the present values. Only the factor of A'A is kept from update to update, and takes
the rows of new measurements. The old factor is the preconditioner of conjugate gradients on the exact A'A:

    A'A dx = g by conjugate gradients,   x <- x [+] dx,   until gap <= 0.8 tol chi2

The gap estimates how far chi2 is above its minimum: four times the decrease of |A dx - b|^2 in the same iterations. On
public graphs and logs chi2 itself decreases by up to 3 times as much. Where steps are damped it is sixteen times. What
the old factor says of the decrease that is left counts 20 times, and more where it needed many iterations. It is not a
proof: small, strongly nonlinear graphs can exceed the gap.

A new pose whose odometry fits exactly changes nothing, and a new measurement of residual r cannot lower the minimum:

    gap_new <= gap + |r|^2

so nothing is solved while that is within tol of chi2. F is made anew, in a new order, when its age has cost as much as
that: by more iterations, and by columns that new rows fill.

Source: M. Kaess, H. Johannsson, R. Roberts, V. Ila, J. Leonard, F. Dellaert, "iSAM2: incremental smoothing and mapping
using the Bayes tree", IJRR 31(2), 2012, for the problem; there the linearization of parts stays old and chi2 above its
minimum.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from factors.base import Factor
from factors.joined import joined
from factors.keys import Keys
from models.advice import Advice
from models.algebra import Array
from models.errors import GraphError, LeadlineError, UnderconstrainedError
from models.listing import some
from models.options import check_between
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.incremental.growing_arrays import part
from nls.incremental.growing_system import GrowingSystem, kept
from nls.incremental.marginal import marginalize
from nls.incremental.membership import Arrivals, Decision, Window, blame, factors_of, refuse_others
from nls.incremental.new_variables import LIMIT, New, lower_start
from nls.linear.updatable import updatable_class
from nls.optimizers import Fit, LevenbergMarquardt
from nls.robust import Robustified
from nls.sparse.threads import single_thread
from nls.values import Values

SETTLED = 0.8  # of the tolerance: a smaller gap is no reason for another step


class Incremental:
    """The estimate of all variables so far, near the optimum of all measurements so far: `gap` estimates how near.

    Parameters
    ----------
    tol : relative, a part of chi2: an update settles until the gap is at most tol * max(chi2, 1).
    lag : how many poses are kept, the newest; all where it is None. The information of an older one about the others
        stays, linearized where it left (`nls.incremental.marginal`). One that is not determined stays longer.
    landmarks : ``leave``: a landmark leaves with the last pose that measured it, so that the cost of a step stays the
        same for ever; measured again it is a new one. ``stay``: landmarks stay, and close loops.
    decide_every : `decide` which loop closures to keep whenever so many have come; a pose graph's alone.

    Attributes
    ----------
    gap : how far chi2 is above its nearest minimum, in units of chi2: an estimate, not a proof. Four times the decrease
        of the linear problem, sixteen times where steps are damped. With robust kernels also from how fast the weights
        settle. Above tol * max(chi2, 1) where not even a batch solution has arrived.

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
        self.gap, self.passes, self.batch_solutions = 0.0, 0, 0
        self._system = GrowingSystem()
        self._window, self._decision = Window(lag, landmarks), Decision(decide_every, lag)
        self._arrivals = Arrivals(self._system, self._window)
        self._undecided: list[Factor] = []  # absolute measurements that are too few to let the gauge go

    def update(self, factors: Factor | Sequence[Factor], values: Values | None = None) -> None:
        """Take measurements, and settle where they change something.

        Parameters
        ----------
        factors : as they arrive; of new variables, too.
        values : starts; the first variable of every kind needs one, which says its space. Others follow from factors.

        Raises
        ------
        GraphError, NoiseModelError, EvaluationError, SingularGeometryError
            A measurement that cannot be used. All is as before the call, and the advice names the measurement.
        """
        factors = factors_of(factors, "update: expected factors such as Between(...)")
        with self._unless_it_fails():
            try:
                self._use([*self._undecided, *factors], values)
                self._leave()
                if self._decision.is_due(factors):
                    self.decide()
            except LeadlineError as error:
                blame(error, factors, [given for given, _ in self._system.given])
                raise

    def _use(self, factors: list[Factor], values: Values | None) -> None:
        """Take measurements, but for absolute ones that are too few to let the gauge go: these wait."""
        if values is not None:
            self._arrivals.offer(values)
        absolute = [*filter(self._arrivals.anchors, factors)]
        self._undecided = []
        if not absolute:
            return self._take(factors)
        try:
            with self._unless_it_fails():
                self._take(factors)
        except UnderconstrainedError:
            self._undecided = absolute
            self._take([factor for factor in factors if factor not in absolute])

    def _leave(self) -> None:
        """Marginalize what is older than the window."""
        if not (gone := self._window.leaving(self._system.variables, self._system.batches)):
            return
        self.gap += self._system.catch_up()
        stacks = [self._system.variables[kind].stack(mask) for kind, mask in gone.items()]
        with suppress(UnderconstrainedError):  # not determined yet: it stays for another step
            marginalize(self._system, gone)
            self._arrivals.leave(stacks)

    @contextmanager
    def _unless_it_fails(self) -> Iterator[None]:
        """All is as before where something fails, also where the user interrupts."""
        with ExitStack() as undo:
            for part in (self, self._decision, self._window, self._arrivals):
                undo.callback(vars(part).update, kept(part))
            undo.callback(self._system.restorer())
            yield
            undo.pop_all()

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
            No pose graph, or one without closures; no tested measurement has come.
        """
        system, old = self._system, self._system.given
        pairs = [*old, *self._decision.rejected]
        suspect = None if doubted is None else np.isin([id(g) for g, _ in pairs], [id(factor) for factor in doubted])
        with self._unless_it_fails():
            decided, keeps = self._decision.judge([system.model(f) for _, f in pairs], self.values, suspect)
            parts = [(g, f, keep) for (g, f), keep in zip(pairs, keeps, strict=True)]
            self._decision.rejected = [(g, out) for g, f, keep in parts if (out := part(f, ~keep)) is not None]
            system.drop([~keep for keep in keeps[: len(old)]])
            for given, factor, keep in parts[len(old) :]:
                if (again := part(factor, keep)) is not None:
                    system.enter(again, given)
            system.put(decided.result.values)
            self.settle()
        return decided

    def _take(self, factors: list[Factor]) -> None:
        """Add variables and measurements, and settle."""
        exact, residuals = None, False
        for arrival in self._arrivals.take(factors):
            if isinstance(arrival, New):
                exact = arrival.measurement
                self._system.join(arrival.key, arrival.space, arrival.value)
            else:
                given, factor = arrival
                self._system.enter(factor, given)
                residuals = residuals or factor is not exact
        if residuals:
            self.gap += self._system.catch_up()
        if self.gap > self._allowed:
            self.settle()

    @property
    def chi2(self) -> float:
        """Of all measurements at the present values."""
        return self._system.chi2

    @property
    def _allowed(self) -> float:
        """The largest gap within the tolerance."""
        return self.tol * max(self.chi2, 1.0)

    @single_thread()
    def settle(self) -> None:
        """Move to the optimum, within the tolerance."""
        last = 0.0
        for share in (1.0, *(SETTLED,) * 30):  # passes at most
            self.passes += 1
            allowed = self._allowed
            dx, promised, fall = self._system.step(SETTLED * allowed / self._system.fall_bound)
            self.gap = self._system.bound(fall, last)
            if self.gap <= share * allowed:
                return
            if not promised or not self._system.move(dx, promised):
                break
            last = fall
        self._solve_batch()

    def _solve_batch(self) -> None:
        """Solve the whole graph by damped steps from the present values, where these steps do not arrive."""
        self.batch_solutions += 1
        result = self.graph.optimize(self.values, LevenbergMarquardt(LIMIT))
        self._system.put(result.values)
        fall = self._system.step(SETTLED * self._allowed / self._system.fall_bound)[-1]
        self.gap = self._system.bound(min(fall, LIMIT.sigmas(self.chi2, result.dof) ** 2) if result.converged else fall)

    def remove(self, factors: Factor | Sequence[Factor]) -> None:
        """Take out measurements that were given, all or none of them, and settle.

        A variable leaves with its last measurement, and comes back with the next one.

        Parameters
        ----------
        factors : the objects that were given to `update`.

        Raises
        ------
        GraphError
            They were not given, or were taken out before, or left the window. All is as before the call.
        UnderconstrainedError
            Something else is free without them; they stay.
        """
        factors = factors_of(factors, "remove: expected factors that were given to update")
        refuse_others(factors, [*self.pending, *self.given, *(given for given, _ in self._decision.rejected)])
        out = {id(factor) for factor in factors}
        with self._unless_it_fails():
            self._undecided = [factor for factor in self._undecided if id(factor) not in out]
            self._decision.rejected = [pair for pair in self._decision.rejected if id(pair[0]) not in out]
            self._arrivals.drop(out)
            held, batches = self._system.held, self.batch_solutions
            self._system.drop([np.full(len(factor), id(given) in out) for given, factor in self._system.given])
            self._system.leave_unmeasured()
            try:
                self.settle()
            except UnderconstrainedError as error:
                error.advise(Advice("remove all", (some([repr(key) for key in error.keys]),)))
                raise
            if len(apart := self._system.held) > max(len(held), all(b.factor.relative for b in self._system.batches)):
                cut = f"Incremental.remove: nothing else connects {apart[-1]} to the rest of the map; connect it first"
                raise UnderconstrainedError(cut, apart[-1:])
            if self.batch_solutions > batches or self._system.fit is not Fit.PLAUSIBLE:  # the map was bent far
                self._system.put(lower_start(self.graph, self.values, self.chi2))
                self._solve_batch()

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
        return FactorGraph(joined([self._system.model(factor) for _, factor in self._system.given]))

    @property
    def given(self) -> tuple[Factor, ...]:
        """Factors that are in the estimate as they were given, each once; `remove` takes these objects."""
        return tuple({id(given): given for given, _ in self._system.given}.values())

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

    def save(self, path: str | Path) -> None:
        """Write the estimate and all that it goes on from; `load` gives a smoother that is equal to the bit.

        Raises
        ------
        GraphError
            A factor made of a function, of a class without a name, `nls.io.register`, or in a space of your own.
        GraphFileError
            The file cannot be written. It is replaced whole or not at all.

        Examples
        --------
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Incremental(lag=50).save(f"{folder}/state")
        ...     Incremental.load(f"{folder}/state")
        Incremental(0 variables, 0 factors, chi2 0, gap 0)
        """
        from nls.incremental.checkpoint import smoother_bytes
        from nls.io.files import write_bytes

        write_bytes(path, smoother_bytes(self))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The smoother of a file that `save` or ``nls stream --checkpoint`` wrote.

        Its measurements are new objects, `given`: `remove` and `decide` do not know those that were given before.

        Raises
        ------
        GraphFileError
            It is no such file, of another version, or damaged.
        """
        from nls.incremental.checkpoint import read_smoother

        return read_smoother(path, cls)[0]

    def __repr__(self) -> str:
        counts = sum(map(len, self._system.variables.values())), len(self._system.given)
        return f"Incremental({counts[0]} variables, {counts[1]} factors, chi2 {self.chi2:.6g}, gap {self.gap:.2g})"
