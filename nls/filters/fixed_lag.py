r"""Fixed-lag smoothing: the latest poses are estimated together, older ones are marginalized out exactly.

    window      poses k - lag + 1 .. k, and the landmarks
    each step   add what is measured, solve the window, marginalize what leaves (`nls.filters.marginal`)

With a lag as long as the path it is the batch solution; with lag 1 a filter that iterates its updates. Source:
G. Sibley, L. Matthies, G. Sukhatme, "Sliding window filter with application to planetary landing", 2010.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from factors.keys import Keys
from models.algebra import Array
from models.errors import GraphError, OptionError
from models.options import check_whole
from nls.filters.base import POSE, Step
from nls.filters.marginal import MarginalPrior, marginalized, numbers_of
from nls.filters.smoother import Smoother
from nls.graph import FactorGraph
from nls.optimizers import Optimizer

__all__ = ["FixedLag"]


class FixedLag(Smoother):
    """The latest poses as a graph, with a dense prior in the place of all before.

    Parameters
    ----------
    lag : how many poses are in the window, at least 1.
    landmarks : ``leave``: a landmark leaves with the last pose of the window that saw it, and the cost of a step stays
        the same for ever; when it is seen again it is a new one, and no loop is closed. ``stay``: landmarks stay, loops
        close, and the prior grows to all of them.
    optimizer : the one of `FactorGraph.optimize` when omitted: Levenberg-Marquardt once something has left.

    Attributes
    ----------
    graph, values : of the window.
    iterations : of every solve, in the order of time.

    Raises
    ------
    OptionError
        A lag or a word there is not.

    Notes
    -----
    The prior is the exact one at the point where the variables left, and is not linearized again: what they were wrong
    by then stays in it. A measurement to a pose that left is refused by name. In the record of a run a pose is as it
    was believed when it left, and so is a landmark that did not come back.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters.fixed_lag import FixedLag
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> track = FixedLag(10, landmarks="stay").run(world.graph, world.start)
    >>> track.ate(world.truth).rmse < 0.4 < world.ate(world.start)
    True
    """

    def __init__(
        self, lag: int, landmarks: Literal["leave", "stay"] = "leave", optimizer: Optimizer | None = None
    ) -> None:
        if landmarks not in ("leave", "stay"):
            raise OptionError("FixedLag: landmarks", landmarks, "leave or stay")
        super().__init__(optimizer)
        self.lag = check_whole("FixedLag: lag", lag, 1, "a whole number of poses of at least 1")
        self.stay = landmarks == "stay"

    @property
    def method(self) -> str:
        return f"fixed lag {self.lag}{', landmarks stay' if self.stay else ''}"

    def _begin(self) -> None:
        self.left: dict[int, Array] = {}  # poses, by number
        self.past: dict[int, tuple[Array, Array]] = {}  # landmarks, and their covariances

    def _grow(self, step: Step, X: Array) -> None:
        for factor in step.observations:
            for keys in factor.keys:
                gone = np.array([keys.kind == POSE and number in self.left for number in keys.numbers.tolist()])
                if gone.any():
                    k = int(np.argmax(gone))
                    raise GraphError(
                        f"{factor.describe(k)} is measured to {keys[[k]]}, which left the window of the latest "
                        f"{self.lag} poses before {step.pose}; use a larger lag, or Online, which keeps them all",
                        [keys[[k]], step.pose],
                        factor.name,
                    )
        super()._grow(step, X)

    def _settle(self) -> None:
        self._solve()
        poses = self.values.stack(POSE)
        old = Keys(POSE, np.sort(poses.numbers)[: -self.lag])
        if not len(old):
            return
        unseen = self._unseen(old)
        leaving = [old, unseen] if len(unseen) else [old]
        if len(unseen):
            P = self.marginals.covariance(unseen, frame="body")
            self.past |= {
                n: (L, P_n) for n, L, P_n in zip(unseen.numbers.tolist(), self.values[unseen], P, strict=True)
            }
        self.left |= dict(zip(old.numbers.tolist(), self.values[old], strict=True))
        factors, self.values = marginalized(self.graph.factors, self.values, leaving)
        self.graph = FactorGraph(factors)

    def _unseen(self, old: Keys) -> Keys:
        """The landmarks that no pose of the window sees once these poses have left."""
        kind = self.landmark_kind
        if kind is None or self.stay:
            return Keys(POSE, [])
        staying = [
            factor[np.flatnonzero(~np.isin(keys.numbers, old.numbers))]
            for factor in self.graph.factors
            if not isinstance(factor, MarginalPrior)
            for keys in factor.keys
            if keys.kind == POSE
        ]
        numbers = self.values.stack(kind).numbers
        return Keys(kind, numbers[~np.isin(numbers, numbers_of(staying, kind))])

    @property
    def landmarks(self) -> tuple[Keys, Array, Array]:
        keys, L, P = super().landmarks
        gone = [number for number in self.past if number not in keys.numbers.tolist()]
        if not gone:
            return keys, L, P
        L_gone, P_gone = (np.stack(stacks) for stacks in zip(*(self.past[number] for number in gone), strict=True))
        return (
            Keys(keys.kind, np.concatenate([keys.numbers, gone])),
            np.concatenate([L.reshape(-1, L_gone.shape[1]), L_gone]),
            np.concatenate([P.reshape(-1, *P_gone.shape[1:]), P_gone]),
        )

    def smoothed(self) -> Array:
        window = self.values.stack(POSE)
        every = self.left | dict(zip(window.numbers.tolist(), window.X, strict=True))
        return np.stack([every[number] for number in sorted(every)])
