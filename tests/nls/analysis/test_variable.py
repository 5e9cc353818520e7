"""What a data set determines of a mounting, and what one more view would tell, for one motion after another."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import factors as f
import nls
from factors import Between, Covariance, Diagonal, ElevationHinge, EpipolarArc, Factor, Isotropic, Landmark, Prior
from factors.replaced import predicted
from factors.rescaled import rescaled
from models import SE2, SE3, R
from models.algebra import Array
from nls import FactorGraph, GraphError, Marginals, OptionError, UnderconstrainedError, Values, kinds
from nls.analysis import helpful_motions, observability
from tests.combinations import for_all
from tests.nls.explanation.test_explain import WATER
from tests.nls.rigs import FLAT, SONAR, l, odometers, rig, s, x

NAMES = list(SE3.components)


def nullity(graph: FactorGraph, values: Values) -> int:
    """Free directions of the whole graph, by singular values."""
    A = graph.linearize(values).A.toarray()
    norms = np.linalg.norm(A, axis=0)
    return int((np.linalg.svd(A / np.where(norms > 1e-12, norms, 1.0), compute_uv=False) < 1e-9).sum())


def dense(graph: FactorGraph, values: Values) -> Array:
    """The block of the pseudo-inverse of A'A that belongs to s0, the last columns, by singular values."""
    A = graph.linearize(values).A.toarray()
    return np.asarray(np.linalg.pinv(A.T @ A, rcond=1e-13, hermitian=True)[-6:, -6:])


@for_all(
    case=[
        ("camera + sonar", [], NAMES, 0),
        ("camera + range", ["roll", "pitch", "yaw"], ["x", "y", "z"], 3),
        ("camera + azimuth", ["x", "y", "z"], ["roll", "pitch", "yaw"], 2),  # in these, two directions
        ("sonar", NAMES, [], 6),
    ],
    seed=[0, 1],
)
def test_camera_and_sonar(case: tuple[str, list[str], list[str], int], seed: int) -> None:
    """Step along each free direction and let the rest follow: chi2 stays 0; along a determined one it does not."""
    sensors, free, known, directions = case
    graph, values = rig(sensors, seed=seed, points=20)
    found = observability(graph, values, s[0])
    assert len(found.free) == 6 - found.rank == directions == nullity(graph, values)
    assert [c for c, u in zip(NAMES, found.undetermined, strict=True) if u] == free
    assert np.isinf(found.sigma).tolist() == [c in free for c in NAMES]
    k = [NAMES.index(c) for c in known]
    np.testing.assert_allclose(found.covariance[np.ix_(k, k)], dense(graph, values)[np.ix_(k, k)], rtol=1e-6)
    table = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert [sigma is None for sigma in table["sigma"]] == found.undetermined.tolist()
    assert table["rank"] == found.rank
    html = found._repr_html_()
    assert html.count("<tr>") == 7
    assert all(f"<td>{name}</td>" in html for name in NAMES)
    assert str(found).startswith(f"s0: {found.rank} of 6 directions determined; fixed by the graph itself\n")
    graph.fix(s[0])
    for n, loose in [*((n, True) for n in found.free), *((w, False) for w in found.weak)] if not seed else []:
        moved = values.copy()
        moved[s[0]] = SE3.retract(values[s[0]], 0.1 * n / np.linalg.norm(n * found.weights) if loose else n / 10)
        chi2 = graph.optimize(moved).chi2_final
        assert chi2 < 1e-12 if loose else chi2 == pytest.approx(0.01, rel=0.1)


def test_free_directions_are_named_with_what_moves_along() -> None:
    """Of azimuths the height of the sonar is free on its own; the scale is, and with it everything has one."""
    found = observability(*rig("camera + azimuth"), s[0])
    scale, height = found.free
    np.testing.assert_allclose(height * found.weights, [0, 0, 1, 0, 0, 0], atol=1e-6)
    p_s = -SE3.rotation(SONAR).T @ SE3.position(SONAR)  # the camera, in axes of the sonar
    assert abs(scale[0] * p_s[1] - scale[1] * p_s[0]) < 1e-6 * np.abs(scale).max() * np.linalg.norm(p_s)
    assert found.with_free == ("x, y, z of x; x, y, z of l", "")
    assert "free: z\n" in str(found)
    assert "free: x, y (together with x, y, z of x; x, y, z of l)" in str(found)
    assert observability(*rig("camera + range"), s[0]).with_free == ("", "", "")


