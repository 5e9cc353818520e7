r"""Other readings of a measurement: the mistakes by which a right number comes to say something else.

    exchanged        z of (i, j) is meant of (j, i)                       Between, BetweenSensors, XYH
    transposed       R -> R', t stays; in the plane yaw -> -yaw           relative poses, priors, XYH, Heading
    mirrored         bearing or azimuth -> its negative                   sensors with such a component
    y flipped        t -> M t, R -> M R M,  M = diag(1, -1, 1)            relative poses, priors, positions, landmarks
    z flipped        the same with M = diag(1, 1, -1)                     the same in space; depth and elevation
    x, y exchanged   (x, y) -> (y, x), yaw -> pi/2 - yaw                  positions, priors, headings

Each reading is a function from the measured values to others, and exchanged one from the variables to others. Noise
stays as it is. Of a rotation with unit quaternion (v, w), M R M has the quaternion (-M v, w): v is an axial vector.
Source of that: J. Diebel, "Representing attitude", 2006; a reflection changes the sign of a rotation about its plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors import XYH, ZPR, Between, BetweenSensors, Factor, Heading, Landmark, Position, Prior, Wheels
from factors.base import Model
from factors.replaced import replaced
from models import SE2, SE3, SO2, SO3, LieGroup, R
from models.algebra import Array, wrap

__all__ = ["READINGS", "Reading"]

ANGLES = ("bearing", "azimuth", "alpha")  # beginnings of names: EpipolarArc has azimuth_i and azimuth_j


@dataclass(frozen=True)
class Reading:
    """One way to read measurements otherwise.

    Attributes
    ----------
    name : of the mistake.
    read : the factor that says what was meant, from a bound one; None where the mistake makes no sense for its type.
    """

    name: str
    read: Callable[[Model], Factor | None]


def exchanged(model: Model) -> Factor | None:
    """The first two variables exchanged; a sensor stays on its vehicle."""
    factor = model.factor
    if not isinstance(factor, Between | BetweenSensors | XYH):
        return None
    i, j, *sensors = factor.keys
    swapped = replaced(factor, keys=[j, i, *sensors])
    if isinstance(swapped, BetweenSensors) and isinstance(swapped.offset, tuple):
        swapped.offset = swapped.offset[::-1]
    return swapped


def transposed(model: Model) -> Factor | None:
    """The rotation inverted, the translation as it is."""
    factor, space, z = model.factor, model.space, model.z
    if isinstance(factor, XYH):
        return replaced(factor, z=np.column_stack([z[:, :2], wrap(-z[:, 2])]))
    if isinstance(factor, Heading):
        return replaced(factor, z=wrap(-z))
    if not isinstance(factor, Between | BetweenSensors | Prior) or space not in (SO2, SO3, SE2, SE3):
        return None
    assert isinstance(space, LieGroup)
    inverse = np.array(space.inverse(z))
    if space in (SE2, SE3):
        inverse[:, : space.point_dim] = z[:, : space.point_dim]
    return replaced(factor, z=inverse)


def mirrored(model: Model) -> Factor | None:
    """Bearings and azimuths counted the other way round."""
    columns = [k for k, name in enumerate(model.space.components) if name.startswith(ANGLES)]
    if not columns:
        return None
    z = np.array(model.z)
    z[:, columns] = wrap(-z[:, columns])
    return replaced(model.factor, z=z)


def flipped(axis: str) -> Callable[[Model], Factor | None]:
    """An axis of all frames points the other way."""

    def read(model: Model) -> Factor | None:
        z = _reflected(model, axis)
        return None if z is None else replaced(model.factor, z=z)

    return read


def _reflected(model: Model, axis: str) -> Array | None:
    """Measured values in frames of which one axis points the other way; None where they do not have that axis."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    if isinstance(factor, Wheels):
        return z[:, [1, 0, 2]] * [1.0, 1.0, -1.0] if axis == "y" else None
    if isinstance(factor, Between | BetweenSensors | Prior) and space in (SE2, SE3):
        if space is SE2:
            return np.column_stack([z[:, 0], -z[:, 1], wrap(-z[:, 2])]) if axis == "y" else None
        M = np.where(np.array(["x", "y", "z"]) == axis, -1.0, 1.0)
        return np.column_stack([z[:, :3] * M, -z[:, 3:6] * M, z[:, 6]])
    if not isinstance(factor, XYH | ZPR | Position | Landmark) and not (
        isinstance(factor, Between | Prior) and space in (R(2), R(3))
    ):
        return _elevation(model) if axis == "z" else None
    signs = {"y": ("y", "yaw"), "z": ("z",)}[axis]
    columns = [k for k, name in enumerate(space.components) if name in signs]
    if not columns or (isinstance(factor, Prior) and not set(model.names) & set(signs)):
        return None
    z[:, columns] *= -1.0
    return z


def _elevation(model: Model) -> Array | None:
    """Elevations of which z points the other way."""
    columns = [k for k, name in enumerate(model.space.components) if name == "elevation"]
    if not columns:
        return None
    z = np.array(model.z)
    z[:, columns] *= -1.0
    return z


def swapped_axes(model: Model) -> Factor | None:
    """East and north for north and east."""
    factor, space, z = model.factor, model.space, model.z
    if isinstance(factor, Heading):
        return replaced(factor, z=wrap(np.pi / 2 - z))
    if isinstance(factor, Prior) and space is SE2 and factor.components is None:
        return replaced(factor, z=np.column_stack([z[:, 1], z[:, 0], wrap(np.pi / 2 - z[:, 2])]))
    plain = isinstance(factor, Position) or (isinstance(factor, Prior) and space in (R(2), R(3)))
    if not plain or not {"x", "y"} <= set(space.components):
        return None
    order = np.arange(space.size)
    x, y = (space.components.index(name) for name in "xy")
    order[[x, y]] = y, x
    return replaced(factor, z=z[:, order])


READINGS = (
    Reading("exchanged", exchanged),
    Reading("transposed", transposed),
    Reading("mirrored", mirrored),
    Reading("y flipped", flipped("y")),
    Reading("z flipped", flipped("z")),
    Reading("x, y exchanged", swapped_axes),
)
