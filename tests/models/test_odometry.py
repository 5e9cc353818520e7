"""Steps in the horizontal and tilts: by hand, against SE(2), against the Euler-angle derivatives, at gimbal lock."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest

from models import SE2, SE3, euler
from models.algebra import Array
from models.sensors import SingularAt, levelled, relative_xyh, zpr

same = np.testing.assert_allclose


def states(n: int, seed: int) -> Array:
    """Euler vectors (roll, pitch, yaw, x, y, z), pitched up to 89 deg."""
    limit = np.array([pi, radians(89), pi, 5.0, 5.0, 5.0])
    return np.random.default_rng(seed).uniform(-limit, limit, size=(n, 6))


def tangent_of_euler(e: Array) -> Array:
    """d(roll, pitch, yaw, x, y, z) / d(rho, phi) (n, 6, 6): T^-1 phi and R rho."""
    J = np.zeros((len(e), 6, 6))
    J[:, :3, 3:] = euler.rate_matrix_inv(e[:, :3])
    J[:, 3:, :3] = SE3.rotation(euler.to_se3(e))
    return J


def test_levelled_steps_are_differences_of_poses_of_the_plane() -> None:
    """By hand, rolled: 3 m east, 1 m north, down 4 m, east to south-west is 3 ahead, 1 to port, 135 deg."""
    i, j = [[0.5, -0.3, pi / 2, 1.0, 2.0, 5.0]], [[-0.2, 0.1, -3 * pi / 4, 2.0, 5.0, 9.0]]
    same(levelled(euler.to_se3(i), euler.to_se3(j))[0], [[3.0, -1.0, 3 * pi / 4]], atol=1e-14)
    a, b = states(300, 1), states(300, 2)
    plane = SE2.between(a[:, [3, 4, 2]], b[:, [3, 4, 2]])
    h, _ = levelled(euler.to_se3(a), euler.to_se3(b))
    same(h[:, :2], plane[:, :2], atol=1e-12)
    same(np.exp(1j * h[:, 2]), np.exp(1j * plane[:, 2]), atol=1e-12)
    assert (np.abs(h[:, 2]) <= pi).all()


def test_derivatives_by_the_euler_formula() -> None:
    """-Rz', Rz', (-s dx + c dy, -c dx - s dy, -1), in Euler parameters; by T^-1 and R in the tangent."""
    a, b = states(50, 3), states(50, 4)
    _, (H_i, H_j) = levelled(euler.to_se3(a), euler.to_se3(b))
    c, s, (dx, dy) = np.cos(a[:, 2]), np.sin(a[:, 2]), (b - a)[:, 3:5].T
    E_i, E_j = np.zeros((2, 50, 3, 6))
    E_i[:, 0, 3], E_i[:, 0, 4], E_i[:, 1, 3], E_i[:, 1, 4] = -c, -s, s, -c
    E_i[:, :, 2] = np.stack([-s * dx + c * dy, -c * dx - s * dy, -np.ones(50)], axis=1)
    E_j[:, :2, 3:5] = -E_i[:, :2, 3:5]
    E_j[:, 2, 2] = 1.0
    for H, E, e in ((H_i, E_i, a), (H_j, E_j, b)):
        expected = E @ tangent_of_euler(e)
        same(H, expected, atol=1e-10 * np.abs(expected).max())
    h, H = zpr(euler.to_se3(a))
    same(h, a[:, [5, 1, 0]], atol=1e-11)
    same(H, tangent_of_euler(a)[:, [5, 1, 0]], atol=1e-9)


def test_gimbal_lock() -> None:
    good = euler.to_se3(states(3, 10))
    for pitch in (pi / 2, -pi / 2):
        bad = np.array(good)
        bad[2] = euler.to_se3([0.3, pitch, 0.1, 1.0, 2.0, 3.0])
        turned = SE3.compose(good, bad)
        for f, poses in (
            (levelled, (good, bad)),
            (levelled, (bad, good)),
            (zpr, (bad,)),
            (relative_xyh, (good, turned)),
        ):
            with pytest.raises(SingularAt, match="gimbal lock") as caught:
                f(*poses)
            assert caught.value.index == 2
    up = euler.to_se3([[0.0, pi / 2, 0.0, 0.0, 0.0, 0.0]])  # a relative step between two such poses has a value
    same(relative_xyh(up, SE3.compose(up, euler.to_se3([[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]])))[0], [[1.0, 2.0, 0.3]])
