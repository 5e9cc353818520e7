"""Local maps: landmarks beside anchors, and the motions between these, against the covariances of the whole graph."""

from __future__ import annotations

import numpy as np

from nls import FactorGraph, Marginals, kinds
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.anchors import of_points
from nls.sonar.contacts.maps import local_maps
from nls.sonar.contacts.stretches import bounds
from tests.nls.sonar.contacts.scenes import estimate_of, in_plane

x, l = kinds("x", "l")


def test_maps_are_known_as_the_graph_knows_them() -> None:
    scene = in_plane()
    pings, tracks = scene.pings, of.renamed(scene.true)
    graph = FactorGraph([*scene.graph.factors, pings.of_landmarks(tracks)])
    values = graph.optimize(scene.truth_by(tracks)).values
    longest = -(-len(pings.poses) // 3)
    stretch = np.searchsorted(bounds(len(pings.poses), longest), pings.ping, side="right") - 1
    maps = local_maps(pings, estimate_of(tracks, graph, values), longest, 3)
    assert len(maps.anchors) == 3
    seen = [(s, t) for s in range(3) for t in np.unique(tracks) if np.sum((tracks == t) & (stretch == s)) >= 3]
    landmarks = tracks[maps.sightings]
    assert [*zip(maps.stretch, landmarks, strict=True)] == seen
    assert len({*landmarks}) < len(seen)  # some are in two maps
    assert np.array_equal(maps.stretch, stretch[maps.sightings])
    np.testing.assert_array_equal(maps.points.p, values[l[landmarks]])

    a, b = np.array([0, 0, 1]), np.array([1, 2, 2])
    keys = maps.anchors[a], maps.anchors[b]
    exact = Marginals(graph, values, pairs=[keys]).relative(*keys)
    np.testing.assert_allclose(maps.motions(a, b), exact, rtol=1e-6, atol=1e-12)

    last = maps.seen_from(2, 2)
    X = values[maps.anchors[[2]]]
    np.testing.assert_allclose(pings.group.act(X, last.p), maps.points.p[maps.stretch == 2], atol=1e-12)
    beside = maps.anchors[maps.stretch], l[landmarks]
    C = of_points(pings.group, Marginals(graph, values, pairs=[beside]), *beside)
    np.testing.assert_allclose(maps.points.C, C, rtol=1e-6, atol=1e-12)
    R = pings.group.rotation(X)
    np.testing.assert_allclose(R @ last.C @ R.mT, C[maps.stretch == 2], rtol=1e-6, atol=1e-12)
