"""Faults of real measurements: so far, loop closures between places that only look alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors import Between
from models import LieGroup
from models.algebra import Mask
from models.errors import OptionError
from nls import FactorGraph, kinds
from sim.checks import check_not_negative, check_rng
from sim.world import World

__all__ = ["outliers"]

GROUP = 5  # closures in a row that one mistaken place yields
WRONG = 10.0  # whitened distance from the truth below which a drawn closure could pass for a right one


def outliers(world: World, fraction: float, rng: np.random.Generator, grouped: bool = False) -> tuple[World, Mask]:
    r"""Add wrong loop closures: two random poses said to be related as two others truly are.

    A measured z of a right closure is claimed for a random pair (i, j). Grouped, the mistake lasts for five poses in a
    row, with measurements that agree with each other,

    .. math:: z_k = x_{i+k}^{-1} \, G \, x_{j+k}, \quad G = x_i z x_j^{-1}

    which is harder to see through.

    Parameters
    ----------
    world : the world to spoil; not changed.
    fraction : wrong closures per right one, at least 0: 0.1 adds one for every ten.
    rng : source of the mistakes.
    grouped : five wrong closures in a row for each mistake.

    Returns
    -------
    world : with the wrong closures appended to ``graph.factors[1]``, weighted like the right ones.
    wrong : (m,) which of the m measurements of the graph are wrong, in its order (odometry, then closures).

    Raises
    ------
    OptionError
        A fraction below 0, a world without closures, or too small a world for wrong closures to differ from right ones.

    Notes
    -----
    Source: N. Suenderhauf, P. Protzel, "Switchable constraints for robust pose graph SLAM", IROS 2012, section V.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.ring(np.random.default_rng(1), laps=2, per_lap=60)
    >>> spoiled, wrong = sim.outliers(world, 0.2, np.random.default_rng(2))
    >>> int(wrong.sum()) == round(0.2 * world.closures) == len(spoiled.graph) - len(world.graph)
    True
    >>> spoiled.graph.chi2(world.truth) > 10 * world.graph.chi2(world.truth)
    True
    """
    check_rng(rng)
    check_not_negative(fraction=fraction)
    odometry, closures = world.graph.factors
    count = round(fraction * len(closures))
    wrong = np.arange(len(world.graph) + count) >= len(world.graph)
    if fraction > 0 and not len(closures):
        raise OptionError("fraction", fraction, "0 for a world without loop closures")
    if not count:
        return world, wrong
    (x,) = kinds("x")
    stack = world.truth.stack("x")
    group, X, n = stack.manifold, stack.X, len(stack)
    assert isinstance(group, LieGroup)
    z_right = group.stack(closures.z)
    run = min(GROUP, count) if grouped else 1
    drawn = 4 * -(-count // run) + 20  # mistakes to choose from
    i, j = rng.integers(0, n - run + 1, size=(2, drawn))
    z = z_right[rng.integers(0, len(z_right), size=drawn)]
    usable = np.abs(i - j) >= max(run, 2)
    i, j, z = i[usable], j[usable], z[usable]
    G = group.compose(group.compose(X[i], z), group.inverse(X[j]))
    G = np.repeat(G, run, axis=0)
    i = np.repeat(i, run) + np.tile(np.arange(run), len(i))
    j = np.repeat(j, run) + np.tile(np.arange(run), len(j))
    z = group.between(X[i], group.compose(G, X[j]))  # (mistakes * run, size)
    b = Between(x[i], x[j], z, closures.noise).bind(group, group).error(X[i], X[j])  # (mistakes * run, dim), whitened
    far = (np.linalg.norm(b, axis=1) > WRONG).reshape(-1, run).all(axis=1).repeat(run)
    i, j, z = i[far][:count], j[far][:count], z[far][:count]
    if len(i) < count:
        raise OptionError("fraction", fraction, f"less for a world of {n} poses: too few pairs are far from the truth")
    right = (*(keys.numbers for keys in closures.keys), z_right)
    i, j, z = (np.concatenate(pair) for pair in zip(right, (i, j, z), strict=True))
    right_and_wrong = Between(x[i], x[j], z, closures.noise, closures.convention)
    description = f"{world.description} {count} wrong loop closures were added{f', {run} in a row' if grouped else ''}."
    return replace(world, graph=FactorGraph([odometry, right_and_wrong]), description=description), wrong
