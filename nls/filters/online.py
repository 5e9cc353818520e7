r"""Online SLAM as what it is: the batch problem so far, solved again at each step from the last optimum.

The start is so near that one or two Gauss-Newton iterations are enough; every estimate is that of a batch solution of
what was measured up to then, and nothing was linearized where it no longer is. The cost of a step grows with the path.
Source: M. Kaess, A. Ranganathan, F. Dellaert, "iSAM: incremental smoothing and mapping", 2008, for the comparison.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.options import check_whole
from nls.filters.base import POSE, Step
from nls.filters.motion import jacobians
from nls.filters.smoother import Smoother
from nls.optimizers import Optimizer

__all__ = ["Online"]


class Online(Smoother):
    """The whole graph so far, solved at every step or every k-th.

    Parameters
    ----------
    every : solve at every k-th step, at the first and at the last. Between, poses follow the motion.
    optimizer : Gauss-Newton when omitted.

    Attributes
    ----------
    graph, values : of the steps so far.
    iterations : of every solve, in the order of time.

    Raises
    ------
    OptionError
        Not a number of steps.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters.online import Online
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> track = Online(every=10).run(world.graph, world.start)
    >>> track.ate(world.truth, smoothed=True).rmse < track.ate(world.truth).rmse < world.ate(world.start)
    True
    """

    def __init__(self, every: int = 1, optimizer: Optimizer | None = None) -> None:
        super().__init__(optimizer)
        self.every = check_whole("Online: every", every, 1, "a whole number of steps of at least 1")
        self._waiting, self._P = 0, np.zeros((0, 0))

    @property
    def method(self) -> str:
        return "online" if self.every == 1 else f"online, every {self.every} steps"

    def _begin(self) -> None:
        self._waiting = self.every  # steps since the latest solve; the first step is solved

    def step(self, step: Step) -> None:
        before, P = self.values[self.latest][None], self._P
        super().step(step)
        if self._waiting:  # P <- F P F' + Q along the motion, Q = (A_j' A_j)^-1, F = -Q A_j' A_i
            A_i, A_j = jacobians(self._motion, before, self.values[self.latest][None])
            Q = np.linalg.inv(A_j.T @ A_j)
            F = -Q @ A_j.T @ A_i
            self._P = F @ P @ F.T + Q

    def _settle(self) -> None:
        self._waiting += 1
        if self._waiting >= self.every:
            self._solve()
            self._waiting = 0
            self._P = self.marginals.covariance(self.latest, frame="body")

    @property
    def pose(self) -> tuple[Array, Array]:
        return self.values[self.latest], self._P

    def smoothed(self) -> Array:
        if self._waiting:  # the end of a run
            self._solve()
            self._waiting = 0
        stack = self.values.stack(POSE)
        return stack.X[np.argsort(stack.numbers)]