def test_bound_is_the_marginal_covariance() -> None:
    graph, values = rig("camera + sonar")
    found = observability(graph, values, s[0])
    expected = Marginals(graph, values).covariance(s[0], frame="body")
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-8, atol=1e-10 * expected.max())
    np.testing.assert_allclose(found.sigma, np.sqrt(np.diagonal(expected)), rtol=1e-9)
    correlation = expected / np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(found.correlation, correlation, atol=1e-7)
    np.testing.assert_allclose(found.weak.T @ found.weak, expected, rtol=1e-7, atol=1e-10 * expected.max())
    in_meters = np.linalg.norm(found.weak * found.weights, axis=1)
    assert (np.diff(in_meters) < 0).all()
    for key, frame in ((x[1], "body"), (l[3], None)):
        expected = Marginals(graph, values).covariance(key, frame=frame)
        np.testing.assert_allclose(observability(graph, values, key).covariance, expected, rtol=1e-6, atol=1e-12)


def test_correlations_are_named() -> None:
    for r, notes in ((-0.95, ["x and y, -0.950"]), (0.8, [])):
        prior = Prior(l[0], [1.0, 2.0], Covariance([[4.0, 2 * r], [2 * r, 1.0]]))
        found = observability(FactorGraph([prior]), Values({l: (R(2), [1.0, 2.0])}), l[0])
        assert re.findall("correlated: (.*)", str(found)) == notes


def test_known_is_all_else_held() -> None:
    graph, values = rig("camera + sonar")
    found = observability(graph, values, s[0])
    alone = observability(FactorGraph(graph.factors, [x[0:6], l[0:40]]), values, s[0])
    np.testing.assert_allclose(found.sigma_known, alone.sigma_known, rtol=1e-12)
    np.testing.assert_allclose(alone.sigma_known, np.diagonal(np.linalg.inv(alone.covariance)) ** -0.5, rtol=1e-9)
    assert (alone.sigma <= found.sigma).all()
    unknown = observability(*rig("camera + range"), s[0]).sigma_known
    assert np.isinf(unknown).tolist() == [False] * 3 + [True] * 3


def test_rank_does_not_depend_on_units_nor_on_how_good_the_sensors_are() -> None:
    """All sigmas times 1e6: the same directions, a million times the standard deviations."""
    graph, values = rig("camera + azimuth")
    models = [values.gather(factor)[0] for factor in graph.factors]
    worse = FactorGraph([rescaled(model, np.full((1, model.dim), 1e6)) for model in models], graph.fixed)
    a, b = observability(graph, values, s[0]), observability(worse, values, s[0])
    assert a.rank == b.rank == 4
    np.testing.assert_allclose(b.sigma[3:], 1e6 * a.sigma[3:], rtol=1e-6)


def test_what_counts_how_much() -> None:
    """A radian as many meters as the targets are away; in the mean a column of A_k is then of length 1."""
    graph, values = rig("camera + sonar")
    found = observability(graph, values, s[0])
    i, j = np.divmod(np.arange(240), 40)
    distance = np.linalg.norm(values[l][j] - values[x][i, :3], axis=1).mean()
    assert found.length == pytest.approx(distance)
    np.testing.assert_allclose(found.weights / found.weights[0], [1, 1, 1, *[distance] * 3])
    assert np.mean(found.known / found.weights**2) == pytest.approx(1.0)
    other = observability(graph, values, s[0], length=1e-3)
    np.testing.assert_allclose(other.sigma, found.sigma, rtol=1e-9)
    assert other.weakest < 3  # when a turn hardly counts


@for_all(free=[False, True])
def test_weak_directions_of_the_rest_are_taken_out_too(free: bool) -> None:
    """k + p0 + p1 and p0 + (1 + d) p1, nearly the same, say nothing about k: p0 and p1 can take it up. k / 100 does.

    With p2 and p3, of which only the difference is measured, the rest is singular and gets damped: no one must notice.
    """
    k, p, d = *kinds("k", "p"), 1e-5
    J = np.array([[1, 1, 1, 0, 0], [0, 1, 1 + d, 0, 0], [0.01, 0, 0, 0, 0], [0, 0, 0, 1, -1.0]])
    keys = [k[0], *p[0:4]]
    graph = FactorGraph(
        [Factor.from_function(lambda *X: np.hstack(X) @ J.T, keys, 4, jacobians=lambda *_: [*J.T[:, None, :, None]])]
    )
    if not free:
        graph.fix(p[3])
    found = observability(graph, Values({k: (R(1), [0.0]), p: (R(1), np.zeros((4, 1)))}), k[0])
    assert found.sigma[0] == pytest.approx(100, rel=1e-3)


