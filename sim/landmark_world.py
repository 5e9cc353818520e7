r"""A simulated world of a vehicle in the plane and its landmarks: one data set for filters and graphs.

    start       z = x_0 Exp(v)               the estimate of the first pose
    odometry    z = h(x_k, x_k+1) [+] v      pose to pose
    sightings   z = h(x_i, l_k) [+] v        wherever a landmark is in sight; which one it is, is known

v ~ N(0, Sigma); a range below 0 is reflected at 0 (`sim.world.reflected`). The initial guess uses no loop
closure: odometry is chained from the estimated first pose, and each landmark is where it was observed first.
"""

from __future__ import annotations

from dataclasses import dataclass

from factors import BearingRange, Between, Line, Prior, Wheels
from sim.world import Simulated

__all__ = ["KNOWN_START", "LandmarkWorld"]

KNOWN_START = (1e-3, 1e-3, 1e-4)  # m, m, rad: a first pose that is known, but for the arithmetic


@dataclass(frozen=True)
class LandmarkWorld(Simulated):
    """A simulated vehicle among landmarks, together with its answer.

    Attributes
    ----------
    name : of the function that made it.
    truth : the true poses, kind ``x`` in SE2, numbers 0 .. n-1 in the order of time, and landmarks, kind ``l``.
    graph : its factors are, in this order, the `Prior` of the first pose, the odometry, the sightings, and what else is
        measured.
    start : dead reckoning, and landmarks where they were seen first.
    rows : numbers drawn at random, the expected chi2 at the truth.
    landmarks_as : the prior of a landmark before it is observed: ``correlated``, ``first-sight`` or ``independent``.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the world is, in sentences with the numbers.
    """

    rows: int
    landmarks_as: str
    seed: int | None
    description: str

    @property
    def first(self) -> Prior:
        """The prior of the first pose."""
        return self.measured(0, Prior)

    @property
    def odometry(self) -> Between | Wheels:
        """The steps from pose to pose."""
        steps = self.graph.factors[1]
        assert isinstance(steps, (Between, Wheels))
        return steps

    @property
    def sightings(self) -> BearingRange | Line:
        """The sightings of the landmarks, in the order of the poses."""
        sightings = self.graph.factors[2]
        assert isinstance(sightings, (BearingRange, Line))
        return sightings
