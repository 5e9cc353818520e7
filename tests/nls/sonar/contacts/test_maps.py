"""Local maps: landmarks beside anchors, and the motions between these, against the covariances of the whole graph."""

from __future__ import annotations

import numpy as np

from nls import FactorGraph, Marginals, kinds
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.maps import local_maps
from tests.nls.sonar.contacts.scenes import estimate_of, in_plane

x, l = kinds("x", "l")


def test_maps_are_known_as_the_graph_knows_them() -> None:
    scene = in_plane()
    pings, tracks = scene.pings, of.renamed(scene.true)
    graph = FactorGraph([*scene.graph.factors, pings.of_landmarks(tracks)])
    numbers = np.unique(tracks)
    values = graph.optimize(scene.truth_by(tracks)).values
    longest = -(-len(pings.poses) // 3)
    maps = local_maps(pings, estimate_of(tracks, graph, values), longest, 3)
    assert len(maps.anchors) == 3
    assert np.array_equal(maps.tracks, numbers[of.sizes(tracks)[numbers] >= 3])
    assert np.array_equal(maps.stretch, pings.ping[maps.tracks] * 3 // len(pings.poses))
    np.testing.assert_array_equal(maps.points.p, values[l[maps.tracks]])

    a, b = np.array([0, 0, 1]), np.array([1, 2, 2])
    keys = maps.anchors[a], maps.anchors[b]
    exact = Marginals(graph, values, pairs=[keys]).relative(*keys)
    np.testing.assert_allclose(maps.motions(a, b), exact, rtol=1e-6, atol=1e-12)

    first = maps.seen_from(0, 0)
    X = values[maps.anchors[[0]]]
    np.testing.assert_allclose(pings.group.act(X, first.p), maps.points.p[maps.stretch == 0], atol=1e-12)
    world = Marginals(graph, values).covariance(l[maps.tracks[maps.stretch == 0]])
    trace = np.trace(first.C, axis1=1, axis2=2)
    assert (trace > 0).all()
    assert np.median(trace / np.trace(world, axis1=1, axis2=2)) < 1  # better known beside the anchor
