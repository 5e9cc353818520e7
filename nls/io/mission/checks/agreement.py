r"""Do the sensors of a raw log agree with each other, and if not, how must one of them be read?

Over windows of time the DVL, turned by the attitude, repeats other sensors. Its way down repeats the depth, its way
north and east the fixes. The misfit of a log is, relative to the way itself and to the noise,

    m_z = rms(r - mean r) / rms(dz - mean dz),   r = dz - dD        n_z = max(sqrt(2) sigma_z / rms dz, FLOOR)
    m_p = median |dp - dd| / median |dp|                            n_p = max(median sigma_p / median |dp|, FLOOR)
    S   = (m_z / n_z)^2 + (m_p / n_p)^2

(The mean of r is the error of a pitch; the median leaves out wrong fixes.) A pair without motion beyond its noise is
left out. Where S is above `DOUBT`, every reading of the log, with another unit, sign, frame or clock, is tried. Those
that bring S below a `CURED` part of it, and are not much above the best of them, are named.

A clock that is late by dt looks like a lever arm of v dt. Where that is below `ARM`, which a vehicle may have, no cause
is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index, Mask
from models.dead_reckoning.drop_outs import longest_step
from nls.io.mission.checks.findings import Cause, Reading
from nls.io.mission.checks.log import Log
from nls.io.mission.checks.readings import Alternative

__all__ = ["Comparison", "compared", "doubtful", "explained"]
WINDOW = 10.0  # s, of the way down
MOST = 20_000  # windows
LONGEST = 0.5  # of a window: the time without bottom lock that it may have
SHORT = 1.0  # s without attitude or depth
FEWEST = 4  # windows
CLEAR = 8.0  # sigmas that the middle way from fix to fix has
MOVING = 4.0  # sigmas that the rms way down has
LEAST = 0.2  # m, of the rms way down
FLOOR = 0.04  # relative misfit of a right log: scale, mounting, drop-outs, lever arms
DOUBT, CURED, TIE = 3.5, 1 / 3, 1.6
ARM = 5.0  # m
MISFIT = 0.1  # relative misfit that may be named, with its reading
WRONG = 0.5  # relative misfit that needs no reading to be named


@dataclass(frozen=True)
class Comparison:
    """Where windows begin and end.

    Attributes
    ----------
    down : (k,) times of the windows of the way down, (k, 2); none where the depth does not change.
    fixes : numbers of the fixes at the ends of windows.
    noise : n_z and n_p.
    """

    down: Array
    fixes: Index
    noise: tuple[float, float]


def compared(log: Log) -> Comparison:
    """The windows of a log as it is read."""
    down, n_z = _windows_down(log)
    fixes, n_p = _windows_of_fixes(log)
    return Comparison(down, fixes, (n_z, n_p))


def _windows_down(log: Log) -> tuple[Array, float]:
    begin, end = (f(log.t_v[k], log.t_z[k], log.t_a[k]) for f, k in ((max, 0), (min, -1)))
    if not 0 < end - begin < np.inf:
        return np.zeros((0, 2)), 1.0
    edges = begin + WINDOW * np.arange(min(int((end - begin) / WINDOW), MOST) + 1)
    both = np.stack([edges[:-1], edges[1:]], axis=1)
    for t, longest in (
        (log.t_v, LONGEST * WINDOW),
        (log.t_a, max(longest_step(log.t_a), SHORT)),
        (log.t_z, max(longest_step(log.t_z), SHORT)),
    ):
        both = both[~_over_a_hole(both, t, longest)]
    if len(both) < FEWEST:
        return both[:0], 1.0
    dz = np.diff(np.interp(both, log.t_z, log.z), axis=1)[:, 0]
    rms, sigma = float(np.std(dz)), np.sqrt(2) * log.sigmas["sigma_z_m"]
    if rms < max(MOVING * sigma, LEAST):
        return both[:0], 1.0
    return both, max(sigma / rms, FLOOR)


def _over_a_hole(windows: Array, t: Array, longest: float) -> Mask:
    """Windows (k, 2) with more time than the longest between two of the times t (n,)."""
    holes = np.concatenate([[0], np.cumsum(np.diff(t) > longest), [0]])
    holes[-1] = holes[-2]
    begin = np.searchsorted(t, windows[:, 0], side="right") - 1
    return np.asarray(holes[np.searchsorted(t, windows[:, 1])] > holes[np.maximum(begin, 0)])


def _windows_of_fixes(log: Log) -> tuple[Index, float]:
    """Fixes so far apart that the way between them is clear of their noise; none where there are no such."""
    none = np.zeros(0, dtype=np.intp)
    if log.fixes is None:
        return none, 1.0
    t = log.fixes.t
    inside = np.flatnonzero((t >= max(log.t_v[0], log.t_a[0])) & (t <= min(log.t_v[-1], log.t_a[-1])))
    if len(inside) <= FEWEST:
        return none, 1.0
    window = WINDOW
    if t[inside[-1]] - t[inside[0]] > MOST * WINDOW:
        window = float((t[inside[-1]] - t[inside[0]]) / MOST)
    while window < (t[inside[-1]] - t[inside[0]]) / FEWEST:
        chosen = inside[np.unique(np.searchsorted(t[inside], np.arange(t[inside[0]], t[inside[-1]], window)))]
        if len(chosen) <= FEWEST:
            break
        both = _ways(log, chosen, log.way())
        by_fixes, by_dvl = (float(np.median(np.linalg.norm(way, axis=1))) for way in both)
        sigma = float(np.median(np.hypot(log.fixes.sigma[chosen[1:]], log.fixes.sigma[chosen[:-1]])))
        if max(by_fixes, by_dvl) > CLEAR * sigma:
            return chosen, max(sigma / (by_fixes if by_fixes > CLEAR * sigma else by_dvl), FLOOR)
        window *= 2
    return none, 1.0


def misfits(log: Log, windows: Comparison) -> tuple[float, float]:
    """m_z and m_p of a log; nan where there are no windows."""
    way, m_z, m_p = log.way(), np.nan, np.nan
    if len(windows.down):
        dz = np.diff(np.interp(windows.down, log.t_z, log.z), axis=1)[:, 0]
        dD = np.diff(np.interp(windows.down, log.t_v, way[:, 2]), axis=1)[:, 0]
        m_z = float(np.std(dz - dD) / np.std(dz)) if np.std(dz) > 0 else np.inf
    if len(windows.fixes):
        dp, dd = _ways(log, windows.fixes, way)
        length = float(np.median(np.linalg.norm(dp, axis=1)))
        m_p = float(np.median(np.linalg.norm(dp - dd, axis=1)) / length) if length > 0 else np.inf
    return m_z, m_p


def _ways(log: Log, chosen: Index, way: Array) -> tuple[Array, Array]:
    """The ways from fix to fix, by the fixes and by the DVL, (k, 2) both."""
    assert log.fixes is not None
    t = log.fixes.t[chosen]
    d = np.column_stack([np.interp(t, log.t_v, column) for column in way[:, :2].T])
    return np.diff(log.fixes.p[chosen], axis=0), np.diff(d, axis=0)


def score(m: tuple[float, float], noise: tuple[float, float]) -> float:
    """S."""
    return float(np.nansum(np.square(np.array(m) / np.array(noise))))


def explained(
    log: Log, windows: Comparison, alternatives: Sequence[Alternative]
) -> tuple[tuple[float, float], tuple[Reading, ...]]:
    """The misfits of a log, and the readings that explain them: none where it fits, or nothing explains it."""
    before = misfits(log, windows)
    S = score(before, windows.noise)
    if not DOUBT < S or not np.nanmax(before) > MISFIT:
        return before, ()
    clocks = [a for a in alternatives if a.reading.cause is Cause.CLOCK]
    scored = _scored(log, windows, [a for a in alternatives if a not in clocks])
    if not any(s <= TIE for s, _ in scored):  # nothing is left for a clock to explain
        scored += _scored(log, windows, clocks)
    best = min((s for s, _ in scored), default=np.inf)
    if best > CURED * S:
        return before, ()
    near: dict[tuple[str, ...], Reading] = {}
    for s, a in sorted(scored, key=lambda pair: pair[0]):
        if s <= TIE * max(best, 1.0):
            near.setdefault((a.reading.cause, a.reading.file, a.reading.column), a.reading)
    arm = ARM / max(float(np.median(np.linalg.norm(log.v, axis=1))), 1e-9)
    first = next(iter(near.values()))
    return before, () if first.cause is Cause.CLOCK and abs(first.factor) < arm else tuple(near.values())


def _scored(log: Log, windows: Comparison, alternatives: Sequence[Alternative]) -> list[tuple[float, Alternative]]:
    """S of every alternative."""
    return [(score(misfits(a.on_log(log), windows), windows.noise), a) for a in alternatives]


def doubtful(m: tuple[float, float], windows: Comparison) -> tuple[int, float]:
    """Which of the two misfits is the larger one beside its noise, 0 or 1, and the limit it is beyond."""
    ratio = np.nan_to_num(np.array(m) / np.array(windows.noise))
    worst = int(np.argmax(ratio))
    return worst, max(MISFIT, float(np.sqrt(DOUBT / 2) * windows.noise[worst]))
