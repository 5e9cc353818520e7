"""Poses and rotations from matrices and from roll, pitch and yaw, and back; elements between two others."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from models import SE2, SE3, SO2, SO3, LieGroup, Measured, R, euler
from models.errors import GraphError
from tests.combinations import for_all

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
        (lambda: R(2).matrix([1.0, 2.0]), re.escape("R(2) has no rotation matrix")),
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
