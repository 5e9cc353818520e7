"""Weak directions of landmarks, and steps that leave them out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import Between, Diagonal, Isotropic, Landmark, Prior, RangeAzimuth, Sighting
from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, R, euler
from models.algebra import Array, Mask
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls import FactorGraph, GaussNewton, Marginals, Pinv, Schur, Status, Values
from nls.analysis import landmark_information
from nls.analysis.leave_one_out import checks
from nls.analysis.swapped_landmarks import Exchanged, SwappedLandmarks, exchanged_contacts, swapped_landmarks
from nls.linear import truncated_inverse
from tests.combinations import for_all
from tests.nls.misreadings import clean, judged, optimum
from tests.nls.planar import l, mission, x


def rotated(rng: np.random.Generator, eigenvalues: Array) -> tuple[Array, Array]:
    """Symmetric matrices (n, d, d) of given eigenvalues (n, d), and their eigenvectors."""
    V = np.linalg.qr(rng.normal(size=(*eigenvalues.shape, eigenvalues.shape[-1])))[0]
    return (V * eigenvalues[:, None, :]) @ V.mT, V


def test_directions_above_the_threshold_are_inverted_and_the_others_left_out() -> None:
    w = np.array([[1e4, 2e3, 11.0], [1e4, 2e3, 9.0], [5.0, 5.0, 5.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    H, V = rotated(np.random.default_rng(1), w)
    kept = np.array([[1, 1, 1], [1, 1, 0], [1, 1, 1], [1, 0, 0], [0, 0, 0]])
    expected = (V * (kept / np.where(kept, w, 1))[:, None, :]) @ V.mT
    np.testing.assert_allclose(truncated_inverse(H), expected, atol=1e-12)
    np.testing.assert_allclose(truncated_inverse(H[0], tau=0.0), np.linalg.inv(H[0]), rtol=1e-9)


def test_the_threshold_is_a_value_and_relative() -> None:
    """Not a place in a list, nor a number of measurements: as many views again, or other units, change nothing.

    A floor leaves out what is known better without.
    """
    H, _ = rotated(np.random.default_rng(2), np.array([[1e4, 5e3, 15.0], [1e4, 5e3, 5.0]]))
    assert np.linalg.matrix_rank(truncated_inverse(H), tol=1e-8).tolist() == [3, 2]
    for scale in (1e-6, 50.0, 1e8):
        np.testing.assert_allclose(truncated_inverse(scale * H) * scale, truncated_inverse(H), rtol=1e-9, atol=1e-12)
    H, _ = rotated(np.random.default_rng(3), np.array([[900.0, 800.0, 30.0], [900.0, 800.0, 30.0]]))
    assert np.linalg.matrix_rank(truncated_inverse(H, floor=[20.0, 40.0]), tol=1e-9).tolist() == [3, 2]


@for_all(tau=[-0.1, 1.0, np.nan, True, "small"])
def test_a_threshold_that_cannot_be(tau: object) -> None:
    with pytest.raises(OptionError, match="tau"):
        truncated_inverse(np.eye(3), tau)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="floor"):
        truncated_inverse(np.eye(3), floor=-1.0)


def test_truncated_blocks_solve_it_and_move_no_landmark_along_its_elevation() -> None:
    graph, _, start = mission(np.random.default_rng(0), np.zeros(12))
    result = graph.optimize(start, GaussNewton(), Schur(block_inverse=truncated_inverse))
    assert 60 < result.chi2_final < 180 < result.chi2_initial  # 180 rows, 60 unknowns that are not elevations
    assert np.abs(result.values[l][:, 2]).max() == 0.0
    shortest = graph.optimize(start, GaussNewton(), Pinv())  # the minimizer with no part along the null space
    np.testing.assert_allclose(result.values[l], shortest.values[l], atol=2e-6)
    np.testing.assert_allclose(SE3.local(result.values[x], shortest.values[x]), 0.0, atol=2e-6)
    graph, truth, start = mission(np.random.default_rng(0), np.zeros(12), noise=0.0)  # a gradient of rounding is none
    result = graph.optimize(start, GaussNewton(), Schur(block_inverse=truncated_inverse))
    assert result.converged
    assert result.chi2_final < 1e-12
    np.testing.assert_allclose(result.values[l], truth[l], atol=1e-6)


@for_all(height=[0.1, 10.0])
def test_what_is_left_alone_may_be_pulled_by_noise_and_by_no_more(height: float) -> None:
    """The height of the points is known to 1 m, too weakly for tau: they stay at 0, wherever that is in sigmas."""
    graph, _, start = mission(np.random.default_rng(0), np.zeros(12))
    graph.add(Prior(l[range(12)], np.full((12, 3), height), Isotropic(1.0), components=("z",)))
    result = graph.optimize(start, GaussNewton(), Schur(block_inverse=truncated_inverse))
    assert np.abs(result.values[l][:, 2]).max() == 0.0
    assert result.linear_solver.endswith("12 directions left alone")
    assert result.status is (Status.CONVERGED if height < 1 else Status.STALLED)
    if height > 1:
        assert "pull one unknown by 10 sigmas" in result.reason
        exact = graph.optimize(start, GaussNewton(), Schur())
        assert exact.converged
        assert exact.chi2_final < result.chi2_final - 100


def test_information_of_a_landmark_is_its_block_of_AtA() -> None:
    graph, _, start = mission(np.random.default_rng(6), np.array([0.0, 0.1, 0.4]), roll=0.1)
    found = landmark_information(graph, start, "l")
    H = graph.linearize(start).H.toarray()
    for k in range(3):
        b = slice(36 + 3 * k, 39 + 3 * k)
        np.testing.assert_allclose(found.information[k], H[b, b], rtol=1e-12)
        w, weak = found.eigenvalues[k], found.weak[k]
        np.testing.assert_allclose(found.information[k] @ weak, w[0] * weak, atol=1e-6)
        assert (found.condition[k], found.sigma[k]) == pytest.approx((w[0] / w[2], w[0] ** -0.5))
    np.testing.assert_allclose(np.linalg.norm(found.weak, axis=1), 1.0)


def test_the_weak_direction_of_level_motion_is_the_elevation() -> None:
    graph, _, start = mission(np.random.default_rng(7), np.zeros(4))
    found = landmark_information(graph, start, l)
    np.testing.assert_allclose(found.weak, np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-9)
    np.testing.assert_allclose(found.elevation_angle, 0.0, atol=1e-7)
    assert (found.condition < 1e-15).all()
    head, *lines = found.report(2).splitlines()
    assert head.startswith("4 of 4 landmarks")
    assert "free along (0.00, 0.00, 1.00), 0 deg from the elevation" in lines[0]
    assert len(lines) == 2


def test_the_elevation_is_that_of_the_first_pose_in_the_world() -> None:
    """A sonar rolled and pitched: one view alone, whose arc is the weak direction; then two, in either order."""
    X = euler.to_se3(np.array([[0.4, 0.3, 0.5, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    O = euler.to_se3([0.0, -0.6, 0.0, 0.3, 0.0, 0.1])
    S = SE3.compose(X, O)
    p = np.array([[3.0, 0.4, 0.25]])
    L = SE3.act(S[:1], p)
    arc = np.cross(np.cross([0, 0, 1.0], p), p) * -1  # dp/del is normal to p, in the plane of p and the z axis
    arc = SE3.rotation(S[0]) @ (arc / np.linalg.norm(arc)).ravel()
    values = Values({x: (SE3, X[[0, 0]], [7, 3]), l: (R(3), L)})
    other = RangeAzimuth(x[7], l[0], [3.0, 0.1], Diagonal([0.01, 0.01]))
    seen = RangeAzimuth(x[3], l[0], [3.0, 0.1], Diagonal([0.01, 0.01]), offset=O)
    found = landmark_information(FactorGraph([seen]), values, l)
    assert abs(found.weak[0] @ arc) == pytest.approx(1.0)
    assert found.elevation_angle[0] == pytest.approx(0.0, abs=1e-6)
    both = landmark_information(FactorGraph([other, seen]), values, l)
    assert both.elevation_angle[0] == pytest.approx(np.arccos(abs(both.weak[0] @ arc)), abs=1e-6)
    assert both.elevation_angle[0] > 0.01
    turned = landmark_information(FactorGraph([seen, other]), values, l)
    np.testing.assert_allclose(turned.elevation_angle, both.elevation_angle, atol=1e-6)


def test_marginal_information_is_the_inverse_of_the_marginal_covariance() -> None:
    graph, _, start = mission(np.random.default_rng(8), np.linspace(-0.4, 0.4, 90), roll=0.3, heave=0.3)
    found = landmark_information(graph, start, l, marginal=True)
    assert found.marginal is not None
    expected = np.linalg.inv(Marginals(graph, start).all(l))
    np.testing.assert_allclose(found.marginal, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    assert (found.eigenvalues <= np.linalg.eigvalsh(found.information) * (1 + 1e-9)).all()


def test_marginal_information_where_landmarks_are_free() -> None:
    """Against the Schur complement by a dense pseudo-inverse; the free directions stay free."""
    graph, _, start = mission(np.random.default_rng(9), np.array([0.0, 0.0, 0.3, -0.2]), roll=0.0)
    found = landmark_information(graph, start, l, marginal=True)
    assert found.marginal is not None
    H = graph.linearize(start).H.toarray()
    for k in range(4):
        own = np.arange(36 + 3 * k, 39 + 3 * k)
        rest = np.setdiff1d(np.arange(len(H)), own)
        B = H[np.ix_(own, rest)]
        M = H[np.ix_(own, own)] - B @ np.linalg.pinv(H[np.ix_(rest, rest)], rcond=1e-13) @ B.T
        np.testing.assert_allclose(found.marginal[k], M, atol=1e-5 * np.abs(M).max())
    assert (found.condition[:2] < 1e-12).all()


def test_marginal_information_needs_what_is_not_a_landmark_to_be_determined() -> None:
    graph, _, start = mission(np.random.default_rng(10), np.array([0.3, -0.3]), roll=0.2)
    graph.remove(graph.factors[1])  # the heading of the first pose
    with pytest.raises(UnderconstrainedError, match="leave 1 direction free"):
        landmark_information(graph, start, l, marginal=True)
    graph.fix(x[range(6)])
    fixed = landmark_information(graph, start, l, marginal=True)
    assert fixed.marginal is not None
    np.testing.assert_allclose(fixed.marginal, fixed.information, rtol=1e-12)


def test_landmarks_of_the_plane_and_kinds_that_are_none() -> None:
    values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]]), l: (R(2), [[2.0, 1.0]])})
    graph = FactorGraph([Landmark(x[0], l[0], [2, 1], Isotropic(0.1)), Prior(x[0], [0, 0, 0], Isotropic(1))])
    found = landmark_information(graph, values, l)
    np.testing.assert_allclose(found.information, [100 * np.eye(2)])
    assert np.isnan(found.elevation_angle).all()
    with pytest.raises(GraphError, match="x is in SE2, expected points"):
        landmark_information(graph, values, x)
    graph.add(Between(l[0], l[1], [1.0, 0.0], Isotropic(0.1)))
    two = Values({x: (SE2, [[0, 0, 0]]), l: (R(2), [[2.0, 1.0], [3.0, 1.0]])})
    joined = landmark_information(graph, two, l, marginal=True).marginal
    assert joined is not None  # l1 is measured from l0 alone: their squared sigmas add up
    Sigma = np.array([[2.0, -2.0], [-2.0, 5.0]]) + 0.01 * np.array([1, 2])[:, None, None] * np.eye(2)
    np.testing.assert_allclose(np.linalg.inv(joined), Sigma, rtol=1e-9)


@for_all(sigma=[0.1, 100.0])
def test_a_free_direction_stays_free_whatever_the_poses_are_known_to(sigma: float) -> None:
    """One sighting by a sonar to a millimeter, from a pose known to decimeters or to hundreds of meters."""
    values = Values({x: (SE3, SE3.identity(1)), l: (R(3), [[4.0, 1.0, 0.5]])})
    sight = RangeAzimuth(x[0], l[0], [4.15, 0.245], Diagonal([0.001, 0.001]))
    graph = FactorGraph([Prior(x[0], SE3.identity(1), Isotropic(sigma)), sight])
    report = landmark_information(graph, values, l, marginal=True)
    assert report.degenerate(1e-9).all()
    arc = np.array([-4.0, -1.0, 17 / 0.5])
    assert abs(report.weak[0] @ arc) / np.linalg.norm(arc) == pytest.approx(1.0, abs=1e-6)


When = Callable[[npt.NDArray[np.int64]], npt.NDArray[np.bool_]]


def swapped(graph: FactorGraph, a: int, b: int, when: When) -> FactorGraph:
    """The graph with landmarks a and b exchanged at some poses, by their number."""
    factors = list(graph.factors)
    for k, factor in enumerate(factors):
        if isinstance(factor, Sighting):
            pose, target, *others = factor.keys
            other = np.where(target.numbers == a, b, np.where(target.numbers == b, a, target.numbers))
            numbers = np.where(when(pose.numbers), other, target.numbers)
            factors[k] = replaced(factor, [pose, Keys(target.kind, numbers), *others])
    return FactorGraph(factors, graph.fixed)


def named(graph: FactorGraph, start: Values) -> tuple[SwappedLandmarks, ...]:
    values = optimum(graph, start)
    checked = judged(graph, values)
    return swapped_landmarks(graph, values, None if checked is None else checks(checked, len(graph.factors)))


def seen_by(graph: FactorGraph, a: int, b: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Poses and landmarks of the sightings of two."""
    (factor,) = (f for f in graph.factors if isinstance(f, Sighting) and not f.limit_only)
    of = np.isin(factor.keys[1].numbers, [a, b])
    return factor.keys[0].numbers[of], factor.keys[1].numbers[of]


