"""The graph of tracks: their landmarks, its optimum, and how far each sighting is from its landmark there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import Cauchy, Huber
from factors.keys import Keys
from factors.robust import Kernel
from models import R
from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_tail
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.pings import Pings
from nls.optimizers import Iteration, LevenbergMarquardt, Stop
from nls.starts import locate_points, search_elevation
from nls.values import Values

KERNEL = Cauchy(2.0)
FIRST_KERNEL = Huber(2.0)  # from dead reckoning, which may be so far away that a Cauchy kernel would believe nothing


@dataclass(frozen=True)
class Estimate:
    """Poses and landmarks by tracks.

    Attributes
    ----------
    tracks : (n,) that it is of.
    graph : of the tracks of two sightings and more, for covariances.
    values : its optimum, roughly.
    d2 : (n,) squared residuals of the sightings in these tracks, in sigmas; 0 of the others.
    doubtful : (n,) sightings of tracks whose chi2 noise does not explain.
    reduced_chi2 : sum of all squared residuals, over the degrees of freedom.
    """

    tracks: Index
    graph: FactorGraph
    values: Values
    d2: Array
    doubtful: Mask
    reduced_chi2: float

    def linearized(self, pings: Pings, d: Index, landmarks: Index) -> tuple[Keys, Keys, tuple[Array, ...], Array]:
        """Poses and landmarks of sightings d (k,), the Jacobians of both, and innovations (k, m)."""
        measured, values = pings.of_landmarks(landmarks, d), self.values
        pose, landmark = measured.keys[:2]
        model = measured.bind(pings.group, values.stack(pings.kind).manifold)
        A, b = model.linearize(values[pose], values[landmark])
        return pose, landmark, A, b


def estimated(pings: Pings, graph: FactorGraph, poses: Values, tracks: Index, kernel: Kernel = KERNEL) -> Estimate:
    """Solve the graph with the landmarks of all tracks of two sightings and more, from these poses."""
    chosen, n = np.flatnonzero(partition.sizes(tracks) > 1), len(tracks)
    d2 = np.zeros(n)
    if not len(chosen):
        return Estimate(tracks, graph, graph.optimize(poses).values, d2, np.zeros(n, dtype=bool), 1.0)
    measured, d = pings.of_landmarks(tracks[chosen], chosen), pings.group.point_dim
    factors, numbers = [*graph.factors, measured.robust(kernel)], np.unique(tracks[chosen])
    # with twice the spread of elevations a landmark that is seen at one edge of the aperture alone bends less
    weak, spread = ([pings.aperture_factor(measured, times)] if pings.limit else [] for times in (2.0, 1.0))
    solved = FactorGraph([*factors, *weak], graph.fixed)
    start = Values.of([*poses.stacks.values()])
    start.add(pings.kind, R(d), np.zeros((len(numbers), d)), numbers)
    start = search_elevation(solved, start, pings.limit, 7) if pings.limit else locate_points(solved, start)
    result = solved.optimize(start, _roughly())
    values = result.values
    d2[chosen] = measured.chi2(values)
    chi2 = result.chi2_final + float((d2 - kernel.rho(d2)).sum())
    size = partition.sizes(tracks)
    dof = pings.dim * size - d
    tail = chi2_tail(np.asarray(np.bincount(tracks, d2, n), dtype=np.float64)[tracks], dof)
    doubtful = tail < 2e-3  # a track whose chi2 is as improbable may be two landmarks
    whole = FactorGraph([*factors, *spread], graph.fixed)
    return Estimate(tracks, whole, values, d2, doubtful & (size > 1), chi2 / max(1, result.dof))


def _roughly() -> LevenbergMarquardt:
    """Ends where chi2 is level, though long chains of poses still swing: the next tracks hold them.

    Level is what three steps lower by less than a thousandth.
    """
    chi2: list[float] = []

    def level(iteration: Iteration) -> bool:
        chi2.append(iteration.chi2)
        return len(chi2) > 3 and chi2[-4] - chi2[-1] < 1e-3 * chi2[-1]

    return LevenbergMarquardt(Stop(max_iterations=30, chi2_rtol=1e-3), level)
