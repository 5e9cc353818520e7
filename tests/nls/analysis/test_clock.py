"""Clock offsets: estimated within their sigma; none where there is another mistake or none."""

from __future__ import annotations

import numpy as np
import pytest

from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Heading, Isotropic, Position
from factors.replaced import replaced
from models import SE2, R
from models.algebra import Array, wrap
from models.sensors import direction, distance
from nls import FactorGraph, Values, kinds
from nls.analysis.clock import ClockOffset, clock_offsets
from tests.combinations import for_all
from tests.nls.misreadings import checked, misread, optimum

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
    order = np.random.default_rng(0).permutation(N)
    shuffled = Values({x: (SE2, values[x][order], order), l: (R(2), values[l])})
    (again,) = offsets(graph, shuffled)
    assert again.dt == pytest.approx(first.dt, rel=1e-4)
    assert again.sigma == pytest.approx(first.sigma, rel=1e-4)
    assert again.fall == pytest.approx(first.fall, rel=1e-4)


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
