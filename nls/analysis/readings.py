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

import numpy as np

from factors import Factor, Wheels
from factors.base import Model
from factors.replaced import replaced
from models import SE2, SE3, SO2, SO3, LieGroup
from models.algebra import Array, wrap

__all__ = ["READINGS", "Reading"]

ANGLES = ("bearing", "azimuth", "alpha")  # beginnings of names: EpipolarArc has azimuth_i and azimuth_j

# What was meant by a bound factor; None where the mistake makes no sense for its type.
Reading = Callable[[Model], Factor | None]


def exchanged(model: Model) -> Factor | None:
    """The first two variables exchanged; a sensor stays on its vehicle."""
    factor = model.factor
    if factor.frame != "first":
        return None
    i, j, *sensors = factor.keys
    swapped = replaced(factor, keys=[j, i, *sensors])
    if isinstance(offset := vars(swapped).get("offset"), tuple):  # of the sensors at both ends
        vars(swapped)["offset"] = offset[::-1]
    return swapped


def transposed(model: Model) -> Factor | None:
    """The rotation inverted, the translation as it is."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    if not factor.frame or "yaw" not in space.components:
        return None
    if space in (SO2, SO3, SE2, SE3):
        assert isinstance(space, LieGroup)
        rotation = slice(space.point_dim if space in (SE2, SE3) else 0, None)
        z[:, rotation] = space.inverse(z)[:, rotation]
    else:
        yaw = space.components.index("yaw")
        z[:, yaw] = wrap(-z[:, yaw])
    return replaced(factor, z=z)


def mirrored(model: Model) -> Factor | None:
    """Bearings and azimuths counted the other way round."""
    columns = [k for k, name in enumerate(model.space.components) if name.startswith(ANGLES)]
    if not columns:
        return None
    z = np.array(model.z)
    z[:, columns] = wrap(-z[:, columns])
    return replaced(model.factor, z=z)


def flipped(axis: str) -> Reading:
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
    if factor.frame and space in (SE2, SE3):
        if space is SE2:
            return np.column_stack([z[:, 0], -z[:, 1], wrap(-z[:, 2])]) if axis == "y" else None
        M = np.where(np.array(["x", "y", "z"]) == axis, -1.0, 1.0)
        return np.column_stack([z[:, :3] * M, -z[:, 3:6] * M, z[:, 6]])
    signs = {"y": ("y", "yaw"), "z": ("z",)}[axis] if factor.frame and axis in model.names else ()
    columns = [k for k, name in enumerate(space.components) if name in signs or (name, axis) == ("elevation", "z")]
    z[:, columns] *= -1.0
    return z if columns else None


def swapped_axes(model: Model) -> Factor | None:
    """East and north for north and east."""
    factor, space, z = model.factor, model.space, np.array(model.z)
    names = space.components
    if factor.frame != "world" or space in (SO2, SO3, SE3) or (space is SE2 and len(model.names) < 3):
        return None
    if "yaw" in names:
        z[:, names.index("yaw")] = wrap(np.pi / 2 - z[:, names.index("yaw")])
    if {"x", "y"} <= set(names):
        x, y = names.index("x"), names.index("y")
        z[:, [x, y]] = z[:, [y, x]]
    elif names != ("yaw",):
        return None
    return replaced(factor, z=z)


READINGS: dict[str, Reading] = {
    "exchanged": exchanged,
    "transposed": transposed,
    "mirrored": mirrored,
    "y flipped": flipped("y"),
    "z flipped": flipped("z"),
    "x, y exchanged": swapped_axes,
}
