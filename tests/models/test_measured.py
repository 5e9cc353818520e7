"""Spaces of named measurements: what wraps, what does not, and that they are groups."""

from __future__ import annotations

import numpy as np
import pytest

from models import Measured
from models.errors import GraphError, OptionError

SPACE = Measured("bearing", "range", "yaw")


def test_one_space_per_names() -> None:
    assert Measured("bearing", "range") is Measured("bearing", "range")
    assert Measured("bearing", "range") is not Measured("range", "bearing")
    assert repr(SPACE) == "(bearing, range, yaw)"
    assert (SPACE.dim, SPACE.size, SPACE.components, SPACE.flat) == (3, 3, ("bearing", "range", "yaw"), True)


def test_angles_wrap_and_numbers_do_not() -> None:
    Y = np.array([[-3.0, 9.0, 3.0], [3.0, -9.0, 1.0]])
    X = np.array([[3.0, 1.0, -3.0], [-3.0, 1.0, 0.0]])
    turn = 2 * np.pi
    expected = np.array([[turn - 6.0, 8.0, 6.0 - turn], [6.0 - turn, -10.0, 1.0]])
    np.testing.assert_allclose(SPACE.local(X, Y), expected, atol=1e-15)
    np.testing.assert_allclose(SPACE.retract(X, expected), Y, atol=1e-15)
    np.testing.assert_array_equal(SPACE.exp(np.array([np.pi, 4.0, -np.pi])), [-np.pi, 4.0, -np.pi])
    for angle in ("azimuth", "elevation", "bearing", "roll", "pitch", "yaw"):
        np.testing.assert_allclose(Measured(angle).local(np.array([[3.0]]), np.array([[-3.0]])), [[turn - 6.0]])
    for plain in ("range", "x", "u"):
        np.testing.assert_array_equal(Measured(plain).local(np.array([[3.0]]), np.array([[-3.0]])), [[-6.0]])

    before = X.copy()
    SPACE.exp(X)
    np.testing.assert_array_equal(X, before)
    np.testing.assert_array_equal(SPACE.jl(X), np.tile(np.eye(3), (2, 1, 1)))


def test_names_and_measurements_are_checked() -> None:
    for names in ((), ("x", "x"), ("",), (3,)):
        with pytest.raises(OptionError, match=r"Measured\(\*names\): "):
            Measured(*names)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match=r"\(bearing, range, yaw\): .*\(2,\), expected \(n, 3\)"):
        SPACE.stack([1.0, 2.0])
    assert Measured("range").stack([1.0, 2.0]).shape == (2, 1)