@pytest.mark.parametrize(("name", "a", "b"), [("subsea", 3, 4), ("lines", 7, 9)])
def test_exchanged_from_some_time_on(name: str, a: int, b: int) -> None:
    graph, start, right = clean(name, 0)
    middle = len(start.stack("x")) // 2
    (swap,) = named(swapped(graph, a, b, lambda pose: pose > middle), start)
    assert (swap.first, swap.second) == (Keys("l", a), Keys("l", b))
    assert swap.chi2 == pytest.approx(graph.chi2(right), rel=1e-3)
    poses, _ = seen_by(graph, a, b)
    late = int((poses > middle).sum())
    assert len(swap.places) in (late, len(poses) - late)  # which half is called exchanged is a matter of names


def test_exchanged_in_one_image() -> None:
    graph, start, _ = clean("lines", 0)
    poses, landmarks = seen_by(graph, 1, 4)
    image = np.intersect1d(poses[landmarks == 1], poses[landmarks == 4])[0]
    (swap,) = named(swapped(graph, 1, 4, lambda pose: pose == image), start)
    assert (swap.first, swap.second) == (Keys("l", 1), Keys("l", 4))
    assert len(swap.places) == 2


def test_wholly_exchanged_where_they_are_known() -> None:
    """Without knowledge of where they are, exchanged names are no mistake."""
    graph, start, _ = clean("headings", 0)
    (swap,) = named(swapped(graph, 0, 1, lambda pose: pose >= 0), start)
    assert (swap.first, swap.second) == (Keys("l", 0), Keys("l", 1))
    assert len(swap.places) == len(seen_by(graph, 0, 1)[0])
    graph, start, _ = clean("subsea", 0)
    assert named(swapped(graph, 0, 1, lambda pose: pose >= 0), start) == ()


