"""The derivatives of every model of a sensor or a vehicle against central differences, for one element and for many."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi
from typing import Any

import numpy as np
import pytest

from models import LINE, SE2, SE3, Manifold, Measured, R, sensors
from models.algebra import Array
from models.sensors.dvl import dvl_velocity
from models.vehicles import ackermann, differential_drive, wheel_travel
from tests.models.differences import on_group

N = 30


def elements(space: Manifold, seed: int) -> Array:
    """Anywhere, angles at +-pi among them; poses of space pitched up to 80 deg."""
    X = np.random.default_rng(seed).uniform(-1.4, 1.4, size=(N, space.dim)) * np.where(np.arange(N) % 2, 1, 3)[:, None]
    if space is SE3:
        return SE3.from_rpy(*X[:, :3].T, *(X[:, 3:] * [1.0, 0.33, 1.0]).T)
    X[0, -1 if space is SE2 else 0] = pi - 1e-9
    return X


def points(d: int, seed: int = 0) -> Array:
    """All around, away from where nothing is measured."""
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 6, size=(N, d)) * rng.choice([-1, 1], (N, d))


ANGLES = Measured("yaw", "pitch")
P, Q, S, T = (elements(space, seed) for space, seed in ((SE2, 1), (SE2, 2), (SE3, 3), (SE3, 4)))
CAMERAS = np.random.default_rng(6).normal([0, 0, 0, 0, 0, -9], size=(N, 6))
CAMERAS[0, :3], CAMERAS[1, :3] = 0.0, [3.14, 0.0, 0.0]
LENSES, U = np.random.default_rng(7).normal([3, 0, 0], 0.1, size=(N, 3)), np.random.default_rng(8).uniform(size=(N, 2))
Row = tuple[Callable[..., Any], list[tuple[Manifold, Array]], Manifold | None]
MODELS: dict[str, Row] = {  # the model, the space and the stack of each argument, the group of what comes out
    "distance in the plane": (sensors.distance, [(R(2), points(2))], None),
    "distance": (sensors.distance, [(R(3), points(3))], None),
    "bearing": (sensors.direction, [(R(2), points(2))], Measured("bearing")),
    "direction": (sensors.direction, [(R(3), points(3))], ANGLES),
    "spherical": (sensors.spherical, [(R(3), points(3))], Measured("range", "yaw", "pitch")),
    "range and azimuth": (sensors.range_azimuth, [(R(3), points(3))], Measured("range", "azimuth")),
    "elevation": (sensors.elevation, [(R(3), points(3))], None),
    "cartesian": (sensors.cartesian, [(R(3), points(3) * [1.0, 0.5, 0.2])], None),
    "point in a frame of the plane": (partial(sensors.point_in_frame, SE2), [(SE2, P), (R(2), points(2))], None),
    "point in a frame": (partial(sensors.point_in_frame, SE3), [(SE3, S), (R(3), points(3))], None),
    "point on a body of the plane": (lambda X: sensors.point_on_body(SE2, X, points(2)[: len(X)]), [(SE2, P)], None),
    "point on a body": (lambda X: sensors.point_on_body(SE3, X, points(3)[: len(X)]), [(SE3, S)], None),
    "heading in the plane": (partial(sensors.heading, SE2), [(SE2, P)], Measured("yaw")),
    "heading": (partial(sensors.heading, SE3), [(SE3, S)], Measured("yaw")),
    "levelled": (sensors.levelled, [(SE3, S), (SE3, T)], Measured("x", "y", "yaw")),
    "relative": (sensors.relative_xyh, [(SE3, S), (SE3, SE3.compose(S, T))], Measured("x", "y", "yaw")),
    "depth and tilt": (sensors.zpr, [(SE3, S)], Measured("z", "pitch", "roll")),
    "line": (sensors.line_in_frame, [(SE2, P), (LINE, elements(LINE, 5))], LINE),
    "bundle": (sensors.project, [(R(6), CAMERAS), (R(3), LENSES), (R(3), points(3))], None),
    "DVL": (dvl_velocity, [(R(3), points(3)), (R(3), points(3, 1)), (SE3, S)], None),
    "car": (partial(ackermann, wheelbase=2.83, encoder=0.76, at=(3.78, 0.5)), [(R(2), 0.6 * U)], None),
    "two wheels": (partial(differential_drive, base=0.7), [(SE2, P), (R(2), U)], SE2),
    "travel": (partial(wheel_travel, base=0.7), [(SE2, P), (SE2, SE2.compose(P, 0.4 * Q))], None),
}


@pytest.mark.parametrize("n", [1, N])
@pytest.mark.parametrize("name", MODELS)
def test_derivatives_are_central_differences(name: str, n: int) -> None:
    model, arguments, out = MODELS[name]
    minus = np.subtract if out is None else lambda b, a: out.local(a, b)
    stacks = [X[:n] for _, X in arguments]
    found = model(*stacks)[1]
    for k, (space, _) in enumerate(arguments):
        H = found[k] if isinstance(found, tuple) else found
        J = on_group(space, lambda Y, k=k: model(*stacks[:k], Y, *stacks[k + 1 :])[0], stacks[k], minus=minus)
        np.testing.assert_allclose(np.broadcast_to(H, J.shape), J, atol=5e-8 * max(1.0, np.abs(J).max()))
