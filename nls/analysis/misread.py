r"""Other readings of a measurement: the mistakes by which a right number comes to say something else.

    exchanged        z of (i, j) is meant of (j, i)                       Between, BetweenSensors, XYH
    transposed       R -> R', t stays; in the plane yaw -> -yaw           relative poses, priors, XYH, Heading
    mirrored         bearing or azimuth -> its negative                   sensors with such a component
    y flipped        t -> M t, R -> M R M,  M = diag(1, -1, 1)            relative poses, priors, positions, landmarks
    z flipped        the same with M = diag(1, 1, -1)                     the same in space; depth and elevation
    x, y exchanged   (x, y) -> (y, x), yaw -> pi/2 - yaw                  positions, priors, headings

Each reading is a function from the measured values to others, and exchanged one from the variables to others. Noise
stays as it is. Of a rotation with unit quaternion (v, w), M R M has the quaternion (-M v, w): v is an axial vector.
Source of that: J. Diebel, "Representing attitude", 2006; a reflection changes the sign of a rotation about its plane.

Whole kinds are read otherwise, each with a start of its own, and chi2 of both optima is compared
(`nls.analysis.alternatives`). A kind is a type of measurements, its steps, its closures, or a single factor.

A single measurement is compared with the optimum of all others. With the covariance C of what they predict of it as
it was meant, in units of its noise,

    t = e' (I + C)^-1 e  ~  chi2(m)
    p = V_m t^(m/2) det(W^-1 (I + C) W^-T)^(1/2) / room

p is the chance that a measurement drawn at random from the room of its kind fits as well; V_m is the volume of the unit
ball in m dimensions. The room of an angle is a turn, that of a rotation 8 pi^2, that of a length the extent of the map.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from factors import Factor, Wheels
from factors.base import Model
from factors.noise import square
from factors.replaced import replaced
from models import SE2, SE3, SO2, SO3
from models.algebra import Array, Index, wrap
from models.chi_squared import chi2_tail, innovation_distances
from models.manifolds.units import unit
from nls.analysis.alternatives import FIRST, UNLIKELY, expected, nearest, need, solved, supported
from nls.analysis.leave_one_out import Checked, Linearization, kinds_of, middle_variance
from nls.analysis.suspects import weights_without
from nls.graph import FactorGraph
from nls.sparse.pattern import Batch, Pattern, measuring
from nls.values import Values

Places = tuple[tuple[int, Index], ...]
# What was meant by a bound factor; None where the mistake makes no sense for its type.
Reading = Callable[[Model], Factor | None]


def exchanged(model: Model) -> Factor | None:
    """The first two variables exchanged; a sensor stays on its vehicle."""
    factor = model.factor
    if factor.frame != "first":
        return None
    i, j, *sensors = factor.keys
    swapped = replaced(factor, keys=[j, i, *sensors])
    if isinstance(offset := vars(swapped).get("offset"), tuple):  # of the sensors at both ends
        vars(swapped)["offset"] = offset[::-1]
    return swapped


def transposed(model: Model) -> Factor | None:
    """The rotation inverted, the translation as it is."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    if not factor.frame or "yaw" not in space.components:
        return None
    if space in (SO3, SE3):
        z[:, -4:-1] *= -1.0
    else:
        yaw = space.components.index("yaw")
        z[:, yaw] = wrap(-z[:, yaw])
    return replaced(factor, z=z)


def mirrored(model: Model) -> Factor | None:
    """Bearings and azimuths counted the other way round."""
    angles = ("bearing", "azimuth", "alpha")  # EpipolarArc has azimuth_i and azimuth_j
    columns = [k for k, name in enumerate(model.space.components) if name.startswith(angles)]
    if not columns:
        return None
    z = np.array(model.z)
    z[:, columns] = wrap(-z[:, columns])
    return replaced(model.factor, z=z)


def flipped(model: Model, axis: str) -> Factor | None:
    """An axis of all frames points the other way."""
    z = _reflected(model, axis)
    return None if z is None else replaced(model.factor, z=z)


