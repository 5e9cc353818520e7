r"""Does the DVL agree with the depth, and if not, how must a sensor of a raw log be read?

Over windows of time the way down by the DVL, turned by the attitude, repeats the depth. No graph compares the two. The
misfit of a log is, relative to the way itself and to the noise,

    m = rms(r - mean r) / rms(dz - mean dz),    r = dz - dD        n = max(sqrt(2) sigma_z / rms dz, FLOOR)

(The mean of r is the error of a pitch.) A log that does not dive beyond its noise says nothing. Where (m / n)^2 is
above `DOUBT`, every reading of the log, with another unit, sign, frame or clock, is tried. Those that bring it below a
`CURED` part, and are not much above the best of them, are named.

A clock that is late by dt looks like a lever arm of v dt. Where that is below `ARM`, which a vehicle may have, no cause
is named.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Mask
from models.dead_reckoning.drop_outs import longest_step
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Log
from nls.missions.checks.readings import Alternative, alternatives, corrected

WINDOW = 10.0  # s
FLOOR = 0.04  # relative misfit of a right log: scale, mounting, drop-outs, lever arms
DOUBT, CURED, TIE = 3.5, 1 / 3, 1.6
ARM = 5.0  # m
SCALED = 0.2  # relative misfit that a reading leaves: a right log had 0.16, by a DVL whose mounting is off


def of_way_down(log: Log) -> list[Implausible]:
    """What is wrong where DVL, attitude and depth do not fit each other; lines are rows, counted from 0."""
    named, wrong = 0.1, 0.5  # relative misfits from which it is named with a reading, and without one
    windows, noise = _windows(log)
    m = _misfit(log, windows)
    readings = _explained(log, windows, m, noise) if m > named else []
    limit = max(named, float(np.sqrt(DOUBT) * noise))
    if not readings and m > wrong:
        readings, limit = [Reading(Cause.UNKNOWN, "depth.csv", "z_m")], wrong
    if not readings:
        return []
    first = readings[0]
    return [Implausible("way down", first.file, 0, first.columns[0], m, limit, "of the way", tuple(readings[:3]))]


def _windows(log: Log) -> tuple[Array, float]:
    """Times of the windows (k, 2), none where the depth does not change; and n."""
    begin, end = (f(log.t_v[k], log.t_z[k], log.t_a[k]) for f, k in ((max, 0), (min, -1)))
    if not 0 < end - begin < np.inf:
        return np.zeros((0, 2)), 1.0
    edges = begin + WINDOW * np.arange(min(int((end - begin) / WINDOW), 20_000) + 1)
    both = np.stack([edges[:-1], edges[1:]], axis=1)
    holes = [(log.t_v, 0.5 * WINDOW), *((t, max(longest_step(t), 1.0)) for t in (log.t_a, log.t_z))]
    for t, longest in holes:  # s without bottom lock, attitude or depth
        both = both[~_over_a_hole(both, t, longest)]
    if len(both) < 4:
        return both[:0], 1.0
    rms, sigma = float(np.std(_ways(both, log.t_z, log.z))), np.sqrt(2) * log.sigmas["sigma_z_m"]
    if rms < max(4.0 * sigma, 0.2):  # m: the vehicle does not dive
        return both[:0], 1.0
    return both, max(sigma / rms, FLOOR)


def _over_a_hole(windows: Array, t: Array, longest: float) -> Mask:
    """Windows (k, 2) with more time than the longest between two of the times t (n,)."""
    holes = np.concatenate([[0], np.cumsum(np.diff(t) > longest), [0]])
    holes[-1] = holes[-2]
    begin = np.searchsorted(t, windows[:, 0], side="right") - 1
    return np.asarray(holes[np.searchsorted(t, windows[:, 1])] > holes[np.maximum(begin, 0)])


def _ways(windows: Array, t: Array, z: Array) -> Array:
    """Ways (k,) down over the windows."""
    return np.asarray(np.diff(np.interp(windows, t, z), axis=1)[:, 0])


def _misfit(log: Log, windows: Array) -> float:
    """m; 0 where there are no windows."""
    if not len(windows):
        return 0.0
    dz = _ways(windows, log.t_z, log.z)
    return float(np.std(dz - _ways(windows, log.t_v, log.way()[:, 2])) / np.std(dz)) if np.std(dz) > 0 else np.inf


def _explained(log: Log, windows: Array, m: float, noise: float) -> list[Reading]:
    """The readings that explain a misfit."""
    S = (m / noise) ** 2
    if not S > DOUBT:
        return []

    def score(a: Alternative) -> float:
        return (_misfit(a.on_log(log), windows) / noise) ** 2

    ways = alternatives()
    clocks = [a for a in ways if a.reading.cause is Cause.CLOCK]
    scored = [(score(a), a.reading) for a in ways if a not in clocks]
    if not any(s <= TIE for s, _ in scored):  # nothing is left for a clock to explain
        scored += [(score(a), a.reading) for a in clocks]
    scored.sort(key=lambda pair: pair[0])
    best = scored[0][0]
    if best > CURED * S or np.sqrt(best) * noise > SCALED:  # the scale of the depth, where that explains it
        dz, dD = _ways(windows, log.t_z, log.z), _ways(windows, log.t_v, log.way()[:, 2])
        slope = float(dz @ dD) / max(float(dD @ dD), 1e-9)
        reading = Reading(Cause.SCALE, "depth.csv", "z_m", slope)
        scaled = 0.5 < slope < 2 and np.sqrt(S) * noise > SCALED and score(corrected(reading)) <= CURED * S
        return [reading] if scaled else []
    near: dict[tuple[str, ...], Reading] = {}
    for s, reading in scored:
        if s <= TIE * max(best, 1.0):
            near.setdefault((reading.cause, reading.file, reading.column), reading)
    arm = ARM / max(float(np.median(np.linalg.norm(log.v, axis=1))), 1e-9)
    first = next(iter(near.values()))
    return [] if first.cause is Cause.CLOCK and abs(first.factor) < arm else [*near.values()]
