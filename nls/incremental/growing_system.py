r"""The linear problem A dx = b of a graph that grows, kept at its present values.

Its factor F ~ A'A takes the rows of new measurements and is otherwise old. This factor is the preconditioner of
conjugate gradients on the exact A. Its age costs iterations, not accuracy. A new one is made, in a new order, when its
age has cost as much as that: by more iterations, and by columns that new rows fill.
"""

from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any

import numpy as np

from factors.base import Factor, Model
from factors.keys import Keys
from models import Manifold
from models.algebra import Array, Mask
from models.errors import EvaluationError, SingularGeometryError, UnderconstrainedError
from nls.gauge import choose_gauge, touched_variables
from nls.incremental.growing_arrays import GrowingBatch, Variables, sort_of_model
from nls.linear import best_decomposition
from nls.linear.factorization import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.linear.updatable import Preconditioner
from nls.optimizers.result import Fit, fit
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

FALL_BOUND = 4.0  # times the fall of a quadratic model; of public graphs and logs chi2 falls by up to 3 times as much
DAMPED_BOUND = 16.0  # the same where steps are damped: the model knows less of the hinges and arcs there
OLD_FALL_BOUND = 20.0  # times what F says of the rest of a fall; k - 1 times as much where the last solution needed k
LEAST = 0.2  # of what is not worth a digit: no smaller fall is stated
AGED, ROWS = 40, 30  # iterations beyond the first of every solution that are too many; rows in F that count as one


