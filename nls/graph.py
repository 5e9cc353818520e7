"""The factor graph: factors and fixed variables. A graph owns no values."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from factors.base import Factor
from factors.joined import batch_of, bound_batch, joined_noise, sort_of
from factors.keys import Keys
from factors.robust import Kernel
from models.algebra import Mask
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls.gauge import choose_gauge, fixed_variables
from nls.linear import LinearSolver
from nls.linear.default import chosen_solver
from nls.linear.null_space import FreeGauge
from nls.linear.underconstrained import directions, free_names, underconstrained
from nls.optimizers import LevenbergMarquardt, Optimizer, Result, default_optimizer
from nls.optimizers.problem import Problem
from nls.optimizers.result import shares
from nls.optimizers.trust_region import TrustRegion
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem
from nls.values import Values

# glibc asks the system for the memory of an array above 128 KB, and gives it back with the array; the system clears
# every page it gives. It keeps arrays up to the size of the largest that was freed, at most 32 MB (mallopt(3), "dynamic
# mmap threshold"). So one of that size is asked for and freed before the first large array, and nothing is written to
# it. From file to optimum kitti_00 takes 14 % less.
np.empty((1 << 25) - (1 << 16), dtype=np.uint8)

SMALLEST_BATCH = 32  # single measurements of one kind, from which on they are one batch


class FactorGraph:
    """Factors over variables; `optimize` finds the values of lowest chi2.

    Parameters
    ----------
    factors : batches of measurements, as `add` takes them.
    fixed : variables that are held, as `fix` takes them.

    Examples
    --------
    >>> from factors import Between, Isotropic, Prior
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph()
    >>> _ = graph.add(Prior(x[0], [0.0], Isotropic(0.1)))
    >>> _ = graph.add(Between(x[[0, 1]], x[[1, 2]], [[1.0], [1.1]], Isotropic(0.2)))
    >>> result = graph.optimize(Values({x: (R(1), [[0.0], [0.0], [0.0]])}))
    >>> result.converged, result.values[x].ravel().round(6).tolist()
    (True, [0.0, 1.0, 2.1])
    """

    def __init__(self, factors: Sequence[Factor] = (), fixed: Sequence[Keys] = ()) -> None:
        self.factors: list[Factor] = []
        self.fixed: list[Keys] = []
        self._pattern: Pattern | None = None
        self._singles = Singles()
        if not isinstance(factors, Iterable) or isinstance(factors, Factor):  # a batch is iterable, too
            raise GraphError(f"FactorGraph: expected a list of factors such as [factor], got {factors!r:.80}")
        for factor in factors:
            self.add(factor)
        if not isinstance(fixed, Iterable) or isinstance(fixed, Keys | str):
            raise GraphError(f"FactorGraph: expected a list of variables to fix such as [x[0]], got {fixed!r:.80}")
        for keys in fixed:
            self.fix(keys)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pattern": None}  # of these factors and no copies of them, and soon made again

    def __len__(self) -> int:
        """Measurements, over all factors."""
        return sum(len(factor) for factor in self.factors)

    def add(self, factor: Factor) -> Factor:
        """Add a factor (a batch of measurements) and return it, the handle for `remove`.

        Many factors of one measurement each become batches in `factors` when the graph is evaluated. A batch of 1,000
        takes as long as a few single ones.
        """
        if not isinstance(factor, Factor):
            raise GraphError(f"FactorGraph.add: expected a factor such as Between(...), got {factor!r:.80}")
        self.factors.append(factor)
        return factor

    def remove(self, factor: Factor) -> None:
        """Remove a factor that was added.

        Raises
        ------
        GraphError
            It is not in the graph.
        """
        place = next((k for k, f in enumerate(self.factors) if f is factor), None)
        if place is not None:
            del self.factors[place]
        elif (rest := self._singles.without(self.factors, factor)) is not None:
            self.factors = rest
        else:
            keys = factor.keys if isinstance(factor, Factor) else ()
            raise GraphError(f"FactorGraph.remove: {factor!r:.80} is not in this graph", keys)

    def fix(self, keys: Keys) -> None:
        """Hold variables at their values: they get no columns in A."""
        if not isinstance(keys, Keys):
            raise GraphError(f"FactorGraph.fix: expected variables such as x[0], got {keys!r:.80}")
        self.fixed.append(keys)

    def release(self, keys: Keys) -> None:
        """Undo `fix` for these variables."""
        if not isinstance(keys, Keys):
            raise GraphError(f"FactorGraph.release: expected variables such as x[0], got {keys!r:.80}")
        self.fixed = [k[~np.isin(k.numbers, keys.numbers)] if k.kind == keys.kind else k for k in self.fixed]

    def copy(self) -> FactorGraph:
        """A graph of the same factors, which are shared and never change; adding to one does not change the other."""
        return self + FactorGraph()

    def __add__(self, other: FactorGraph) -> FactorGraph:
        """A new graph of the factors and fixed variables of both, shared as in `copy`; both stay unchanged.

        A factor that is in both counts twice.

        Examples
        --------
        >>> from factors import Between, Isotropic, Prior
        >>> from nls import FactorGraph, kinds
        >>> (x,) = kinds("x")
        >>> known = FactorGraph([Prior(x[0], [0.0], Isotropic(0.1))])
        >>> step = Between(x[0], x[1], [1.0], Isotropic(0.2))
        >>> known + FactorGraph([step]), known
        (FactorGraph(2 factors, 2 measurements), FactorGraph(1 factors, 1 measurements))
        """
        if not isinstance(other, FactorGraph):
            return NotImplemented
        graph = FactorGraph([*self.factors, *other.factors], [*self.fixed, *other.fixed])
        graph._singles = self._singles + other._singles
        return graph

    def robust(self, kernel: Kernel) -> FactorGraph:
        """A graph of the same measurements, each under a robust kernel; this one does not change."""
        return FactorGraph([factor.robust(kernel) for factor in self.factors], self.fixed)

    def only(self, masks: Sequence[Mask | Sequence[bool]]) -> FactorGraph:
        """A graph of some of the measurements: of every factor those (n,) where its mask is True.

        Raises
        ------
        GraphError
            Not one mask for every factor, or one of another length.
        """
        arrays = [np.asarray(mask) for mask in masks] if isinstance(masks, Iterable) else []
        shapes, types = [mask.shape for mask in arrays], {str(mask.dtype) for mask in arrays} - {"bool"}
        if types or shapes != [(len(factor),) for factor in self.factors]:
            got = f"{len(shapes)} of shapes {shapes!s:.60} {', '.join(sorted(types))}".rstrip()
            raise GraphError(
                f"FactorGraph.only: expected a mask of True and False for each of {len(self.factors)} factors, as long "
                f"as it has measurements, got {got}"
            )
        factors = [f if m.all() else f[m] for f, m in zip(self.factors, arrays, strict=True) if m.any()]
        graph = FactorGraph(factors, self.fixed)
        graph._pattern = self._pattern  # serves it where nothing is left out
        return graph

    def chi2(self, values: Values) -> float:
        """|b|^2 at the values, without one-half; with robust kernels the sum of their costs rho(|b_i|^2)."""
        return self.pattern(values).chi2(values)

    def pattern(self, values: Values) -> Pattern:
        """Rows and columns of A with nothing held; the latest is kept for values of the same variables."""
        pattern = self._pattern
        if pattern is None or not pattern.serves(self.factors, _values(values)):
            self.factors = self._singles.joined(self.factors, values)
            pattern = self._pattern = Pattern(self.factors, _values(values))
        return pattern

    def linearize(self, values: Values) -> LinearSystem:
        """A and b at the values, with labels; only fixed variables are left out, and no gauge."""
        return LinearSystem.at(self.pattern(values).holding(fixed_variables(self.fixed, values)), values)

    @single_thread()  # a BLAS thread that waits for the next product burns the second core meanwhile
    def optimize(
        self,
        values: Values,
        optimizer: Optimizer | None = None,
        linear_solver: LinearSolver | None = None,
        gauge: str = "first",
    ) -> Result:
        """The values of lowest chi2, from a start.

        Parameters
        ----------
        values : start; not changed. Every variable a factor touches must be there.
        optimizer : `GaussNewton`, `LevenbergMarquardt` or `Dogleg` with its `Stop`. When omitted Gauss-Newton, and
            dogleg from its best point where it fails (`Automatic`); or Levenberg-Marquardt where a factor says that
            undamped steps fail (`Factor.damped`). The result names them.
        linear_solver : `nls.linear`; the best one installed when omitted (the result names it).
        gauge : ``first``, ``prior``, ``free`` or ``none``, see `nls.gauge`.

        Returns
        -------
        Result

        Raises
        ------
        GraphError
            Nothing to optimize; a factor's variable without a value.
        UnderconstrainedError
            The measurements leave something free: named, with cures.
        EvaluationError
            The start cannot be evaluated.
        """
        started = perf_counter()
        if not self.factors or not len(self):
            raise GraphError("the graph has no factors: nothing to optimize")
        method = default_optimizer(self.factors) if optimizer is None else optimizer
        if not isinstance(method, Optimizer):
            raise OptionError("optimizer", optimizer, "an optimizer such as GaussNewton(Stop(max_iterations=20))")
        if gauge == "free" and isinstance(method, LevenbergMarquardt):
            raise OptionError("gauge", gauge, "'none' with Levenberg-Marquardt, which damps what is free by itself")
        fixed, every = fixed_variables(self.fixed, _values(values)), self.pattern(values)
        every.refuse_extreme()
        decided = choose_gauge(gauge, every, values, fixed)
        pattern = decided.pattern.holding(decided.held)
        solver = chosen_solver(linear_solver, pattern.n)
        if decided.free:
            solver, pattern = FreeGauge(solver, pattern), decided.pattern.holding(decided.fixed)
        problem = Problem(pattern, solver)
        problem.timings["build"] = perf_counter() - started - problem.timings["analyze"]
        dof = pattern.measured_rows - int(pattern.dims[~decided.held].sum())
        limited = any(factor.limit_only for factor in self.factors)  # what is free may be meant to be, within them
        try:
            if dof < 0 and not limited and isinstance(method, TrustRegion):  # it would not notice
                raise underconstrained(LinearSystem.at(pattern, values), values)
            watch = method.run(problem, values.copy())
        except UnderconstrainedError as error:
            error.leave_out({f"nls.{type(method).__name__}()", f"gauge={gauge!r}"})
            raise
        assert watch.status is not None
        free = () if watch.free is None else free_names(watch.free, solver.left(watch.free))
        return Result(
            values=watch.best,
            status=watch.status,
            reason=watch.reason + (f"; free: {directions(len(free))}" if free else ""),
            history=watch.records,
            chi2_initial=watch.records[0].chi2,
            chi2_final=watch.lowest,
            dof=dof + len(free),
            linear_solver=problem.analysis.description,
            gauge=decided.description,
            timings=problem.timings,
            method=", then ".join(watch.methods),
            rule=watch.rule,
            last_update=watch.last_update,
            attempts=tuple(watch.attempts),
            robust=(robust := any(factor.kernel is not None for factor in self.factors)),
            underconstrained=free,
            shares=shares(self.factors, watch.best) if robust else (),
        )

    def summary(self) -> str:
        """A table: per factor type the measurements, and the variables they touch."""
        counts: dict[str, int] = {}
        touched: dict[str, set[int]] = {}
        for factor in self.factors:
            counts[factor.name] = counts.get(factor.name, 0) + len(factor)
            for keys in factor.keys:
                touched.setdefault(keys.kind, set()).update(keys.numbers.tolist())
        lines = [f"{name:24s} {count:8d}" for name, count in counts.items()]
        lines += [f"variables {kind:14s} {len(numbers):8d}" for kind, numbers in touched.items()]
        lines += [f"fixed                    {len({key for keys in self.fixed for key in keys}):8d}"]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"FactorGraph({len(self.factors)} factors, {len(self)} measurements)"


def _values(values: object) -> Values:
    if not isinstance(values, Values):
        raise GraphError(f"expected Values such as Values({{x: (SE2, X0)}}), got {values!r:.80}")
    return values


class Singles:
    """Which batches were made of single measurements, and of which."""

    def __init__(self) -> None:
        self._made: list[tuple[Factor, list[Factor]]] = []  # a batch, and its rows as they were given

    def __add__(self, other: Singles) -> Singles:
        """The batches of two graphs."""
        both = Singles()
        both._made = [*self._made, *other._made]
        return both

    def joined(self, factors: Sequence[Factor], values: Values) -> list[Factor]:
        """Measurements of a graph, single ones in batches, a batch in the place of its first.

        Parameters
        ----------
        factors : of a graph, some of them batches that were made here before.
        values : of their variables.
        """
        fresh = [factor for factor in factors if len(factor) == 1 and not factor.opaque]
        if len(fresh) < SMALLEST_BATCH:
            return list(factors)
        parts = {id(factor): [factor] for factor in fresh} | {id(batch): rows for batch, rows in self._made}
        groups: dict[Hashable, list[Factor]] = {}
        for factor in factors:
            if id(factor) in parts:
                groups.setdefault(sort_of(factor), []).append(factor)
        batches: dict[int, Factor] = {}  # by the identity of its first
        gone: set[int] = set()
        for group in groups.values():
            rows = [row for factor in group for row in parts[id(factor)]]
            if len(group) > 1 and len(rows) >= SMALLEST_BATCH:
                batch = _batch(group, values)
                batches[id(group[0])] = batch
                gone |= {id(factor) for factor in group}
                self._made.append((batch, rows))
        self._made = [made for made in self._made if id(made[0]) not in gone]
        rest = [batches.pop(id(factor), None) if id(factor) in gone else factor for factor in factors]
        return [factor for factor in rest if factor is not None]

    def without(self, factors: Sequence[Factor], factor: Factor) -> list[Factor] | None:
        """The factors without one that was given alone; None where it is in none of their batches."""
        for k, (batch, rows) in enumerate(self._made):
            if not any(f is batch for f in factors):
                continue
            place = next((k for k, row in enumerate(rows) if row is factor), None)
            if place is not None:
                rest = batch[np.arange(len(batch)) != place]
                rows = rows[:place] + rows[place + 1 :]
                self._made[k : k + 1] = [(rest, rows)] if rows else []
                return [rest if f is batch else f for f in factors if f is not batch or rows]
        return None


def _batch(group: Sequence[Factor], values: Values) -> Factor:
    """Factors of one sort as one; bound one by one only where their noises differ in type."""
    noise = joined_noise([factor.noise for factor in group], [len(factor) for factor in group])
    sizes = {factor.z.size // len(factor) for factor in group}
    if noise is None or len(sizes) > 1:
        spaces = [values.stack(keys.kind).manifold for keys in group[0].keys]  # of one sort: of all of them
        return bound_batch([factor.bind(*spaces) for factor in group])
    return batch_of(group, [factor.z.reshape(len(factor), -1) for factor in group], noise)
