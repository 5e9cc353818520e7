r"""Clocks of fixes, ranges and directions that are late by an unknown time: a variable of calibration.csv.

A row measured c before its time belongs to the pose at t - c. The pose of the row is that at t_0 = t - c_0, with c_0 of
calibration.csv, so to first order in c - c_0

    h(X(t - c)) = h(X(t_0)) + G (c - c_0),   G = -dh/dt = -sum H_k xi_k

with the twist xi of the vehicle by dead reckoning, that of the ship by ship.csv. With z + G c_0 instead of z this is a
`factors.Shifted`.
"""

from __future__ import annotations

import numpy as np

from factors.base import Factor
from factors.keys import kinds
from models import SE3
from models.algebra import Array, apply
from nls.missions.folder.rows import Assembly
from nls.missions.folder.timeline import Timeline
from nls.values import Values

CLOCKED = ("fixes", "ranges", "usbl")
x, s = kinds("x", "s")


def shift_clocks(mission: Assembly, timeline: Timeline, start: Values, ship: Array) -> None:
    """Put the factors of every file whose clock is a variable under a `Shifted` of that variable, each in its place.

    Parameters
    ----------
    mission, timeline : whose factors are replaced.
    start : poses whose track gives the rates.
    ship : (k, 6) twists of the ship at its poses, in its own axes.
    """
    moving = {s.name: ship}
    for name in CLOCKED:
        clock = f"{name}_clock_s"
        if name not in mission.times or mission.calibrations.variable(clock) is None:
            continue
        if x.name not in moving:
            moving[x.name] = twists(start[x], timeline.at(start.stack(x).numbers))
        factors = mission.graph.factors
        for k, source in enumerate(mission.report.sources):
            if source.path == mission.tables[name].path:
                G = -total(rates_by_time(factors[k], start, moving))
                factors[k] = mission.calibrations.shifted(factors[k], clock, G)


def rates_by_time(factor: Factor, values: Values, moving: dict[str, Array]) -> dict[str, Array]:
    """Rates dh/dt (n, m) of measurements, from each kind that moves with twists (k, 6)."""
    model, X = values.gather(factor)
    H = factor.predict(model.manifolds, *X)[1]
    assert H is not None
    return {
        keys.kind: apply(np.asarray(block), moving[keys.kind][values.stack(keys.kind).index(keys)])
        for keys, block in zip(factor.keys, H, strict=True)
        if keys.kind in moving
    }


def total(rates: dict[str, Array]) -> Array:
    """Rates (n, m) of measurements from all kinds."""
    return np.asarray(np.sum(list(rates.values()), axis=0))


def twists(X: Array, t: Array) -> Array:
    """Body twists (n, 6) of poses (n, 7) at times (n,), m/s and rad/s: over the legs before and after."""
    times, first, of = np.unique(t, return_index=True, return_inverse=True)
    if len(times) == 1:
        return np.zeros((len(t), SE3.dim))
    X, dt = X[first], np.diff(times)
    step = SE3.local(X[:-1], X[1:])
    zero = np.zeros((1, SE3.dim))
    both = np.concatenate([step, zero]) + np.concatenate([zero, step])
    return np.asarray((both / (np.append(dt, 0.0) + np.append(0.0, dt))[:, None])[of])
