"""Online and fixed-lag smoothing as filters: `nls.Incremental`, given a step at a time."""

from typing import Literal

import numpy as np

from factors.keys import Keys
from models.algebra import Array
from nls.filters.base import POSE, Filter, Step
from nls.incremental import Incremental
from nls.values import Values


class Smoother(Filter):
    """The optimum of everything measured so far, or of the latest poses and a prior in the place of all before.

    Parameters
    ----------
    lag, landmarks, tol : of `nls.Incremental`; without a lag every step is a batch solution of what was measured.

    Attributes
    ----------
    smoother : the `nls.Incremental` of a run.

    Raises
    ------
    OptionError
        A lag, a word or a tolerance there is not.

    Notes
    -----
    A landmark joins once its measurements determine it. In the record of a run, a pose that left the window is as it
    was believed then. So is a landmark, and its covariance is nan.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters import Smoother
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> track = Smoother(lag=10, landmarks="stay").run(world.graph, world.start)
    >>> track.ate(world.truth).rmse < 0.4 < world.ate(world.start)
    True
    """

    def __init__(
        self, lag: int | None = None, landmarks: Literal["leave", "stay"] = "leave", tol: float = 1e-6
    ) -> None:
        self.lag, self._landmarks, self.tol = lag, landmarks, tol
        self.smoother = self._new()

    def _new(self) -> Incremental:
        return Incremental(self.tol, self.lag, self._landmarks)

    @property
    def method(self) -> str:
        if self.lag is None:
            return "online"
        return f"fixed lag {self.lag}{', landmarks stay' if self._landmarks == 'stay' else ''}"

    def start(self, step: Step, values: Values) -> None:
        self.smoother, self.latest = self._new(), step.pose
        self._kind = next((kind for kind in values.stacks if kind != POSE), None)
        beginning = values.spaces().extended(step.pose, values[step.pose][None])
        self.smoother.update([*step.motion, *step.observations], beginning)

    def step(self, step: Step) -> None:
        self.latest = step.pose
        self.smoother.update([*step.motion, *step.observations])

    @property
    def pose(self) -> tuple[Array, Array]:
        return self.smoother[self.latest], self.smoother.covariance(self.latest, frame="body")

    @property
    def landmarks(self) -> tuple[Keys, Array, Array]:
        kind = self._kind or "l"
        stacks = [values.stacks[kind] for values in (self.smoother.values, self.smoother.left) if kind in values.stacks]
        keys = Keys(kind, np.concatenate([[], *(stack.numbers for stack in stacks)]).astype(np.int64))
        if not len(keys):
            return keys, np.zeros((0, 0)), np.zeros((0, 0, 0))
        L: Array = np.concatenate([stack.X for stack in stacks])
        d = stacks[0].manifold.dim
        P = np.full((len(keys), d, d), np.nan)
        if len(here := Keys(kind, stacks[0].numbers)):
            P[: len(here)] = self.smoother.covariance(here, frame="body")
        return keys, L, P

    def smoothed(self) -> Array:
        parts = [values.stacks[POSE] for values in (self.smoother.left, self.smoother.values) if POSE in values.stacks]
        X: Array = np.concatenate([stack.X for stack in parts])
        return np.asarray(X[np.argsort(np.concatenate([stack.numbers for stack in parts]))])
