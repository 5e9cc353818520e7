"""Faults of a sonar mission: contacts that are lost, false or taken for a neighbor's, and poor odometry.

Each function returns another mission; `Mission.wrong` says which of its contacts are wrong. The others are untouched.
"""

from __future__ import annotations

import numpy as np

from factors import XYH, Diagonal, RangeAzimuth
from models.algebra import Array, Index, wrap
from models.errors import OptionError
from sim.checks import check_fraction, check_rng
from sim.mission import FEWEST, SIGMA_SONAR, Mission, rebuilt

__all__ = ["drop_contacts", "exchange_contacts", "false_contacts", "poor_odometry"]

WRONG = 10.0  # whitened distance below which a wrong contact could pass for a right one
APART = 1e6  # whitened distance put between two images, so that neighbors are those of one image


def drop_contacts(mission: Mission, drop_outs: float, rng: np.random.Generator) -> Mission:
    """Lose contacts at random; landmarks with fewer than three left leave the mission, the others keep their numbers.

    Parameters
    ----------
    mission : not changed.
    drop_outs : part of the contacts that is lost, from 0 to 1.
    rng : which ones.

    Raises
    ------
    OptionError
        A fraction outside 0 to 1, or one that leaves no landmark.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> fewer = sim.drop_contacts(mission, 0.5, np.random.default_rng(2))
    >>> 0.3 < len(fewer.contacts) / len(mission.contacts) <= 0.5
    True
    """
    check_rng(rng)
    check_fraction(drop_outs=drop_outs)
    lost = _drawn(rng, np.arange(len(mission.contacts)), round(drop_outs * len(mission.contacts)))
    if not len(lost):
        return mission
    mask = np.ones(len(mission.contacts), dtype=bool)
    mask[lost] = False
    landmark = mission.contacts.keys[1].numbers
    landmarks, counts = np.unique(landmark[mask], return_counts=True)
    mask &= np.isin(landmark, landmarks[counts >= FEWEST])
    if not mask.any():
        raise OptionError("drop_outs", drop_outs, f"less: no landmark keeps {FEWEST} contacts")
    contacts = mission.contacts[np.flatnonzero(mask)]
    assert isinstance(contacts, RangeAzimuth)
    note = f"{len(lost)} contacts were lost, {len(contacts)} are left of landmarks with three or more."
    return rebuilt(mission, contacts=contacts, wrong=mission.wrong[mask], note=note)


def false_contacts(mission: Mission, outliers: float, rng: np.random.Generator) -> Mission:
    """Replace contacts by false ones anywhere in the image, ten standard deviations or more from the landmark.

    Parameters
    ----------
    mission : not changed.
    outliers : part of the contacts, from 0 to 1; only those not yet wrong are replaced.
    rng : which ones, and by what.

    Raises
    ------
    OptionError
        A fraction outside 0 to 1, or more than there are right contacts.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> spoiled = sim.false_contacts(mission, 0.1, np.random.default_rng(2))
    >>> int(spoiled.wrong.sum()) == round(0.1 * len(mission.contacts))
    True
    >>> spoiled.graph.chi2(mission.truth) > 10 * mission.graph.chi2(mission.truth)
    True
    """
    check_rng(rng)
    check_fraction(outliers=outliers)
    right, count = np.flatnonzero(~mission.wrong), round(outliers * len(mission.contacts))
    if count > len(right):
        raise OptionError("outliers", outliers, f"less: of {len(mission.contacts)} contacts {len(right)} are right")
    if not count:
        return mission
    chosen = _drawn(rng, right, count)
    z, sonar = mission.contacts.z.copy(), mission.sonar
    true, todo = z[chosen], np.arange(len(chosen))
    half = np.array([0.0, sonar.fan / 2])
    low, high = np.array([sonar.window[0], 0.0]) - half, np.array([sonar.window[1], 0.0]) + half
    while len(todo):  # one draw in a hundred and fifty is near the truth
        z[chosen[todo]] = rng.uniform(low, high, size=(len(todo), 2))
        todo = todo[_apart(z[chosen[todo]], true[todo]) < WRONG]
    return _with_contacts(mission, z, chosen, f"{len(chosen)} contacts are false, anywhere in the image.")


