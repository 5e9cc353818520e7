"""Tangent steps along the axes of the world and in Euler angles, against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, SO2, SO3, LieGroup, R, euler
from models.algebra import Array, wrap
from models.errors import OptionError, SingularGeometryError

GROUPS = (R(1), R(2), R(3), R(6), SO2, SE2, SO3, SE3)
STEP = 1e-6


def elements(group: LieGroup, n: int = 7) -> Array:
    return group.exp(np.random.default_rng(group.dim).normal(size=(n, group.dim)) * 1.3)


def steps(group: LieGroup, X: Array) -> tuple[Array, Array]:
    """X moved by +-STEP in every tangent component, (dim, n, size) each."""
    E = STEP * np.eye(group.dim)
    there = np.stack([group.retract(X, np.broadcast_to(e, (len(X), group.dim))) for e in E])
    back = np.stack([group.retract(X, np.broadcast_to(-e, (len(X), group.dim))) for e in E])
    return there, back


@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_world_axes(group: LieGroup) -> None:
    """Of the position; and of the rotation of the world that takes R(X) to R(X Exp(delta)), R(X Exp(delta)) R(X)'."""
    X = elements(group)
    there, back = steps(group, X)
    G = group.world_axes(X)
    assert G.shape == (7, group.dim, group.dim)
    slope = (group.position(there) - group.position(back)) / (2 * STEP)  # (dim, n, k)
    np.testing.assert_allclose(G[:, : slope.shape[-1]], np.moveaxis(slope, 0, -1), atol=1e-9)
    if group in (SO2, SE2, SO3, SE3):
        turn = group.rotation(there) @ group.rotation(X).mT  # (dim, n, k, k)
        if group.point_dim == 3:
            w = np.stack([turn[..., 2, 1], turn[..., 0, 2], turn[..., 1, 0]], axis=-1) / STEP
        else:
            w = turn[..., 1, :1] / STEP
        np.testing.assert_allclose(G[:, -w.shape[-1] :], np.moveaxis(w, 0, -1), atol=1e-5)
    assert group.body_axes is bool((G != np.eye(group.dim)).any())  # declared where they differ from the world
    np.testing.assert_allclose(G @ G.mT, np.broadcast_to(np.eye(group.dim), G.shape), atol=1e-12)
    np.testing.assert_array_equal(group.world_axes(X[3]), G[3])


def test_euler_axes_against_differences() -> None:
    X = elements(SE3)
    there, back = steps(SE3, X)
    change = euler.from_se3(there) - euler.from_se3(back)
    slope = np.concatenate([wrap(change[..., :3]), change[..., 3:]], axis=-1) / (2 * STEP)
    np.testing.assert_allclose(SE3.euler_axes(X), np.moveaxis(slope, 0, -1), atol=2e-8)


def test_no_euler_angles() -> None:
    with pytest.raises(SingularGeometryError, match="gimbal lock"):
        SE3.euler_axes(euler.to_se3([[0.1, np.pi / 2, 0.2, 1.0, 2.0, 3.0]]))
    for group in (R(3), SE2, SO3):
        with pytest.raises(OptionError, match=r"view: 'euler' is not possible.*has no roll"):
            group.euler_axes(elements(group))
