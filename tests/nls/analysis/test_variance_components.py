"""Scales of the sigmas from simulated graphs, against the scales that were simulated and against dense formulas."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import nls
from factors import BearingRange, Between, Cauchy, Covariance, Diagonal, Isotropic, Prior
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, Values, variance_components
from nls.analysis.residual_groups import residual_groups

x, l = nls.kinds("x", "l")
POSES, LANDMARKS, SEEDS = 20, 5, 32
STATED = {"x": 0.1, "y": 0.1, "yaw": 0.02}


def survey(seed: int, steps: Array, sighting: Array, outliers: int = 0) -> tuple[FactorGraph, Values]:
    """A ring of poses with steps, sightings of landmarks and fixes; the errors are the stated sigmas times scales.

    Parameters
    ----------
    steps, sighting : scales (3,) of x, y, yaw and (2,) of bearing, range; those of the fixes are 1.
    outliers : sightings with a range that is 20 m wrong.
    """
    rng, angle = np.random.default_rng(seed), 2 * np.pi * np.arange(POSES) / POSES
    X = np.stack([8 * np.cos(angle), 8 * np.sin(angle), angle + np.pi / 2], axis=1)
    around = 2 * np.pi * rng.uniform(size=LANDMARKS)
    L = rng.choice([3.0, 13.0], LANDMARKS)[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1)
    k, i, j = np.arange(POSES - 1), *(a.ravel() for a in np.mgrid[:POSES, :LANDMARKS])
    z = SE2.retract(SE2.between(X[:-1], X[1:]), rng.normal(0, steps * [*STATED.values()], (POSES - 1, 3)))
    d = SE2.act(SE2.inverse(X[i]), L[j])
    seen_at = np.stack([np.arctan2(d[:, 1], d[:, 0]), np.linalg.norm(d, axis=1)], axis=1)
    seen_at += rng.normal(0, sighting * [0.03, 0.2], seen_at.shape)
    seen_at[rng.choice(len(i), outliers, replace=False), 1] += 20.0
    fixes = X + np.column_stack([rng.normal(0, 0.3, (POSES, 2)), np.zeros(POSES)])
    graph = FactorGraph(
        [
            Between(x[k], x[k + 1], z, Diagonal(**STATED)),
            BearingRange(x[i], l[j], seen_at, Diagonal(bearing=0.03, range=0.2)),
            Prior(x[:POSES], fixes, Isotropic(0.3), components=("x", "y")),
        ]
    )
    return graph, Values({x: (SE2, X), l: (R(2), L)})


def z_scores(estimate: nls.VarianceComponents, true: list[float]) -> list[float]:
    """Errors of the logarithms of the scales, in their stated standard deviations."""
    return [np.log(c.scale / s) * c.scale / c.sigma for c, s in zip(estimate.components, true, strict=True)]


def test_scales_are_within_their_uncertainty() -> None:
    true, scores = [3.0, 2.0, 1.5, 0.5, 0.5, 1.0, 1.0], []
    for seed in range(SEEDS):
        graph, values = survey(seed, np.array([3.0, 2.0, 1.5]), np.array([0.5, 0.5]))
        estimate = variance_components(graph, values, "components")
        assert estimate.settled
        scores.append(z_scores(estimate, true))
        redundancy = sum(c.redundancy for c in estimate.components)
        assert redundancy == pytest.approx(estimate.result.dof)
        assert estimate.result.chi2_final == pytest.approx(estimate.result.dof, rel=5e-3)
    mean, std = np.mean(scores, axis=0), np.std(scores, axis=0, ddof=1)
    assert (np.abs(mean) < 0.57).all(), mean  # a scale is biased by a part of its sigma
    assert (np.abs(std - 1) < 0.3).all(), std


def test_a_kernel_finds_the_scale_of_the_inliers() -> None:
    """A wrong range counts as one of c sigmas at most, so 4 of 100 make the scale a little larger, and not 10 times."""
    clean, spoiled, plain = [], [], []
    for seed in range(6):
        graph, values = survey(seed, np.full(3, 3.0), np.full(2, 0.5))
        clean.append(z_scores(variance_components(graph.robust(Cauchy(2.385)), values), [3.0, 0.5, 1.0]))
        graph, values = survey(seed, np.full(3, 3.0), np.full(2, 0.5), outliers=4)
        spoiled.append(variance_components(graph.robust(Cauchy(2.385)), values).components[1].scale)
        if seed < 2:
            plain.append(variance_components(graph, values).components[1].scale)
    assert (np.abs(np.mean(clean, axis=0)) < 3 / np.sqrt(6) + 0.15).all(), clean
    assert (np.std(clean, axis=0, ddof=1) < 1.6).all(), clean
    assert 0.5 < np.mean(spoiled) < 0.65
    assert min(plain) > 5


def test_the_covariance_is_that_of_the_dense_formula() -> None:
    graph, values = survey(0, np.full(3, 3.0), np.full(2, 0.5))
    estimate = variance_components(graph, values)
    A = estimate.graph.linearize(estimate.result.values).A.toarray()
    M = np.eye(len(A)) - A @ np.linalg.pinv(A)
    ends = np.cumsum([0, 3 * (POSES - 1), 2 * POSES * LANDMARKS, 2 * POSES])
    blocks = [slice(a, b) for a, b in pairwise(ends)]
    N = np.array([[np.square(M[a, b]).sum() / 2 for b in blocks] for a in blocks])
    C = np.linalg.inv(N)
    sigma = np.sqrt(np.diagonal(C))
    assert [c.sigma / c.scale for c in estimate.components] == pytest.approx(sigma / 2, rel=1e-3)
    assert estimate.correlation == pytest.approx(C / np.outer(sigma, sigma), abs=1e-3)


def test_random_columns_agree_with_the_exact_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, values = survey(0, np.full(3, 3.0), np.full(2, 0.5))
    exact = variance_components(graph, values).components
    monkeypatch.setattr("nls.analysis.residual_groups.EXACT_ROWS", 10)
    drawn = variance_components(graph, values).components
    assert [c.sigma for c in drawn] == pytest.approx([c.sigma for c in exact], rel=0.05)


def test_one_kind_has_the_scale_of_chi2() -> None:
    graph, values = survey(0, np.full(3, 3.0), np.full(2, 0.5))
    alone = FactorGraph([graph.factors[1]], [x[:POSES]])
    estimate = variance_components(alone, values)
    before = alone.optimize(values)
    (kind,) = estimate.components
    assert kind.scale == pytest.approx(np.sqrt(before.chi2_final / before.dof), rel=1e-3)
    assert kind.sigma == pytest.approx(kind.scale / np.sqrt(2 * before.dof))


def test_steps_and_closures_are_kinds_of_their_own() -> None:
    graph, values = survey(0, np.full(3, 3.0), np.full(2, 0.5))
    closure = Between(x[POSES - 1], x[0], SE2.between(values[x[POSES - 1]], values[x[0]]), Diagonal(**STATED))
    estimate = variance_components(FactorGraph([graph.factors[0], closure]), values_of_poses(values))
    assert [c.name for c in estimate.components] == ["Between, steps", "Between, closures"]


def test_what_nothing_checks_keeps_its_sigmas() -> None:
    graph, values = survey(1, np.ones(3), np.ones(2))
    tied = FactorGraph([*graph.factors[:2], Prior(x[0], values[x[0]], Isotropic(0.01))])
    estimate = variance_components(tied, values)
    prior = estimate.components[-1]
    assert (prior.known, prior.scale) == (False, 1.0)
    assert prior.redundancy == pytest.approx(0, abs=1e-6)
    assert str(prior).startswith("Prior: stated sigmas kept, no other measurement checks them")
    assert np.isnan(estimate.correlation[-1]).all()
    assert estimate.settled


def test_scales_far_off_do_not_hide_one_another() -> None:
    """Fixes stated a thousand times too wide check nothing at first."""
    graph, values = survey(2, np.full(3, 3.0), np.full(2, 1.0))
    wide = Prior(x[:POSES], graph.factors[2].z, Isotropic(300.0), components=("x", "y"))
    near = variance_components(FactorGraph([graph.factors[0], graph.factors[2]]), values_of_poses(values))
    far = variance_components(FactorGraph([graph.factors[0], wide]), values_of_poses(values))
    assert [c.known for c in far.components] == [True, True]
    assert far.components[0].scale == pytest.approx(near.components[0].scale, rel=0.02)
    assert 1000 * far.components[1].scale == pytest.approx(near.components[1].scale, rel=0.02)


def values_of_poses(values: Values) -> Values:
    return Values({x: (SE2, values[x[np.arange(POSES)]])})


def test_kinds_of_variables_and_units_are_groups_of_their_own() -> None:
    graph, values = survey(0, np.ones(3), np.ones(2))
    graph.add(Prior(l[:LANDMARKS], values[l[np.arange(LANDMARKS)]], Isotropic(1.0)))
    names = list(residual_groups(graph.pattern(values), "units"))
    seen = ["BearingRange: bearing", "BearingRange: range"]
    assert names == ["Between: x, y", "Between: yaw", *seen, "Prior of x", "Prior of l"]


def test_correlated_components_share_a_scale() -> None:
    graph, values = survey(0, np.ones(3), np.ones(2))
    Sigma = np.array([[0.01, 0.002, 0], [0.002, 0.01, 0], [0, 0, 0.0004]])
    steps = Between(*graph.factors[0].keys, graph.factors[0].z, Covariance(Sigma))
    correlated = FactorGraph([steps, *graph.factors[1:]])
    assert len(variance_components(correlated, values, "units").components) == 5
    with pytest.raises(nls.OptionError, match="correlated"):
        variance_components(correlated, values, "components")
    with pytest.raises(nls.OptionError, match="kinds, units, components"):
        variance_components(correlated, values, "kind")  # type: ignore[arg-type]


def test_the_graph_given_stays_and_another_is_rescaled() -> None:
    graph, values = survey(0, np.full(3, 3.0), np.full(2, 0.5))
    chi2 = graph.chi2(values)
    estimate = variance_components(graph.robust(Cauchy(2.385)), values)
    plain = estimate.rescaled(graph)
    assert graph.chi2(values) == chi2
    assert [factor.kernel for factor in plain.factors] == [None] * 3
    assert all(factor.kernel is not None for factor in estimate.graph.factors)
    sigma = plain.factors[0].noise.named["x"]  # type: ignore[attr-defined]
    assert sigma == pytest.approx(0.1 * estimate.components[0].scale)


def test_an_exact_fit_has_no_scale() -> None:
    graph, values = survey(0, np.zeros(3), np.zeros(2))
    estimate = variance_components(FactorGraph(graph.factors[:2], [x[0]]), values)
    assert [c.known for c in estimate.components] == [False] * 2
    assert "their errors cannot be detected" in str(estimate)
