"""Checks of fixes.csv beside the way by the DVL: fixes that are far away, and fixes that jump."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Mask
from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.checks.log import Fixes, Log, middle

__all__ = ["jumping", "of_fixes"]
FARTHEST = 1e5  # m from x = y = 0: where the plane is no map any more; a voyage may be longer
FAR, SHARE, FEW_ROWS = 10.0, 0.02, 10
DRIFT = 0.1  # of the way between three fixes


def of_fixes(fixes: Fixes | None, wild: Mask) -> list[Implausible]:
    """Implausible fixes, of which some (n,) are `jumping`; lines are rows of the table."""
    return [] if fixes is None else [*_far(fixes), *_jumps(fixes, wild)]


def _far(fixes: Fixes) -> Iterator[Implausible]:
    """Fixes beyond the plane: another origin, latitude and longitude exchanged, or the letter of a side lost."""
    away = np.linalg.norm(fixes.p, axis=1)
    low, high = np.quantile(fixes.p, [0.05, 0.95], axis=0)
    if (distance := float(np.median(away))) <= max(FARTHEST, float(np.linalg.norm(high - low))):
        return
    near = [reading for reading, p in fixes.others if np.median(np.linalg.norm(p, axis=1)) < FARTHEST]
    reading = next(iter(near), Reading(Cause.FAR, "fixes.csv", ", ".join(fixes.columns)))
    row = int(fixes.rows[np.argmax(away > FARTHEST)])
    yield Implausible("far away", "fixes.csv", row, fixes.columns[0], distance, FARTHEST, "m", (reading,))


def _jumps(fixes: Fixes, wild: Mask) -> Iterator[Implausible]:
    """So many single fixes leave those before and after that a robust kernel is needed."""
    if wild.any() and wild.mean() > SHARE:
        row = int(fixes.rows[np.argmax(wild)])
        reading = Reading(Cause.OUTLIERS, "fixes.csv", ", ".join(fixes.columns))
        yield Implausible("jumps", "fixes.csv", row, fixes.columns[0], wild.mean(), SHARE, "of the rows", (reading,))


def jumping(log: Log) -> Mask:
    """Single fixes (n,) of a thinned log that leave those before and after, which the DVL joins; none of a few."""
    fixes = log.fixes
    if fixes is None or len(fixes.t) < FEW_ROWS:
        return np.zeros(0 if fixes is None else len(fixes.t), dtype=bool)
    d = np.column_stack([np.interp(fixes.t, log.t_v, column) for column in log.way()[:, :2].T])
    off = fixes.p - d
    away = np.linalg.norm(off - middle(off), axis=1)
    step = np.linalg.norm(np.diff(d, axis=0), axis=1)
    allowed = FAR * fixes.sigma + DRIFT * (np.append(step, 0.0) + np.append(0.0, step))
    wild = away > np.maximum(allowed, 3 * float(np.median(away)))
    return np.asarray(wild & (fixes.t >= log.t_v[0]) & (fixes.t <= log.t_v[-1]))
