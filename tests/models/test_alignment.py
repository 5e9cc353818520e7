"""Motions between points: exact without noise, never a reflection, 1 / sqrt(n) with noise, refused where not unique."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from models.algebra import Array
from models.alignment import align, align_similarity, align_yaw, three_points
from models.errors import GraphError, SingularGeometryError
from models.sensors import SingularAt
from tests.combinations import for_all

every_group = pytest.mark.parametrize("group", [SE2, SE3], ids=str)


def motions(group: LieGroup, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Random motions (*shape, size), turned by up to pi."""
    delta = rng.normal(size=(*shape, group.dim))
    turn = delta[..., group.point_dim :]
    turn *= rng.uniform(0, np.pi, (*shape, 1)) / np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.asarray(group.exp(delta))


def apart(group: LieGroup, S: Array, T: Array) -> float:
    """Largest component of what is between motions."""
    return float(np.abs(group.local(S, T)).max())


@every_group
@for_all(shape=[(), (1,), (5,), (2, 3)], n=[3, 20])
def test_exact_points_give_their_motion(group: LieGroup, shape: tuple[int, ...], n: int) -> None:
    rng = np.random.default_rng(1)
    T, v = motions(group, shape, rng), 5 * rng.normal(size=(*shape, n, group.point_dim)) + 100
    u = group.act(T[..., None, :], v)
    for weights in (None, rng.uniform(0.1, 9, n), rng.uniform(0.1, 9, (*shape, n))):
        found = align(u, v, weights)
        assert found.shape == T.shape
        assert apart(group, T, found) < 1e-10
    if n == 3 and group is SE3:
        assert apart(SE3, three_points(u - 100, v - 100), align(u - 100, v - 100)) < 1e-9


@every_group
@for_all(mirrored=[False, True])
def test_no_other_motion_is_better(group: LieGroup, mirrored: bool) -> None:
    """Nor is one near a mirror image of the points, where the best matrix would be a reflection."""
    rng = np.random.default_rng(5)
    v, w = rng.normal(size=(12, group.point_dim)), rng.uniform(0.2, 3, 12)
    u = v + 0.3 * rng.normal(size=v.shape)
    u[:, 0] *= -1 if mirrored else 1

    def cost(T: Array) -> float:
        return float(w @ np.square(u - group.act(T, v)).sum(axis=1))

    best = align(u, v, w)
    for size in 60 * [1e-3, 0.05, 2.0]:
        assert cost(group.compose(best, group.exp(size * rng.normal(size=group.dim)))) > cost(best)


def test_weights_count_points() -> None:
    rng = np.random.default_rng(6)
    u, v = rng.normal(size=(2, 5, 3))
    again = [0, 1, 1, 2, 3, 3, 3]
    assert align(u, v, [1, 2, 1, 3, 0]) == pytest.approx(align(u[again], v[again]), abs=1e-12)
    assert align(u, v, 1e-200 * np.array([1, 2, 1, 3, 0])) == pytest.approx(align(u[again], v[again]), abs=1e-12)
    both = align(np.stack([u, u]), np.stack([v, v]), [[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]])
    assert both[0] == pytest.approx(align(u[:3], v[:3]), abs=1e-12)
    assert both[1] == pytest.approx(align(u[2:], v[2:]), abs=1e-12)


LINE = np.linspace(0, 3, 10)[:, None] * [1.0, 2, -1] + [40, 5, 6]


def test_points_that_leave_a_rotation_free() -> None:
    for v, what in ((LINE, "10 points on one line"), (LINE[:2], "2 points"), (np.ones((4, 3)), "4 points on one spot")):
        other = np.random.default_rng(8).normal(size=v.shape)
        for u, named in ((v, what), (other, "rotation free")):
            with pytest.raises(SingularGeometryError, match=named):
                align(u, v)
        with pytest.raises(SingularAt) as raised:
            align(np.stack([other, other]), np.stack([other if len(v) > 2 else v, v]))
        assert raised.value.index == (1 if len(v) > 2 else 0)


