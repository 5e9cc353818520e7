"""Where a ray meets a range: every case told apart, derivatives and covariance against differences and drawn noise."""

from __future__ import annotations

import numpy as np
import pytest

from models.algebra import Array
from models.errors import GraphError, SingularGeometryError
from models.ray_range import ray_range
from tests.models.differences import difference

AHEAD = np.array([0.0, 0.0, 1.0])


def test_cases() -> None:
    """Sonars, ranges, depths on a ray ahead, and whether the ray passes or meets behind the camera."""
    for s, r, depth, missed, behind in (
        ([0, 0, 0], 4, [4], False, False),  # sonar at the camera: d = r
        ([0, 3, 0], 5, [4], False, False),  # beside it
        ([0, 0, -1], 4, [3], False, False),  # behind it
        ([0, 0, 1], 4, [5], False, False),  # ahead, the camera inside of the sphere: -3 is behind
        ([0, 3, 8], 5, [12, 4], False, False),  # in and out
        ([0, 3, -8], 5, [], False, True),  # in and out, both behind
        ([0, 3, 8], 2, [], True, False),  # passes
        ([0, 3, -8], 2, [], True, False),  # passes, behind
        ([0, 3, 8], 3, [8], False, False),  # touches
        ([0, 0, 5], 5, [10], False, False),  # the camera on the sphere, which is ahead
        ([0, 0, -5], 5, [], False, True),  # on the sphere, which is behind
        ([0, 0, 5], 0, [5], False, False),  # range 0: the sonar itself
    ):
        found = ray_range([AHEAD], s, [float(r)])
        assert found.roots.tolist() == [len(depth)], (s, r)
        expected = np.array([*depth, np.nan, np.nan])[:2, None]
        assert found.depth == pytest.approx(expected, nan_ok=True)
        assert found.points == pytest.approx(expected[..., None] * AHEAD, nan_ok=True)
        assert (found.missed.item(), found.behind.item()) == (missed, behind), (s, r)
        assert found.closest == pytest.approx([s[2]])
        assert found.discriminant == pytest.approx([s[2] ** 2 - np.dot(s, s) + r * r])


def drawn(n: int, seed: int) -> tuple[Array, Array, Array]:
    """Bearings, sonars and ranges of which every case is frequent."""
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(n, 3))
    return b / np.linalg.norm(b, axis=1, keepdims=True), 2 * rng.normal(size=(n, 3)), rng.uniform(0.1, 5, n)


def test_derivatives_against_central_differences() -> None:
    def at(b: Array, s: Array, r: Array) -> Array:
        return ray_range(b / np.linalg.norm(b, axis=1, keepdims=True), s, r).points[int(near)]

    for near in (False, True):
        b, s, r = drawn(2000, 2)
        found = ray_range(b, s, r)
        keep = (found.roots > near) & (found.discriminant > 0.05)
        b, s, r = b[keep], s[keep], r[keep]
        assert len(r) > 100
        p_b, p_r, p_s = ray_range(b, s, r).jacobians(near)
        h = 1e-6
        assert p_r[..., 0] == pytest.approx((at(b, s, r + h) - at(b, s, r - h)) / (2 * h), abs=1e-6)
        assert p_s == pytest.approx(difference(lambda s, b=b, r=r: at(b, s, r), s), abs=1e-6)
        for k, e in enumerate(np.eye(3)):
            across = e - b * b[:, [k]]  # a bearing moves across itself
            moved = (at(b + h * across, s, r) - at(b - h * across, s, r)) / (2 * h)
            assert np.matvec(p_b, across) == pytest.approx(moved, abs=1e-6)


def test_no_derivative_where_there_is_no_point_or_the_ray_touches() -> None:
    zero = np.zeros((2, 3, 2))
    for s, r, near in (([0.0, 3, 8], 2.0, False), ([0, 3, 8], 3.0, False), ([0, 3, 0], 5.0, True)):
        found = ray_range([AHEAD, AHEAD], [[0, 3, 8], s], [5.0, r])
        with pytest.raises(SingularGeometryError, match="roots"):
            found.covariance(zero, np.eye(2), 0.1, near=near)


def test_mistakes() -> None:
    b, s, r = [AHEAD, AHEAD], [0.0, 0, 0], [1.0, 2.0]
    for wrong in ((AHEAD, s, r), (b, [0, 0], r), (b, s, [1.0]), (b, s, 1.0), (b, [s, s, s], r), (np.eye(2), s, r)):
        with pytest.raises(GraphError, match=r"expected \(n, 3\), \(3,\) or \(n, 3\), \(n,\)"):
            ray_range(*wrong)
    for wrong, named in (
        (([AHEAD, np.nan * AHEAD], s, r), "b .* nan"),
        ((b, [0, np.inf, 0], r), "s .* inf"),
        ((b, s, [1, np.nan]), "r .* nan"),
        (([AHEAD, 2 * AHEAD], s, r), r"b\[1\] .* 2, expected 1"),
        ((b, s, [1.0, -2.0]), r"r\[1\] is -2 m"),
        ((b, s, ["far", "near"]), "r is not"),
    ):
        with pytest.raises(GraphError, match=named):
            ray_range(*wrong)
    assert ray_range(np.zeros((0, 3)), s, []).points.shape == (2, 0, 3)
