"""Poses and rotations from matrices and from roll, pitch and yaw (z down), and back; elements between two others."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models import SE2, SE3, SO2, SO3, LieGroup, Measured, R, euler
from models.algebra import Array, wrap
from models.errors import GraphError, OptionError, SingularGeometryError
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from tests.combinations import for_all
from tests.models.differences import on_group

GROUPS = [SE2, SE3, SO2, SO3]
same = np.testing.assert_allclose


@for_all(group=GROUPS, shape=[(), (1,), (5,), (2, 3)])
def test_matrices_there_and_back(group: LieGroup, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    X = group.exp(rng.normal(size=(*shape, group.dim)) * 2)
    M = group.matrix(X)
    k = group.point_dim + bool(group.position(X).shape[-1])
    assert M.shape == (*shape, k, k)
    Y = group.from_matrix(M)
    assert Y.shape == X.shape
    same(group.local(X, Y), np.zeros((*shape, group.dim)), atol=1e-9)
    p = rng.normal(size=(*shape, group.point_dim))
    column = np.concatenate([p, np.ones((*shape, k - group.point_dim))], axis=-1)
    same((M @ column[..., None])[..., : group.point_dim, 0], group.act(X, p), atol=1e-12)
    Z = group.exp(rng.normal(size=(*shape, group.dim)))
    same(group.matrix(group.compose(X, Z)), M @ group.matrix(Z), atol=1e-12)


def test_rounded_matrices_are_taken_and_halves_of_a_turn_too() -> None:
    T = SE3.matrix(SE3.from_rpy(1, 2, 3, 0.4, -0.5, np.pi))
    same(SE3.local(SE3.from_matrix(T), SE3.from_matrix(T.round(4))), np.zeros(6), atol=1e-4)
    for turn in (np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])):
        same(SO3.matrix(SO3.from_matrix(turn)), turn, atol=1e-15)
    assert SE2.from_matrix(np.diag([-1.0, -1.0, 1.0]))[2] == -np.pi


GOOD = np.eye(4)
SHEARED, MIRRORED, MOVED = GOOD.copy(), np.diag([1.0, 1.0, -1.0, 1.0]), GOOD.copy()
SHEARED[0, 1], MOVED[3, :3] = 0.1, [1.0, 2.0, 3.0]


@for_all(
    case=[
        (lambda: SE3.from_matrix([GOOD, SHEARED]), "SE3.from_matrix: matrix 1 is no rigid motion: .*by 0.1, above"),
        (lambda: SE3.from_matrix(2 * np.eye(4)), "SE3.from_matrix: matrix 0 has the last row .*2.0], expected"),
        (lambda: SE3.from_matrix(np.diag([2, 2, 2, 1])), "matrix 0 is no rigid motion: .*by 3, above .* scale"),
        (lambda: SE3.from_matrix([GOOD, GOOD, MIRRORED]), "matrix 2 is a reflection: .* expected 1"),
        (lambda: SE3.from_matrix(MOVED), "last row .*; it is transposed, give T.mT"),
        (lambda: SE3.from_matrix(np.eye(3)), r"shape \(3, 3\), expected \(4, 4\) or \(n, 4, 4\)"),
        (lambda: SE3.from_matrix(np.eye(4)[:3]), r"shape \(3, 4\), expected \(4, 4\) or \(n, 4, 4\)"),
        (lambda: SE3.from_matrix(np.full((4, 4), np.nan)), "SE3.from_matrix: .*not finite"),
        (lambda: SE3.from_matrix("T"), "SE3.from_matrix: .*not an array of numbers"),
        (lambda: SE2.from_matrix(np.eye(4)), r"SE2.from_matrix: shape \(4, 4\), expected \(3, 3\)"),
        (lambda: SE2.from_matrix(np.diag([1, -1, 1])), "SE2.from_matrix: matrix 0 is a reflection"),
        (lambda: SO3.from_matrix(2 * np.eye(3)), "SO3.from_matrix: matrix 0 is no rigid motion"),
        (lambda: SO2.from_matrix(-np.eye(3)), r"SO2.from_matrix: shape \(3, 3\), expected \(2, 2\)"),
        (
            lambda: SE3.from_rpy([1, 2], 0, 0, [1, 2, 3], 0, 0),
            r"SE3.from_rpy: .* differ: roll \(3,\), .*x \(2,",
        ),
        (lambda: SE3.from_rpy(0, 0, 0, np.inf, 0, 0), "SE3.from_rpy: roll .* not finite"),
        (lambda: R(4).matrix(np.ones(4)), re.escape("R(4) has no rotation matrix")),
    ]
)
def test_matrices_that_are_no_rigid_motion(case: tuple[Callable[[], object], str]) -> None:
    with pytest.raises(GraphError, match=case[1]):
        case[0]()


def test_roll_pitch_and_yaw() -> None:
    state = np.array([[0.1, -0.2, 0.3, 1.0, 2.0, 5.0], [0.4, 0.5, -3.0, 6.0, 7.0, 8.0]])
    roll, pitch, yaw, x, y, z = state.T
    same(euler.from_se3(SE3.from_rpy(x, y, z, roll, pitch, yaw)), state, atol=1e-12)
    assert SE3.from_rpy(1, 2, 3, 0, 0, 0).tolist() == [1, 2, 3, 0, 0, 0, 1]


@for_all(group=[*GROUPS, R(3), Measured("yaw", "range")])
def test_elements_between_two_others(group: LieGroup) -> None:
    rng = np.random.default_rng(2)
    X, Y = group.exp(rng.normal(size=(2, 6, group.dim)))
    t = np.linspace(0, 1, 6)
    between = group.interpolate(X, Y, t)
    expected = [group.retract(X[k], t[k] * group.local(X[k], Y[k])) for k in range(6)]
    same(between, expected, atol=1e-14)
    same(group.local(group.interpolate(X, Y, 0.0), X), 0 * group.local(X, Y), atol=1e-12)
    same(group.local(group.interpolate(X, Y, 1), Y), 0 * group.local(X, Y), atol=1e-12)
    one = group.interpolate(X[0], Y[0], t)
    assert one.shape == (6, group.size)
    steps = group.local(one[:-1], one[1:])
    same(steps, np.tile(group.local(X[0], Y[0]) / 5, (5, 1)), atol=1e-12)
    assert group.interpolate(X[0], Y[0], 0.5).shape == (group.size,)


every_shape = for_all(shape=[(), (1,), (3, 1, 2)])


def by_hand(roll: float, pitch: float, yaw: float) -> Array:
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def random_angles(shape: tuple[int, ...], seed: int) -> Array:
    """Canonical angles away from gimbal lock."""
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-3.1, 3.1, shape), rng.uniform(-1.5, 1.5, shape), rng.uniform(-3.1, 3.1, shape)], -1)


@every_shape
def test_angles_to_rotations_and_back(shape: tuple[int, ...]) -> None:
    rpy = random_angles(shape, 1)
    q = euler.quaternion_from_angles(rpy)
    assert q.shape == (*shape, 4)
    assert np.linalg.norm(q, axis=-1) == pytest.approx(1.0, abs=1e-15)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(rotation3(q)[index], by_hand(*rpy[index]), atol=1e-15)
    for stored in (q, -q, 1.01 * q, quaternion_from_matrix(rotation3(q))):
        found = euler.angles_from_quaternion(stored)
        assert found.shape == (*shape, 3)
        np.testing.assert_allclose(found, rpy, atol=1e-13)
    t = np.random.default_rng(4).normal(size=(*shape, 3))
    state = np.concatenate([rpy, t], axis=-1)
    T = euler.to_se3(state)
    np.testing.assert_array_equal(T, np.concatenate([t, q], axis=-1))
    np.testing.assert_allclose(euler.from_se3(T), state, atol=1e-12)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_the_other_triple_of_a_rotation_comes_back_canonical(roll: float, pitch: float, yaw: float) -> None:
    same = euler.quaternion_from_angles([roll + np.pi, np.pi - pitch, yaw + np.pi])
    np.testing.assert_allclose(rotation3(same), by_hand(roll, pitch, yaw), atol=1e-14)
    np.testing.assert_allclose(euler.angles_from_quaternion(same), [roll, pitch, yaw], atol=1e-12)


@every_shape
def test_rate_matrix_is_the_body_rotation_of_a_change_of_angles(shape: tuple[int, ...]) -> None:
    rpy = random_angles(shape, 3)
    T = euler.rate_matrix(rpy)
    assert T.shape == (*shape, 3, 3)
    flat, turned = rpy.reshape(-1, 3), lambda after, before: SO3.local(before, after)
    w = on_group(R(3), euler.quaternion_from_angles, flat, minus=turned)
    np.testing.assert_allclose(T.reshape(w.shape), w, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(T), np.cos(rpy[..., 1]), atol=1e-14)
    eye = np.broadcast_to(np.eye(3), T.shape)
    np.testing.assert_allclose(euler.rate_matrix_inv(rpy) @ T, eye, atol=1e-12)
    np.testing.assert_allclose(T @ euler.rate_matrix_inv(rpy), eye, atol=1e-12)


def test_euler_axes_are_the_change_of_angles_and_position() -> None:
    X = SE3.exp(np.random.default_rng(6).normal(size=(7, 6)) * 1.3)

    def change(after: Array, before: Array) -> Array:
        return np.concatenate([wrap(after[:, :3] - before[:, :3]), after[:, 3:] - before[:, 3:]], axis=1)

    np.testing.assert_allclose(SE3.euler_axes(X), on_group(SE3, euler.from_se3, X, minus=change), atol=2e-8)
    for group in (R(3), SE2, SO3):
        with pytest.raises(OptionError, match=r"view: 'euler' is not possible.*has no roll"):
            group.euler_axes(group.identity(7))


def test_vectors_of_another_length_are_refused() -> None:
    for size in (0, 4, 5, 7):
        with pytest.raises(OptionError, match="roll, pitch, yaw"):
            euler.to_se3(np.zeros((2, size)))


def test_gimbal_lock_is_refused() -> None:
    for pitch in (np.pi / 2, -np.pi / 2, np.pi / 2 - 5e-7, np.pi / 2 + 5e-7):
        batch = np.array([[0.1, 0.2, 0.3], [0.1, pitch, 0.3]])
        poses = euler.to_se3(np.concatenate([batch, np.ones((2, 3))], axis=1))
        q = euler.quaternion_from_angles(batch)
        for f, X in ((euler.angles_from_quaternion, q), (euler.rate_matrix_inv, batch), (euler.from_se3, poses)):
            with pytest.raises(SingularGeometryError, match=r"element 1 .*gimbal lock"):
                f(X)
        with pytest.raises(SingularGeometryError, match="element 0"):
            euler.rate_matrix_inv(batch[1])
    for refused in (lambda: euler.covariance_from_se3(poses[1], np.eye(6)), lambda: SE3.euler_axes(poses)):
        with pytest.raises(SingularGeometryError, match="gimbal lock"):
            refused()
    for pitch in (1.57, -1.57, np.pi / 2 - 1e-5):  # close to it all works
        rpy = np.array([0.1, pitch, 0.3])
        q = euler.quaternion_from_angles(rpy)
        np.testing.assert_allclose(euler.angles_from_quaternion(q), rpy, atol=1e-9)
        np.testing.assert_allclose(euler.rate_matrix_inv(rpy) @ euler.rate_matrix(rpy), np.eye(3), atol=1e-9)


@for_all(angle=[0.0, 1e-9, 0.1, 2.0, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-9, np.pi])
def test_quaternion_of_a_matrix(angle: float) -> None:
    rng = np.random.default_rng(5)
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(50, 3)), [[1, 1, 0], [0, 1, -1], [1, 1, 1]]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    K = np.cross(axes[:, None, :], np.eye(3)).swapaxes(1, 2)  # columns: axis x e
    matrices = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    q = quaternion_from_matrix(matrices)
    np.testing.assert_allclose(rotation3(q), matrices, atol=4e-15)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-15)
    assert (q[:, 3] >= 0).all()
    assert np.abs(q[:, 3] - np.cos(angle / 2)).max() < 1e-15
    expected = np.sin(angle / 2) * axes
    sign = np.sign(np.sum(q[:, :3] * expected, axis=1, keepdims=True)) if angle == np.pi else 1.0
    np.testing.assert_allclose(q[:, :3] * sign, expected, atol=1e-15)
    np.testing.assert_array_equal(quaternion_from_matrix(matrices[7]), q[7])
    np.testing.assert_array_equal(quaternion_from_matrix(matrices[:6].reshape(3, 1, 2, 3, 3)).reshape(6, 4), q[:6])


@every_shape
def test_covariances_there_and_back(shape: tuple[int, ...]) -> None:
    """Against errors of the vector pushed through, and back again."""
    rng = np.random.default_rng(9)
    state = np.concatenate([random_angles(shape, 8), rng.normal(size=(*shape, 3))], axis=-1)
    root = rng.normal(size=(*shape, 6, 6))
    P = root @ root.mT
    Sigma = euler.covariance_to_se3(state, P)
    T, eps = euler.to_se3(state), 1e-6
    pushed = [SE3.local(T, euler.to_se3(state + eps * root[..., k])) for k in range(6)]
    by_differences = sum(np.asarray(d[..., :, None] * d[..., None, :]) for d in pushed) / eps**2
    np.testing.assert_allclose(Sigma, by_differences, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(euler.covariance_from_se3(T, Sigma), P, rtol=1e-9, atol=1e-9)
