r"""Single measurements that fit when they are read otherwise: exchanged variables, a transposed rotation, a sign.

Measurement i is compared with the optimum of all others. With the covariance C of what they predict of it as it was
meant, in units of its noise,

    t = e' (I + C)^-1 e  ~  chi2(m)
    p = V_m t^(m/2) det(W^-1 (I + C) W^-T)^(1/2) / room

p is the chance that a measurement drawn at random from the room of its kind fits as well; V_m is the volume of the unit
ball in m dimensions. The room of an angle is a turn, that of a rotation 8 pi^2, that of a length the extent of the map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors.base import Model
from factors.noise import square
from models import SE3, SO3
from models.algebra import Array
from models.manifolds.units import unit
from nls.analysis.alternatives import UNLIKELY
from nls.analysis.chi_squared import chi2_tail, mahalanobis
from nls.analysis.linearization import Checked, Linearization
from nls.analysis.readings import READINGS
from nls.analysis.suspects import weights_without
from nls.sparse.pattern import Batch, Pattern, measuring
from nls.values import Values

__all__ = ["misread_measurements"]

FAR = 100.0  # squared sigmas of a measurement that is wrong and not only poor


@dataclass(frozen=True)
class MisreadMeasurement:
    """A measurement that fits when it is read otherwise, and not as it stands.

    Attributes
    ----------
    place : number of the factor, index of the measurement.
    reading : a name of `nls.analysis.readings`.
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
        In the order of the places, then of t; several of one place where nothing tells its readings apart.

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
    meant = []  # (number of the factor, reading, factor)
    for k, indices in doubtful.items():
        for reading, read in READINGS.items():
            factor = read(pattern.batches[k].model)
            if factor is not None:
                meant.append((k, reading, factor[indices]))
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
            if standing[k][i] >= FAR:
                out.append(MisreadMeasurement((k, i), name, float(standing[k][i]), float(t[row])))
    return tuple(sorted(out, key=lambda misread: (list(places).index(misread.place), misread.t)))


def _distances(checked: Checked, k: int) -> Array:
    """t (n,) of the measurements of a batch that do not count: e' (I + C)^-1 e."""
    return mahalanobis(checked.e[k], np.eye(checked.e[k].shape[1]) + checked.C[k])


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
