"""Checks of an integrated track: the depths and tilts of zpr.csv, and the steps of odometry.csv beside the times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nls.io.mission.checks.alone import FASTEST, HIGHEST, LONG, STEEPEST
from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.checks.readings import DEGREES
from nls.io.mission.table import Table

__all__ = ["of_track"]
LARGEST = 1e9  # m, as the reader has it


def of_track(tables: dict[str, Table]) -> list[Implausible]:
    """Implausible numbers in an integrated track; lines are rows of the table."""
    if "zpr" not in tables or "odometry" not in tables:
        return []
    return [*_depths(tables["zpr"]), *_tilts(tables["zpr"]), *_steps(tables["odometry"], tables.get("poses"))]


def _depths(zpr: Table) -> Iterator[Implausible]:
    """Depths above the surface throughout."""
    z = zpr.floats("z_m")[:, 0]
    if np.median(z) < HIGHEST and np.mean(z < 0) > 0.9:
        cause = Reading(Cause.SIGN, "zpr.csv", "z_m", -1.0)
        yield Implausible("depth", "zpr.csv", int(np.argmax(z < 0)), "z_m", float(np.median(z)), 0.0, "m", (cause,))


def _tilts(zpr: Table) -> Iterator[Implausible]:
    """Roll or pitch beyond 30 degrees for long."""
    for column in ("roll_rad", "pitch_rad"):
        angle = np.abs(zpr.floats(column)[:, 0])
        if (steep := angle > STEEPEST).mean() > LONG:
            cause = Reading(Cause.UNIT, "zpr.csv", column, DEGREES)
            row, size = int(np.argmax(steep)), float(np.quantile(angle, 1 - LONG))
            yield Implausible("tilt", "zpr.csv", row, column, size, STEEPEST, "rad", (cause,))


def _steps(odometry: Table, poses: Table | None) -> Iterator[Implausible]:
    """Steps that are faster than a vehicle, where the poses have times."""
    if poses is None:
        return
    ids, t = poses.integers("i"), poses.floats("time_s")[:, 0]
    i, j = (np.searchsorted(np.sort(ids), odometry.integers(name)) for name in ("i", "j"))
    t = t[np.argsort(ids)]
    if max(i.max(), j.max()) >= len(t) or not (t[j] != t[i]).all():
        return  # the reader names these
    way = odometry.floats("x_m", "y_m")
    if not np.abs(way).max() < LARGEST:
        return
    speed = np.linalg.norm(way, axis=1) / np.abs(t[j] - t[i])
    if (middle := float(np.median(speed))) > FASTEST:
        units = [f for f in (1000.0, 100.0) if middle / f < FASTEST / 2]
        causes = [Reading(Cause.UNIT, "odometry.csv", "x_m, y_m", f) for f in units]
        causes += [Reading(Cause.UNIT, "poses.csv", "time_s", 1e-3)] * (not causes)
        row = int(np.argmax(speed > FASTEST))
        yield Implausible("speed", "odometry.csv", row, "x_m", middle, FASTEST, "m/s", tuple(causes))
