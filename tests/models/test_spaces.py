"""Lines of the plane, their two normals and what is seen of them; spaces of named measurements."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from models import LINE, S2, SE2, Measured
from models.algebra import Array, wrap
from models.errors import GraphError, OptionError
from models.sensors import line_from_frame, line_in_frame, normalized

same = np.testing.assert_allclose


def other(l: Array) -> Array:
    """Lines by their other normals."""
    return np.column_stack([l[:, 0] + pi, -l[:, 1]])


def feet(l: Array) -> Array:
    """The point of each line nearest to the origin, and the direction of the line up to its sign, as numbers."""
    n = np.exp(1j * l[:, 0])
    return np.column_stack([l[:, 1] * n, n**2])


def scene(n: int, seed: int = 0) -> tuple[Array, Array]:
    """Poses and lines; the first few with angles at +-pi and r' near 0."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-pi, pi, n)])
    l = np.column_stack([rng.uniform(-pi, pi, n), rng.uniform(-9, 9, n)])
    X[0, 2], l[0, 0] = pi - 1e-9, -pi + 1e-9
    if n > 1:
        l[1, 1] = X[1, 0] * np.cos(l[1, 0]) + X[1, 1] * np.sin(l[1, 0]) + 1e-9
    return X, l


def test_the_two_normals_are_one_line() -> None:
    l = scene(60, 7)[1]
    same(LINE.local(l, other(l)), 0.0, atol=1e-14)
    same(LINE.local(other(l), l), 0.0, atol=1e-14)
    same(feet(other(l)), feet(l), atol=1e-13)
    step = np.random.default_rng(1).uniform(-0.7, 0.7, (60, 2))
    same(LINE.local(l, other(LINE.retract(l, step))), step, atol=1e-13)
    l[0, 1] = 0.0
    out = normalized(l)
    assert (out[:, 1] >= 0).all()
    assert (l[:, 1] < 0).sum() > 10
    assert ((out[:, 0] >= -pi) & (out[:, 0] < pi)).all()
    same(LINE.local(l, out), 0.0, atol=1e-13)
    np.testing.assert_array_equal(out[l[:, 1] >= 0], l[l[:, 1] >= 0])


def test_a_step_leads_to_the_other_line_and_the_angle_decides() -> None:
    """r = 0.01 and r = -0.01 with the same normal are 2 cm apart; the sign of r would make them 180 deg apart."""
    a, b = scene(200, 2)[1], scene(200, 3)[1]
    step = LINE.local(a, b)
    assert 1.4 < np.abs(step[:, 0]).max() <= pi / 2
    same(feet(LINE.retract(a, step)), feet(b), atol=1e-12)
    one = np.array([[0.3, 0.01], [0.3, 0.01], [3.1, 1.0]])
    two = np.array([[0.3, -0.01], [0.3 + pi, 0.01], [-3.1, 1.0]])
    same(LINE.local(one, two), [[0.0, -0.02], [0.0, -0.02], [2 * pi - 6.2, 0.0]], atol=1e-15)


def test_a_single_line_and_its_errors() -> None:
    assert (LINE.dim, LINE.size, LINE.components, repr(LINE)) == (2, 2, ("alpha", "r"), "LINE")
    assert LINE.stack([0.1, 2.0]).shape == (1, 2)
    assert LINE.position(LINE.identity(3)).shape == (3, 0)
    with pytest.raises(GraphError, match=r"LINE: .* \(3,\), expected \(n, 2\)"):
        LINE.stack([0.1, 2.0, 3.0])


def test_what_is_seen_by_hand() -> None:
    """From (8, 3) looking along y: x = 10 is 2 m to the right, x = 6 2 m to the left, y = 10 ahead, y = 0 behind."""
    walls = np.array([[0.0, 10.0], [0.0, 6.0], [pi / 2, 10.0], [pi / 2, 0.0]])
    h, _ = line_in_frame(np.tile([8.0, 3.0, pi / 2], (4, 1)), walls)
    same(h, [[-pi / 2, 2.0], [-pi / 2, -2.0], [0.0, 7.0], [0.0, -3.0]], atol=1e-14)
    same(normalized(h), [[-pi / 2, 2.0], [pi / 2, 2.0], [0.0, 7.0], [-pi, 3.0]], atol=1e-14)


def test_there_and_back() -> None:
    """Points of the line are on the line that is seen; the way back is the line, by either normal."""
    X, l = scene(40, 4)
    h, _ = line_in_frame(X, l)
    n, t = np.exp(1j * l[:, 0]), 1j * np.exp(1j * l[:, 0])
    for along in (-3.0, 0.0, 7.0):
        p = l[:, 1] * n + along * t
        q = SE2.act(SE2.inverse(X), np.column_stack([p.real, p.imag]))
        same(q[:, 0] * np.cos(h[:, 0]) + q[:, 1] * np.sin(h[:, 0]), h[:, 1], atol=1e-12)
    found = line_from_frame(X, h)
    same(wrap(found[:, 0] - l[:, 0]), 0.0, atol=1e-13)
    same(found[:, 1], l[:, 1], atol=1e-12)
    same(LINE.local(l, line_from_frame(X, normalized(h))), 0.0, atol=1e-12)


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
    same(SPACE.local(X, Y), expected, atol=1e-15)
    same(SPACE.retract(X, expected), Y, atol=1e-15)
    np.testing.assert_array_equal(SPACE.exp(np.array([np.pi, 4.0, -np.pi])), [-np.pi, 4.0, -np.pi])
    for angle in ("azimuth", "elevation", "bearing", "roll", "pitch", "yaw"):
        same(Measured(angle).local(np.array([[3.0]]), np.array([[-3.0]])), [[turn - 6.0]])
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


def directions(n: int, rng: np.random.Generator) -> Array:
    """Unit vectors, the first along the axes."""
    return S2.stack(np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(n - 6, 3))]))


def test_a_step_on_the_sphere_turns_by_its_length_and_local_finds_it() -> None:
    rng = np.random.default_rng(0)
    X, delta = directions(60, rng), rng.normal(size=(60, 2))
    delta *= (np.geomspace(1e-12, 3.14, 60) / np.linalg.norm(delta, axis=1))[:, None]
    Y = S2.retract(X, delta)
    same(np.linalg.norm(Y, axis=1), 1.0, atol=1e-15)
    same(np.linalg.norm(np.cross(X, Y), axis=1), np.sin(np.linalg.norm(delta, axis=1)), atol=1e-15)
    same(S2.local(X, Y), delta, rtol=1e-9, atol=1e-13)
    same(S2.axes(X).mT @ np.dstack([X, S2.axes(X)]), np.tile([[0, 1, 0], [0, 0, 1]], (60, 1, 1)), atol=1e-15)
    J = S2.motion(X, Y)[1]
    ahead, behind = (S2.local(X, S2.retract(Y, np.tile(1e-6 * np.array(e), (60, 1)))) for e in ([1, 0], [-1, 0]))
    same(J[:55, :, 0], (ahead - behind)[:55] / 2e-6, atol=1e-7)
    assert np.isnan(S2.local(X, -X)).all(), "no turn to the opposite is shorter than all others"
    with pytest.raises(GraphError, match=r"element 1 .*length 0"):
        S2.stack([[3.0, 0, 0], [0, 0, 0]])
