"""Checks of fixes.csv beside the way by the DVL: fixes that are far away, and fixes that jump."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nls.io.mission.plausible.findings import Cause, Implausible, Reading
from nls.io.mission.plausible.log import Fixes, Log, middle

__all__ = ["of_fixes"]
FARTHEST = 1e5  # m from x = y = 0: where the plane is no map any more
FAR, SHARE, FEW_ROWS = 10.0, 0.02, 10
DRIFT = 0.1  # of the way between three fixes


def of_fixes(log: Log) -> list[Implausible]:
    """Implausible fixes of a log; lines are rows of the table."""
    return [] if log.fixes is None else [*_far(log.fixes), *_jumps(log)]


def _far(fixes: Fixes) -> Iterator[Implausible]:
    """Fixes beyond the plane: another origin, or latitude and longitude exchanged."""
    away = np.linalg.norm(fixes.p, axis=1)
    if (distance := float(np.median(away))) <= FARTHEST:
        return
    columns, cause = ", ".join(fixes.columns), Cause.FAR
    if fixes.exchanged is not None and np.median(np.linalg.norm(fixes.exchanged, axis=1)) < FARTHEST:
        cause = Cause.SWAPPED
    row = int(fixes.rows[np.argmax(away > FARTHEST)])
    reading = Reading(cause, "fixes.csv", columns)
    yield Implausible("far away", "fixes.csv", row, fixes.columns[0], distance, FARTHEST, "m", (reading,))


def _jumps(log: Log) -> Iterator[Implausible]:
    """Single fixes that leave those before and after, which the DVL joins."""
    fixes = log.fixes
    assert fixes is not None
    thin = log.thinned()
    if len(fixes.t) < FEW_ROWS:
        return
    way = thin.way()[:, :2]
    d = np.column_stack([np.interp(fixes.t, thin.t_v, column) for column in way.T])
    off = fixes.p - d
    away = np.linalg.norm(off - middle(off), axis=1)
    step = np.linalg.norm(np.diff(d, axis=0), axis=1)
    allowed = FAR * fixes.sigma + DRIFT * (np.append(step, 0.0) + np.append(0.0, step))
    wild = away > np.maximum(allowed, 3 * float(np.median(away)))
    wild &= (fixes.t >= thin.t_v[0]) & (fixes.t <= thin.t_v[-1])
    if wild.mean() > SHARE:
        row = int(fixes.rows[np.argmax(wild)])
        reading = Reading(Cause.OUTLIERS, "fixes.csv", ", ".join(fixes.columns))
        yield Implausible("jumps", "fixes.csv", row, fixes.columns[0], wild.mean(), SHARE, "of the rows", (reading,))
