"""What online and fixed-lag smoothing share: a graph that grows by a step at a time, solved from its last optimum."""

from __future__ import annotations

import warnings
from abc import abstractmethod

import numpy as np

from factors.joined import joined
from factors.keys import Keys
from models.algebra import Array
from models.errors import GraphWarning
from nls.covariance import Marginals
from nls.filters.base import POSE, Filter, Step
from nls.filters.marginal import numbers_of
from nls.filters.motion import copies, most_likely, slot_of
from nls.graph import FactorGraph
from nls.optimizers import Optimizer, Result
from nls.starts.landmarks import locate_points
from nls.values import Stack, Values


class Smoother(Filter):
    """A graph of the steps so far, or of the latest of them. A subclass gives `_settle`, what is done after each step.

    A new pose begins where the motion leads, a new landmark where it is seen from there; everything else begins at the
    last optimum, so that a few Gauss-Newton iterations are enough.

    Attributes
    ----------
    graph, values : of the steps so far, as they are believed now.
    iterations : of every solve, in the order of time.
    """

    def __init__(self, optimizer: Optimizer | None = None) -> None:
        self.optimizer = optimizer

    def start(self, step: Step, values: Values) -> None:
        self.start_values, self.iterations, self.graph = values, list[int](), FactorGraph()
        self.values = Values.of(Stack(s.kind, s.manifold, s.X[:0], s.numbers[:0]) for s in values.stacks.values())
        self.landmark_kind = next((kind for kind in values.stacks if kind != POSE), None)
        self._begin()
        self.latest = step.pose
        self._grow(step, values[step.pose])
        self._settle()

    def step(self, step: Step) -> None:
        manifold, before = self.values.stack(POSE).manifold, self.values[self.latest][None]
        motion = [(copies(f, [manifold] * 2, 1), slot_of(f, step.pose), (before,)) for f in step.motion]
        X, _ = most_likely(motion, manifold, before, step.pose)
        self._motion = motion
        self.latest = step.pose
        self._grow(step, X[0])
        self._settle()

    @abstractmethod
    def _begin(self) -> None:
        """Forget everything of an earlier run."""

    @abstractmethod
    def _settle(self) -> None:
        """What is done once the graph and the values have grown by a step."""

    def _solve(self) -> Result:
        """The optimum of the graph from where the values are."""
        result = self.graph.optimize(self.values, self.optimizer, gauge="none")
        if not result.converged:
            warnings.warn(f"{self.method} at {self.latest}: {result.status.value}: {result.reason}", GraphWarning, 3)
        self.values = result.values
        self.iterations.append(result.iterations)
        return result

    @property
    def marginals(self) -> Marginals:
        """Covariances of the graph at its values."""
        return Marginals(self.graph, self.values, gauge="none")

    @property
    def pose(self) -> tuple[Array, Array]:
        return self.values[self.latest], self.marginals.covariance(self.latest, frame="body")

    @property
    def landmarks(self) -> tuple[Keys, Array, Array]:
        kind = self.landmark_kind
        keys = Keys(kind or "l", self.values.stack(kind).numbers if kind else [])
        if not len(keys):
            return keys, np.zeros((0, 0)), np.zeros((0, 0, 0))
        return keys, self.values[keys], self.marginals.covariance(keys, frame="body")

    def _grow(self, step: Step, X: Array) -> None:
        """The factors of a step, its pose at X (size,), and its new landmarks where they are seen from there."""
        known = [Keys(stack.kind, stack.numbers) for stack in self.values.stacks.values() if len(stack)]
        self.values = self.values.extended(step.pose, X[None])
        if (kind := self.landmark_kind) is not None:
            numbers = numbers_of(step.observations, kind)
            new = Keys(kind, numbers[~np.isin(numbers, self.values.stack(kind).numbers)])
            self.values = self.values.extended(new, self.start_values[new]) if len(new) else self.values
        graph = FactorGraph(step.observations)
        for keys in known:
            graph.fix(keys)
        self.values = locate_points(graph, self.values) if step.observations else self.values
        self.graph = FactorGraph(
            joined([self.values.gather(f)[0] for f in (*self.graph.factors, *step.motion, *step.observations)])
        )