class GrowingSystem:
    """Variables and batches of measurements, and steps for them.

    Attributes
    ----------
    variables : by kind.
    iterations, factorizations : so far.
    held : a variable of every part of the map that nothing but the gauge holds; it may have left since.
    """

    def __init__(self) -> None:
        self.variables: dict[str, Variables] = {}
        self.batches: list[GrowingBatch] = []
        self.iterations = self.factorizations = 0
        self._preconditioner: Preconditioner | None = None
        self._age = self._needed = 0
        self.held: list[Keys] = []
        self._damping = 0.0  # of the next step: lambda of Levenberg

    @property
    def values(self) -> Values:
        """A copy of the estimate."""
        return Values.of(variables.stack() for variables in self.variables.values())

    @property
    def chi2(self) -> float:
        """Cost at the present values."""
        return sum(batch.total for batch in self.batches)

    @property
    def fit(self) -> Fit:
        """Whether noise explains chi2; what the gauge holds is counted as measured."""
        free = sum(v.columns.size * v.manifold.dim for v in self.variables.values())
        return fit(self.chi2, sum(batch.b.size for batch in self.batches) - free, self.robust)

    @property
    def robust(self) -> bool:
        """Whether a kernel weighs some measurements."""
        return any(batch.kernel for batch in self.batches)

    @property
    def fall_bound(self) -> float:
        """By how many times its fall in the linear model chi2 may fall."""
        return DAMPED_BOUND if self._damping else FALL_BOUND

    def bound(self, fall: float, last: float = 0.0) -> float:
        """The gap, from a fall: under kernels with those to come, at the rate from the last to this one."""
        # the rate of reweighting is not known in a first pass
        rate = 0.0 if not self.robust else min(fall / last, 0.95) if last > 0 else 0.9
        return fall * max(self.fall_bound, 1 / (1 - rate))

    def model(self, factor: Factor) -> Model:
        """A factor in the spaces of its variables."""
        return factor.bind(*(self.variables[keys.kind].manifold for keys in factor.keys))

    def put(self, values: Values) -> None:
        """Take other values."""
        for kind, stack in values.stacks.items():
            self.variables[kind].put(stack.X)
        self._linearize()
        self.renew()

    def join(self, key: Keys, space: Manifold, value: Array) -> None:
        """Add a variable at a value (size,)."""
        if key.kind not in self.variables:
            self.variables[key.kind] = Variables(key.kind, space)
        variables = self.variables[key.kind]
        room = None if self._preconditioner is None else self._preconditioner.column(variables.manifold.dim)
        if room is None:
            self.renew()
        variables.join(int(key.numbers[0]), value, 0 if room is None else room)

    def enter(self, factor: Factor, given: Factor) -> None:
        """Add measurements of variables that are there, of a factor that was given."""
        model, variables = self.model(factor), [self.variables[keys.kind] for keys in factor.keys]
        sort = sort_of_model(model)
        batch = next((batch for batch in self.batches if batch.sort == sort), None)
        if batch is None:
            batch = GrowingBatch(model, variables)
            self.batches.append(batch)
        if self.held and anchors(factor, model.manifolds, [self.variables[key.kind].manifold for key in self.held]):
            self.held = []  # what was held for the gauge may move now
            self.renew()
        batch.append(model, given)

    def catch_up(self) -> float:
        """Linearize what has come; its cost."""
        return sum(batch.catch_up() for batch in self.batches)

    def restorer(self) -> Callable[[], None]:
        """What makes all as it is now; the preconditioner anew where it has taken rows, or is another since."""
        tables: list[Variables | GrowingBatch] = [*self.variables.values(), *self.batches]
        states = [(thing, kept(thing)) for thing in (self, *self.batches)]
        states += [(part, {**vars(part)}) for table in tables for part in table.parts()]
        F = self._preconditioner
        rows = F.rows if F else 0
        states += [(F, {"used": F.used})] if F else []

        def restore() -> None:
            is_same = F is not None and self._preconditioner is F and F.rows == rows
            for thing, state in states:
                vars(thing).update(state)
            for v in self.variables.values():
                v.find()
            for batch in self.batches:
                batch.place()
            self._preconditioner = F if is_same else None
            self._linearize()

        return restore

    @property
    def given(self) -> list[tuple[Factor, Factor]]:
        """Factors as they were given, and the part of each that is used."""
        return [pair for batch in self.batches for pair in batch.given]

    def drop(self, masks: list[Mask]) -> None:
        """Forget measurements (n,) of every batch, or of every factor that was given."""
        whole, ends = np.concatenate([*masks, np.zeros(0, bool)]), np.cumsum([len(batch) for batch in self.batches])
        for batch, rows in zip(self.batches, np.split(whole, ends), strict=False):
            if rows.any():
                batch.drop(rows)
        self.batches = [batch for batch in self.batches if len(batch)]

    def exchange(self, rows: list[Mask], gone: dict[str, Mask], priors: Iterable[Factor]) -> None:
        """Have priors instead of measurements (n,) of every batch, and of variables (n,) by kind.

        The preconditioner keeps the columns of what leaves. Its solutions for 0 there are those with the priors.
        """
        F = self._preconditioner
        held = (gone[key.kind][self.variables[key.kind].index(key)].any() for key in self.held if key.kind in gone)
        if F is not None and (self._age or self._aged(F) or any(held)):
            self.renew()  # else a heading that is hardly known seems settled before it is
        elif F is not None:
            self._refreshed()
        self.drop(rows)
        self.leave(gone)
        for prior in priors:
            self.enter(prior, prior)
        self.catch_up()
        for batch in self.batches:
            batch.entered = len(batch)

    def leave(self, gone: dict[str, Mask]) -> None:
        """Take out variables (n,) by kind that no measurement is about."""
        for kind, mask in gone.items():
            self.variables[kind].drop(mask)
        places = {kind: np.cumsum(~mask) - 1 for kind, mask in gone.items()}
        for batch in self.batches:
            batch.renumber(places)

    def leave_unmeasured(self) -> None:
        """Take out all variables that no measurement is about."""
        alone = {kind: ~touched(v, self.batches) for kind, v in self.variables.items()}
        self.leave({kind: mask for kind, mask in alone.items() if mask.any()})
        self.renew()

    def renew(self) -> None:
        """Make the preconditioner anew before the next step."""
        self._preconditioner = None

    def step(self, enough: float) -> tuple[Array, float, float]:
        """The step dx with (A'A + damping I) dx = A'b by conjugate gradients, what it promises, and what there is.

        Parameters
        ----------
        enough : a fall that is not worth a digit.

        Returns
        -------
        dx, fall : by how much it lowers |A dx - b|^2 + damping |dx|^2.
        whole : by how much |A dx - b|^2 can be lowered; not all of it, where `fall` alone is far more than enough.
            Infinite, without a step, where weights differ too much to compute one.

        Raises
        ------
        UnderconstrainedError
            Something is free.
        """
        if not self.batches:
            return np.zeros(0), 0.0, 0.0
        self.catch_up()
        try:
            F = self._refreshed()
        except UnderconstrainedError as error:
            if error.nullity:
                raise
            return np.zeros(0), 0.0, np.inf
        dx, fall, rest = self._solved(F, 0.0 if self._damping else enough, self._damping)
        if self._damping and fall <= 2 * enough:
            _, whole, rest = self._solved(F, enough, 0.0)
            return dx, fall, whole + rest
        return dx, fall, fall + rest

    def _solved(self, F: Preconditioner, enough: float, damping: float) -> tuple[Array, float, float]:
        """A step dx, by how much it lowers |A dx - b|^2 + damping |dx|^2, and how much more a longer search may.

        Both together are at least `LEAST` of enough.
        """
        rows = [batch.A(F.width) for batch in self.batches]
        r = reduce(np.add, [At @ batch.b for (_, At), batch in zip(rows, self.batches, strict=True)])
        dx, d, fall, rz = np.zeros(F.width), np.zeros(F.width), 0.0, np.inf
        times, self._needed = OLD_FALL_BOUND * max(1, self._needed - 1), 0
        for _ in range(60):
            z = F.solve(r)
            before, rz = rz, float(r @ z)
            # where more than enough has fallen another step follows anyway: a hundredth may be left
            if times * rz <= enough - fall or (fall > enough and rz <= 0.01 * fall):
                break
            d = z + (rz / before) * d
            q = reduce(np.add, [At @ (A @ d) for A, At in rows]) + damping * d
            alpha = rz / float(d @ q)
            dx += alpha * d
            r -= alpha * q
            fall += alpha * rz
            self._needed += 1
        self.iterations += self._needed
        self._age += max(self._needed - 1, 0) * (not damping)
        return dx, fall, max(times * rz, LEAST * enough - fall)

    def move(self, dx: Array, fall: float) -> bool:
        """Move all variables by the whole step, or the first of its halves that lowers chi2 enough; whether one does.

        Halves hold back all variables for one that would go too far. A graph with factors that say so, `Factor.damped`,
        is damped from then on. That holds back what is poorly determined, as the elevation of a landmark.

        Parameters
        ----------
        dx, fall : of `step`.

        Raises
        ------
        EvaluationError
            A function of the user's raised an exception.
        """
        chi2, begin = self.chi2, {kind: v.X for kind, v in self.variables.items()}
        for part in (*0.5 ** np.arange(8), 0.0):
            for kind, v in self.variables.items():
                step = dx.take(v.columns + np.arange(v.manifold.dim)[:, None]).T
                v.put(v.manifold.retract(begin[kind], part * step))
            try:
                self._linearize()
            except (EvaluationError, SingularGeometryError) as error:
                if error.is_fault:
                    raise
            else:
                if chi2 - self.chi2 > 0.01 * fall:  # less is no reason for another step
                    self._damp(part, fall / float(dx @ dx))
                    return True
        return False

    def _damp(self, part: float, begun: float) -> None:
        """Damp the next step: more than this one where only a part of it was taken, and else less.

        Parameters
        ----------
        begun : the damping that costs as much as this step gains.
        """
        if part < 1 and any(batch.factor.damped for batch in self.batches):
            self._damping = max(2 * self._damping, begun)
        else:
            self._damping = 0.5 * self._damping if self._damping > 1e-3 * begun else 0.0

    def _linearize(self) -> None:
        """All measurements at values that have changed."""
        framed = {kind: v.manifold.framed(v.X) for kind, v in self.variables.items()}
        for batch in self.batches:
            batch.linearize(framed=framed)

    def _refreshed(self) -> Preconditioner:
        """The preconditioner with all measurements in it."""
        F = self._preconditioner
        if F is None or self._aged(F):
            F = self._preconditioner = self._factorized()
        else:
            for batch in self.batches:
                F.add(*batch.new_rows())
                batch.entered = len(batch)
        return F

    def _aged(self, F: Preconditioner) -> bool:
        """Whether its age, in iterations, and the columns that its rows fill have cost as much as a new one."""
        return self._age + F.rows / ROWS > AGED

    def _factorized(self) -> Preconditioner:
        """A'A at the present values, factorized in an order of little fill."""
        self.factorizations += 1
        self._age = self._needed = 0
        values = self.values
        pattern = Pattern([batch.model().factor for batch in self.batches], values)
        untouched = ~touched_variables(pattern)  # the first of all, while its measurements wait for others
        gauge = choose_gauge("first", pattern, values, untouched)
        self.held = [pattern.key(k) for k in np.flatnonzero(gauge.held).tolist()]
        pattern = pattern.holding(gauge.held)
        b = [batch.b for batch in self.batches]
        system = LinearSystem(pattern, [batch.blocks() for batch in self.batches], np.concatenate(b))
        hessian = pattern.hessian(best_decomposition().order)
        try:
            preconditioner = Preconditioner(hessian, system.H_blocks)
        except SingularSystemError as error:
            raise underconstrained(system, values) from error
        position = np.append(np.argsort(hessian.permutation), preconditioner.n)  # the last: held
        for variables in self.variables.values():
            begin = pattern.offsets[variables.kind]
            variables.columns[:] = position[pattern.starts[begin : begin + len(variables)]]
        for batch in self.batches:
            batch.place()
            batch.entered = len(batch)
        return preconditioner


def anchors(factor: Factor, spaces: tuple[Manifold | None, ...], held: Iterable[Manifold]) -> bool:
    """Whether a measurement determines what the gauge may hold: beside poses, points do that know the axes."""
    return not factor.relative or (factor.knows_axes(spaces) and any(space.body_axes for space in held))


def kept(thing: object) -> dict[str, Any]:
    """The attributes of an object, with copies of its lists, sets and tables."""
    return {name: v.copy() if type(v) in (list, set, dict) else v for name, v in vars(thing).items()}


def touched(v: Variables, batches: Iterable[GrowingBatch], by: dict[str, Mask] | None = None) -> Mask:
    """Which variables (n,) of a kind are measured: by all measurements, or by those of some others."""
    measured = np.zeros(len(v), dtype=bool)
    for batch in batches:
        rows = slice(None) if by is None else batch.touches(by)
        for index in batch.rows_of(v):
            measured[index[rows]] = True
    return measured
