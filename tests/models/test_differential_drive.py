"""Two wheels: the motion, its inverse and the derivatives of both."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from models.algebra import Array
from models.errors import OptionError
from models.vehicles import differential_drive, travel_sigmas, wheel_travel

same = np.testing.assert_allclose
BASE = 0.7


def drives(n: int, seed: int = 0) -> tuple[Array, Array]:
    """Poses, headings at +-pi among them, and travel that turns by up to 2 rad, forwards and backwards."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-pi, pi, n)])
    X[0, 2] = pi - 1e-9
    return X, rng.uniform(-0.7, 0.7, (n, 2)) + np.where(np.arange(n) % 3 > 0, 1.0, -1.0)[:, None]


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


def test_a_base_is_above_zero() -> None:
    X, u = drives(1)
    for base in (0.0, -0.5, float("nan"), "wide"):
        for name, call in (
            ("differential_drive", lambda base=base: differential_drive(X, u, base)),
            ("wheel_travel", lambda base=base: wheel_travel(X, X, base)),
        ):
            with pytest.raises(OptionError, match=rf"^{name}: base: .* the distance of the wheels, m, above 0$"):
                call()
