"""`nls.explain`: what it finds in graphs that were broken on purpose, by name, and nothing in good ones."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import factors as f
import nls
import sim
from factors import Bearing, Between, Cauchy, Diagonal, Factor, Isotropic, Landmark, Prior, Range, RangeAzimuth, Tukey
from factors.replaced import replaced
from factors.robust import Kernel
from models import SE2, SE3, R
from models.algebra import Array
from models.manifolds.rn import Vectors
from nls import Explanation, FactorGraph, GraphError, Kind, Values
from nls.analysis.freedom import freedom
from nls.explanation.naming import named_directions
from nls.explanation.words import directions
from nls.gauge import choose_gauge, fixed_variables
from tests.combinations import for_all
from tests.factors.samples import Sample, situation
from tests.factors.samples_sonar import ELIMINATING_SAMPLES
from tests.factors.test_conformity import SAMPLES

x, l = nls.kinds("x", "l")
NOISE = Diagonal(x=0.1, y=0.1, yaw=0.02)


def kinds(explanation: Explanation) -> list[str]:
    return [finding.kind for finding in explanation.findings]


def ring(*more: Factor, seed: int = 0) -> tuple[FactorGraph, Values]:
    """Two laps of twenty poses, measured with noise, and more factors."""
    world = sim.ring(np.random.default_rng(seed), laps=2, per_lap=20)
    return FactorGraph([*world.graph.factors, *more]), world.start


def explained(graph: FactorGraph, start: Values) -> Explanation:
    return nls.explain(graph, graph.optimize(start, nls.LevenbergMarquardt()).values)


def test_a_good_graph_is_good() -> None:
    explanation = explained(*ring())
    assert explanation.rank == explanation.unknowns == 117
    assert explanation.low < explanation.chi2 < explanation.high
    assert kinds(explanation) == ["unchecked"]
    assert explanation.findings[0].keys == (x[38], x[39])
    assert explanation.report().startswith("117 unknowns, all determined. chi2, 42.27, is as expected.\n")
    assert json.loads(json.dumps(explanation.record(), allow_nan=False))["parts"][0]["name"] == "Between, steps"


@for_all(seed=range(2))
def test_a_wrong_closure_is_named_and_its_neighbors_are_not(seed: int) -> None:
    good = explained(*ring(seed=seed))
    explanation = explained(*ring(Between(x[7], x[33], [3, 0, 0.5], NOISE), seed=seed))
    wrong = [finding for finding in explanation.findings if finding.kind == "wrong_closure"]
    assert [finding.keys for finding in wrong] == [(x[7], x[33])]
    assert "outlier" not in kinds(explanation)
    assert explanation.chi2 > 100 * explanation.dof
    assert explanation.chi2_without == pytest.approx((good.chi2, good.dof), rel=1e-4)
    assert sum(w.chance < 1e-3 for w in explanation.worst) > 3  # before it is taken out, others look wrong as well
    (suspect,) = explanation.suspects
    assert suspect.factor == "Between(x7, x33)"
    assert suspect.normalized > 50


def test_three_wrong_closures_in_space() -> None:
    world = sim.sphere(np.random.default_rng(4), 12, 12)
    z = SE3.between(world.truth[x[[5, 40, 99]]], world.truth[x[[77, 120, 12]]])
    wrong = Between(x[[5, 40, 99]], x[[77, 120, 12]], SE3.retract(z, np.full((3, 6), 1.0)), Isotropic(0.05))
    graph = FactorGraph([*world.graph.factors, wrong])
    explanation = explained(graph, world.truth)
    assert {suspect.factor for suspect in explanation.suspects} == {wrong.describe(k) for k in range(3)}
    shuffled = [factor[np.random.default_rng(1).permutation(len(factor))] for factor in graph.factors[::-1]]
    again = explained(FactorGraph(shuffled), world.truth)
    for many in ("suspects", "worst"):
        assert [m.factor for m in getattr(again, many)] == [m.factor for m in getattr(explanation, many)]
    distances = [[measurement.normalized for measurement in found.worst] for found in (again, explanation)]
    assert distances[0] == pytest.approx(distances[1], rel=1e-5)


def test_one_landmark_under_two_numbers() -> None:
    """The two that are one, of eight; not two that are seen from one pose, nor two too far apart for their sigmas."""
    world = sim.subsea(np.random.default_rng(1), known_start=True)
    (seen,) = (factor for factor in world.graph.factors if factor.keys[-1].kind == "l")
    others = [factor for factor in world.graph.factors if factor is not seen]
    pose, point = seen.keys
    late = (point.numbers == 0) & (pose.numbers > 60)
    again = seen[point.numbers == 1]
    start = world.start.extended(l[[50, 60]], world.start[l[[0, 1]]])
    for shift, expected in ((0.0, [(l[0], l[50])]), (1.0, [])):
        z = seen.z + shift * late[:, None] * [0, 1]
        numbered = f.BearingRange(pose, l[np.where(late, 50, point.numbers)], z, seen.noise)
        graph = FactorGraph([*others, numbered, replaced(again, [again.keys[0], l[[60] * len(again)]])])
        values = graph.optimize(start).values
        found = [finding for finding in nls.explain(graph, values).findings if finding.kind == "twins"]
        assert [finding.keys for finding in found] == expected
        for finding in found:
            D, apart = np.hstack([np.eye(2), -np.eye(2)]), values[l[0]] - values[l[50]]
            Sigma = D @ nls.Marginals(graph, values).joint(l[[0, 50]]).matrix @ D.T
            sigmas = np.sqrt(apart @ np.linalg.solve(Sigma, apart))
            assert finding.numbers == pytest.approx({"distance": np.linalg.norm(apart), "sigmas": sigmas})


def test_in_a_single_loop_nothing_tells_the_wrong_one() -> None:
    k = np.arange(4)
    z = np.array([[2, 0, np.pi / 2], [2, 0, np.pi / 2], [2, 0, np.pi / 2], [5, 0, np.pi / 2]])
    order = np.array([1, 0, 3, 2])  # the closure, from x3 to x0, neither first nor last
    graph = FactorGraph([Between(x[k[order]], x[(k[order] + 1) % 4], z[order], Isotropic(0.1))])
    start = Values({x: (SE2, [[0, 0, 0], [2, 0, np.pi / 2], [2, 2, np.pi], [0, 2, -np.pi / 2]])})
    found = explained(graph, start).findings[0]
    assert (found.kind, found.keys) == ("wrong_closure", (x[3], x[0]))
    assert (found.numbers["rivals"], found.numbers["rival"]) == (3, "Between(x1, x2)")


def test_two_that_are_wrong_by_themselves_are_no_rivals() -> None:
    graph, start = ring()
    X = graph.optimize(start).values
    i, j = np.array([3, 12]), np.array([28, 31])
    graph.add(Between(x[i], x[j], SE2.between(X[x[i]], X[x[j]]) + np.array([3.0, 0.0, 0.5]), NOISE))
    graph.fix(x[np.arange(40)])
    findings = [found for found in nls.explain(graph, X).findings if found.kind == "wrong_closure"]
    assert {found.keys for found in findings} == {(x[3], x[28]), (x[12], x[31])}
    assert not any(found.numbers["rivals"] for found in findings)


@for_all(kernel=[Cauchy(0.1), Tukey(0.1)])
def test_a_kernel_that_rejects_most_is_not_recommended_itself(kernel: Kernel) -> None:
    graph, start = ring()
    robust = FactorGraph([factor.robust(kernel) for factor in graph.factors])
    (finding, *_) = (found for found in nls.explain(robust, start).findings if found.kind == "rejected")
    assert finding.numbers["kernel"] == repr(kernel)
    assert finding.numbers["of"] >= finding.numbers["off"] > finding.numbers["of"] / 2
    assert ("gentle kernel" in {advice.action for advice in finding.advice}) == isinstance(kernel, Tukey)


def test_many_wrong_closures_are_too_many_to_name() -> None:
    rng = np.random.default_rng(3)
    i, j = rng.integers(0, 18, 30), rng.integers(20, 40, 30)
    explanation = explained(*ring(Between(x[i], x[j], rng.normal(size=(30, 3)), NOISE)))
    many = next(finding for finding in explanation.findings if finding.kind == "many_outliers")
    assert len(many.numbers["factors"]) == 10
    assert many.advice[0].action == "gnc"


@for_all(factor=[0.5, 1.0, 2.0])
def test_sigmas_of_the_wrong_size(factor: float) -> None:
    """Judged by kind, to a fifth, and no measurement is blamed for it."""
    world = sim.manhattan(np.random.default_rng(0), 400)
    sized = [Between(*f.keys, f.z, Isotropic(0.02 * factor), f.convention) for f in world.graph.factors]
    explanation = explained(FactorGraph(sized), world.truth)
    assert {"wrong_closure", "outlier", "many_outliers"}.isdisjoint(kinds(explanation))
    causes = [finding.numbers["cause"] for finding in explanation.findings if finding.kind == "sigmas"]
    assert causes == {0.5: ["small"] * 2, 1.0: [], 2.0: ["large"] * 2}[factor]
    for part in explanation.parts:
        assert part.typical == pytest.approx(factor**-2, rel=0.4)


@for_all(case=[([1, 1, -1], "misread"), ([3.28, 3.28, 1], "calibration"), ([1, 1, 57.3], "systematic")])
def test_a_kind_that_is_wrong_as_a_whole(case: tuple[list[float], str]) -> None:
    """A wrong sign, feet for meters, degrees for radians."""
    wrong, first = case
    world = sim.manhattan(np.random.default_rng(0), 100)
    steps = world.graph.factors[0]
    turned = Between(*steps.keys, steps.z * wrong, steps.noise)
    found = kinds(explained(FactorGraph([turned, *world.graph.factors[1:]]), world.truth))
    assert ("systematic" in found) == (first != "calibration")
    assert found[0] == first
    assert {"outlier", "wrong_closure"}.isdisjoint(found)


def test_causes_of_a_large_graph_are_not_tried_and_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nls.explanation.explanation.WORK", 10_000)
    world = sim.manhattan(np.random.default_rng(0), 100)
    steps = world.graph.factors[0]
    wrong = FactorGraph([Between(*steps.keys, steps.z * [1, 1, -1], steps.noise), *world.graph.factors[1:]])
    found = kinds(explained(wrong, world.truth))
    assert ("not_tried" in found, "misread" in found) == (True, False)
    assert "not_tried" not in kinds(explained(world.graph, world.truth))


def test_a_factor_made_from_a_function() -> None:
    """Such factors have no parts; what is wrong in them is named all the same."""
    angle = np.array([3.1, -3.1, 3.1])

    def minus(X: Array) -> Array:
        return X[:, :1] - angle[:, None]

    graph = FactorGraph([Factor.from_function(minus, x[[0, 0, 0]], 1, Isotropic(0.1))])
    explanation = explained(graph, Values({x: (R(1), [3.1])}))
    assert explanation.worst[0].factor == "minus(x0)"
    assert explanation.findings[0].kind == "outlier"
    assert "repeated" not in kinds(explanation)


def test_values_that_are_no_optimum() -> None:
    graph, start = ring()
    explanation = nls.explain(graph, start)
    assert kinds(explanation)[0] == "no_optimum"
    assert explanation.promised > 1
    assert explanation.suspects == ()
    assert explanation.report().startswith("117 unknowns, all determined. The values are no optimum.")
    assert json.dumps(explanation.record(), allow_nan=False)


def test_repetitions_across_batches() -> None:
    graph, start = ring()
    closures = graph.factors[1]
    graph = FactorGraph([*graph.factors, closures[[2]], closures[[2, 4]]])
    (finding,) = (found for found in explained(graph, start).findings if found.kind == "repeated")
    assert finding.numbers["count"] == 3
    assert set(finding.keys) == {keys[[k]] for keys in closures.keys for k in (2, 4)}


def test_parts_and_variables_that_nothing_joins() -> None:
    graph = FactorGraph([Between(x[[0, 1, 10]], x[[1, 2, 11]], [1, 0, 0], Isotropic(0.1))])
    values = Values({x: (SE2, np.zeros((6, 3)), [0, 1, 2, 10, 11, 20])})
    explanation = nls.explain(graph, values)
    assert explanation.components == (3, 2)
    found = {finding.kind: finding for finding in explanation.findings}
    assert found["unmeasured"].keys == (x[20],)
    assert found["separate_parts"].keys == (x[0], x[10])
    assert found["separate_parts"].numbers["variables"] == (3, 2)
    assert found["unchecked"].numbers["count"] == found["unchecked"].numbers["of"] == 3


def test_weights_too_different_for_the_normal_equations() -> None:
    graph = FactorGraph([Prior(x[0], [0.0, 0.0], Isotropic(1e3)), Between(x[0], x[1], [1.0, 0.0], Isotropic(1e-4))])
    explanation = nls.explain(graph, Values({x: (R(2), np.zeros((2, 2)))}))
    assert (kinds(explanation), explanation.nullity, explanation.parts) == (["ill_conditioned"], 0, ())


def test_nothing_to_estimate_and_nothing_measured() -> None:
    graph, start = ring()
    graph.add(Between(x[[]], x[[]], np.zeros((0, 3)), NOISE))
    graph.fix(x[np.arange(40)])
    explanation = nls.explain(graph, start)
    assert (explanation.unknowns, explanation.rank, explanation.weakest) == (0, 0, ())
    assert explanation.dof == 147
    assert json.dumps(explanation.record(), allow_nan=False)


def test_what_cannot_be_explained() -> None:
    with pytest.raises(GraphError, match="no factors: nothing to explain"):
        nls.explain(FactorGraph(), Values())
    graph, start = ring()
    factors, numbers = list(graph.factors), start[x].copy()
    nls.explain(graph, start)
    assert graph.factors == factors
    assert graph.fixed == []
    np.testing.assert_array_equal(start[x], numbers)


class Water(Vectors):
    """Temperature and salinity."""

    def __init__(self) -> None:
        super().__init__(2)
        self.components, self.units = ("temperature", "salinity"), ("K", "g/kg")


WATER = Water()


def test_a_space_of_ones_own_states_its_units() -> None:
    """A number alone, which may be anything, has none."""
    w, c = nls.kinds("w", "c")
    graph = FactorGraph([Prior(w[0], [280.0, 35.0], Diagonal([0.5, 0.1])), Prior(c[0], [1.0], Isotropic(0.2))])
    result = graph.optimize(Values({w: (WATER, [[280.0, 35.0]]), c: (R(1), [1.0])}))
    assert [weak.unit for weak in nls.explain(graph, result.values).weakest] == ["K", "g/kg", ""]
    assert "w0 salinity         0.1 g/kg" in nls.explain(graph, result.values).report()


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
    whole = "of all 11 variables connected to x0"
    assert seen_from(FactorGraph([bearings]), values) == [f"scale about x0 {whole}"]
    ranges = Range(x[i], l[j], np.linalg.norm(d, axis=1), Isotropic(0.01))
    assert set(seen_from(FactorGraph([ranges]), values)) == {f"yaw about x0 {whole}", "x1: yaw", "x2: yaw"}
    k = np.arange(3)
    graph = FactorGraph(
        [Between(x[k], x[k + 1], [1, 0, 0], Isotropic(0.1)), Prior(x[1], [0, 0, 0], Isotropic(1), ["yaw"])]
    )
    straight = Values({x: (SE2, np.column_stack([np.arange(4), np.zeros((4, 2))]))})
    explanation = nls.explain(graph, straight)
    assert explanation.free == ("x of all 4 variables connected to x0", "y of all 4 variables connected to x0")
    assert explanation.rank == np.linalg.matrix_rank(graph.linearize(straight).A.toarray()) == 10


def test_more_free_directions_than_are_found_at_once() -> None:
    """Twenty pairs of points with a difference each, not declared relative: 40 directions that move two of them."""
    k = np.arange(20)
    graph = FactorGraph([Factor.from_function(lambda X, Y: Y - X, [l[k], l[100 + k]], 2, Isotropic(0.1))])
    values = Values({l: (R(2), np.random.default_rng(0).normal(size=(40, 2)), np.concatenate([k, 100 + k]))})
    explanation = nls.explain(graph, values)
    assert (explanation.nullity, explanation.rank, explanation.capped) == (40, 40, False)
    assert {f"{c} of all 2 variables connected to l{n}" for c in "xy" for n in k} == set(explanation.free)


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


@for_all(sample=[sample for sample in [*SAMPLES, *ELIMINATING_SAMPLES] if sample.convention == "log"])
def test_rank_and_words(sample: Sample) -> None:
    X, z = situation(sample, "large innovation", 3, 0)
    factor = sample.factor(z, Isotropic(0.1))
    values = Values()
    for keys, manifold, elements in zip(factor.keys, sample.manifolds, X, strict=True):
        values.add(Kind(keys.kind), manifold, elements, np.unique(keys.numbers))
    graph = FactorGraph([factor])
    explanation = nls.explain(graph, values)
    pattern = graph.pattern(values)
    pattern = pattern.holding(choose_gauge("first", pattern, values, fixed_variables([], values)).held)
    A = nls.LinearSystem.at(pattern, values).A.toarray()
    norms = np.linalg.norm(A, axis=0)
    A = A / np.where(norms > 1e-13 * norms.max(initial=0.0), norms, np.inf)
    rank = np.linalg.matrix_rank(A, tol=1e-9) if A.size else 0
    assert (explanation.unknowns, explanation.rank) == (A.shape[1], rank)
    assert len(explanation.free) == explanation.nullity == A.shape[1] - rank
    assert explanation.report()
    assert json.dumps(explanation.record(), allow_nan=False)
    free = freedom(pattern, values)
    r = free.combinations.shape[1]
    turn = np.linalg.qr(np.random.default_rng(r).normal(size=(r, r)))[0]
    turned = replace(free, combinations=free.combinations @ turn)  # any basis is as good as another
    named = named_directions(turned, pattern, values)
    assert sum(len(directions(finding)) for finding in named) == explanation.nullity