def test_a_space_of_ones_own_states_its_units() -> None:
    """Only components of one unit are compared; a number alone, which may be anything, has none."""
    w, c = kinds("w", "c")
    values = Values({w: (WATER, [[280.0, 35.0]]), c: (R(1), [1.0])})
    graph = FactorGraph([Prior(w[0], [280.0, 35.0], Diagonal([0.5, 0.1])), Prior(c[0], [1.0], Isotropic(0.2))])
    of_water, alone = (observability(graph, values, key[0], gauge="none") for key in (w, c))
    rows = [line.split()[:3] for line in str(of_water).splitlines()[2:4]]
    assert rows == [["temperature", "0.5", "K"], ["salinity", "0.1", "g/kg"]]
    assert of_water.compared.tolist() == [1.0, 1.0]
    assert of_water.to_dict()["units"] == ["K", "g/kg"]
    assert str(alone).splitlines()[2].split() == ["x", "0.2", "0.2"]


def test_what_cannot_be_asked() -> None:
    graph, values = rig("camera + sonar")
    with pytest.raises(UnderconstrainedError, match="s1: no factor touches it"):
        observability(graph, values.extended(s[[1]], SONAR[None]), s[1])
    for key, match in ((x[0], "x0 is fixed"), (x[0:2], "one variable"), (s[9], "s9 has no value")):
        with pytest.raises(GraphError, match=match):
            observability(graph, values, key)
    for name, value in (("gauge", "free"), ("length", -1.0)):
        with pytest.raises(OptionError, match=name):
            observability(graph, values, s[0], **{name: value})  # type: ignore[arg-type]
    graph.release(x[0])
    with pytest.raises(GraphError, match="gauge 'first' fixes x0"):
        observability(graph, values, x[0])
    assert observability(graph, values, x[0], gauge="none").rank == 0
    assert observability(graph, values, s[0], gauge="none").rank == 6


def test_a_helpful_motion_is_one_view_more() -> None:
    """Against the graph made by hand: the view, its factors and the covariance by another way. No limit is copied."""
    graph, values = rig("camera + sonar")
    step = np.array([0.0, 0.3, 0.0, 0.1, 0.0, 0.2])
    sensors = list(graph.factors)
    graph.add(ElevationHinge(x[5], l[0], 1e-6, 0.01, SONAR))  # one that pushes
    found = helpful_motions(graph, values, s[0], motions={"mine": step}, frame=SONAR)
    assert found.pose == x[5]
    there = SE3.compose(SE3.compose(values[x[5]], SE3.compose(SONAR, SE3.exp(step))), SE3.inverse(SONAR))
    more = values.extended(x[[6]], there[None])
    again = FactorGraph(graph.factors, [x[0]])
    for factor in sensors:
        keys = [x[np.full(40, 6)], l[0:40], s[np.zeros(40, dtype=int)]][: len(factor.keys)]
        again.add(predicted(factor[200:], keys, more))
    expected = np.sqrt(np.diagonal(Marginals(again, more).covariance(s[0], frame="body")))
    np.testing.assert_allclose(found.ranking[0].after.sigma, expected, rtol=1e-8)
    np.testing.assert_allclose(found.ranking[0].gain, found.before.sigma / expected, rtol=1e-8)
    assert (found.ranking[0].gain > 1).all()


def test_ranking_is_by_the_weakest_component_and_knows_to_stay() -> None:
    graph, values = rig("camera + sonar")
    found = helpful_motions(graph, values, s[0], frame=SONAR)
    assert found.before.components[found.before.weakest] == "pitch"
    gains = [motion.gain[4] for motion in found.ranking]
    assert gains == sorted(gains, reverse=True)
    assert [m.name for m in found.ranking].count("stay") == 1
    assert len(found.ranking) == 7
    assert all((m.gain >= 1 - 1e-9).all() for m in found.ranking)
    with pytest.raises(nls.SingularGeometryError, match="x6"):  # nothing is seen from there
        helpful_motions(graph, values, s[0], motions={"about": np.array([0, 0, 0, 0, np.pi, 0])})