def _reflected(model: Model, axis: str) -> Array | None:
    """Measured values in frames of which one axis points the other way; None where they do not have that axis."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    if isinstance(factor, Wheels):
        return z[:, [1, 0, 2]] * [1.0, 1.0, -1.0] if axis == "y" else None
    if factor.frame and space in (SE2, SE3):
        if space is SE2:
            return np.column_stack([z[:, 0], -z[:, 1], wrap(-z[:, 2])]) if axis == "y" else None
        M = np.where(np.array(["x", "y", "z"]) == axis, -1.0, 1.0)
        return np.column_stack([z[:, :3] * M, -z[:, 3:6] * M, z[:, 6]])
    signs = {"y": ("y", "yaw"), "z": ("z",)}[axis] if factor.frame and axis in model.names else ()
    columns = [k for k, name in enumerate(space.components) if name in signs or (name, axis) == ("elevation", "z")]
    z[:, columns] *= -1.0
    return z if columns else None


def swapped_axes(model: Model) -> Factor | None:
    """East and north for north and east."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    names = space.components
    if factor.frame != "world" or space in (SO2, SO3, SE3) or (space is SE2 and len(model.names) < 3):
        return None
    if "yaw" in names:
        z[:, names.index("yaw")] = wrap(np.pi / 2 - z[:, names.index("yaw")])
    if {"x", "y"} <= set(names):
        x, y = names.index("x"), names.index("y")
        z[:, [x, y]] = z[:, [y, x]]
    elif names != ("yaw",):
        return None
    return replaced(factor, z=z)


READINGS: dict[str, Reading] = {
    "exchanged": exchanged,
    "transposed": transposed,
    "mirrored": mirrored,
    "y flipped": partial(flipped, axis="y"),
    "z flipped": partial(flipped, axis="z"),
    "x, y exchanged": swapped_axes,
}


@dataclass(frozen=True)
class MisreadKind:
    """A source of measurements that fits when it is read otherwise, and not as it stands.

    Attributes
    ----------
    kind : ``BearingRange``, ``Between``, ``Between, steps``, or ``Position, factor 3`` for one of several factors.
    places : number of the factor and indices (k,) of its measurements, for each factor that the source is made of.
    reading : a name of `READINGS`.
    standing, chi2 : chi2 of the whole graph at the optimum as it stands, and as it was meant.
    dof : degrees of freedom of both.
    values : the optimum as it was meant.
    """

    kind: str
    places: Places
    reading: str
    standing: float
    chi2: float
    dof: int
    values: Values


def misread_kinds(graph: FactorGraph, values: Values) -> tuple[MisreadKind, ...]:
    """Sources of measurements with a wrong sign, order or frame, where noise does not explain chi2.

    Parameters
    ----------
    graph : not changed.
    values : its optimum.

    Returns
    -------
    tuple of MisreadKind
        The lowest chi2 first. The data do not distinguish several ones: mirrored bearings against odometry,
        or mirrored odometry against bearings.

    Raises
    ------
    GraphError
        A variable of a factor has no value.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from factors.replaced import replaced
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> first, odometry, sightings = world.graph.factors
    >>> wrong = FactorGraph([first, odometry, replaced(sightings, z=sightings.z * [-1, 1])])
    >>> sorted((kind.kind, kind.reading) for kind in misread_kinds(wrong, wrong.optimize(world.start).values))
    [('BearingRange', 'mirrored'), ('Between', 'y flipped')]
    """
    standing = solved(graph, values, start=False)
    if standing is None or expected(standing):
        return ()
    alternatives = [
        (name, places, reading, factors)
        for name, places in _sources(graph.pattern(values)).items()
        for reading, read in READINGS.items()
        if (factors := _reread(graph, values, places, read)) is not None
    ]
    need(graph, len(alternatives) + 1)
    standing = min(standing, solved(graph, values) or standing, key=lambda fit: fit.chi2)
    if expected(standing):
        return ()
    worst = 100.0 * standing.chi2  # of a start that leads somewhere; headings turned by 90 degrees begin at 6
    fits = [
        solved(FactorGraph([*reread, *other_factors], graph.fixed), standing.values, True, FIRST, worst)
        for *_, (reread, other_factors) in alternatives
    ]
    lowest = min((fit.chi2 for fit in fits if fit is not None), default=0.0)
    meant = []
    for (name, places, reading, (reread, _)), begun in zip(alternatives, fits, strict=True):
        if begun is None or begun.chi2 > 10.0 * lowest:
            continue
        fit = solved(begun.graph, begun.values, start=False)
        if fit is None or not supported(standing, fit, len(alternatives)) or _middle(reread, fit.values) > 2.0:
            continue
        meant.append(MisreadKind(name, places, reading, standing.chi2, fit.chi2, fit.dof, fit.values))
    return nearest(meant)


