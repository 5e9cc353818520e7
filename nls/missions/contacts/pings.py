r"""Pings without names: where the target of each sighting may be, and stretches of pings that follow one another.

    p_k = p(z, el_k),   C = J Sigma_z J',   J = dp/dz (z, 0),   |el_k| <= limit, evenly spaced

in the frame of the sensor. A range and an azimuth leave the elevation free within the aperture: nine points of the arc
stand for it. A sighting that locates its target (bearing and range, a position) has one point.

Dead reckoning drifts with the way. Within a stretch of a long mission, and by the measurements between its poses alone,
it has drifted little, and a target has few others beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.base import Model
from factors.elevation import Elevation
from factors.keys import Keys, Kind
from factors.mount import pose_group
from factors.noise import Isotropic, square
from factors.replaced import replaced
from factors.sighting import Sighting
from models import LieGroup, R
from models.algebra import Array, Index, congruence
from models.errors import GraphError
from models.options import check_between
from models.sensors import cartesian
from nls.covariance import Marginals
from nls.gauge import by_number, component_labels
from nls.graph import FactorGraph
from nls.sparse.elimination import firsts
from nls.starts.parts import Parts
from nls.values import Values


@dataclass(frozen=True)
class Pings:
    """Sightings of targets without names, ping by ping: all sightings from one pose are a ping.

    Attributes
    ----------
    sightings : n of them; their targets are ignored.
    kind : of the landmarks to be.
    limit : half of the aperture, rad; 0 where a sighting locates its target.
    group : of the poses.
    poses : (m,) those with sightings, in the order of their numbers.
    row : (m,) of these in the values.
    ping : (n,) place of each sighting's pose among them.
    """

    sightings: Sighting
    kind: Kind
    limit: float
    group: LieGroup
    poses: Keys
    row: Index
    ping: Index

    @classmethod
    def of(cls, sightings: Sighting, values: Values, kind: Kind, aperture: float | None) -> Pings:
        """Sightings from poses that have values.

        Raises
        ------
        GraphError
            No sightings, an offset that is a variable, poses without a value, sightings that leave more free than an
            elevation; landmarks of this kind that are there already.
        OptionError
            Contacts without an aperture, or one that is no angle.
        """
        if not isinstance(sightings, Sighting) or not len(sightings):
            raise GraphError(f"associate: expected sightings such as RangeAzimuth(...), got {sightings!r:.80}")
        if isinstance(sightings.offset, Keys):
            message = f"{sightings!r:.80} has an offset that is a variable; the place of the sensor must be known"
            raise GraphError(f"associate: {message}", sightings.keys, sightings.name)
        if kind.name in values.stacks:
            raise GraphError(f"associate: kind {kind.name!r} has values already; landmarks need a kind of their own")
        stack = values.stack(sightings.keys[0].kind)
        if sightings.contact:
            height = "the height of the view, an angle in (0, pi), rad"
            limit = check_between("aperture", aperture, 0, np.pi, height) / 2
        elif sightings.locates:
            limit = 0.0
        else:
            message = (
                f"associate: one {sightings.name} leaves more free than an elevation; expected RangeAzimuth, or "
                "sightings that locate their targets such as BearingRange"
            )
            raise GraphError(message, sightings.keys, sightings.name)
        group = pose_group(sightings, stack.manifold)
        numbers, ping = np.unique(sightings.keys[0].numbers, return_inverse=True)
        poses = Keys(stack.kind, numbers)
        return cls(sightings, kind, limit, group, poses, stack.index(poses), ping)

    def __len__(self) -> int:
        return len(self.sightings)

    def of_landmarks(self, landmarks: Index, which: Index | slice = slice(None)) -> Sighting:
        """Sightings (k,) as measurements of landmarks (k,) by number."""
        chosen = self.sightings[which]
        named = replaced(chosen, [chosen.keys[0], self.kind[landmarks]])
        assert isinstance(named, Sighting)
        return named

    def model(self, which: Index) -> Model:
        """Some sightings (k,), to be linearized at any poses and points."""
        return self.of_landmarks(np.arange(len(which)), which).bind(self.group, R(self.group.point_dim))

    @property
    def dim(self) -> int:
        """Numbers of one sighting."""
        return int(self.model(np.arange(1)).dim)

    def covariances_of_poses(self, marginals: Marginals) -> Array:
        """Covariances (m, d, d) of the poses, in the axes of the body."""
        return marginals.all(Kind(self.poses.kind), frame="body")[self.row]

    def sensors(self, values: Values) -> Array:
        """Pose of the sensor at every sighting (n, size)."""
        return self.sightings.sensor_pose(self.group, values[self.poses][self.ping])

    @cached_property
    def points(self) -> Array:
        """Where each target may be (n, K, d) in the frame of its sensor, m."""
        return np.asarray(self._located(self.model(np.arange(len(self))).z))

    @cached_property
    def covariances(self) -> Array:
        """Of the middle points (n, d, d), by the noise of the measurement, m^2."""
        model, middle = self.model(np.arange(len(self))), self.points.shape[1] // 2
        W = np.broadcast_to(square(model.W), (len(self), model.dim, model.dim))
        C = np.asarray(np.linalg.inv(W.mT @ W), dtype=np.float64)
        step = 1e-6  # of the differences for dp/dz: m, rad
        moved = [self._located(model.z + one)[:, middle] for one in step * np.eye(model.dim)]
        return congruence((np.stack(moved, axis=-1) - self.middle[..., None]) / step, C)

    @cached_property
    def variances(self) -> Array:
        """The largest (n,) of these along any axis, m^2."""
        return np.asarray(np.linalg.eigvalsh(self.covariances)[:, -1])

    def _located(self, z: Array) -> Array:
        """Points (n, K, d) of measurements z (n, m)."""
        if not self.limit:
            return self.sightings.point(z)[:, None]
        elevation = np.linspace(-self.limit, self.limit, 9)  # between two of these points an arc is straight
        h = np.column_stack([np.repeat(z, 9, axis=0), np.tile(elevation, len(z))])
        return cartesian(h)[0].reshape(len(z), 9, 3)

    @property
    def middle(self) -> Array:
        """The middle point (n, d) of each arc."""
        return np.asarray(self.points[:, self.points.shape[1] // 2])

    @cached_property
    def extent(self) -> Array:
        """How far (n,) the ends of each arc are from its middle, m."""
        return np.asarray(np.linalg.norm(self.points - self.middle[:, None], axis=2).max(axis=1))

    def aperture_factor(self, sightings: Sighting, times: float = 1.0) -> Elevation:
        """Elevation 0 with the sigma of an even spread, once for every landmark: at its middle sighting.

        A target crosses the aperture from edge to edge while the vehicle moves ahead. At its first sighting it is at an
        edge, and a prior there would bend the track.
        """
        pose, target = sightings.keys[:2]
        order = np.lexsort((pose.numbers, target.numbers))
        _, first, count = np.unique(target.numbers[order], return_index=True, return_counts=True)
        at = order[first + (count - 1) // 2]
        offset = sightings.offset if sightings.offset is None or len(sightings.offset) == 1 else sightings.offset[at]
        return Elevation(pose[at], target[at], 0.0, Isotropic(times * self.limit / np.sqrt(3)), offset)


def without(values: Values, kind: Kind) -> Values:
    """The values of all other kinds."""
    return Values.of(stack for name, stack in values.stacks.items() if name != kind.name)


def bounds(pings: int, longest: int) -> Index:
    """Where stretches of so many pings at most begin (n,), as long as one another, and in the end how many pings.

    Examples
    --------
    >>> bounds(7, longest=3)
    array([0, 2, 4, 7])
    """
    count = -(-pings // longest)
    return np.asarray(np.arange(count + 1) * pings // count)


def middles(begin: Index) -> Index:
    """The ping in the middle (n,) of every stretch, its anchor, by where they begin (n + 1,).

    Examples
    --------
    >>> middles(bounds(7, longest=3))
    array([1, 3, 5])
    """
    return (begin[:-1] + begin[1:]) // 2


def stretch_of_ping(begin: Index) -> Index:
    """The number of its stretch, for every ping (m,), by where stretches begin (n + 1,).

    Examples
    --------
    >>> stretch_of_ping(bounds(7, longest=3))
    array([0, 0, 1, 1, 2, 2, 2])
    """
    return np.arange(len(begin) - 1).repeat(np.diff(begin))


def stretches(
    pings: Pings, graph: FactorGraph, values: Values, longest: int
) -> Iterator[tuple[Index, Pings, FactorGraph, Values]]:
    """All stretches of the pings, as long as one another, each with the poses up to the next.

    Parameters
    ----------
    pings : of a mission.
    graph, values : its other measurements, and their optimum.
    longest : pings of a stretch, at most.

    Yields
    ------
    sightings (k,) of a stretch by their place among all, the same as pings, and a graph with values. Held are its first
    pose, or the first of every component, and all that is no pose.
    """
    parts, poses, number = Parts(graph, values), values.stack(pings.poses.kind), pings.poses.numbers
    begin = bounds(len(number), longest)
    first, of_sighting = number[begin[:-1]], stretch_of_ping(begin)[pings.ping]
    of_pose = np.searchsorted(first[1:], poses.numbers, side="right")
    for stretch in range(len(first)):
        inside = of_pose == stretch
        within, across = {poses.kind: inside}, {poses.kind: ~inside}
        measurements = [parts.any(k, within) & ~parts.any(k, across) for k in range(len(graph.factors))]
        held = {kind: np.full(len(stack), kind != poses.kind) for kind, stack in values.stacks.items()}
        part, touched = parts.take(measurements, held, values)
        mine = inside.copy()
        if poses.kind in touched.stacks:  # an opaque factor comes with all of its poses
            mine[poses.index(Keys(poses.kind, touched.stack(poses.kind).numbers))] = True
        own = poses.only(mine)
        start = Values.of([own, *without(touched, Kind(poses.kind)).stacks.values()])
        pattern = part.pattern(start)  # held: the pose of lowest number in every component
        lowest = firsts(component_labels(pattern), by_number(pattern, own.kind))
        part.fix(Keys(own.kind, own.numbers[lowest - pattern.offsets[own.kind]]))
        rows = np.flatnonzero(of_sighting == stretch)
        sightings = pings.sightings[rows]
        assert isinstance(sightings, Sighting)
        yield rows, Pings.of(sightings, start, pings.kind, 2 * pings.limit or None), part, start
