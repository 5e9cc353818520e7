"""Marginalizing: what is known of the rest stays known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import Between, Factor, Information, Isotropic, Landmark, Line, Prior, Range
from models import LINE, SE2, SE3, LieGroup, Manifold, R
from models.errors import UnderconstrainedError
from models.sensors import line_from_frame
from nls import FactorGraph, GaussNewton, Marginals, Values, kinds
from nls.incremental.marginal import MarginalPrior, marginalized
from tests.combinations import for_all

Array = npt.NDArray[np.float64]
close = np.testing.assert_allclose
x, l, o = kinds("x", "l", "o")
STEPS, SEEN = 9, [(0, 0), (0, 1), (1, 0), (2, 1), (3, 2), (4, 2), (5, 2), (5, 3), (6, 3), (8, 3)]


def linear(seed: int = 0) -> tuple[FactorGraph, Values]:
    """Points that walk and see points, everything a difference with full covariances: a linear problem."""
    rng = np.random.default_rng(seed)

    def informations(n: int) -> Array:
        L = np.tril(rng.uniform(-0.3, 0.3, (n, 2, 2))) + np.eye(2) * rng.uniform(0.2, 1.0, (n, 1, 1))
        return np.linalg.inv(L @ L.mT)

    i, k = np.array(SEEN).T
    at = np.arange(STEPS)
    graph = FactorGraph(
        [
            Prior(x[0], rng.normal(size=2), Information(informations(1))),
            Between(x[at[:-1]], x[at[1:]], rng.normal(size=(STEPS - 1, 2)), Information(informations(STEPS - 1))),
            Between(x[i], l[k], rng.normal(size=(len(i), 2)), Information(informations(len(i)))),
        ]
    )
    return graph, Values({x: (R(2), np.zeros((STEPS, 2))), l: (R(2), np.zeros((4, 2)))})


def test_marginalizing_keeps_estimate_and_covariance_of_the_rest() -> None:
    graph, values = linear(3)
    best = graph.optimize(values, gauge="none").values
    leaving = [x[[0, 2, 4]], l[[1]]]
    left, rest = marginalized(graph.factors, values, leaving)
    assert isinstance(left[-1], MarginalPrior)
    assert not any(key in keys for gone in leaving for key in gone for f in left for keys in map(set, f.keys))
    kept = x[[1, 3, 5, 6, 7, 8]]
    reduced = FactorGraph(left)
    again = reduced.optimize(rest, GaussNewton(), gauge="none").values
    close(again[kept], best[kept], atol=1e-9)
    whole, part = Marginals(graph, best, gauge="none"), Marginals(reduced, again, gauge="none")
    close(part.joint([kept, l[[0, 2, 3]]]).matrix, whole.joint([kept, l[[0, 2, 3]]]).matrix, atol=1e-10)


@for_all(scene=[sim.subsea, sim.lines])
def test_a_prior_left_by_poses_has_the_derivatives_it_says(scene: Callable[..., sim.LandmarkWorld]) -> None:
    generator = np.random.default_rng(5)
    world = scene(np.random.default_rng(2), laps=1)
    factors, _ = marginalized(world.graph.factors, world.start, [x[np.arange(20)]])
    prior = factors[-1]
    assert isinstance(prior, MarginalPrior)
    manifolds = [world.start.stack(k.kind).manifold for k in prior.keys]
    model = prior.bind(*manifolds)
    X = [m.retract(x0[None], generator.normal(0, 0.4, (1, m.dim))) for m, x0 in zip(manifolds, prior.X0, strict=True)]
    A, b = model.linearize(*X)
    assert np.abs(b).max() > 1
    for slot, m in enumerate(manifolds):
        for c in range(m.dim):
            delta = np.zeros((1, m.dim))
            delta[0, c] = 1e-6
            there, back = ([*X[:slot], m.retract(X[slot], s * delta), *X[slot + 1 :]] for s in (1, -1))
            close(-A[slot][0, :, c], (model.error(*there) - model.error(*back))[0] / 2e-6, rtol=1e-5, atol=1e-4)


def seen(space: LieGroup, target: Manifold, seed: int) -> tuple[list[Factor], Values]:
    """Four poses that see three targets through a sensor of unknown place; from their steps and sightings alone."""
    rng, n = np.random.default_rng(seed), np.arange(4)
    X, noise = space.exp(rng.normal(0, 1, (4, space.dim))), Isotropic(0.1)
    L = rng.normal(0, 5, (3, target.dim))
    i, j = np.repeat(n, 3), np.tile(n[:3], 4)
    sort = Line if target is LINE else Landmark
    mount = space.exp(rng.normal(0, 0.3, (1, space.dim)))
    z = sort(x[i], l[j], np.zeros((12, target.dim)), noise, mount).predict((space, target), X[i], L[j])[0]
    z = target.retract(z, rng.normal(0, 0.1, (12, target.dim)))
    moved = space.retract(space.between(X[:-1], X[1:]), rng.normal(0, 0.1, (3, space.dim)))
    factors = [Between(x[n[:-1]], x[n[1:]], moved, noise), sort(x[i], l[j], z, noise, o[0])]
    return factors, FactorGraph(factors).optimize(Values({o: (space, mount), x: (space, X), l: (target, L)})).values


@for_all(spaces=[(SE2, R(2)), (SE2, LINE), (SE3, R(3))])
def test_a_common_motion_costs_a_prior_of_relative_measurements_nothing(spaces: tuple[LieGroup, Manifold]) -> None:
    group, target = spaces
    factors, values = seen(group, target, 1)
    prior = marginalized(factors, values, [x[[0, 1]]])[0][-1]
    assert isinstance(prior, MarginalPrior)
    assert prior.relative
    assert prior.unmoved == (0,)
    rng = np.random.default_rng(0)
    model = prior.bind(*(values.stack(keys.kind).manifold for keys in prior.keys))
    at = [m.retract(x0[None], rng.normal(0, 0.3, (1, m.dim))) for m, x0 in zip(model.manifolds, prior.X0, strict=True)]
    for size in (0.1, 3.0):
        G = group.exp(rng.normal(0, size, (1, group.dim)))
        moved = [at[0], *(moved_by(group, G, m, X) for m, X in zip(model.manifolds[1:], at[1:], strict=True))]
        close(model.error(*moved), model.error(*at), atol=1e-9)
    assert np.abs(model.error(*at)).max() > 1


def moved_by(group: LieGroup, G: Array, space: Manifold, X: Array) -> Array:
    """Elements of a space after a motion of everything."""
    return group.compose(G, X) if space is group else line_from_frame(G, X) if space is LINE else group.act(G, X)


def test_a_landmark_that_is_not_determined_cannot_leave() -> None:
    steps = Between(x[0:2], x[1:3], [[1.0, 0, 0]] * 2, Isotropic(0.1))
    factors = [Prior(x[0], [0, 0, 0], Isotropic(0.1)), steps, Range(x[0], l[7], [5.0], Isotropic(0.1))]
    values = Values({x: (SE2, SE2.identity(3)), l: (R(2), [[3.0, 4.0]], [7])})
    with pytest.raises(UnderconstrainedError, match=r"l7 cannot leave the window.*Prior"):
        marginalized(factors, values, [l[7]])
