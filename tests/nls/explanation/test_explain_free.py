"""`nls.explain` on graphs that leave something free: every direction by its name, and as many as there are."""

from __future__ import annotations

import re

import numpy as np

import nls
import sim
from factors import Bearing, Between, Diagonal, Factor, Isotropic, Landmark, Prior, Range, RangeAzimuth
from factors.replaced import replaced
from models import SE2, SE3, R
from nls import FactorGraph, Values

x, l = nls.kinds("x", "l")


def seen_from(graph: FactorGraph, values: Values) -> list[str]:
    return list(nls.explain(graph, values).free)


def test_a_pose_that_sees_points_on_one_line() -> None:
    """The pose turns about that line, wherever it stands."""
    line = np.array([[3, 0, 1.0], [4, 0, 1], [5, 0, 1], [6, 0, 1]])
    pose = np.array([[0, 2.0, 0, 0, 0, 0, 1]])
    points = Prior(l[[0, 1, 2, 3]], line, Isotropic(0.1))
    graph = FactorGraph([points, Landmark(x[0], l[[0, 1, 2, 3]], line - pose[:, :3], Isotropic(0.1))])
    explanation = nls.explain(graph, Values({x: (SE3, pose), l: (R(3), line)}))
    assert len(explanation.free) == 1
    assert re.fullmatch(r"x0: roll about l[0-3]", explanation.free[0])
    assert explanation.findings[0].advice[0].action == "off axis"


def test_three_hundred_points_seen_once() -> None:
    """Each by name, in one finding: as many as there are, however many."""
    rng = np.random.default_rng(0)
    z = np.column_stack([rng.uniform(3, 6, 300), rng.uniform(-0.5, 0.5, 300)])
    contact = RangeAzimuth(x[0], l[np.arange(300)], z, Diagonal(range=0.01, azimuth=0.005))
    pose = SE3.exp(rng.normal(size=(1, 6)))  # any attitude: the elevation is the sonar's, not the world's
    points = SE3.act(pose, RangeAzimuth.arc(z, rng.uniform(-0.1, 0.1, 300)))
    graph = FactorGraph([Prior(x[0], pose[0], Isotropic(0.1)), contact])
    explanation = nls.explain(graph, Values({x: (SE3, pose), l: (R(3), points)}))
    assert (explanation.nullity, explanation.capped, explanation.rank) == (300, False, 606)
    assert set(explanation.free) == {f"l{k}: elevation as seen from x0" for k in range(300)}
    assert len(explanation.findings[0].keys) == 300
    assert "and 295 more" in explanation.findings[0].says


def test_wholes_that_move_as_one() -> None:
    """Scale of bearings only; turning of ranges only; x, y of a part whose heading alone is known."""
    rng = np.random.default_rng(0)
    P, L = np.array([[0, 0, 0], [1, 0, 0.1], [2, 0.5, 0.2]]), rng.uniform(-5, 5, (8, 2))
    i, j = np.repeat(np.arange(3), 8), np.tile(np.arange(8), 3)
    d, values = L[j] - P[i, :2], Values({x: (SE2, P), l: (R(2), L)})
    bearings = Bearing(x[i], l[j], np.arctan2(d[:, 1], d[:, 0]) - P[i, 2], Isotropic(0.01))
    whole = "of all 11 variables joined to x0"
    assert seen_from(FactorGraph([bearings]), values) == [f"scale about x0 {whole}"]
    ranges = Range(x[i], l[j], np.linalg.norm(d, axis=1), Isotropic(0.01))
    assert set(seen_from(FactorGraph([ranges]), values)) == {f"yaw about x0 {whole}", "x1: yaw", "x2: yaw"}
    k = np.arange(3)
    graph = FactorGraph(
        [Between(x[k], x[k + 1], [1, 0, 0], Isotropic(0.1)), Prior(x[1], [0, 0, 0], Isotropic(1), ["yaw"])]
    )
    straight = Values({x: (SE2, np.column_stack([np.arange(4), np.zeros((4, 2))]))})
    explanation = nls.explain(graph, straight)
    assert explanation.free == ("x of all 4 variables joined to x0", "y of all 4 variables joined to x0")
    assert explanation.rank == np.linalg.matrix_rank(graph.linearize(straight).A.toarray()) == 10


def test_more_free_directions_than_are_found_at_once() -> None:
    """Twenty pairs of points with a difference each, not declared relative: 40 directions that move two of them."""
    k = np.arange(20)
    graph = FactorGraph([Factor.from_function(lambda X, Y: Y - X, [l[k], l[100 + k]], 2, Isotropic(0.1))])
    values = Values({l: (R(2), np.random.default_rng(0).normal(size=(40, 2)), np.concatenate([k, 100 + k]))})
    explanation = nls.explain(graph, values)
    assert (explanation.nullity, explanation.rank, explanation.capped) == (40, 40, False)
    assert {f"{c} of all 2 variables joined to l{n}" for c in "xy" for n in k} == set(explanation.free)


def test_a_calibration_is_named_beside_a_landmark_that_is_free() -> None:
    """Bearings are off by 0.1 rad. One landmark has a single bearing, and its distance is free."""
    world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    first, odometry, sightings = world.graph.factors
    turned = FactorGraph([first, odometry, replaced(sightings, z=sightings.z + np.array([0.1, 0]))])
    values = turned.optimize(world.start).values.extended(l[[99]], np.array([[30.0, 4.0]]))
    X, P = values[x[0]], values[l[99]]
    bearing = np.arctan2(P[1] - X[1], P[0] - X[0]) - X[2]
    explanation = nls.explain(FactorGraph([*turned.factors, Bearing(x[0], l[99], bearing, Isotropic(0.01))]), values)
    assert list(explanation.free) == ["l99: range as seen from x0"]
    (finding,) = (finding for finding in explanation.findings if finding.kind == "calibration")
    ways = {(way["kind"], way["quantity"]): way for way in finding.numbers["calibrations"]}
    assert set(ways) == {("Between", "odometry"), ("BearingRange", "mounting")}
    for way in ways.values():
        np.testing.assert_allclose(way["correction"], [-0.1], atol=0.01)
