"""Where a new variable begins, once its measurements determine it: by one of them, by all of them, or with others."""

from collections.abc import Container, Iterable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from factors.base import Factor
from factors.joined import joined
from factors.keys import Keys
from factors.prior import Prior
from factors.sighting import Sighting
from models import LieGroup, Manifold
from models.algebra import Array, Mask
from models.errors import EvaluationError, SingularGeometryError, UnderconstrainedError
from models.manifolds.rn import Vectors
from nls.graph import FactorGraph
from nls.incremental.growing_arrays import part
from nls.incremental.growing_system import GrowingSystem
from nls.linear.null_space import own_information
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts import dead_reckoning, odometry
from nls.starts.dead_reckoning import walks
from nls.starts.landmarks import DETERMINED, locate_points, search_elevation
from nls.values import Stack, Values

LIMIT = Stop(max_iterations=30)  # of a batch solution; the next update goes on

Variable = tuple[str, int]  # kind, number


@dataclass(frozen=True)
class New:
    """A variable that joins the estimate, and its value (size,); the one measurement that is exact there, if any."""

    key: Keys
    space: Manifold
    value: Array
    measurement: Factor | None = None


@dataclass(frozen=True)
class Known:
    """The estimate, and what the user said of variables to come.

    Attributes
    ----------
    system : the estimate.
    spaces, starts : of kinds and variables to come.
    """

    system: GrowingSystem
    spaces: dict[str, Manifold] = field(default_factory=dict)
    starts: dict[Variable, Array] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """How many variables are in the estimate."""
        return sum(map(len, self.system.variables.values()))

    def space(self, kind: str) -> Manifold | None:
        """The space of a kind, if that is known."""
        return self.system.variables[kind].manifold if kind in self.system.variables else self.spaces.get(kind)

    def has(self, keys: Keys, starts: Container[Variable] = ()) -> Mask:
        """Which variables (k,) are in the estimate, or have one of some starts."""
        place = self.place(keys.kind)
        return np.array([n in place or (keys.kind, n) in starts for n in keys.numbers.tolist()], dtype=bool)

    def place(self, kind: str) -> dict[int, int]:
        """Rows of the variables of a kind that are in the estimate, by number."""
        return self.system.variables[kind].place if kind in self.system.variables else {}

    def ready(self, factor: Factor, starts: Container[Variable] = ()) -> Mask:
        """Which measurements (n,) of a factor are about such variables alone."""
        return np.asarray(np.logical_and.reduce([self.has(keys, starts) for keys in factor.keys]))

    def value(self, keys: Keys) -> Array:
        """(k, size) of variables of the estimate."""
        variables = self.system.variables.get(keys.kind)
        return np.zeros((0, 0)) if variables is None else np.asarray(variables.X[variables.index(keys)])

    def values(self, graph: FactorGraph, starts: dict[Variable, Array], new: Manifold | None = None) -> Values:
        """Of the variables of a graph: those of the estimate, which are held there, and those with a start.

        Parameters
        ----------
        new : the space of kinds that are not known yet.
        """
        X: dict[str, dict[int, Array]] = {}
        for keys in (keys for factor in graph.factors for keys in factor.keys):
            held, of_kind = keys[self.has(keys)], X.setdefault(keys.kind, {})
            graph.fix(held)
            of_kind |= zip(held.numbers.tolist(), self.value(held), strict=True)
            of_kind |= {n: starts[keys.kind, n] for n in keys.numbers.tolist() if (keys.kind, n) in starts}
        stacks = []
        for kind, of_kind in X.items():
            if of_kind and (space := self.space(kind) or new) is not None:
                numbers = sorted(of_kind)
                stacks.append(Stack(kind, space, np.stack([of_kind[n] for n in numbers]), np.array(numbers)))
        return Values.of(stacks)


def alone(known: Known, key: Keys, space: Manifold, touching: list[tuple[Factor, int]]) -> New | None:
    """A variable that its measurements to the estimate, and the slots in which it is there, determine; see `points`."""
    start = known.starts.get((key.kind, int(key.numbers[0])))
    for factor, slot in touching:
        if (value := _placed(known, factor, slot, space)) is not None:
            exact = factor if start is None and len(factor) == 1 else None
            return New(key, space, value if start is None else start, exact)
    factors = [factor for factor, _ in touching]
    return _determined(known, key, space, start, factors) if factors and not isinstance(space, Vectors) else None