def _sources(pattern: Pattern) -> dict[str, Places]:
    """Measurements that may be off alike, each set of them once, the larger first."""
    types: dict[str, Places] = {}
    single: dict[str, Places] = {}
    for k, batch in enumerate(pattern.batches):
        factor = batch.model.factor
        if not factor.limit_only:
            place = (k, np.arange(len(batch)))
            types[factor.name] = (*types.get(factor.name, ()), place)
            single[f"{factor.name}, factor {k}"] = (place,)
    kinds = {name: tuple(kind) for name, kind in kinds_of(pattern, len(pattern.batches)).items()}
    sources: dict[str, Places] = {}
    known = set()
    for name, places in [*types.items(), *kinds.items(), *single.items()]:
        label = tuple((k, indices.tobytes()) for k, indices in places)
        if label not in known and sum(len(indices) for _, indices in places) >= 6:
            known.add(label)
            sources[name] = places
    return sources


def _reread(
    graph: FactorGraph, values: Values, places: Places, read: Reading
) -> tuple[list[Factor], list[Factor]] | None:
    """The source read otherwise, and all other measurements; None where the reading makes no sense for the source."""
    chosen, reread, other_factors = dict(places), [], []
    for k, factor in enumerate(graph.factors):
        if k not in chosen:
            other_factors.append(factor)
            continue
        meant = read(values.gather(factor)[0])
        if meant is None:
            return None
        reread.append(meant[chosen[k]])
        if len(rest := np.setdiff1d(np.arange(len(factor)), chosen[k])):
            other_factors.append(factor[rest])
    return reread, other_factors


def _middle(factors: list[Factor], values: Values) -> float:
    """Variance of the median of some measurements, relative to its noise; outliers do not move it."""
    chi2 = np.concatenate([factor.chi2(values) for factor in factors])
    m = np.concatenate([measuring(values.gather(factor)[0]) for factor in factors])
    return middle_variance(chi2[m > 0], m[m > 0]) if (m > 0).any() else math.inf


@dataclass(frozen=True)
class MisreadMeasurement:
    """A measurement that fits when it is read otherwise, and not as it stands.

    Attributes
    ----------
    place : number of the factor, index of the measurement.
    reading : a name of `READINGS`.
    standing, t : squared distance from the prediction of all others, as it stands and as it was meant, in sigmas of the
        difference.
    """

    place: tuple[int, int]
    reading: str
    standing: float
    t: float


