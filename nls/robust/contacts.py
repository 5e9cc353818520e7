r"""Whether contacts of a sonar are wrong, and which to begin with then: those that agree along dead reckoning.

Of every landmark the largest set that agrees is taken.

A contact a (range, azimuth) of a landmark and an elevation e say where the landmark is, as seen from its own pose. Each
other contact b of the landmark, from a pose at T_ab with the covariance P_ab along the track, is predicted from there:

    p = S_a r(z_a, e),     d_b = v' S^-1 v,     v = z_b - h(T_ab, p),     S = R_b + H_T P_ab H_T' + H_p C H_p'

    C = J diag(R_a, sigma_e^2) J',     sigma_e = step of the elevations / sqrt(12)

J is the derivative of p with respect to range, azimuth and elevation. Up to 10 contacts of a landmark, spread evenly
over its sightings, and elevations all over the aperture are tried. The one of the lowest sum of min(d_b, c^2), c^2 the
99 % quantile of chi2, wins; the contacts with d_b <= c^2 are its set, and p is where the landmark begins. The cost is
linear in the contacts.

One contact that nothing repeats decides nothing: where no second one agrees, the landmark has no set. Contacts of a
landmark in parts of the track that nothing trusted joins are sets of their own.

The covariance of a step of the track, in the axes of its end, is that of the trusted graph (`Marginals.relative`).
The steps are added as if they were independent (`nls.robust.loop_graph.Odometry`). They are where odometry measures
them; a depth or an attitude that every pose measures by itself makes the sum too large, never too small. A track ends
where nothing trusted joins a pose to the one before: dives that only have landmarks in common.

After a plain solution contacts are wrong where

    chi2 > its 97.5 % quantile,     max s > v q,     v = max(1, median s / median of chi2)

with s the squared whitened residuals of the n contacts, and q a quantile of chi2 of two numbers (`misfit`). One of n
right contacts is beyond it by chance with 0.1 %. v is the variance of unit weight by the median. Sigmas that are all
too small raise v and max s alike, wrong contacts raise the largest ones far more.

Source: the largest set of measurements that agree, as in J. G. Mangelson et al., "Pairwise consistent measurement set
maximization for robust multi-robot map merging", ICRA 2018; here all are compared with one of them, as in M. Fischler,
R. Bolles, "Random sample consensus", Communications of the ACM 24(6), 1981, since two contacts of an arc agree easily.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, radians

import numpy as np

from factors.base import Factor, Model
from factors.keys import Keys
from factors.noise import square
from factors.sighting import Sighting
from models import SE3, LieGroup
from models.algebra import Array, Index, Mask, Numbers
from models.chi_squared import chi2_gate, innovation_distances
from models.sensors import cartesian
from nls.covariance import Marginals
from nls.covariance.frames import turned
from nls.gauge import component_labels
from nls.graph import FactorGraph
from nls.optimizers import Fit, Result
from nls.posegraph import Edges
from nls.robust.landmarks import Landmarks
from nls.robust.loop_graph import Odometry
from nls.starts.landmarks import aperture_of, sees_landmarks
from nls.starts.parts import put_back
from nls.values import Values

TRIED = 10  # contacts of a landmark that are tried; with every third one wrong all of them are with 2e-5
PAIRS_AT_ONCE = 20_000  # of contacts that are compared


@dataclass(frozen=True)
class Agreement:
    """The sets of the contacts of one factor.

    Attributes
    ----------
    kept : (n,) which contacts are in the set of their landmark.
    rows : (k,) rows of the stack of the landmarks that have a set.
    points : (k, 3) where these begin, m.
    size : (k,) how many contacts say so.
    """

    kept: Mask
    rows: Index
    points: Array
    size: Index


@dataclass(frozen=True)
class OdometryTrack:
    """Poses of one kind in the order of their numbers.

    Attributes
    ----------
    numbers : (n,) of the poses, rising.
    X : (n, size) poses.
    part : (n,) number of the part of the track that each pose is in.
    odometry : relative poses and covariances of poses in one part, by place.
    """

    numbers: Numbers
    X: Array
    part: Index
    odometry: Odometry

    def places(self, keys: Keys) -> Index:
        """Places (k,) of poses on the track."""
        return np.searchsorted(self.numbers, keys.numbers)


def along(graph: FactorGraph, values: Values, kind: str) -> OdometryTrack:
    """The track of a kind of poses.

    Parameters
    ----------
    graph, values : the trusted measurements, and their optimum.

    Raises
    ------
    UnderconstrainedError
        The trusted measurements leave a pose free within its part of the track.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))])
    >>> track = along(graph, Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])}), "x")
    >>> pose, covariance = track.odometry.between(np.array([0]), np.array([2]))
    >>> pose, covariance[0].diagonal().round(3)
    (array([[2., 0., 0.]]), array([0.02, 0.03, 0.02]))
    """
    stack = values.stack(kind)
    group = stack.manifold
    assert isinstance(group, LieGroup)
    order = np.argsort(stack.numbers, kind="stable")
    numbers, X = stack.numbers[order], np.asarray(stack.X[order])
    pattern = graph.pattern(values)
    label = component_labels(pattern)[pattern.offsets[kind] + order]
    step = np.flatnonzero(label[1:] == label[:-1])
    part = np.concatenate([[0], np.cumsum(label[1:] != label[:-1])])
    i, j = Keys(kind, numbers[step]), Keys(kind, numbers[step + 1])
    T = group.between(X[step], X[step + 1])
    C = Marginals(graph, values, pairs=[(i, j)]).relative(i, j) if len(step) else np.zeros((0, group.dim, group.dim))
    return OdometryTrack(numbers, X, part, Odometry(Edges(group, step, step + 1, T, C), X))


def doubted_contacts(graph: FactorGraph, values: Values, doubted: Sequence[Mask]) -> list[int]:
    """Numbers of the factors whose tested measurements are contacts of landmarks."""
    return [
        number
        for number, (factor, mask) in enumerate(zip(graph.factors, doubted, strict=True))
        if mask.any() and sees_landmarks(factor, values) and isinstance(factor, Sighting) and factor.contact
    ]


def selected(graph: FactorGraph, values: Values, landmarks: Landmarks) -> tuple[Values, list[Mask]]:
    """Poses by the trusted measurements alone, landmarks where agreeing contacts put them, and what to begin with.

    Parameters
    ----------
    graph, values : all measurements, and a start of the trusted ones.
    landmarks : of the graph, with the measurements under test.

    Returns
    -------
    values : the start.
    inliers : per factor the trusted measurements and tested ones that are no contacts (n,), and the contacts that
        agree; none of landmarks that this leaves undetermined.

    Raises
    ------
    UnderconstrainedError
        The trusted measurements leave a pose free.
    """
    trusted = landmarks.kept([~mask for mask in landmarks.doubted], values, lost=True)
    reckoned = graph.only(trusted)
    optimum = reckoned.optimize(landmarks.present(trusted, values)).values
    values = put_back(values, optimum)
    inliers = [np.ones(len(mask), dtype=bool) for mask in landmarks.doubted]
    tracks: dict[str, OdometryTrack] = {}
    size: dict[str, Index] = {}
    for number in doubted_contacts(graph, values, landmarks.doubted):
        factor, mask = graph.factors[number], landmarks.doubted[number]
        pose, target = (keys.kind for keys in factor.keys[:2])
        if pose not in tracks:
            tracks[pose] = along(reckoned, optimum, pose)
        contacts = factor[mask]
        assert isinstance(contacts, Sighting)
        sets = agreement(contacts, values, tracks[pose], aperture_of(graph, target))
        inliers[number][mask] = sets.kept
        points = np.array(values.stack(target).X)
        larger = sets.size > size.setdefault(target, np.zeros(len(points), dtype=np.intp))[sets.rows]
        movable = larger & ~landmarks.held[target][sets.rows]
        points[sets.rows[movable]] = sets.points[movable]
        size[target][sets.rows[movable]] = sets.size[movable]
        values = values.replaced({target: points})
    return values, landmarks.kept(inliers, values)


def agreement(factor: Sighting, values: Values, track: OdometryTrack, limit: float) -> Agreement:
    """Of every landmark the contacts that agree, and where they put it.

    Parameters
    ----------
    factor : contacts, seen from the poses of the track.
    values : of the landmarks, of which the numbers alone matter, and of offsets that are variables.
    track : along trusted measurements.
    limit : half of the aperture, rad.

    Returns
    -------
    Agreement

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import FactorGraph, Values
    >>> from nls.robust.contacts import along
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=12, outliers=0.1)
    >>> poses = Values.of([mission.start.stack("x")])
    >>> track = along(FactorGraph(mission.graph.factors[:4]), poses, "x")
    >>> sets = agreement(mission.contacts, mission.start, track, mission.sonar.aperture / 2)
    >>> bool(sets.kept[mission.wrong].mean() < 0.1), bool(sets.kept[~mission.wrong].mean() > 0.95)
    (True, True)
    """
    model, X = values.gather(factor)
    place = track.places(factor.keys[0])
    row = values.stack(factor.keys[1].kind).index(factor.keys[1])
    order = np.lexsort((place, track.part[place], row))
    new = (np.diff(row[order]) != 0) | (np.diff(track.part[place[order]]) != 0)
    count = np.diff(np.concatenate([[0], np.flatnonzero(new) + 1, [len(order)]]))
    arcs = Arcs(factor, model, X[2:], track, place, limit)
    pairs = np.cumsum(count * np.minimum(count, TRIED))
    blocks = np.split(np.arange(len(count)), np.flatnonzero(np.diff(pairs // PAIRS_AT_ONCE)) + 1)
    contacts = np.split(order, np.cumsum(count)[[block[-1] for block in blocks[:-1]]])
    sets = [arcs.sets(c, count[block]) for c, block in zip(contacts, blocks, strict=True)]
    agreeing, a, points, size = (np.concatenate(column) for column in zip(*sets, strict=True))
    enough = (size >= 2) | (count == 1)
    kept = np.zeros(len(factor), dtype=bool)
    kept[order] = agreeing & np.repeat(enough, count)
    a, points, size = a[enough], points[enough], size[enough]
    largest = np.lexsort((-size, row[a]))  # of a landmark in several parts of the track
    rows, at = np.unique(row[a[largest]], return_index=True)
    return Agreement(kept, rows, points[largest[at]], size[largest[at]])


@dataclass(frozen=True)
class Arcs:
    """Contacts of one factor, bound to its variables, with their places on the track."""

    factor: Sighting
    model: Model
    O: tuple[Array, ...]
    track: OdometryTrack
    place: Index
    limit: float

    def sets(self, contacts: Index, count: Index) -> tuple[Mask, Index, Array, Index]:
        """The largest sets of some groups of contacts.

        Parameters
        ----------
        contacts : (m,) rows of the factor, group by group.
        count : (g,) contacts of each group.

        Returns
        -------
        agreeing : (m,) whether a contact is in the set of its group.
        a, points, size : (g,) the contact the set agrees with, (g, 3) the landmark by it, and how many are in the set.
        """
        tries, first = np.minimum(count, TRIED), np.cumsum(count) - count
        group = np.repeat(np.arange(len(count)), tries)
        a = contacts[first[group] + _ranked(tries) * count[group] // tries[group]]
        of = np.repeat(np.arange(len(a)), count[group])  # of which try each pair is
        member = first[group[of]] + _ranked(count[group])
        b = contacts[member]
        T, P = self.track.odometry.between(self.place[a[of]], self.place[b])
        steps = max(ceil(2 * self.limit / radians(1.8)), 1)  # 0.15 m at 5 m, and sigma_e is 0.045 m
        elevations = self.limit * ((2 * np.arange(steps) + 1) / steps - 1)
        sigma, c2 = 2 * self.limit / steps / np.sqrt(12), chi2_gate(2, 0.99)
        d = np.empty((steps, len(b)))
        p = np.empty((steps, len(a), 3))
        for k, elevation in enumerate(elevations):
            p[k], C = self._landmarks(a, elevation, sigma)
            d[k] = self._distances(b, T, P, p[k][of], C[of])
        d[:, b == a[of]] = 0.0
        cost = np.array([np.bincount(of, np.minimum(distances, c2)) for distances in d])
        step = np.argmin(cost, axis=0)
        by_cost = np.lexsort((cost.min(axis=0), group))
        best = by_cost[np.cumsum(tries) - tries]  # of every group the try of the lowest cost
        agreeing = np.zeros(len(contacts), dtype=bool)
        mine = np.flatnonzero(best[group[of]] == of)
        agreeing[member[mine]] = d[step[of[mine]], mine] <= c2
        size = np.add.reduceat(agreeing.astype(np.intp), first)
        X, S = self.track.X[self.place[a[best]]], p[step[best], best]
        return agreeing, a[best], SE3.act(X, S), size

    def _landmarks(self, a: Index, elevation: float, sigma: float) -> tuple[Array, Array]:
        """Landmarks (k, 3) of contacts a (k,) at an elevation, in the axes of their vehicles; covariances (k, 3, 3)."""
        factor = self.factor[a]
        assert isinstance(factor, Sighting)
        S = factor.sensor_pose(SE3, SE3.identity(len(a)), *(O[a] for O in self.O))
        p, J = cartesian(np.column_stack([self.model.z[a], np.full(len(a), elevation)]))
        J = SE3.rotation(S) @ J
        W = np.linalg.inv(square(self.model.part(factor, a).W))
        spread = np.array([[0.0], [0.0], [sigma]])
        L = np.concatenate([J[..., :2] @ W, np.broadcast_to(J @ spread, (len(a), 3, 1))], axis=2)
        return SE3.act(S, p), L @ L.mT

    def _distances(self, b: Index, T: Array, P: Array, p: Array, C: Array) -> Array:
        """d (k,) of contacts b from their predictions."""
        model = self.model.part(self.factor[b], b)
        (H_T, H_p, *_), v = model.linearize(T, p, *(O[b] for O in self.O))
        return innovation_distances(v, turned(H_T, P) + turned(H_p, C))


def _ranked(count: Index) -> Index:
    """0, 1 .. of every group, for groups of so many."""
    return np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)


def misfit(result: Result, contacts: Sequence[Factor]) -> bool:
    """Whether an optimum says that some of its contacts are wrong.

    Parameters
    ----------
    result : of least squares, without robust kernels.
    contacts : factors of two numbers a measurement.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> spoiled = sim.exchange_contacts(mission, 0.05, np.random.default_rng(2))
    >>> [misfit(m.graph.optimize(m.start), [m.contacts]) for m in (mission, spoiled)]
    [False, True]
    """
    s = np.concatenate([factor.chi2(result.values) for factor in contacts] or [np.zeros(0)])
    if not len(s) or result.fit is Fit.PLAUSIBLE:
        return False
    variance = max(1.0, float(np.median(s)) / chi2_gate(2, 0.5))
    return bool(s.max() > variance * chi2_gate(2, 1 - 1e-3 / len(s)))
