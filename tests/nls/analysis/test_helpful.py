"""One more view, for one motion after another, and what it would tell."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, BetweenSensors, Diagonal, ElevationHinge, EpipolarArc, Factor, Isotropic, Landmark, Prior
from factors.replaced import predicted
from models import SE2, SE3, R
from nls import FactorGraph, GraphError, Marginals, OptionError, SingularGeometryError, Values
from nls.analysis import helpful_motions, observability
from tests.nls.rigs import FLAT, SONAR, l, odometers, rig, s, x


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
    with pytest.raises(SingularGeometryError, match="x6"):  # nothing is seen from there
        helpful_motions(graph, values, s[0], motions={"about": np.array([0, 0, 0, 0, np.pi, 0])})


def test_a_leg_goes_on_from_the_last_pose_and_a_loop_comes_back() -> None:
    X = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0.5, 0.3], [2, 1.5, 1.9]])
    O, step = [0.3, 0.1, 0.2], np.array([1.0, 0.0, 0.4])
    values = Values({x: (SE2, X), s: (SE2, O)})
    more = Values({x: (SE2, np.vstack([X, SE2.compose(X[3], SE2.exp(step))])), s: (SE2, O)})

    def joined(i: list[int], j: list[int], values: Values) -> FactorGraph:
        """Legs by both odometers, of different quality."""
        vehicle = Between(x[i], x[j], np.zeros((len(i), 3)), Diagonal([0.02, 0.03, 0.1]))
        sensor = BetweenSensors(x[i], x[j], np.zeros((len(i), 3)), Isotropic(0.01), s[0])
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


def test_what_cannot_be_asked() -> None:
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
