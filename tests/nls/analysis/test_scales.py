"""Lengths and informations beyond all others of their kind."""

from __future__ import annotations

import numpy as np

from factors import Between, Diagonal, Information, Position
from factors.replaced import replaced
from models import SE2, SE3
from nls import FactorGraph, Values, kinds
from nls.analysis.scales import outsized
from tests.combinations import for_all
from tests.nls.graphs import walk
from tests.nls.misreadings import WORLDS, misread_one, world

x, l = kinds("x", "l")
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
        alone = [steps[k != i], steps[[i]]]
        for factors in ([steps], alone):
            found = outsized(FactorGraph(factors).pattern(values))
            assert len(found) == expected
            assert {one.component for one in found} == ({"yaw"} if expected else set())
        found = outsized(FactorGraph([steps]).pattern(values))
        assert sorted(one.place[1] for one in found) == (wrong.tolist() if expected else [])


def test_components_are_compared_with_their_like() -> None:
    """A depth is sharper than a fix, and nothing is wrong with it; an information of 0 is none."""
    X, k = SE3.exp(0.1 * np.arange(48.0).reshape(8, 6)), np.arange(8)
    fix = Position(x[k], SE3.position(X)[:, :2], Diagonal([100.0, 100.0]), components=("x", "y"))
    depth = Position(x[k], SE3.position(X)[:, 2], Diagonal([1e-4]), components=("z",))
    blind = np.zeros((7, 6, 6))
    blind[:3] = np.eye(6)
    steps = Between(x[k[:-1]], x[k[1:]], SE3.between(X[:-1], X[1:]), Information(blind))
    assert outsized(FactorGraph([fix, depth, steps]).pattern(Values({x: (SE3, X)}))) == ()


@for_all(name=WORLDS)
def test_smaller_mistakes(name: str) -> None:
    """A transposed rotation, degrees for radians."""
    graph, values = world(name, 0)
    if name != "lines":
        wrong = misread_one(graph, values, 1, 3, "transposed")
        assert outsized(wrong.pattern(values)) == ()
    degrees = [
        replaced(f, z=f.z * [1, 1, 57.3]) if isinstance(f, Between) and f.z.shape[1] == 3 else f for f in graph.factors
    ]
    assert outsized(FactorGraph(degrees).pattern(values)) == ()