def test_contacts_of_a_sonar_in_space() -> None:
    """Two pairs in two images, whose hinges go with them."""
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=4)
    spoiled = sim.exchange_contacts(mission, 0.008, np.random.default_rng(1))
    swaps = named(spoiled.graph, spoiled.start)
    target = mission.contacts.keys[1].numbers[spoiled.wrong]
    assert {int(key.numbers[0]) for swap in swaps for key in (swap.first, swap.second)} == set(target.tolist())
    assert all(len(swap.places) == 4 for swap in swaps)


def test_a_false_sighting_is_no_exchange() -> None:
    graph, start, _ = clean("subsea", 0)
    first, odometry, seen = graph.factors
    z = np.array(seen.z)
    z[len(z) // 2] += [1.0, 5.0]
    assert named(FactorGraph([first, odometry, replaced(seen, z=z)]), start) == ()


RNG = np.random.default_rng


def exchanged(mission: sim.Mission, rejected: Mask, values: Values | None = None) -> tuple[Exchanged, ...]:
    """Pairs whose contacts were exchanged, of those that were rejected; at the truth unless there are values."""
    masks = [rejected if f is mission.contacts else np.zeros(len(f), dtype=bool) for f in mission.graph.factors]
    return exchanged_contacts(mission.graph, values or mission.truth, masks)


def test_exchanged_pairs_are_named_with_their_contacts() -> None:
    right = sim.hauv_floor(RNG(1), legs=2, per_leg=12)
    mission = sim.exchange_contacts(right, 0.05, RNG(2))
    pairs = exchanged(mission, mission.wrong)
    rows = [index for pair in pairs for _, index in pair.places]
    assert mission.wrong[rows].all()
    assert len(set(rows)) > 0.9 * mission.wrong.sum()
    assert [len(pair.places) for pair in pairs] == sorted((len(pair.places) for pair in pairs), reverse=True)
    for pair in pairs:
        numbers = mission.contacts.keys[1].numbers[[index for _, index in pair.places]]
        assert set(numbers.tolist()) == {int(pair.first.numbers[0]), int(pair.second.numbers[0])}
        assert pair.standing > 100 * len(pair.places)
        assert pair.chi2 < 9.3 * len(pair.places)
    own = right.contacts.chi2(mission.truth)[sorted(set(rows))]
    np.testing.assert_allclose(sum(pair.chi2 for pair in pairs), own.sum(), rtol=0.1)


def test_false_contacts_are_no_exchange() -> None:
    mission = sim.hauv_floor(RNG(1), legs=2, per_leg=12, outliers=0.1)
    assert exchanged(mission, mission.wrong) == exchanged(mission, mission.wrong & False) == ()


def test_landmarks_that_left_are_passed_over() -> None:
    mission = sim.hauv_floor(RNG(1), legs=2, per_leg=12, wrong_associations=0.05)
    pairs = exchanged(mission, mission.wrong)
    gone = int(pairs[0].first.numbers[0])
    stack = mission.truth.stack("l")
    values = Values.of([mission.truth.stack("x"), stack.only(stack.numbers != gone)])
    fewer = exchanged(mission, mission.wrong, values)
    assert 0 < len(fewer) < len(pairs)
    assert all(gone not in (pair.first.numbers[0], pair.second.numbers[0]) for pair in fewer)