def test_what_is_nearly_a_line_is_not_refused() -> None:
    """Width over length 1e-3: coplanar and thin, but the turn about the length is told."""
    v = LINE + 5e-3 * np.random.default_rng(9).normal(size=LINE.shape)
    T = SE3.exp([1.0, 2, 3, 0.3, -0.2, 2.5])
    assert apart(SE3, align(SE3.act(T, v), v), T) < 1e-8
    assert apart(SE3, three_points(SE3.act(T, v[[0, 5, 9]]), v[[0, 5, 9]]), T) < 1e-8


def test_three_points_in_line_and_weights_of_nothing() -> None:
    turned = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for u, v in ((LINE[:3], turned), (turned, LINE[:3]), (turned, np.ones((3, 3)))):
        with pytest.raises(SingularGeometryError, match="3 points on one"):
            three_points(u, v)
    with pytest.raises(SingularGeometryError, match="leave a rotation free"):
        align(turned, turned, [0, 0, 0])
    with pytest.raises(SingularGeometryError, match="on one spot"):
        align(np.zeros((3, 2)), np.zeros((3, 2)))
    assert align([[1.0, 1], [1, 2]], [[0.0, 0], [1, 0]]) == pytest.approx([1, 1, np.pi / 2])  # two do in the plane


V, TALL, HOLE = np.eye(3), np.eye(4)[:, :3], [[0, 0, 0], [0, np.nan, 0], [1, 0, 0]]


def test_mistakes() -> None:
    for f in (align, three_points):
        for u, v, named in (
            *((u, v, "expected the same") for u, v in ((V, V[:2]), (V[0], V[0]), (V[:, :1], V[:, :1]), (V[:0], V[:0]))),
            (V, HOLE, "v .* nan"),
            ([["a"]], V, "u is not"),
            (1e200 * V, 1e200 * V, "largest"),
        ):
            with pytest.raises(GraphError, match=named):
                f(u, v)
    with pytest.raises(GraphError, match=r"three_points: shape \(4, 3\)"):
        three_points(TALL, TALL)
    for weights in ([1, -1, 1], [1, 1], [[[1.0, 1, 1]]], 2.0, [1, np.inf, 1]):
        with pytest.raises(GraphError, match=r"weights .*(, expected \(3,\)|inf)"):
            align(V, V, weights)


def test_similarity_and_yaw_of_batches_with_weights() -> None:
    """Each is the least of its kind; a weight of 0 leaves a point out; what is not unique is refused."""
    rng = np.random.default_rng(8)
    v, T = 5 * rng.normal(size=(4, 9, 3)), motions(SE3, (4,), rng)
    s = rng.uniform(0.1, 9, 4)
    u = SE3.act(T[:, None], s[:, None, None] * v)
    w = np.ones(9)
    u[:, 3], w[3] = 99.0, 0.0
    S, scale = align_similarity(u, v, w)
    assert (apart(SE3, T, S), scale) == (pytest.approx(0, abs=1e-10), pytest.approx(s))
    noisy = v + 0.3 * rng.normal(size=v.shape)
    for yaw in (2.7, -0.4):
        Z = SE3.exp([1.0, -2, 3, 0, 0, 0]) * [1, 1, 1, 0, 0, 0, 0] + [0, 0, 0, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2)]
        turned = SE3.act(Z, noisy)
        Y = align_yaw(turned, v)
        assert np.abs(Y[:, 3:5]).max() == 0
        best = np.square(turned - SE3.act(Y[:, None], v)).sum((1, 2))
        for d in (1e-3, -1e-3):  # no other yaw about the mean is nearer
            c, q = v.mean(axis=1), np.array([0, 0, np.sin(d / 2), np.cos(d / 2)])
            D = np.concatenate([c - SE3.act(np.r_[0.0, 0, 0, q], c), np.tile(q, (4, 1))], axis=1)
            worse = np.square(turned - SE3.act(SE3.compose(Y, D)[:, None], v)).sum((1, 2))
            assert (worse > best).all()
    line = np.array([[0.0, 0, 1], [0, 0, 2], [0, 0, 5]])
    for other in (align_yaw, align_similarity):
        with pytest.raises(SingularAt, match="free"):
            other(line, line)
    with pytest.raises(GraphError, match="points of space"):
        align_yaw(line[:, :2], line[:, :2])
