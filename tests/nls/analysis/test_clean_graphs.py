"""Clean graphs raise no alarm; clock offsets and numbers beyond all others are named, other mistakes are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Heading, Information, Isotropic, Position
from factors.replaced import replaced
from models import SE2, SE3, R
from models.algebra import Array, wrap
from models.sensors import direction, distance
from nls import FactorGraph, Values, kinds
from nls.analysis.calibrations import calibrations
from nls.analysis.clock import ClockOffset, clock_offsets
from nls.analysis.leave_one_out import checks
from nls.analysis.misread import misread_kinds, misread_measurements
from nls.analysis.scales import outsized
from nls.analysis.swapped_landmarks import swapped_landmarks
from tests.combinations import for_all
from tests.nls.graphs import walk
from tests.nls.misreadings import PUBLIC, WORLDS, checked, clean, doubted, misread, optimum, public


def alarms(graph: FactorGraph, values: Values) -> tuple[object, ...]:
    """All that the analyses say of a graph at its optimum."""
    pattern, doubts = doubted(graph, values)
    found, count = checked(graph, values), len(graph.factors)
    out = [*swapped_landmarks(graph, values, checks(found, count)), *clock_offsets(found, values, count)]
    out += [*misread_kinds(graph, values), *misread_measurements(pattern, doubts.values, doubts.places)]
    return *out, *calibrations(graph, values), *outsized(pattern)


@pytest.mark.parametrize("name", WORLDS)
def test_worlds(name: str) -> None:
    for seed in range(2):
        graph, _, values = clean(name, seed)
        assert alarms(graph, values) == (), seed


@pytest.mark.parametrize("name", PUBLIC)
def test_public_graphs(name: str, data: Path) -> None:
    assert alarms(*public(data / name)) == ()


x, l = kinds("x", "l")
POSES = 80


def weaving(t: Array) -> Array:
    """Poses (n, 3) of a vehicle at times t in steps: faster and slower, to the left and to the right."""
    s = t + 0.6 * np.sin(0.9 * t)
    return np.column_stack([s, 3 * np.sin(0.4 * s), np.arctan(1.2 * np.cos(0.4 * s))])


def survey(seed: int, dt: float, sensor: str) -> tuple[FactorGraph, Values]:
    """Odometry, fixes, headings and sightings, those of one sensor dt steps late."""
    rng, k = np.random.default_rng(seed), np.arange(POSES)
    X = {name: weaving(k + (dt if name == sensor else 0.0)) for name in ("odometry", "fix", "heading", "sight")}
    L = np.column_stack([np.linspace(0, POSES, 8), np.tile([5.0, -5.0], 4)])
    sigmas = np.array([0.05, 0.05, 0.01])
    odometry = SE2.retract(SE2.between(X["odometry"][:-1], X["odometry"][1:]), sigmas * rng.normal(size=(POSES - 1, 3)))
    i = np.repeat(k, 2)
    j = np.clip(np.column_stack([k // 12, k // 12 + 1]), 0, 7).reshape(-1)
    p = SE2.act(SE2.inverse(X["sight"][i]), L[j])
    z = np.hstack([direction(p)[0], distance(p)[0]]) + [0.01, 0.1] * rng.normal(size=(len(i), 2))
    z[:, 0] = wrap(z[:, 0])
    factors: list[Factor] = [
        Between(x[k[:-1]], x[k[1:]], odometry, Diagonal(sigmas)),
        Position(x[k], X["fix"][:, :2] + 0.1 * rng.normal(size=(POSES, 2)), Isotropic(0.1)),
        Heading(x[k], X["heading"][:, 2] + 0.02 * rng.normal(size=POSES), Isotropic(0.02)),
        BearingRange(x[i], l[j], z, Diagonal(bearing=0.01, range=0.1)),
    ]
    return FactorGraph(factors), Values({x: (SE2, weaving(k)), l: (R(2), L)})


def offsets(graph: FactorGraph, values: Values) -> tuple[ClockOffset, ...]:
    return clock_offsets(checked(graph, values), values, len(graph.factors))


@for_all(sensor=["fix", "heading", "sight"], dt=[0.3, -0.3])
def test_an_offset_is_estimated(sensor: str, dt: float) -> None:
    """Whatever the order of the poses in the stack."""
    graph, start = survey(int(dt < 0), dt, sensor)
    values = optimum(graph, start)
    (first,) = offsets(graph, values)
    assert first.kind == {"fix": "Position", "heading": "Heading", "sight": "BearingRange"}[sensor]
    assert first.dt == pytest.approx(dt, rel=0.25, abs=4 * first.sigma)
    assert first.chance < 1e-6
    order = np.random.default_rng(0).permutation(POSES)
    shuffled = Values({x: (SE2, values[x][order], order), l: (R(2), values[l])})
    (again,) = offsets(graph, shuffled)
    assert (again.dt, again.sigma, again.fall) == pytest.approx((first.dt, first.sigma, first.fall), rel=1e-4)


def test_other_mistakes_and_none_are_no_offset() -> None:
    """Nothing wrong; wrong sigmas, an outlier, a heading offset, a kernel, fixes in another frame."""
    for seed in range(1, 6):
        graph, start = survey(seed, 0.0, "")
        assert offsets(graph, optimum(graph, start)) == (), seed
    odometry, fixes, headings, sights = graph.factors
    far = np.array(fixes.z)
    far[20] += 3.0
    for wrong in (
        FactorGraph([odometry, Position(fixes.keys[0], fixes.z, Isotropic(0.02)), headings, sights]),
        FactorGraph([odometry, replaced(fixes, z=far), headings, sights]),
        FactorGraph([odometry, fixes, replaced(headings, z=headings.z + 0.2), sights]),
        FactorGraph([odometry, fixes.robust(Cauchy(1)), headings, sights]),
        misread(graph, start, 3, "mirrored"),
    ):
        assert offsets(wrong, optimum(wrong, start)) == ()


N = 12


@for_all(group=[SE2, SE3], seed=range(2))
def test_one_edge_is_too_long(group: type[SE2], seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, k, i = walk(group, N, rng), np.arange(N - 1), int(rng.integers(N - 1))
    z = np.array(group.between(X[:-1], X[1:]))
    for times, expected in ((1e8, [(0, i)]), (1e4, [])):
        far = z.copy()
        far[i, : group.point_dim] *= times
        steps = Between(x[k], x[k + 1], far, Diagonal(np.full(group.dim, 0.1)))
        found = outsized(FactorGraph([steps]).pattern(Values({x: (group, X)})))
        assert [(one.place, one.quantity) for one in found] == [(place, "length") for place in expected]
        assert all(one.value > 1e6 * one.reference for one in found)


@for_all(seed=range(2))
def test_one_information_is_too_large(seed: int) -> None:
    """Of one component: also in a batch of its own, and not where it is a thousand times as large or where half are."""
    rng = np.random.default_rng(seed)
    X, k, i = walk(SE2, N, rng), np.arange(N - 1), int(rng.integers(N - 1))
    z, values = SE2.between(X[:-1], X[1:]), Values({x: (SE2, X)})
    for times, count, expected in ((1e7, 1, 1), (1e7, 2, 2), (1e3, 1, 0), (1e7, 6, 0)):
        Omega = np.tile(np.diag([100.0, 100.0, 2500.0]), (N - 1, 1, 1))
        wrong = np.sort(rng.permutation(N - 1)[:count])
        Omega[wrong, 2, 2] *= times
        steps = Between(x[k], x[k + 1], z, Information(Omega))
        apart, whole = (outsized(FactorGraph(f).pattern(values)) for f in ([steps[k != i], steps[[i]]], [steps]))
        assert len(apart) == expected
        assert {one.component for one in (*apart, *whole)} == ({"yaw"} if expected else set())
        assert sorted(one.place[1] for one in whole) == (wrong.tolist() if expected else [])


def test_components_are_compared_with_their_like() -> None:
    """A depth is sharper than a fix, and nothing is wrong with it; an information of 0 is none."""
    X, k = SE3.exp(0.1 * np.arange(48.0).reshape(8, 6)), np.arange(8)
    fix = Position(x[k], SE3.position(X)[:, :2], Diagonal([100.0, 100.0]), components=("x", "y"))
    depth = Position(x[k], SE3.position(X)[:, 2], Diagonal([1e-4]), components=("z",))
    blind = np.zeros((7, 6, 6))
    blind[:3] = np.eye(6)
    steps = Between(x[k[:-1]], x[k[1:]], SE3.between(X[:-1], X[1:]), Information(blind))
    assert outsized(FactorGraph([fix, depth, steps]).pattern(Values({x: (SE3, X)}))) == ()
