"""Clock offsets: estimated within their sigma, in steps and in seconds; none where there is another mistake or none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Heading, Isotropic, Position
from factors.replaced import replaced
from models import SE2, R
from models.algebra import Array, wrap
from models.sensors import direction, distance
from nls import FactorGraph, Values, kinds
from nls.analysis.clock import ClockOffset, clock_offsets
from nls.analysis.freedom import freedom
from nls.gauge import choose_gauge
from tests.nls.misreadings import PUBLIC, WORLDS, misread, optimum, public, world

x, l = kinds("x", "l")
N = 80


def weaving(t: Array) -> Array:
    """Poses (n, 3) of a vehicle at times t in steps: faster and slower, to the left and to the right."""
    s = t + 0.6 * np.sin(0.9 * t)
    return np.column_stack([s, 3 * np.sin(0.4 * s), np.arctan(1.2 * np.cos(0.4 * s))])


def survey(seed: int, dt: float, sensor: str) -> tuple[FactorGraph, Values]:
    """Odometry, fixes, headings and sightings, those of one sensor dt steps late."""
    rng, k = np.random.default_rng(seed), np.arange(N)
    X = {name: weaving(k + (dt if name == sensor else 0.0)) for name in ("odometry", "fix", "heading", "sight")}
    L = np.column_stack([np.linspace(0, N, 8), np.tile([5.0, -5.0], 4)])
    sigmas = np.array([0.05, 0.05, 0.01])
    odometry = SE2.retract(SE2.between(X["odometry"][:-1], X["odometry"][1:]), sigmas * rng.normal(size=(N - 1, 3)))
    i = np.repeat(k, 2)
    j = np.clip(np.column_stack([k // 12, k // 12 + 1]), 0, 7).reshape(-1)
    p = SE2.act(SE2.inverse(X["sight"][i]), L[j])
    z = np.hstack([direction(p)[0], distance(p)[0]]) + [0.01, 0.1] * rng.normal(size=(len(i), 2))
    z[:, 0] = wrap(z[:, 0])
    factors: list[Factor] = [
        Between(x[k[:-1]], x[k[1:]], odometry, Diagonal(sigmas)),
        Position(x[k], X["fix"][:, :2] + 0.1 * rng.normal(size=(N, 2)), Isotropic(0.1)),
        Heading(x[k], X["heading"][:, 2] + 0.02 * rng.normal(size=N), Isotropic(0.02)),
        BearingRange(x[i], l[j], z, Diagonal(bearing=0.01, range=0.1)),
    ]
    return FactorGraph(factors), Values({x: (SE2, weaving(k)), l: (R(2), L)})


def offsets(graph: FactorGraph, values: Values, times: Array | None = None) -> tuple[ClockOffset, ...]:
    whole = graph.pattern(values)
    gauge = choose_gauge("first", whole, values, np.zeros(len(whole.dims), dtype=bool))
    checked = freedom(graph.factors, whole.holding(gauge.held), values).checked
    assert checked is not None
    return clock_offsets(checked, values, len(graph.factors), None if times is None else {"x": times})


@pytest.mark.parametrize(("sensor", "kind"), [("fix", "Position"), ("heading", "Heading"), ("sight", "BearingRange")])
@pytest.mark.parametrize("dt", [0.3, -0.3])
@pytest.mark.parametrize("seed", range(3))
def test_an_offset_is_estimated(sensor: str, kind: str, dt: float, seed: int) -> None:
    graph, start = survey(seed, dt, sensor)
    values = optimum(graph, start)
    (first,) = offsets(graph, values)
    assert first.kind == kind
    assert first.dt == pytest.approx(dt, rel=0.25, abs=4 * first.sigma)
    assert first.chance < 1e-6
    (timed,) = offsets(graph, values, 0.5 * np.arange(N))
    assert timed.seconds
    assert timed.dt == pytest.approx(first.dt / 2)
    assert timed.sigma == pytest.approx(first.sigma / 2)
    assert timed.fall == pytest.approx(first.fall)


def test_the_order_of_variables_is_that_of_their_numbers() -> None:
    graph, start = survey(0, 0.3, "fix")
    values = optimum(graph, start)
    order = np.random.default_rng(0).permutation(N)
    shuffled = Values({x: (SE2, values[x][order], order), l: (R(2), values[l])})
    assert offsets(graph, shuffled)[0].dt == pytest.approx(offsets(graph, values)[0].dt, rel=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_no_offset(seed: int) -> None:
    graph, start = survey(seed, 0.0, "")
    assert offsets(graph, optimum(graph, start)) == ()


@pytest.mark.parametrize("seed", range(3))
def test_other_mistakes_are_no_offset(seed: int) -> None:
    """Wrong sigmas, an outlier, a heading offset, fixes in another frame."""
    graph, start = survey(seed, 0.0, "")
    odometry, fixes, headings, seen = graph.factors
    far = np.array(fixes.z)
    far[20] += 3.0
    for wrong in (
        [odometry, Position(fixes.keys[0], fixes.z, Isotropic(0.02)), headings, seen],
        [odometry, replaced(fixes, z=far), headings, seen],
        [odometry, fixes, replaced(headings, z=headings.z + 0.2), seen],
        [odometry, fixes.robust(Cauchy(1)), headings, seen],
    ):
        assert offsets(FactorGraph(wrong), optimum(FactorGraph(wrong), start)) == ()
    mirrored = misread(graph, start, 3, "mirrored")
    assert offsets(mirrored, optimum(mirrored, start)) == ()


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("seed", range(4))
def test_clean_worlds(name: str, seed: int) -> None:
    graph, start = world(name, seed)
    assert offsets(graph, optimum(graph, start)) == ()


@pytest.mark.parametrize("name", PUBLIC[:2])
def test_relative_poses_have_no_clock(name: str, data: Path) -> None:
    assert offsets(*public(data / name)) == ()
