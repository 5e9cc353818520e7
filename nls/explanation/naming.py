"""Free directions by name, together where the same helps against them.

Those of single points are named in the frame of the sensor that sees them: range, azimuth, elevation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from factors import Sighting
from factors.keys import Keys
from models import LieGroup
from models.advice import Advice
from models.algebra import Array, Index
from models.sensors import point_in_frame
from nls.analysis.freedom import AXES, NEAR, SAME_MOTION, Freedom, Motion, generators, motions, places
from nls.explanation.findings import Finding, FindingKind
from nls.gauge import component_labels
from nls.sparse.pattern import Pattern
from nls.values import Values

ALIGNED = 0.99  # cosine of the angle between an axis and the free directions
ABSENT = 1e-8  # share of a direction that is rounding
SHARE = 0.05  # a variable is named when it moves by at least this part of the farthest moving one, in sigmas
CURES: dict[str, tuple[Advice, ...]] = {
    "elevation": (Advice("roll", ("the point",)), Advice("aperture")),
    "range": (Advice("second place", ("the point",)), Advice("measure", ("a range",))),
    "bearing": (Advice("spread ranges"), Advice("measure", ("a bearing",))),
    "azimuth": (Advice("spread ranges"), Advice("measure", ("a bearing",))),
}


def named_directions(free: Freedom, pattern: Pattern, values: Values) -> list[Finding]:
    """Findings, one for all directions against which the same helps.

    Parameters
    ----------
    free : the directions, over the free columns of the pattern.
    pattern : the graph with the gauge fixed.
    """
    groups: dict[tuple[int, tuple[str, ...]], list[tuple[Keys, Sight | None]]] = {}
    for variable, names, sight in _singles(free, pattern, values):
        sightings = 0 if sight is None else min(sight.count, 2)
        groups.setdefault((sightings, names), []).append((pattern.key(variable), sight))
    alone = [_group(names, sightings == 1, *zip(*of, strict=True)) for (sightings, names), of in groups.items()]
    return _whole(free, pattern, values) + alone


def _group(names: tuple[str, ...], once: bool, keys: tuple[Keys, ...], sights: tuple[Sight | None, ...]) -> Finding:
    """One finding for variables of which the same is free."""
    poses = tuple(repr(sight.pose) for sight in sights if sight is not None)
    numbers = {"moved": "alone", "directions": names, "seen_from": poses, "seen_once": once}
    pronoun = "it" if len(keys) == 1 else "them"
    prior = Advice("prior", (pronoun,))
    if poses:
        advice = next((CURES[name] for name in names if name in CURES), (Advice("view", (pronoun,)), prior))
    elif any(" about " in name for name in names):
        advice = (Advice("off axis"), prior)
    else:
        advice = (Advice("measure", (f"{', '.join(names)} of {pronoun}",)), prior, Advice("fix", (pronoun,)))
    return Finding(FindingKind.FREE, keys, numbers, advice)


def _singles(free: Freedom, pattern: Pattern, values: Values) -> Iterator[tuple[int, tuple[str, ...], Sight | None]]:
    """Single variables, the names of their free directions, and where they are seen from."""
    owner, _ = pattern.column_owner()
    first = free.singles.indices[free.singles.indptr[:-1]]
    variables, inverse = np.unique(owner[first], return_inverse=True)
    sight_of = sights(pattern, values, variables)
    for k, v in enumerate(variables.tolist()):
        rows = pattern.starts[v] + np.arange(pattern.dims[v])
        U = np.linalg.qr(free.singles[:, np.flatnonzero(inverse == k)][rows].toarray())[0]
        sight = sight_of.get(v)
        names = () if sight is None else named(U, sight.axes, sight.names)
        if not names:
            sight, components = None, pattern.component_names(v)
            names = named(U, np.eye(len(components)), components) or _turning(U, v, pattern, values)
            taking = [name for name, u in zip(components, np.abs(U).max(axis=1), strict=True) if u >= SHARE]
            names = names or (f"a direction of {', '.join(taking)}",) * U.shape[1]
        yield v, names, sight


def _turning(U: Array, v: int, pattern: Pattern, values: Values) -> tuple[str, ...]:
    """The one motion that a pose is free to make, with the variable it turns about; () of others."""
    key = pattern.key(v)
    stack = values.stack(key.kind)
    if U.shape[1] != 1 or not stack.manifold.body_axes:
        return ()
    X = np.asarray(stack.X)[stack.index(key)]
    motion = np.asarray(np.linalg.lstsq(generators(stack.manifold, X)[0, :, :6], U[:, 0], rcond=None)[0], dtype=float)
    neighbors = [pattern.key(int(other)) for other in _beside(v, pattern)]
    points = [places(values.stack(k.kind).manifold, values[k][None]) for k in neighbors]
    names = [repr(k) for k, place in zip(neighbors, points, strict=True) if len(place)]
    positions = np.concatenate([*points, places(stack.manifold, X)])
    return (_motion_name(Motion(motion[:3], motion[3:], 0.0), positions, [*names, repr(key)]),)


def _beside(v: int, pattern: Pattern) -> Index:
    """The neighbors of a variable: what shares a factor with it."""
    rows = [np.stack(batch.variables) for batch in pattern.batches]
    return np.setdiff1d(np.concatenate([row[:, (row == v).any(axis=0)].reshape(-1) for row in rows]), [v])


def _whole(free: Freedom, pattern: Pattern, values: Values) -> list[Finding]:
    """Directions that move several variables: of whole parts of the graph where they are motions of the world."""
    if not free.combinations.shape[1]:
        return []
    label, findings = component_labels(pattern), []
    part = np.repeat(label, pattern.dims)  # of every unknown
    directions = np.stack([pattern.expand(u) for u in free.combinations.T], axis=1) * free.scale[:, None]
    for k, N in sorted(_by_part(directions, part).items()):
        members = np.flatnonzero(label == k)
        G, positions, places_named = _motions_of(members, pattern, values)
        whole, remainder = motions(N[part == k], G * free.scale[part == k, None])
        names = sorted(
            (_motion_name(motion, positions, places_named) for motion in whole),
            key=lambda name: AXES.index(name) if name in AXES else len(AXES),
        )
        if names:
            numbers = {"moved": "as one", "directions": tuple(names), "variables": len(members)}
            findings.append(Finding(FindingKind.FREE, (pattern.key(int(members[0])),), numbers, _cures(names)))
        moved = members[~pattern.held[members]]
        columns = np.concatenate([pattern.starts[v] + np.arange(pattern.dims[v]) for v in moved])
        findings += _loose(remainder[np.repeat(~pattern.held[members], pattern.dims[members])], columns, pattern)
    return findings


def _by_part(directions: Array, part: Index) -> dict[int, Array]:
    """Every direction (n, r) under the part (n,) that has most of it; those of one part differ within it.

    A calibration is a part of its own, and a direction may move it and poses. Q has orthonormal columns. Then the
    squares of the singular values of the rows of a part are the shares that it has of directions.
    """
    Q = np.linalg.qr(directions)[0]
    out: dict[int, Array] = {}
    parts = np.unique(part[np.abs(Q).max(axis=1) > ABSENT]).tolist()
    for share in (0.5, 0.0):  # most of a direction, then what no part has most of
        for k in parts:
            _, s, Vt = np.linalg.svd(np.linalg.qr(Q[part == k], mode="r"))
            mine = np.pad(s, (0, len(Vt) - len(s))) ** 2 > max(share, ABSENT)
            if mine.any():
                out[k] = np.concatenate([out.get(k, Q[:, :0]), Q @ Vt[mine].T], axis=1)
            Q = Q @ Vt[~mine].T
    return out


def _motions_of(members: Index, pattern: Pattern, values: Values) -> tuple[Array, Array, list[str]]:
    """Motions of the world over all unknowns of some variables; positions and names of those that have one.

    Fixed variables do not move in a direction, and must not in a motion; variables without a measurement may.
    """
    sizes = pattern.dims[members]
    begin = np.cumsum(sizes) - sizes
    G = np.zeros((sizes.sum(), len(AXES)))
    positions, names = [], []
    for name, stack in values.stacks.items():
        place = members - pattern.offsets[name]
        here = np.flatnonzero((place >= 0) & (place < len(stack)))
        if not len(here):
            continue
        X = np.asarray(stack.X)[place[here]]
        G[begin[here, None] + np.arange(stack.manifold.dim)] = generators(stack.manifold, X)
        if len(p := places(stack.manifold, X)):
            positions.append(p)
            names += [repr(Keys(name, int(number))) for number in stack.numbers[place[here]]]
    return G, np.concatenate([np.zeros((0, 3)), *positions]), names


def _cures(names: list[str]) -> tuple[Advice, ...]:
    if any(name.startswith("scale") for name in names):
        return (Advice("distance"),)
    axes = ", ".join(name for name in names if name in AXES) or "that"
    return Advice("prior", ("one of them",)), Advice("measure", (f"{axes} of one of them",)), Advice("fix", ("one",))


def _loose(directions: Array, columns: Index, pattern: Pattern) -> list[Finding]:
    """Directions that are no motion of the whole, each by the unknowns that it moves."""
    if not directions.shape[1]:
        return []
    from scipy.linalg import qr

    pivots = qr(directions.T, mode="r", pivoting=True)[1][: directions.shape[1]]
    owner, component = pattern.column_owner()
    findings = []
    for u in np.abs(directions @ np.linalg.inv(directions[pivots])).T:
        moving = columns[np.flatnonzero(u >= SHARE * u.max())]
        names: dict[int, list[str]] = {}
        for v, c in zip(owner[moving].tolist(), component[moving].tolist(), strict=True):
            names.setdefault(v, []).append(pattern.component_names(v)[c])
        numbers = {"moved": "together", "components": tuple(map(tuple, names.values()))}
        advice = (Advice("prior", ("one of them",)), Advice("view", ("one of them",)), Advice("fix", ("one",)))
        findings.append(Finding(FindingKind.FREE, tuple(map(pattern.key, names)), numbers, advice))
    return findings


def _motion_name(motion: Motion, positions: Array, names: list[str]) -> str:
    """A motion in words: ``x``, ``yaw``, ``yaw about x0``, ``scale about (1.2, 0.3, 0)``.

    Parameters
    ----------
    positions : (n, 3) of the variables that have one.
    names : of these.
    """
    extent = max(float(np.ptp(positions, axis=0).max()), 1e-300) if len(positions) else 1.0
    v, omega, s = motion.v, motion.omega, motion.s
    speed, turning, growing = float(np.linalg.norm(v)), float(np.linalg.norm(omega)) * extent, abs(s) * extent
    if max(turning, growing) < NEAR * speed:
        axis = np.abs(v) / speed
        return AXES[int(axis.argmax())] if axis.max() > 1 - SAME_MOTION else f"a shift along {_numbers(v / speed)}"
    W = np.array([[s, -omega[2], omega[1]], [omega[2], s, -omega[0]], [-omega[1], omega[0], s]])
    center = -np.linalg.lstsq(W, v, rcond=1e-9)[0]
    flat = not positions[:, 2].any()
    if growing > turning:
        name, distance = "scale", np.linalg.norm(positions - center, axis=1)
    else:
        a = omega / np.linalg.norm(omega)
        axis = np.abs(a)
        name = AXES[3 + int(axis.argmax())] if axis.max() > 1 - SAME_MOTION else f"rotation about {_numbers(a)}"
        away = positions - center
        distance = np.linalg.norm(away - np.outer(away @ a, a), axis=1)  # from the axis
    nearest = int(np.argmin(distance)) if len(distance) else -1
    if nearest >= 0 and distance[nearest] <= NEAR * extent:
        return f"{name} about {names[nearest]}"
    return f"{name} about {_numbers(center[:2] if flat else center)}"


def _numbers(a: Array) -> str:
    return f"({', '.join(f'{round(float(x), 3) + 0.0:g}' for x in a)})"


@dataclass(frozen=True)
class Sight:
    """The first sighting of a point, and how many there are.

    Attributes
    ----------
    pose : from where.
    count : sightings of the point, by all factors.
    axes : (d, d) unit vectors in the world, a row for each of `names`; nan straight above the sensor.
    names : range, azimuth, elevation; range, bearing in the plane.
    """

    pose: Keys
    count: int
    axes: Array
    names: tuple[str, ...]


def sights(pattern: Pattern, values: Values, points: Index) -> dict[int, Sight]:
    """The first sighting of each of some variables (n,) that are points and seen from a pose."""
    out: dict[int, Sight] = {}
    count = np.zeros(len(pattern.dims), dtype=np.intp)
    for batch in pattern.batches:
        factor = batch.model.factor
        if not isinstance(factor, Sighting) or batch.model.manifolds[1] is batch.model.manifolds[0]:
            continue
        rows = np.flatnonzero(np.isin(batch.variables[1], points))
        if not len(rows):
            continue
        count += np.bincount(batch.variables[1], minlength=len(count))
        group = batch.model.manifolds[0]
        assert isinstance(group, LieGroup)
        _, X = values.gather(factor)
        S = factor.sensor_pose(group, X[0], *X[2:])
        p = np.broadcast_to(point_in_frame(group, S, X[1])[0], (len(batch), group.point_dim))[rows]
        R = np.broadcast_to(group.rotation(S), (len(batch), group.point_dim, group.point_dim))[rows]
        names, E = _spherical(p)
        E = E @ R.mT  # rows, in the world
        variables, first = np.unique(batch.variables[1][rows], return_index=True)
        for v, k in zip(variables.tolist(), first.tolist(), strict=True):
            if v not in out:
                out[v] = Sight(factor.keys[0][[rows[k]]], 0, E[k], names)
    return {v: replace(sight, count=int(count[v])) for v, sight in out.items()}


def _spherical(p: Array) -> tuple[tuple[str, ...], Array]:
    """Directions in which range, azimuth and elevation grow, (n, d, d), a row for each, at points p (n, d)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        e = p / np.linalg.norm(p, axis=1, keepdims=True)
        if p.shape[1] == 2:
            return ("range", "bearing"), np.stack([e, np.stack([-e[:, 1], e[:, 0]], axis=1)], axis=1)
        across = np.stack([-p[:, 1], p[:, 0], 0 * p[:, 0]], axis=1)
        across = across / np.linalg.norm(across, axis=1, keepdims=True)
        return ("range", "azimuth", "elevation"), np.stack([e, across, np.cross(e, across)], axis=1)


def named(U: Array, axes: Array, names: tuple[str, ...]) -> tuple[str, ...]:
    """The axes (rows) that lie in the span of orthonormal columns U (d, q); () where these are others."""
    cosines = np.linalg.norm(axes @ U, axis=1)
    along = tuple(name for name, c in zip(names, cosines, strict=True) if c > ALIGNED)
    return along if len(along) == U.shape[1] else ()
