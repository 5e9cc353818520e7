"""Checks of sound-speed.csv."""

from __future__ import annotations

import numpy as np

from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.table import Table

__all__ = ["sound_speeds"]
SLOWEST, FASTEST = 1400.0, 1600.0  # m/s, of fresh water at 0 deg C and of the Red Sea or the deepest trench
UNITS = (3.2808, 1e3, 100.0, 1e-3)  # ft/s, mm/s, cm/s and km/s in a m/s


def sound_speeds(table: Table | None) -> list[Implausible]:
    """Speeds of sound that water does not have."""
    if table is None:
        return []
    c = table.floats("sound_speed_m_s")[:, 0]
    if not (out := (c < SLOWEST) | (c > FASTEST)).any():
        return []
    row = int(np.argmax(out))
    factor = next((f for f in UNITS if SLOWEST < c[row] / f < FASTEST), None)
    column = "sound_speed_m_s"
    cause = Reading(Cause.UNKNOWN, "sound-speed.csv", column)
    if factor is not None:
        cause = Reading(Cause.UNIT, "sound-speed.csv", column, factor)
    limit = SLOWEST if c[row] < SLOWEST else FASTEST
    return [Implausible("sound speed", "sound-speed.csv", row, column, float(c[row]), limit, "m/s", (cause,))]