def exchange_contacts(mission: Mission, wrong_associations: float, rng: np.random.Generator) -> Mission:
    """Exchange contacts of neighbors in the image of one pose: each is said to be of the other's landmark.

    Only pairs that are nearest to each other are exchanged, ten standard deviations or more apart.

    Parameters
    ----------
    mission : not changed.
    wrong_associations : part of the contacts, from 0 to 1; a pair counts as two.
    rng : which ones.

    Raises
    ------
    OptionError
        A fraction outside 0 to 1, or more than there are such pairs.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> spoiled = sim.exchange_contacts(mission, 0.1, np.random.default_rng(2))
    >>> int(spoiled.wrong.sum()) == 2 * round(0.05 * len(mission.contacts))
    True
    """
    from scipy.spatial import cKDTree

    check_rng(rng)
    check_fraction(wrong_associations=wrong_associations)
    count = round(wrong_associations * len(mission.contacts) / 2)
    if not count:
        return mission
    z = mission.contacts.z.copy()
    place = np.column_stack([z / SIGMA_SONAR, APART * mission.contacts.keys[0].numbers])
    distance, nearest = (column[:, 1] for column in cKDTree(place).query(place, k=2))
    a = np.arange(len(z))
    pairs = (nearest[nearest] == a) & (a < nearest) & (distance >= WRONG) & (distance < APART / 2)
    a = np.flatnonzero(pairs & ~mission.wrong & ~mission.wrong[nearest])
    if count > len(a):
        raise OptionError("wrong_associations", wrong_associations, f"less: there are {len(a)} pairs of neighbors")
    a = _drawn(rng, a, count)
    changed, exchanged = np.concatenate([a, nearest[a]]), np.concatenate([nearest[a], a])
    z[changed] = z[exchanged]
    return _with_contacts(mission, z, changed, f"{len(changed)} contacts are exchanged with that of a neighbor.")


def poor_odometry(mission: Mission, fraction: float, rng: np.random.Generator, times: float = 10.0) -> Mission:
    """Make steps of the odometry `times` as noisy, as where a velocity log loses the bottom; their weights say so.

    Parameters
    ----------
    mission : not changed.
    fraction : part of the steps, from 0 to 1.
    rng : which ones, and the noise.
    times : factor on their standard deviations, above 1.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=12)
    >>> poor = sim.poor_odometry(mission, 0.2, np.random.default_rng(2))
    >>> poor.ate(poor.start) > mission.ate(mission.start)
    True
    """
    check_rng(rng)
    check_fraction(fraction=fraction)
    if not times > 1:
        raise OptionError("times", times, "a number above 1")
    n = len(mission.odometry)
    chosen = _drawn(rng, np.arange(n), round(fraction * n))
    z = mission.odometry.z.copy()
    sigmas = np.array(np.broadcast_to(1 / mission.odometry.noise.sqrt_information(n, ("x", "y", "yaw")), (n, 3)))
    # the noise that is there stays: variances add
    z[chosen] += np.sqrt(times**2 - 1) * sigmas[chosen] * rng.standard_normal((len(chosen), 3))
    z[:, 2] = wrap(z[:, 2])
    sigmas[chosen] *= times
    i, j = mission.odometry.keys
    note = f"{len(chosen)} steps of the odometry are {times:g} times as noisy."
    return rebuilt(mission, odometry=XYH(i, j, z, Diagonal(sigmas), mission.odometry.form), note=note)


def spoiled(
    mission: Mission, rng: np.random.Generator, drop_outs: float, outliers: float, wrong_associations: float
) -> Mission:
    """`drop_contacts`, `exchange_contacts` and `false_contacts`, one after the other."""
    mission = drop_contacts(mission, drop_outs, rng)
    mission = exchange_contacts(mission, wrong_associations, rng)
    return false_contacts(mission, outliers, rng)


def _drawn(rng: np.random.Generator, of: Index, count: int) -> Index:
    """Some of these numbers, in their order."""
    return np.sort(rng.choice(of, size=count, replace=False))


def _apart(z: Array, y: Array) -> Array:
    """Whitened distances (n,) of contacts."""
    d = z - y
    d[:, 1] = wrap(d[:, 1])
    return np.asarray(np.linalg.norm(d / SIGMA_SONAR, axis=1))


def _with_contacts(mission: Mission, z: Array, chosen: Index, note: str) -> Mission:
    """The mission with contacts z of which the chosen ones are wrong."""
    pose, target = mission.contacts.keys[:2]
    contacts = RangeAzimuth(pose, target, z, mission.contacts.noise, mission.offset)
    wrong = mission.wrong.copy()
    wrong[chosen] = True
    return rebuilt(mission, contacts=contacts, wrong=wrong, note=note)
