"""Spoiled logs are named with their cause, and right ones are not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from models import SE3
from nls.missions.checks.findings import Cause, Reading
from nls.missions.checks.inspection import of_log
from nls.missions.checks.log import Fixes, Log
from tests.combinations import for_all
from tests.nls.missions.checks.spoils import SPOILS
from tests.nls.missions.checks.vehicle import SIGMAS, clean


def same(a: Reading, b: Reading) -> bool:
    """Whether two readings say the same; a ratio of sigmas and a lag of a clock are estimates."""
    if (a.cause, a.file, a.column) != (b.cause, b.file, b.column):
        return False
    return b.cause is Cause.SIGMA or abs(a.factor - b.factor) <= 0.25 * abs(b.factor)


@for_all(name=list(SPOILS))
def test_a_spoiled_log_is_named_with_its_cause(name: str) -> None:
    spoil, reading = SPOILS[name]
    findings = of_log(spoil(clean(3)))
    named = [reading for entry in findings for reading in entry.readings]
    assert any(same(entry, reading) for entry in named), named
    assert len(named) <= 4, named
    for entry in findings:
        assert re.match(rf"{entry.file}:\d+: {entry.column} is implausible: [^{{]+Probable cause: [^{{]+$", entry.says)


@for_all(seed=list(range(10)))
def test_a_right_log_is_plausible(seed: int) -> None:
    log = clean(seed, drop_outs=seed % 2 == 0)
    assert of_log(log) == []
    assert of_log(replace(log, fixes=None)) == []


@for_all(number=list(range(1, 8)), every=[0, 5, 20])
def test_a_real_log_is_plausible(number: int, every: int, data: Path, script: Callable[[str], Any]) -> None:
    """Attitude, depth and fixes (a meter) are those of the truth with noise, the DVL is as measured."""
    real = script("logs").read_auv_dvl(data / "underwater-auv-dvl", number)
    rng = np.random.default_rng(number)
    t, n, sigmas = real.t, len(real.t), SIGMAS | {"sigma_v_m_s": 0.02, "sigma_z_m": 0.05}
    rows = np.arange(0, n, every or 1)
    p = real.p[rows, :2] + rng.normal(0, 1.0, (len(rows), 2))
    fixes = Fixes(t[rows], p, np.full(len(rows), 2**0.5), ("x_m", "y_m"), rows) if every else None
    rpy, z = real.rpy + rng.normal(0, 0.003, (n, 3)), real.p[:, 2] + rng.normal(0, 0.05, n)
    log = Log(t, real.v_d, np.ones(n, dtype=bool), t, rpy, t, z, SE3.identity()[0], sigmas, fixes)
    assert [entry.says for entry in of_log(log)] == []


def test_a_short_lag_is_no_cause_as_a_lever_arm_looks_the_same() -> None:
    """1 s at 1.4 m/s is the same as a DVL 1.4 m ahead of where it is said to be."""
    log = clean(4)
    late = of_log(replace(log, t_a=log.t_a + 1.0))
    ahead = of_log(replace(log, mount=np.concatenate([[-1.4, 0.0, 0.0], log.mount[3:]])))
    assert [entry.readings for entry in (*late, *ahead) if entry.readings[0].cause is Cause.CLOCK] == []


def test_a_velocity_without_another_sensor_that_tells_has_several_units() -> None:
    """The depth does not change and there are no fixes: 300 may be in mm/s or cm/s."""
    log = clean(1)
    level = replace(log, v=300 / 1.4 * log.v, z=9.0 + 0.01 * np.sin(log.t_z), fixes=None)
    finding = of_log(level)[0]
    assert [reading.factor for reading in finding.readings] == [1000.0, 100.0]
    assert re.search("mm/s.*cm/s", finding.says)


def test_fixes_that_jump_are_no_disagreement_of_sensors() -> None:
    """Few windows, several of them with a fix that jumps: its outliers are the cause, not another reading."""
    log = clean(18, minutes=2.0)
    fixes, rng = log.fixes, np.random.default_rng(18)
    assert fixes is not None
    t = np.linspace(log.t_v[0], log.t_v[-1], 60)
    p = np.column_stack([np.interp(t, fixes.t, column) for column in fixes.p.T]) + rng.normal(0, 0.5, (60, 2))
    rows = np.sort(rng.choice(np.arange(2, 58), 3, replace=False))
    p[rows, 0] += 50.0
    jumping = replace(fixes, t=t, p=p, sigma=np.full(60, 0.7), rows=np.arange(60))
    (finding,) = of_log(replace(log, fixes=jumping))
    assert (finding.check, finding.line) == ("jumps", rows[0])
    assert finding.readings == (Reading(Cause.OUTLIERS, "fixes.csv", "x_m, y_m"),)


@for_all(seed=[2, 3])
def test_fixes_far_away_may_have_latitude_and_longitude_exchanged_or_of_another_side(seed: int) -> None:
    log = clean(seed)
    assert log.fixes is not None
    away = log.fixes.p + np.array([4e6, -4e6])
    others = (
        Reading(Cause.SWAPPED, "fixes.csv", "lat_deg, lon_deg"),
        Reading(Cause.SIGN, "fixes.csv", "lon_deg", -1.0),
    )
    for near in (*others, None):
        read = tuple((reading, log.fixes.p if reading == near else away) for reading in others)
        fixes = replace(log.fixes, p=away, others=read, columns=("lat_deg", "lon_deg"))
        reading = of_log(replace(log, fixes=fixes))[-1].readings[0]
        assert reading == near or (near is None and reading.cause is Cause.FAR)
