"""Cars and two wheels: the motion of their points against geometry; and velocities integrated in the plane."""

from __future__ import annotations

from itertools import pairwise
from math import nan, pi

import numpy as np
import pytest

from models import SE2
from models.algebra import Array
from models.dead_reckoning import integrate_plane
from models.errors import GraphError, OptionError
from models.vehicles import ackermann, differential_drive, travel_sigmas, wheel_travel

same = np.testing.assert_allclose
BASE = 0.7
TRUCK = {"wheelbase": 2.83, "encoder": 0.76, "at": (3.78, 0.5)}


def test_on_a_circle_every_point_turns_about_the_same_center() -> None:
    """Steered by alpha, the middle of the rear axle goes round on radius L / tan(alpha), the wheel inside it by H."""
    alpha, inner = 0.3, 2.0
    radius = 2.83 / np.tan(alpha)
    twist, F_u = ackermann([[inner, alpha], [-inner, alpha], [inner, -alpha], [2.0, 0.0], [0.0, 0.4]], **TRUCK)
    assert F_u.shape == (5, 3, 2)
    w = inner / (radius - 0.76)
    same(twist[0], [w * (radius - 0.5), w * 3.78, w])
    same(twist[1], -twist[0])
    assert twist[2, 2] == pytest.approx(-inner / (radius + 0.76))
    same(twist[3:], [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


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


def test_a_distance_of_wheels_or_axles_is_above_zero() -> None:
    X, u = drives(1)
    for bad in (0.0, -0.5, nan, "wide"):
        for named, call in (
            ("ackermann: wheelbase", lambda bad=bad: ackermann(u, wheelbase=bad)),
            ("differential_drive: base", lambda bad=bad: differential_drive(X, u, bad)),
            ("wheel_travel: base", lambda bad=bad: wheel_travel(X, X, bad)),
        ):
            with pytest.raises(OptionError, match=rf"^{named}: .* the distance of the (axles|wheels), m, above 0$"):
                call()


def samples(rng: np.random.Generator, n: int = 200) -> tuple[Array, Array, Array]:
    """Times, twists and densities of a wild drive."""
    t = np.cumsum(rng.uniform(0.005, 0.03, size=n))
    return t, rng.normal([1.0, 0.0, 0.3], [0.5, 0.1, 1.0], size=(n, 3)), np.diag([0.1, 0.02, 0.05])


def test_legs_are_products_of_steps_wherever_they_are_cut() -> None:
    rng = np.random.default_rng(2)
    t, twist, S = samples(rng)
    b = np.sort(rng.uniform(t[0], t[-1], size=7))
    legs = integrate_plane(t, twist, S, boundaries=b)
    for k in range(6):
        edges = np.concatenate([[b[k]], t[(t > b[k]) & (t < b[k + 1])], [b[k + 1]]])
        X = SE2.identity()
        for begin, end in pairwise(edges):
            X = SE2.compose(X, SE2.exp(twist[t <= begin][-1:] * (end - begin)))
        same(legs.z[k], X[0], atol=1e-12)
    track = legs.track([1.0, 2.0, 3.0])
    same(SE2.between(track[:-1], track[1:]), legs.z, atol=1e-12)
    b = t[[0, 70, -1]]
    two, one = integrate_plane(t, twist, S, boundaries=b), integrate_plane(t, twist, S, boundaries=b[[0, 2]])
    J = SE2.adjoint_inverse(two.z[1])
    same(J @ two.Sigma[0] @ J.T + two.Sigma[1], one.Sigma[0], rtol=1e-9)


def test_an_error_held_over_one_long_step() -> None:
    """A step that turns by 1.4 rad: Sigma dt is G G', G the derivative of its end by the sources of the error."""
    S, twist = np.diag([0.1, 0.03, 0.3]), np.array([1.0, 0.2, 0.7])
    legs = integrate_plane([0.0, 2.0], [twist, twist], S, boundaries=[0.0, 2.0])
    ends = [integrate_plane([0.0, 2.0], [u, u], S, boundaries=[0.0, 2.0]).z for u in twist + 1e-6 * S]
    G = SE2.local(np.tile(legs.z, (3, 1)), np.concatenate(ends)).T / 1e-6
    same(legs.Sigma[0] * 2.0, G @ G.T, rtol=1e-5)


def test_what_cannot_be_integrated_is_refused() -> None:
    t, twist, S = samples(np.random.default_rng(5), 4)
    for wrong, named in (
        ({"twist": twist[:, :2]}, r"twist \(4, 2\) and density \(3, 3\)"),
        ({"density": np.zeros((2, 3, 3))}, r"density \(2, 3, 3\)"),
        ({"density": np.zeros((3, 3, 3))}, r"density \(3, 3, 3\)"),
        ({"t": t[[0, 0, 1, 2]]}, r"t\[1\] = "),
        ({"boundaries": [t[0], t[-1] + 1]}, r"boundaries\[1\] = "),
        ({"twist": np.where(twist == twist[2], np.nan, twist)}, "twist .* nan"),
    ):
        given = {"t": t, "twist": twist, "density": S, "boundaries": t, **wrong}
        with pytest.raises(GraphError, match=named):
            integrate_plane(**given)