def _placed(known: Known, factor: Factor, slot: int, space: Manifold) -> Array | None:
    """Where the first of some measurements puts the variable of a slot; None where it does not say."""
    if factor.opaque:
        return None
    model = factor.bind(*(known.space(keys.kind) or space for keys in factor.keys))
    spaces, W = model.manifolds, model.W[0]
    if model.dim < space.dim or not (W.all() if W.ndim == 1 else np.linalg.det(W)):
        return None
    if isinstance(factor, Prior) and factor.offset is None:
        return np.asarray(model.z[0])
    X = [np.zeros((1, space.size)) if k == slot else known.value(keys[:1]) for k, keys in enumerate(factor.keys)]
    z = factor.relative_poses(model)
    if z is not None and isinstance(space, LieGroup) and spaces[1 - slot] is space:
        return np.asarray(space.compose(X[1 - slot], z[:1] if slot == 1 else space.inverse(z[:1]))[0])
    if isinstance(factor, Sighting) and factor.locates and slot == 1 and isinstance(spaces[0], LieGroup):
        first = factor[:1]
        return np.asarray(first.locate(spaces[0], first.sensor_pose(spaces[0], X[0], *X[2:]), model.z[:1])[0])
    return None


def _determined(known: Known, key: Keys, space: Manifold, start: Array | None, factors: list[Factor]) -> New | None:
    """Where all measurements between it and the estimate put a variable; None where they leave something free."""
    graph = FactorGraph(factors)
    stacks = known.values(graph, {}).stacks.values()
    starts = [stack.X[-1] for stack in stacks if stack.manifold is space] if start is None else [start]
    for begin in starts:
        values = known.values(graph, {(key.kind, int(key.numbers[0])): begin}, space)
        with suppress(UnderconstrainedError, EvaluationError, SingularGeometryError):
            if start is None and walks(graph):  # near enough: all settle with it
                values = dead_reckoning(graph, values)
            elif (result := graph.optimize(values, gauge="none")).converged:
                values = result.values
            else:
                continue
            if _full_rank(graph.linearize(values).H.toarray()):
                return New(key, space, values[key[0]])
    return None


def points(known: Known, space: Manifold, measurements: dict[Variable, list[Factor]]) -> list[New]:
    """Points of a kind that their measurements to the estimate determine: where rays meet, or on an arc."""

    def few_batches(starts: dict[Variable, Array]) -> tuple[FactorGraph, Values]:
        factors = [factor for variable in starts for factor in measurements[variable]]
        graph = FactorGraph(joined([f.bind(*(known.space(keys.kind) or space for keys in f.keys)) for f in factors]))
        return graph, known.values(graph, starts, space)

    starts = {variable: known.starts[variable] for variable in measurements if variable in known.starts}
    if missing := {variable: np.zeros(space.size) for variable in measurements if variable not in starts}:
        graph, values = few_batches(missing)
        located = locate_points(graph, search_elevation(graph, values))
        starts |= {variable: X for variable in missing if (X := located[Keys(*variable)]).any()}
    graph, values = few_batches(starts)
    with suppress(EvaluationError, SingularGeometryError):
        system = graph.linearize(values)
        whole = _full_rank(own_information(system, np.flatnonzero(~system.pattern.held), space.dim))
        return [New(Keys(*v), space, X) for (v, X), good in zip(sorted(starts.items()), whole, strict=True) if good]
    return []


def _full_rank(H: Array) -> Mask:
    """Whether no direction of a matrix (..., d, d) is free, with the diagonal scaled to ones."""
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), np.finfo(float).tiny))
    return np.asarray(np.linalg.eigvalsh(H / (scale[..., None] * scale[..., None, :]))[..., 0] > DETERMINED)


def together(known: Known, waiting: Iterable[Variable], factors: list[Factor]) -> list[New]:
    """Variables with start values that their measurements determine together, at the optimum of these."""
    starts = {variable: known.starts[variable] for variable in waiting if variable in known.starts}
    while starts:
        graph = FactorGraph([m for factor in factors if (m := part(factor, known.ready(factor, starts))) is not None])
        if not graph.factors:
            return []
        try:
            result = graph.optimize(known.values(graph, starts))
        except UnderconstrainedError as error:
            free = {(keys.kind, n) for keys in error.keys for n in keys.numbers.tolist()} & set(starts)
            starts = {variable: X for variable, X in starts.items() if free and variable not in free}
        except EvaluationError:
            return []
        else:
            optimum = result.values if result.converged else Values()
            new = [key for variable in starts if (key := Keys(*variable)) in optimum]
            return [New(key, optimum.stack(key.kind).manifold, optimum[key]) for key in new]
    return []


def lower_start(graph: FactorGraph, values: Values, chi2: float) -> Values:
    """The optimum that a start from the measurements alone leads to, where its chi2 is lower than given."""
    nothing = {kind: np.repeat(stack.X[:1], len(stack), axis=0) for kind, stack in values.stacks.items()}
    with suppress(EvaluationError, SingularGeometryError, UnderconstrainedError):  # there may be no such start
        result = graph.optimize(odometry(graph, values.replaced(nothing)), LevenbergMarquardt(LIMIT))
        return result.values if result.chi2_final < chi2 else values
    return values
