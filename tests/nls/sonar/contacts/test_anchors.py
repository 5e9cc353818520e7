"""Bounds beside anchors against the joint covariance, and how near they come to it."""

from __future__ import annotations

import numpy as np
import pytest

from nls import FactorGraph, Marginals
from nls.sonar.contacts.anchors import anchored, bounded
from tests.nls.sonar.contacts.scenes import estimate_of, floor, in_plane, landmark_distances

SCENES = {"floor": floor, "in_plane": in_plane}


@pytest.mark.parametrize("name", SCENES)
def test_bounds_hold_for_poses_that_have_not_seen_a_landmark(name: str) -> None:
    scene = SCENES[name]()
    pings, half = scene.pings, len(scene.pings.poses) // 2
    early = np.flatnonzero(pings.ping < half)
    measured = pings.of_landmarks(scene.true[early], early)
    graph = FactorGraph([*scene.graph.factors, measured])
    if pings.limit:
        graph.add(pings.aperture_factor(measured))
    values = graph.optimize(scene.truth_of(scene.true[early])).values
    late = np.flatnonzero(pings.ping >= half)
    numbers = np.unique(scene.true[early])
    d, landmarks = np.repeat(late, len(numbers)), np.tile(numbers, len(late))
    estimate = estimate_of(scene.true, graph, values)
    pairings = anchored(pings, d, landmarks)
    marginals = Marginals(graph, values, pairs=pairings.pairs)
    d2, width, least = bounded(pings, estimate, marginals, pairings)
    exact_d2, exact_width = landmark_distances(pings, estimate, d, landmarks, np.inf)
    assert (d2 <= exact_d2 * (1 + 1e-6)).all()
    assert (least <= exact_width * (1 + 1e-6)).all()
    assert (exact_width**2 <= 2 * width**2).all()
    assert np.median(least / exact_width) > 0.5  # a bound that is never near would be of no use
    assert (d2 > 0.5 * exact_d2).any()
    widest = 1.0001 * float(np.quantile(exact_width, 0.3))  # not the width of a pair itself
    _, bound = landmark_distances(pings, estimate, d, landmarks, np.inf, widest)
    assert np.array_equal(bound < widest, exact_width < widest)  # the same pairs are narrow
    assert (bound < 0.99 * exact_width).any()  # not all have been asked for their joint covariance
