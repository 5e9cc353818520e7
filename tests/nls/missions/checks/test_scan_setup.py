"""Wrong setups of a scan mission are named: laps in a room with a few walls, and a straight way along one."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import pytest

from models import SE2
from models.algebra import Array, wrap
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.missions.checks.scan_setup import doubt_of_sigmas, fits, most_are_mirrored
from nls.sonar.scans import Closing, Drift, Mounting, Scans, SetupKind, check_setup, close, dead_reckoning, mounting
from nls.values import Values
from sim import Scene

WALLS = [[0, 0, 44, 0], [44, 0, 44, 30], [44, 30, 0, 30], [0, 30, 0, 0], [12, 10, 16, 14], [26, 16, 33, 16]]
ROOM = Scene(walls=[[wall[:2], wall[2:]] for wall in WALLS])
RAYS = np.radians(np.arange(-65, 66, 2.5)) + 0.0123  # none along a wall
Right: TypeAlias = tuple[FactorGraph, Values, Scans, Array, Closing]
FAR, PERIOD = 25.0, 2.0  # m, s
STRAIGHT = np.column_stack([np.linspace(4, 40, 40), np.full(40, 6.0), np.zeros(40)])


def laps() -> Array:
    """A lap and a half (66, 3), m and rad."""
    a = np.linspace(0, 3 * np.pi, 66, endpoint=False)
    p = np.column_stack([22 + 14 * np.cos(a) * (1 + 0.15 * np.sin(3 * a)), 15 + 8 * np.sin(a) + 1.5 * np.sin(5 * a)])
    v = np.gradient(p, axis=0)
    return np.column_stack([p, np.unwrap(np.arctan2(v[:, 1], v[:, 0]))])


def mission(
    X: Array, mount: tuple[float, float, float] = (0.0, 0.0, 0.0), late: float = 0.0
) -> tuple[FactorGraph, Values, Scans, Array]:
    """Dead reckoning with a drift of 5 % and a compass, scans by a sensor at a mount, stamped late; and the times."""
    rng = np.random.default_rng(0)
    t = PERIOD * np.arange(len(X)) + rng.uniform(-0.3, 0.3, len(X))
    there = np.column_stack([np.interp(t - late, t, column) for column in X.T])
    hits = ROOM.first_hits(SE2.compose(there, np.broadcast_to(mount, X.shape)), RAYS, (0.0, FAR))
    k, ray = np.nonzero(np.isfinite(hits))
    r, azimuth = hits[k, ray], RAYS[ray]
    r = r + rng.normal(0, 0.05, len(r))
    step = SE2.between(X[:-1], X[1:])[:, :2]
    step = step + 0.05 * np.linalg.norm(step, axis=1)[:, None] * [1.0, 0.0] + rng.normal(0, 0.03, step.shape)
    yaw = X[:, 2] + rng.normal(0, 0.01, len(X))
    way = SE2.act(np.column_stack([0 * step, yaw[:-1]]), step)
    reckoned = np.column_stack([X[0, :2] + np.vstack([np.zeros(2), np.cumsum(way, axis=0)]), wrap(yaw)])
    points = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth)])
    graph, values = dead_reckoning(reckoned, Drift(step=0.05, yaw=0.02, heading=0.01))
    return graph, values, Scans(points, k, len(X)), t


@pytest.fixture(scope="module")
def right() -> Right:
    graph, values, scans, t = mission(laps())
    return graph, values, scans, t, close(graph, values, scans, rounds=1)


def test_a_right_setup_gives_no_finding(right: Right) -> None:
    graph, values, scans, t, _ = right
    assert check_setup(graph, values, scans, times=t) == []


def test_mirrored_azimuths_are_named(right: Right) -> None:
    graph, values, scans, t, _ = right
    (finding,) = check_setup(graph, values, scans.mirrored(), times=t)
    assert finding.kind is SetupKind.MIRRORED
    assert finding.numbers["mirrored"] > 10 * finding.numbers["given"]


def test_a_mirror_needs_steps_and_most_of_them() -> None:
    counts = [(0, 9), (3, 10), (10, 30), (10, 31)]
    assert [most_are_mirrored(*pair) for pair in counts] == [False, True, False, True]


def test_scans_without_points_say_nothing() -> None:
    graph, values = dead_reckoning(STRAIGHT)
    scans = Scans(np.zeros((0, 2)), np.zeros(0, dtype=int), len(STRAIGHT))
    assert check_setup(graph, values, scans, times=np.arange(40.0)) == []
    assert not mounting(graph, values, scans).determined.any()


def test_the_mounting_is_estimated() -> None:
    graph, values, scans, _ = mission(laps(), mount=(1.5, -0.8, 0.0))
    estimate = mounting(graph, values, scans)
    assert (np.abs(estimate.value[:3] - [1.5, -0.8, 0.0]) < 3 * estimate.sigma[:3]).all()
    assert (estimate.sigma[:2] < 0.4).all()
    assert estimate.wrong[0]


def test_a_sensor_ahead_is_named(right: Right) -> None:
    graph, values, scans, _, _ = right
    (finding,) = check_setup(graph, values, scans.at([2.0, 0.0, 0.0]))
    assert finding.kind is SetupKind.MOUNTING
    assert finding.record()["numbers"]["component"] == "x"
    assert abs(finding.numbers["mount"][0]) < 3 * finding.numbers["sigma"]


@pytest.mark.parametrize(("yaw", "late"), [(0.2, 0.0), (0.0, 1.0)])
def test_a_turned_sonar_and_a_late_clock_are_named(yaw: float, late: float) -> None:
    """The turn is not told from a drift to the side."""
    graph, values, scans, t = mission(laps(), mount=(0.0, 0.0, yaw), late=late)
    (finding,) = check_setup(graph, values, scans, times=t if late else None)
    assert finding.kind is (SetupKind.TIME_OFFSET if late else SetupKind.TURNED)
    assert abs(finding.numbers["value"] - (yaw + late)) < 3 * finding.numbers["sigma"]


def test_a_straight_way_determines_no_lever_arm() -> None:
    graph, values, scans, _ = mission(STRAIGHT)
    estimate = mounting(graph, values, scans)
    assert estimate.steps > 20
    assert not estimate.determined[:2].any()


def test_sigmas_of_steps_and_closures(right: Right) -> None:
    graph, values, scans, _, closing = right
    shown = fits(graph, closing)
    assert list(shown) == ["steps", "drifts", "closures"]
    assert sum(dof for _, dof in shown.values()) < closing.result.dof
    exact = [f for f in check_setup(graph, values, scans, closing) if f.kind is SetupKind.SIGMAS_TOO_LARGE]
    assert {f.numbers["measurements"] for f in exact} <= {"drifts", "closures"}
    numbers = ((24.0, 100.0), (26.0, 100.0), (390.0, 100.0), (410.0, 100.0), (2.0, 10.0))
    large, small = SetupKind.SIGMAS_TOO_LARGE, SetupKind.SIGMAS_TOO_SMALL
    assert [doubt_of_sigmas("closures", *pair) for pair in numbers] == [large, None, None, small, None]
    assert doubt_of_sigmas("steps", 1.0, 100.0) is None, "their yaw and the heading are one number"


def test_times_have_to_rise(right: Right) -> None:
    graph, values, scans, t, _ = right
    with pytest.raises(GraphError, match=r"times: .*one rising number"):
        mounting(graph, values, scans, t[::-1])


def test_what_is_wrong_is_far_in_sigmas_and_in_meters() -> None:
    value, sigma = np.array([0.6, 0.4, 0.5, np.nan]), np.array([0.1, 0.1, 0.2, np.nan])
    before = np.array([2.0, 2.0, 0.17, 10.0])
    estimate = Mounting(50, value, sigma, before, np.zeros(3), float("nan"), (float("nan"), float("nan")))
    assert estimate.wrong.tolist() == [True, False, False, False]


def test_clutter_is_named(right: Right) -> None:
    """Random points close loops by chance; no scan shows those of the scan before it."""
    graph, values, scans, t, _ = right
    rng, n = np.random.default_rng(0), 25 * len(scans)
    r, azimuth = rng.uniform(1, 20, n), rng.uniform(-1.1, 1.1, n)
    points = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth)])
    clutter = Scans(points, np.repeat(np.arange(len(scans)), 25), len(scans))
    (finding,) = check_setup(graph, values, clutter, times=t)
    assert finding.kind is SetupKind.UNREPEATED
    assert finding.numbers["fit"] < 0.25 * finding.numbers["scans"]


def test_dead_reckoning_alone_says_nothing_of_its_sigmas() -> None:
    """Without a closure all residuals are 0."""
    k = np.arange(60.0)
    graph, values = dead_reckoning(np.column_stack([k, 0.1 * k, 0.01 * k]))
    empty = Scans(np.zeros((0, 2)), np.zeros(0, dtype=int), 60)
    assert check_setup(graph, values, empty, close(graph, values, empty)) == []
