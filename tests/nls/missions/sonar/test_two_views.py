"""Two sonar images as one factor: against the full graph, its singular directions, mirror images, and statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factors import Between, RangeAzimuth
from factors.noise import Diagonal
from models import SE3, R, euler
from models.algebra import Array
from models.errors import EvaluationError, GraphError, OptionError, SingularGeometryError, UnderconstrainedError
from models.sensors import cartesian
from models.sensors.arcs import Contacts, second_view
from nls import FactorGraph, LevenbergMarquardt, Stop, Values, kinds
from nls.missions.sonar import TwoView, two_views
from tests.combinations import for_all

x, l = kinds("x", "l")
SIGMA = np.array([0.01, np.radians(0.25)])
LIMIT = np.radians(7.0)
ODOMETRY = np.array([0.02, 0.02, 0.01, 0.002, 0.002, 0.01])  # x, y, z, m, roll, pitch, yaw, rad
MOUNT = euler.to_se3([0.1, -0.5, 0.2, 0.3, 0.1, -0.1])
ORIGIN = SE3.identity()[0]
GENERAL = [0.2, 0.1, 0.5, 0.2, 0.05, 0.1]


def views(
    motion: list[float], seed: int = 0, m: int = 15, offset: Array = ORIGIN, noise: float = 1.0, el: float = LIMIT
) -> tuple[Array, Array, Array, Array, Array]:
    """Motion T of the vehicle, points (range, azimuth, elevation), both images, and what odometry says of T."""
    rng, O = np.random.default_rng(seed), offset
    T = SE3.compose(SE3.compose(O, SE3.exp(np.array(motion))), SE3.inverse(O))  # the motion is that of the sonar
    h = np.column_stack([rng.uniform(2, 6, m), rng.uniform(-0.25, 0.25, m), rng.uniform(-el, el, m)])
    z_j, _ = second_view(SE3.exp(np.array(motion))[None], h)
    z_i, z_j = (z + noise * SIGMA * rng.normal(size=z.shape) for z in (h[:, :2], z_j))
    return T, h, z_i, z_j, SE3.retract(T, noise * ODOMETRY * rng.normal(size=6))


def solved(motion: list[float], seed: int = 0, offset: Array = ORIGIN, **more: float) -> tuple[TwoView, Array]:
    T, _, z_i, z_j, start = views(motion, seed, offset=offset, **more)  # type: ignore[arg-type]
    return two_views(z_i, z_j, SIGMA, start, LIMIT, np.diag(ODOMETRY**-2), offset), T


@for_all(offset=[None, MOUNT])
def test_it_is_the_full_graph_with_its_points_eliminated(offset: Array | None) -> None:
    """Poses and information: same optimum as the graph with points, and as that with the factor in their place."""
    O = ORIGIN if offset is None else offset
    _, h, z_i, z_j, start = views(GENERAL, seed=5, offset=O, el=0.5 * LIMIT, noise=0.2)
    odometry, poses = Between(x[0], x[1], start, Diagonal(ODOMETRY)), (SE3, np.stack([ORIGIN, start]))
    seen = [RangeAzimuth(x[v], l[0:15], z, Diagonal(SIGMA), offset) for v, z in ((0, z_i), (1, z_j))]
    values = Values({x: poses, l: (R(3), SE3.act(O, cartesian(h)[0]))})
    graph = FactorGraph([odometry, *seen], [x[0]])
    tight = LevenbergMarquardt(Stop(update_tol=1e-10, chi2_rtol=1e-14))
    full = graph.optimize(values, tight)
    found = two_views(z_i, z_j, SIGMA, start, LIMIT, np.diag(ODOMETRY**-2), offset)
    assert found.converged
    assert not (found.weak | found.ambiguous).any()
    np.testing.assert_allclose(SE3.local(full.values[x[1]], found.pose), 0.0, atol=1e-6)

    H = graph.linearize(full.values).H.toarray()
    S = H[:6, :6] - H[:6, 6:] @ np.linalg.solve(H[6:, 6:], H[6:, :6])
    J = SE3.jl_inv(SE3.local(full.values[x[1]], start))
    S -= J.T @ np.diag(ODOMETRY**-2) @ J
    W = ODOMETRY[:, None] * np.eye(6)  # compared in standard deviations of the odometry
    np.testing.assert_allclose(W @ found.information @ W, W @ S @ W, atol=2e-3)

    again = FactorGraph([odometry, found.factor(x[0], x[1])], [x[0]]).optimize(Values({x: poses}), tight)
    np.testing.assert_allclose(SE3.local(again.values[x[1]], found.pose) / ODOMETRY, 0.0, atol=0.02)


def test_the_square_root_is_one_and_the_singular_directions_have_no_information() -> None:
    found, _ = solved(GENERAL, seed=1)
    W, S = found.sqrt_information, found.information
    np.testing.assert_allclose(W.T @ W, S, rtol=1e-9)
    assert (np.abs(W).max(axis=1) > 0).tolist() == found.kept_directions.tolist()
    assert 0 < found.kept_directions.sum() < 6
    for gain, v, kept in zip(found.gains, found.directions, found.kept_directions, strict=True):
        assert v @ np.diag(ODOMETRY**-2) @ v == pytest.approx(1.0)
        assert v @ S @ v == pytest.approx(gain if kept else 0.0, abs=1e-9)
        assert kept == (gain > 1e-3)


@for_all(motion=[[0.5, 0, 0, 0, 0, 0], [0.4, 0.3, 0, 0, 0, 0.2], [0, 0, 0, 0, 0, 0.2]])
def test_in_plane_motion_says_nothing_about_heave_roll_and_pitch(motion: list[float]) -> None:
    """Points at elevation 0, level: the sonar sees x, y and yaw, and its factor alone is refused by name."""
    found, _ = solved(motion, noise=0.0, el=0.0)
    assert found.converged
    assert found.kept_directions.sum() == 3
    out, seen = [2, 3, 4], [0, 1, 5]
    S = found.information * np.outer(ODOMETRY, ODOMETRY)
    assert np.abs(S[out]).max() < 1e-4 * S.max()
    assert np.linalg.eigvalsh(S[np.ix_(seen, seen)])[0] > 0.1
    graph = FactorGraph([found.factor(x[0], x[1])], [x[0]])
    values = Values({x: (SE3, np.stack([ORIGIN, found.pose]))})
    with pytest.raises(UnderconstrainedError, match=r"x1: .*z, roll, pitch") as caught:
        graph.optimize(values)
    assert caught.value.nullity == 3
    graph.add(Between(x[0], x[1], found.pose, Diagonal(ODOMETRY)))
    assert graph.optimize(values).converged


def test_both_mirror_images_are_kept_where_the_motion_is_in_plane() -> None:
    """Large elevations make their size visible, never their side: both hypotheses, same chi2, no average."""
    m = 10
    T, h, _, _, start = views([1.0, 0.8, 0, 0, 0, 0.3], noise=0.0, m=m)
    h[:, 2] = np.linspace(0.3, 0.4, m) * np.where(np.arange(m) % 2, 1, -1)
    z_i, (z_j, _) = h[:, :2], second_view(T[None], h)
    found = two_views(z_i, z_j, SIGMA / 10, start, 0.5, np.diag(ODOMETRY**-2))
    assert found.converged
    assert found.ambiguous.all()
    np.testing.assert_allclose(np.abs(found.h[:, :, 2]), np.abs(h[:, 2])[None] * [[1], [1]], atol=1e-3)
    np.testing.assert_array_equal(np.sign(found.h[0, :, 2]), -np.sign(found.h[1, :, 2]))
    np.testing.assert_allclose(found.chi2, 0.0, atol=1e-6)
    assert np.abs(found.information[2:5]).max() * 1e-4 < 1e-6 * found.information.max()
    np.testing.assert_allclose(SE3.local(found.pose, T), 0.0, atol=1e-5)
    # the rest of the motion known: the information in the plane is that of points whose sides are known
    sigmas = np.array([0.02, 0.02, 1e-6, 1e-6, 1e-6, 0.01])
    found = two_views(z_i, z_j, SIGMA / 10, start, 0.5, np.diag(sigmas**-2))
    assert found.ambiguous.all()
    contacts = Contacts(np.column_stack([z_i, z_j]), np.diag(10 / np.tile(SIGMA, 2))[None], 0.5)
    A_T, A_l, _ = contacts.linearize(T[None], h)
    seen = [0, 1, 5]
    P = np.eye(4) - A_l @ np.linalg.inv(A_l.mT @ A_l) @ A_l.mT  # what a free point leaves of its four measurements
    S = (A_T.mT @ P @ A_T).sum(axis=0)[np.ix_(seen, seen)]
    scale = np.outer(sigmas[seen], sigmas[seen])
    np.testing.assert_allclose(found.information[np.ix_(seen, seen)] * scale, S * scale, rtol=1e-3, atol=1e-3)


@for_all(heave=[1e-6, 0.1, 0.3])
def test_a_point_of_unknown_side_does_not_take_the_heave_for_exact(heave: float) -> None:
    """Surge towards one point ahead, put at +-limit / sqrt(3): its range error is 2 sigma_r^2 + (sin(el) sigma_z)^2."""
    T, h = SE3.exp([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([[4.0, 0.0, 0.0]])
    sigmas = np.array([1.0, 0.02, heave, 0.002, 0.002, 0.01])
    found = two_views(h[:, :2], second_view(T[None], h)[0], SIGMA, T, LIMIT, np.diag(sigmas**-2))
    assert found.weak.all()
    el = np.arcsin(4.0 / 3.5 * np.sin(LIMIT / np.sqrt(3)))
    expected = 1 / (2 * SIGMA[0] ** 2 + (np.sin(el) * heave) ** 2)
    assert found.information[0, 0] == pytest.approx(expected, rel=0.02)


def test_a_roll_tells_the_sides_apart() -> None:
    T, h, _, _, start = views([0, 0, 0, 0.5, 0, 0], noise=0.0, m=10)
    h[:, 2] = np.linspace(0.08, 0.12, 10) * np.where(np.arange(10) % 2, 1, -1)
    found = two_views(h[:, :2], second_view(T[None], h)[0], SIGMA, start, LIMIT, np.diag(ODOMETRY**-2))
    assert not (found.ambiguous | found.weak).any()
    np.testing.assert_allclose(found.h[0, :, 2], h[:, 2], atol=1e-4)


def test_the_information_is_what_the_errors_say() -> None:
    """z against the truth over 8 seeds: squared errors under the information, against their number of directions.

    By motion, and for all motions together, where half or twice the information is too far off.
    """
    counts = np.zeros((3, 2))
    for n, motion in enumerate((GENERAL, [0.5, 0, 0, 0, 0, 0], [0, 0, 0.4, 0, 0, 0])):
        for seed in range(8):
            found, T = solved(motion, seed, MOUNT)
            assert found.converged
            e = SE3.local(found.z, T)
            counts[n] += e @ found.information @ e, found.kept_directions.sum()
    for total, directions in (*counts, counts.sum(axis=0)):
        assert abs(total - directions) < 3.3 * np.sqrt(2 * directions), counts
    total, directions = counts.sum(axis=0)
    assert 3.3 * np.sqrt(2 * directions) < directions / 2


def test_weak_points_are_said_to_be_weak_by_the_aperture_not_by_their_number() -> None:
    few, _ = solved([0.3, 0, 0, 0, 0, 0], m=5)
    many, _ = solved([0.3, 0, 0, 0, 0, 0], m=40)
    assert few.weak.all()
    assert many.weak.all()
    np.testing.assert_allclose(np.sort(np.abs(few.h[:, :, 2]).ravel()), LIMIT / np.sqrt(3))
    strong, _ = solved([0, 0, 0.5, 0.3, 0, 0])
    assert not strong.weak.any()


def test_without_odometry_the_sonar_alone() -> None:
    """A start that counts for nothing: exact data bring the pose back along every direction seen."""
    T, _, z_i, z_j, _ = views([0.2, 0.1, 0.5, 0.4, 0.05, 0.1], noise=0.0, m=40, el=0.9 * LIMIT)
    start = SE3.retract(T, np.array([0.02, -0.02, 0.02, 0.01, -0.01, 0.01]))
    found = two_views(z_i, z_j, SIGMA / 10, start, LIMIT)
    assert found.converged
    e = SE3.local(found.pose, T)
    assert e @ found.information @ e < 1e-3
    assert found.kept_directions.sum() >= 5


def test_what_cannot_be_is_refused() -> None:
    *_, z_i, z_j, start = views(GENERAL)
    refusals: list[tuple[str, dict[str, object]]] = [
        (r"z_i \(15, 2\) and z_j \(14, 2\)", {"z_j": z_j[1:]}),
        ("sigmas", {"sigmas": [0.01, 0.0]}),
        ("range that is not above 0", {"z_i": -z_i}),
        ("one initial guess", {"start": [start, start]}),
        ("not positive definite", {"odometry_information": np.diag([1.0, 1, 1, 1, 1, 0])}),
        ("symmetric", {"odometry_information": np.eye(3)}),
        *(("limit", {"limit": limit}) for limit in (0.0, 2.0, True)),
        ("tau", {"tau": 0.0}),
    ]
    given = {"z_i": z_i, "z_j": z_j, "sigmas": SIGMA, "start": start, "limit": LIMIT}
    for match, wrong in refusals:
        with pytest.raises(OptionError if match in ("limit", "tau") else GraphError, match=match):
            two_views(**given | wrong)  # type: ignore[arg-type]
    with pytest.raises(EvaluationError, match="did not converge"):
        replace(two_views(**given), converged=False).factor(x[0], x[1])
    end = cartesian(np.array([[4.0, 0.0, -LIMIT]]))[0][0]  # of the arc, where the search begins
    above = SE3.exp(np.array([end[0], 0, 1.0, 0, 0, 0]))  # the second sonar stands straight over or under it
    with pytest.raises(SingularGeometryError, match=r"contact at 4 m, 0 rad, seen from the second view: .* z axis"):
        two_views([[4.0, 0.0]], [[1.0, 0.0]], SIGMA, above, LIMIT)