def test_a_leg_goes_on_from_the_last_pose_and_a_loop_comes_back() -> None:
    X = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0.5, 0.3], [2, 1.5, 1.9]])
    O, step = [0.3, 0.1, 0.2], np.array([1.0, 0.0, 0.4])
    values = Values({x: (SE2, X), s: (SE2, O)})
    more = Values({x: (SE2, np.vstack([X, SE2.compose(X[3], SE2.exp(step))])), s: (SE2, O)})

    def joined(i: list[int], j: list[int], values: Values) -> FactorGraph:
        """Legs by both odometers, of different quality."""
        vehicle = Between(x[i], x[j], np.zeros((len(i), 3)), Diagonal([0.02, 0.03, 0.1]))
        sensor = f.BetweenSensors(x[i], x[j], np.zeros((len(i), 3)), Isotropic(0.01), s[0])
        return FactorGraph([predicted(factor, factor.keys, values) for factor in (vehicle, sensor)])

    graph = joined([0, 1, 2, 3], [1, 2, 3, 0], values)
    found = helpful_motions(graph, values, s[0], motions={"on": step}).ranking[0].after
    by_hand = observability(joined([0, 1, 2, 3, 3, 4], [1, 2, 3, 0, 4, 0], more), more, s[0])
    np.testing.assert_allclose(found.sigma, by_hand.sigma, rtol=1e-9)
    assert np.isfinite(found.sigma).all()


def test_turns_about_other_axes_tell_the_lever_along_the_first() -> None:
    """After a flat mission roll and pitch do; they come first, and the table says what is then known."""
    graph, values = odometers(FLAT)
    found = helpful_motions(graph, values, s[0])
    ranks = {motion.name: motion.after.rank for motion in found.ranking}
    assert {name for name, rank in ranks.items() if rank == 6} == {"roll 10 deg", "pitch 10 deg"}
    assert {motion.name for motion in found.ranking[:2]} == {"roll 10 deg", "pitch 10 deg"}
    for motion in found.ranking:
        assert np.isinf(motion.gain[:3]).all() == (motion.after.rank == 6)
        assert (motion.gain[3:] >= 1 - 1e-9).all()
    best, worst = str(found).splitlines()[2], str(found).splitlines()[-1]
    assert f"now {found.ranking[0].after.sigma[0]:.3g} m" in best
    assert worst.split()[-6:-3] == ["free"] * 3
    assert str(found).startswith("one more view from x5: sigmas of s0")


def test_motions_in_the_plane_are_three() -> None:
    values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0.2]]), l: (R(2), [[3, 1], [4, -1], [2, 2]])})
    seen = Landmark(x[[0, 0, 0, 1, 1, 1]], l[[0, 1, 2, 0, 1, 2]], np.zeros((6, 2)), Isotropic(0.1))
    graph = FactorGraph([predicted(seen, seen.keys, values)])
    names = [motion.name for motion in helpful_motions(graph, values, l[0]).ranking]
    assert sorted(names) == ["stay", "surge 0.5 m", "sway 0.5 m", "yaw 10 deg"]


def test_motions_that_cannot_be_asked() -> None:
    graph, values = rig("camera + sonar")
    for wrong in (np.zeros(3), np.full(6, np.nan), "ahead"):
        with pytest.raises(OptionError, match="step of 6 finite numbers"):
            helpful_motions(graph, values, s[0], motions={"wrong": wrong})  # type: ignore[dict-item]
    with pytest.raises(GraphError, match="helpful_motions: expected one variable"):
        helpful_motions(graph, values, "s0")  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="expected one pose"):
        helpful_motions(graph, values, s[0], pose=l[0])
    only = FactorGraph([Prior(l[0], values[l[0]], Isotropic(0.1))])
    with pytest.raises(GraphError, match="no pose shares a factor with l0"):
        helpful_motions(only, values, l[0])
    graph.add(Factor.from_function(lambda X: X[:, :3], x[[4, 5]], 3))
    with pytest.raises(GraphError, match="cannot be sliced"):
        helpful_motions(graph, values, s[0])


def test_the_same_measurements_of_other_variables() -> None:
    """A target that is no variable is nowhere: what fits old contacts best is none of what would be measured there."""
    graph, values = rig("camera + sonar")
    two, sonar = values.extended(s[[1]], SE3.identity(1)), graph.factors[1][0:40]
    there = predicted(sonar, [x[np.full(40, 3)], l[0:40], s[np.ones(40, dtype=int)]], two)
    assert there.chi2(two).max() < 1e-20
    assert sonar.keys[0].numbers.tolist() == [0] * 40  # the one given is as it was
    np.testing.assert_allclose(there.z[:, 0], np.linalg.norm(SE3.act(SE3.inverse(values[x[3]]), values[l]), axis=1))
    with pytest.raises(GraphError, match="expected 40"):
        predicted(sonar, [x[3], l[0], s[0]], two)
    pair = EpipolarArc(x[0], x[1], [[4.0, 0.1, 4.0, 0.1]], Diagonal([0.01, 0.004] * 2), 0.1)
    with pytest.raises(GraphError, match=r"EpipolarArc\(x0, x1\): .* as a variable"):
        predicted(pair, [x[[0]], x[[2]]], values)
