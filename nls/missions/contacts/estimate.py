r"""The graph of tracks: their landmarks, its optimum, and how far each sighting is from its landmark there.

**Gates**: how far a sighting is from a target, in sigmas: squared Mahalanobis distances of pairs.

A sighting d of ping j and the arc of a sighting c of ping i, point by point, whitened by the noise of d:

    b = W (z_d - h(X_j, p_k)),   S = I + A_X Sigma_G A_X' + A_l C A_l',        d2 = min over the arc of b' S^-1 b

with Sigma_G the covariance of the motion X_i^-1 X_j and C that of the point by the noise of c, both with the Jacobians
of the middle of the arc.

The elevation of a landmark l is determined by other sightings. C_l is its covariance beside its anchor a, in the axes
of the world. Sigma_G is that of the motion a^-1 X_j. For a sighting d of l:

    b = W (z_d - h(X_j, l)),     S = I + A_X Sigma_G A_X' + A_l C_l A_l',      d2 = b' S^-1 b

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001, for the gate; the arc is that of `models.sensors.arcs`.

The covariances of all these motions come from few. An anchor a is a pose in the middle of a stretch of pings. The
motion between two pings goes by their anchors:

    X_i^-1 X_j = (a_i^-1 X_i)^-1 (a_i^-1 a_j) (a_j^-1 X_j)

Each of the three has a covariance from the graph; their errors count as independent. So only poses and landmarks beside
their own anchors are asked for, and anchors beside near ones. They are about as many as the pings. The pairs of
sightings are many times more, and would fill the factor of the graph.

Pairs are worth a gate where trees find them near: within the length of the arc and the error of the pose that the gate
allows.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factors import Cauchy, Huber
from factors.keys import Keys
from factors.robust import Kernel
from models import LieGroup, R
from models.algebra import Array, Index, Mask, congruence, product
from models.chi_squared import chi2_tail, mahalanobis
from models.sensors import point_in_frame
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.pings import Pings, bounds, middles, stretch_of_ping
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


Pairs = tuple[Index, Index]  # first and second (k,) of each


class Motions(NamedTuple):
    """Covariances Sigma (q, d, d) of motions, in the axes of the later pose, and which (k,) is that of each pair."""

    Sigma: Array
    which: Index


class Anchored:
    """Covariances of motions between pings, and of landmarks beside their anchors, at an estimate.

    Parameters
    ----------
    pings, estimate : the sightings, and poses and landmarks by them. Landmarks may be cut (`decisions.Cuts`).
    pairs : (c, d) of sightings (k,), whose motions are asked for. A landmark has the number of its first sighting.

    Attributes
    ----------
    marginals : of the estimate, with what the motions need.
    """

    def __init__(self, pings: Pings, estimate: Estimate, *pairs: Pairs) -> None:
        self._pings, begin = pings, bounds(len(pings.poses), 10)
        self._anchor = middles(begin)[stretch_of_ping(begin)]  # (m,) place of that of every ping
        poses, anchors = pings.poses, pings.poses[self._anchor]
        moved = np.flatnonzero(poses.numbers != anchors.numbers)
        near = [_once(len(poses), *(self._anchor[pings.ping[of]] for of in pair))[0] for pair in pairs]
        apart = [(poses[a[a != b]], poses[b[a != b]]) for a, b in near]
        values = estimate.values
        numbers = values.stack(pings.kind).numbers if pings.kind.name in values.stacks else np.zeros(0, dtype=np.intp)
        numbers = numbers[numbers < len(pings)]  # above are parts of these (`decisions.Cuts`)
        self._landmarks = anchors[pings.ping[numbers]], pings.kind[numbers]
        beside = [(anchors[moved], poses[moved]), self._landmarks, *apart]
        self.marginals = Marginals(estimate.graph, values, pairs=beside)
        d = pings.group.dim
        self._own = np.zeros((len(poses), d, d))  # of the motions from anchors to their pings
        self._own[moved] = self.marginals.relative(*beside[0])

    def of_sightings(self, c: Index, d: Index) -> Motions:
        """From the pings of sightings c (k,) to those of d (k,), for `pairs`."""
        return self._motions(self._pings.ping[c], self._pings.ping[d])

    def of_landmarks(self, landmarks: Index, d: Index) -> Motions:
        """From the anchors of landmarks (k,) to the pings of sightings d (k,), for `pairs`."""
        return self._motions(self._anchor[self._pings.ping[landmarks]], self._pings.ping[d])

    def _motions(self, i: Index, j: Index) -> Motions:
        group, poses, values = self._pings.group, self._pings.poses, self.marginals.values
        (i, j), which = _once(len(poses), i, j)
        a, b = self._anchor[i], self._anchor[j]
        X_j, apart = values[poses[j]], np.flatnonzero(a != b)
        Sigma = self._own[j] + congruence(_adjoint(group, values[poses[i]], X_j), self._own[i])
        between = self.marginals.relative(poses[a[apart]], poses[b[apart]])
        Sigma[apart] += congruence(_adjoint(group, values[poses[b[apart]]], X_j[apart]), between)
        return Motions(Sigma, which)

    def landmarks(self) -> Array:
        """Covariances (q, d, d) of all landmarks as their anchors see them, in the axes of the world."""
        (a, l), marginals, group = self._landmarks, self.marginals, self._pings.group
        X = marginals.values[a]
        _, (H_a, H_l) = point_in_frame(group, X, marginals.values[l])
        half = product(product(H_a, marginals.cross(a, l, "body")), H_l.mT)
        C = congruence(H_a, marginals.covariance(a, "body")) + congruence(H_l, marginals.covariance(l)) + half + half.mT
        return congruence(group.rotation(X), C)


def _once(count: int, i: Index, j: Index) -> tuple[Pairs, Index]:
    """Pairs of pings i and j (k,), of so many, each pair once, and the place (k,) of each among these."""
    pairs, which = np.unique(i * count + j, return_inverse=True)
    return np.divmod(pairs, count), which


def _adjoint(group: LieGroup, X: Array, Y: Array) -> Array:
    """Ad (n, d, d) of the motions from Y to X: errors at X, as Y sees them."""
    return group.adjoint_inverse(group.between(X, Y))


def near_pings(
    pings: Pings, graph: FactorGraph, values: Values, lags: int, gate: float
) -> tuple[Index, Index, Motions]:
    """Pairs (k,) of sightings, the second from one of so many pings after that of the first, and their motions."""
    P, m = pings.group.act(pings.sensors(values), pings.middle), len(pings.poses)
    i = [np.arange(m - lag) for lag in range(1, lags + 1)]  # pings that have another one so much later
    begin = np.cumsum([0, *map(len, i)])
    first, second = np.concatenate(i), np.concatenate([early + lag for lag, early in enumerate(i, 1)])
    pair = pings.poses[first], pings.poses[second]
    Sigma = Marginals(graph, values, pairs=[pair]).relative(*pair)
    pairs, which = [], []
    for lag in range(1, lags + 1):
        early = pings.ping + lag < m
        radius = np.zeros(len(pings))
        radius[early] = _radius(pings, Sigma[begin[lag - 1] + pings.ping[early]], gate, early)
        # 1,000 km lie between one ping and the next, so that one tree holds them all
        here, there = (np.column_stack([P, 1e6 * ping]) for ping in (pings.ping, pings.ping + lag))
        near = _within(there, here, radius)
        pairs.append(near)
        which.append(begin[lag - 1] + pings.ping[near[:, 0]])
    c, d = np.concatenate(pairs).T
    return c, d, Motions(Sigma, np.concatenate(which))


def near_sightings(
    pings: Pings, estimate: Estimate, Sigma: Array, which: Index, gate: float, widest: float = np.inf
) -> Pairs:
    """Pairs (k,) of some sightings in different pings, the first from the earlier one."""
    P = pings.group.act(pings.sensors(estimate.values), pings.middle)[which]
    c, d = _within(P, P, _radius(pings, Sigma[pings.ping], gate, slice(None), widest)[which]).T
    c, d = which[c], which[d]
    late = pings.ping[c] > pings.ping[d]  # the later pose may be the one with the larger error
    pairs = np.unique(np.where(late, [d, c], [c, d])[:, pings.ping[c] != pings.ping[d]], axis=1)
    return pairs[0], pairs[1]


def near_landmarks(
    pings: Pings, estimate: Estimate, Sigma: Array, which: Index, gate: float, widest: float = np.inf
) -> Pairs:
    """Some of the sightings (k,), and landmarks (k,) by number that they may be of, not yet seen in their ping.

    Pairs of innovations that are wider than `widest` sigmas of the sensor may be left out.
    """
    values = estimate.values
    if pings.kind.name not in values.stacks:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    S, stack = pings.sensors(values), values.stack(pings.kind)
    P = pings.group.act(S, pings.middle)
    radius = _radius(pings, Sigma[pings.ping], gate, slice(None), widest)
    d, row = _within(P[which], stack.X, radius[which]).T
    d = which[d]
    n = len(pings.poses)
    free = ~np.isin(stack.numbers[row] * n + pings.ping[d], estimate.tracks * n + pings.ping)
    d, row = d[free], row[free]
    if pings.limit:
        q = pings.group.act(pings.group.inverse(S[d]), stack.X[row])
        elevation = np.arctan2(q[:, 2], np.hypot(q[:, 0], q[:, 1]))
        visible = np.abs(elevation) < 1.5 * pings.limit  # a landmark farther above or below was not seen
        d, row = d[visible], row[visible]
    return d, stack.numbers[row]


def _within(points: Array, others: Array, radius: Array) -> Index:
    """Pairs (k, 2) of points (n, d) and others within the radius (n,) of each, the 32 nearest."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(others).query(points, np.arange(1, 33), distance_upper_bound=radius.max(initial=0))
    rows, columns = np.nonzero(distance <= radius[:, None])
    return np.column_stack([rows, near[rows, columns]])