def misread_measurements(
    pattern: Pattern, values: Values, places: Sequence[tuple[int, int]]
) -> tuple[MisreadMeasurement, ...]:
    """Doubtful measurements that fit all others when they are read otherwise.

    Parameters
    ----------
    pattern : of the graph, with the gauge and whatever is free held.
    values : the optimum without the doubtful measurements.
    places : number of the factor and index of each of them, as of `nls.analysis.suspects`.

    Returns
    -------
    tuple of MisreadMeasurement
        In the order of the places, then of t; several of one place where the data do not distinguish its readings.

    Raises
    ------
    SingularSystemError
        Without these measurements something is free.

    Examples
    --------
    >>> import numpy as np
    >>> import nls, sim
    >>> from factors import Between
    >>> world = sim.sphere(np.random.default_rng(0), 8, 12)
    >>> odometry, closures = world.graph.factors
    >>> i, j = closures.keys
    >>> wrong = Between(j[[0]], i[[0]], closures.z[[0]], closures.noise)  # i and j exchanged
    >>> pattern = Pattern([odometry, closures[1:], wrong], world.truth)
    >>> pattern = pattern.holding(np.arange(96) == 0)
    >>> values = nls.FactorGraph([odometry, closures[1:]]).optimize(world.truth).values
    >>> [misread.reading for misread in misread_measurements(pattern, values, [(2, 0)])]
    ['exchanged']
    """
    if not places:
        return ()
    factors = [batch.model.factor for batch in pattern.batches]
    doubtful: dict[int, list[int]] = {}
    for k, i in places:
        doubtful.setdefault(k, []).append(i)
    meant = [
        (k, reading, factor[indices])
        for k, indices in doubtful.items()
        for reading, read in READINGS.items()
        if (factor := read(pattern.batches[k].model)) is not None
    ]
    whole = Pattern([*factors, *(factor for *_, factor in meant)], values).holding(pattern.held)
    nothing = [np.zeros(len(factor)) for *_, factor in meant]
    checked = Checked(Linearization(whole, values, [*weights_without(pattern, places, len(factors)), *nothing]))
    standing = {k: _distances(checked, k) for k in doubtful}
    out = []
    for n, (k, name, _) in enumerate(meant, start=len(factors)):
        t, m = _distances(checked, n), measuring(whole.batches[n].model)
        tries = sum(other == k for other, *_ in meant)
        chance = tries * _accidental(whole.batches[n].model, _room(pattern.batches[k], values), checked.C[n], t)
        fits = (chi2_tail(t, m) >= UNLIKELY) & (chance <= UNLIKELY)
        for row in np.flatnonzero(fits).tolist():
            i = doubtful[k][row]
            if standing[k][i] >= 100.0:  # squared sigmas: wrong, and not only poor
                out.append(MisreadMeasurement((k, i), name, float(standing[k][i]), float(t[row])))
    return tuple(sorted(out, key=lambda misread: (list(places).index(misread.place), misread.t)))


def _distances(checked: Checked, k: int) -> Array:
    """t (n,) of the measurements of a batch that do not count: e' (I + C)^-1 e."""
    return innovation_distances(checked.e[k], checked.C[k])


def _accidental(model: Model, room: float, C: Array, t: Array) -> Array:
    """p (n,) of some measurements; infinite where a component has no information or no room.

    Parameters
    ----------
    model : of the measurements as they were meant.
    room : of such measurements.
    """
    d = model.dim
    ball = math.pi ** (d / 2) / math.gamma(d / 2 + 1)
    W = np.broadcast_to(square(model.W), (len(t), d, d))
    size = np.abs(np.linalg.det(W))
    spread = np.sqrt(np.linalg.det(np.eye(d) + C)) / np.where(size > 0, size, 1.0)
    possible = (size > 0) & (room > 0)
    return np.where(possible, ball * t ** (d / 2) * spread / (room if room > 0 else 1.0), np.inf)


def _room(batch: Batch, values: Values) -> float:
    """Volume of the possible measurements of a kind, m and rad: lengths within the map, or within those measured."""
    model, space = batch.model, batch.model.space
    group = space in (SE3, SO3)
    where = model.manifolds[0].position(values.stacks[batch.kinds[0]].X)
    extent = float(np.ptp(where, axis=0).max(initial=0.0))
    room = 8 * math.pi**2 if group else 1.0
    for name in model.names:
        if unit(name) == "rad":
            room *= 1.0 if group else 2 * math.pi
        else:
            room *= max(extent, float(np.ptp(model.z[:, space.components.index(name)])))
    return room
