"""Two wheels: the motion, its inverse and the derivatives of both, and what taking the arc for the chord costs."""

from __future__ import annotations

from math import pi, radians, sin

import numpy as np
import pytest

from models import SE2, R
from models.algebra import Array
from models.vehicles import differential_drive, travel_sigmas, wheel_travel
from tests.models.differences import on_group

same = np.testing.assert_allclose
BASE = 0.7


def drives(n: int, seed: int = 0) -> tuple[Array, Array]:
    """Poses, headings at +-pi among them, and travel that turns by up to 2 rad, forwards and backwards."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-pi, pi, n)])
    X[0, 2] = pi - 1e-9
    return X, rng.uniform(-0.7, 0.7, (n, 2)) + np.where(np.arange(n) % 3 > 0, 1.0, -1.0)[:, None]


def minus(Y: Array, X: Array) -> Array:
    return SE2.local(X, Y)


def test_motion_and_travel_by_hand() -> None:
    X = np.tile([1.0, 2.0, pi / 2], (3, 1))
    ahead, spot, quarter = [0.5, 0.5], [0.1, -0.1], [1 + BASE * pi / 4, 1 - BASE * pi / 4]
    found, _ = differential_drive(X, [ahead, spot, quarter], BASE)
    d = np.sqrt(0.5)  # in the middle of the quarter turn the heading is 135 deg
    same(found, [[1.0, 2.5, pi / 2], [1.0, 2.0, pi / 2 + 0.2 / BASE], [1 - d, 2 + d, -pi]], atol=1e-14)
    Y = np.array([[1.0, 2.5, pi / 2], [0.8, 2.0, pi / 2], [1.0, 2.0, pi / 2 - 0.2]])
    same(wheel_travel(X, Y, BASE)[0], [[0.5, 0.5, 0], [0, 0, 0.2], [-0.1 * BASE, 0.1 * BASE, 0]], atol=1e-14)
    sigmas = travel_sigmas([[4.0, -1.0], [0.0, 0.25]], right=0.01, left=0.02, lateral=0.003)
    same(sigmas, [[0.02, 0.02, 0.003], [0.0, 0.01, 0.003]])


def test_travel_is_the_inverse_of_the_motion() -> None:
    X, u = drives(50)
    h, _ = wheel_travel(X, differential_drive(X, u, BASE)[0], BASE)
    same(h, np.column_stack([u, np.zeros(50)]), atol=1e-13)
    assert np.abs(np.diff(u)).max() / BASE > 1.5


def test_derivatives_are_central_differences() -> None:
    for n in (1, 30):
        X, u = drives(n, 1)
        Y, (F_X, F_u) = differential_drive(X, u, BASE)
        same(F_X, on_group(SE2, lambda X, u=u: differential_drive(X, u, BASE)[0], X, minus=minus), atol=2e-8)
        same(F_u, on_group(R(2), lambda u, X=X: differential_drive(X, u, BASE)[0], u, minus=minus), atol=2e-8)
        Y = SE2.retract(Y, np.random.default_rng(3).normal(0, 0.3, (n, 3)))
        h, (H_X, H_Y) = wheel_travel(X, Y, BASE)
        assert np.abs(h[:, 2]).max() > 0.05
        same(H_X, on_group(SE2, lambda X, Y=Y: wheel_travel(X, Y, BASE)[0], X), atol=2e-8)
        same(H_Y, on_group(SE2, lambda Y, X=X: wheel_travel(X, Y, BASE)[0], Y), atol=2e-8)


def test_derivatives_are_those_in_world_axes_of_the_textbook() -> None:
    """With x, y, theta moved along the axes of the world, F_x = [[1, 0, -ds sin be], [0, 1, ds cos be], [0, 0, 1]]."""
    X, u = drives(20, 4)
    Y, (F_X, F_u) = differential_drive(X, u, BASE)
    ds, be, k = u.mean(axis=1), X[:, 2] + (u[:, 0] - u[:, 1]) / (2 * BASE), u.mean(axis=1) / (2 * BASE)
    c, s, o, e = np.cos(be), np.sin(be), np.zeros(20), np.ones(20)
    F_world = np.moveaxis(np.array([[e, o, -ds * s], [o, e, ds * c], [o, o, e]]), -1, 0)
    wheels = [[c / 2 - k * s, c / 2 + k * s], [s / 2 + k * c, s / 2 - k * c], [e / BASE, -e / BASE]]
    same(SE2.world_axes(Y) @ F_X @ np.linalg.inv(SE2.world_axes(X)), F_world, atol=1e-13)
    same(SE2.world_axes(Y) @ F_u, np.moveaxis(np.array(wheels), -1, 0), atol=1e-13)


def test_the_arc_is_longer_than_the_chord() -> None:
    """Driven as one step and as 1000 small ones, which follow the arc: by a share of turn^2 / 24."""
    for turn, error in ((radians(5), 3.2e-4), (radians(30), 1.1e-2), (radians(90), 0.1)):
        u = 1.0 + np.array([[1.0, -1.0]]) * BASE * turn / 2
        once, many = differential_drive(SE2.identity(), u, BASE)[0], SE2.identity()
        for _ in range(1000):
            many = differential_drive(many, u / 1000, BASE)[0]
        same(once[:, 2], many[:, 2], atol=1e-12)
        lengths = [float(np.linalg.norm(X[0, :2])) for X in (once, many)]
        assert lengths == pytest.approx([1.0, sin(turn / 2) / (turn / 2)], rel=1e-6)
        assert lengths[0] / lengths[1] - 1 == pytest.approx(error, rel=0.12)