def _radius(pings: Pings, Sigma: Array, gate: float, which: Mask | slice, widest: float = np.inf) -> Array:
    """How far from the middle of their arcs targets (k,) may seem, m, for covariances (k, d, d) of the pose."""
    k = pings.group.point_dim
    far = np.linalg.norm(pings.middle[which], axis=1)
    position, turn = largest_variances(Sigma, k)
    noise = pings.variances[which]
    sigma = np.sqrt(position + 2 * noise) + far * np.sqrt(turn)  # of both sightings
    return np.asarray(pings.extent[which] + np.sqrt(gate) * np.minimum(sigma, widest * np.sqrt(noise)))


def largest_variances(Sigma: Array, k: int) -> tuple[Array, Array]:
    """Of poses or motions, by covariances (n, d, d): along any axis of the k of position (n,), and of the turn (n,)."""
    position, turn = (np.linalg.eigvalsh(block)[:, -1] for block in (Sigma[:, :k, :k], Sigma[:, k:, k:]))
    return np.maximum(position, 0.0), np.maximum(turn, 0.0)


def sighting_distances(pings: Pings, values: Values, c: Index, d: Index, motions: Motions) -> tuple[Array, Array]:
    """d2 (k,) of sightings d from the arcs of sightings c in other pings, and the largest sigma (k,) of that.

    The motions (k,) are those from the pings of c to the pings of d.
    """
    group, X, sensors = pings.group, values[pings.poses][pings.ping], pings.sensors(values)
    d2, width = np.empty(len(c)), np.empty(len(c))
    for span in _spans(len(c)):
        i, j, (k, K, dim) = c[span], d[span], pings.points[c[span]].shape
        every, R = np.repeat(j, K), group.rotation(sensors[i])
        L = group.position(sensors[i])[:, None] + pings.points[i] @ R.mT
        b = pings.model(every).error(X[every], L.reshape(k * K, dim)).reshape(k, K, -1)
        (A_X, A_l), _ = pings.model(j).linearize(X[j], L[:, K // 2])
        C = congruence(product(A_l, R), pings.covariances[i])
        S = np.eye(b.shape[2]) + congruence(A_X, motions.Sigma[motions.which[span]]) + C
        d2[span], width[span] = _least(b, np.asarray(np.linalg.inv(S))), np.sqrt(np.linalg.eigvalsh(S)[:, -1])
    return d2, width


def _spans(count: int) -> list[slice]:
    """Parts of so many pairs, so that memory does not grow with their number."""
    return [slice(begin, begin + 4096) for begin in range(0, count, 4096)]


def _least(b: Array, M: Array) -> Array:
    """Least b' M b (k,) on the lines from the best of points b (k, K, m) to its neighbors, by M (k, m, m)."""
    pair, best = np.arange(len(b)), quadratic(b, M[:, None]).argmin(axis=1)
    a = b[pair, best]
    least = quadratic(a, M)
    for step in (-1, 1):
        u = b[pair, np.clip(best + step, 0, b.shape[1] - 1)] - a
        Mu = (M @ u[..., None])[..., 0]
        length = (u * Mu).sum(axis=1)
        t = np.clip(-(a * Mu).sum(axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        least = np.minimum(least, quadratic(a + t[:, None] * u, M))
    return np.asarray(least)


def landmark_distances(
    pings: Pings, estimate: Estimate, anchored: Anchored, d: Index, landmarks: Index
) -> tuple[Array, Array]:
    """d2 (k,) of sightings d from landmarks by number, and the largest sigma (k,) of that.

    The pairs (landmarks, d) are among those of the covariances.
    """
    d2, width = np.empty(len(d)), np.empty(len(d))
    if not len(d):
        return d2, width
    motions, C_l = anchored.of_landmarks(landmarks, d), anchored.landmarks()
    row = estimate.values.stack(pings.kind).index(pings.kind[landmarks])
    for span in _spans(len(d)):
        _, _, (A_X, A_l), b = estimate.linearized(pings, d[span], landmarks[span])
        of_motion, of_landmark = congruence(A_X, motions.Sigma[motions.which[span]]), congruence(A_l, C_l[row[span]])
        S = np.eye(b.shape[1]) + of_motion + of_landmark
        d2[span], width[span] = mahalanobis(b, S), np.sqrt(np.linalg.eigvalsh(S)[:, -1])
    return d2, width


def quadratic(b: Array, M: Array) -> Array:
    """b' M b of stacks."""
    return np.asarray((b * (M @ b[..., None])[..., 0]).sum(axis=-1))
