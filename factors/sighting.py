r"""Common base of landmark, range and bearing: the target's position in the frame of the sensor, then g of it.

S = X o O                        pose of the sensor: vehicle X, mounting O (sensor to vehicle)
p = S^-1 l,   z = g(p)           l: the target, or the position of the target's pose L = (R_L, l)

H_S = J_g [-I, [p]x]             J_g = dg/dp; in the plane [-I, (p_y, -p_x)']
H_X = H_S Ad(O)^-1               X Exp(d) o O = S Exp(Ad(O)^-1 d)
H_O = H_S
H_l = J_g R_S'                   of a pose as target: J_g R_S' [R_L, 0]
"""

from __future__ import annotations

from abc import abstractmethod
from copy import copy
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import check_offset, fixed_offset, named_singularity, pose_group
from factors.noise import Noise
from models import LieGroup, Manifold, R
from models.algebra import Array, product
from models.errors import GraphError
from models.manifolds.units import ANGLES
from models.sensors import point_in_frame

__all__ = ["Sighting"]


class Sighting(Factor):
    r"""A target seen from a pose: the base class of `Landmark`, `Range`, `Bearing` and `BearingRange`.

    .. math:: h(X, l) = g(p), \quad p = (X \circ O)^{-1} l

    A subclass states `measured` and `sense`. It states `point` where a single measurement says where the target is, or
    one of `ranges`, `directions` and `rays` where it says as much.

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    target : the point(s), R(2) or R(3), or other poses of the same group, of which the position is meant.
    z : (n, size) measurements.
    noise : of the measured numbers, by the names of `measured`.
    offset : pose of the sensor on the vehicle in the stored form of the pose group, (size,) or (n, size); a variable of
        that group, to be estimated; None where the sensor is the vehicle.

    Attributes
    ----------
    offset : None, the fixed offsets (1 or n, size), or the `Keys` of the variable(s).
    from_points : whether the sensor may be a point, R(2) or R(3), which has the axes of the world and no offset.
    locates : whether one measurement is enough to say where its target is.
    contact : whether z is range, m, and azimuth, rad, alone, as of an imaging sonar: its target is on an arc.
    limit : half of the aperture, rad, of those that only say that their target was in it (`limit_only`).

    Raises
    ------
    GraphError
        A range below 0, an angle beyond a turn; keys, measurements and offset that do not fit together.
    """

    relative = True
    per_measurement = ("offset",)
    from_points: ClassVar[bool] = False
    locates: ClassVar[bool] = False
    contact: ClassVar[bool] = False
    limit: float

    def __init__(
        self, pose: Keys, target: Keys, z: npt.ArrayLike, noise: Noise, offset: npt.ArrayLike | Keys | None = None
    ) -> None:
        keys = [pose, target, offset] if isinstance(offset, Keys) else [pose, target]
        super().__init__(keys, z, noise)
        self._refuse_impossible()
        self.slots, self.unmoved = (None,) * len(keys), tuple(range(2, len(keys)))
        self.offset: Array | Keys | None = (
            self.keys[2] if len(keys) == 3 else None if offset is None else fixed_offset(self, offset)  # type: ignore[arg-type]
        )

    def mounted(self, offset: npt.ArrayLike | Keys | None) -> Self:
        """The measurements with the sensor elsewhere on the vehicle, or there as a variable to be estimated.

        Parameters
        ----------
        offset : as for the factor itself.

        Returns
        -------
        The factor with that offset; this one stays as it is.

        Raises
        ------
        GraphError
            An offset that does not fit the measurements.

        Examples
        --------
        >>> from factors import Diagonal, RangeAzimuth
        >>> from models import SE3
        >>> from nls import kinds
        >>> x, l, o = kinds("x", "l", "o")
        >>> contact = RangeAzimuth(x[0], l[0], [5.0, 0.0], Diagonal(range=0.01, azimuth=0.005), SE3.identity())
        >>> contact.mounted(o[0])
        RangeAzimuth(x0, l0, o0)
        """
        mounted_factor = copy(self)
        pose, target = self.keys[:2]
        Sighting.__init__(mounted_factor, pose, target, self.z, self.noise, offset)
        mounted_factor.slots = (*self.slots[:2], *mounted_factor.slots[2:])
        return mounted_factor

    def _refuse_impossible(self) -> None:
        """No distance is below 0: one that marks an echo which is missing measured nothing. No direction is beyond a
        turn, and degrees nearly always are."""
        for space in (self.measured(2), self.measured(3)):
            z = self._z[..., None] if space.size == 1 and self._z.ndim < 2 else self._z
            if z.shape[-1:] != (space.size,):
                continue
            for name, numbers in zip(space.components, z.reshape(-1, space.size).T, strict=True):
                if name == "range":
                    wrong, says = numbers < 0, "m; none is below 0. Leave out what was not received"
                else:
                    wrong = (np.abs(numbers) > 2 * np.pi) & (name in ANGLES)
                    part = "z" if space.size == 1 else f"z[..., {space.components.index(name)}]"
                    says = (
                        f"rad, which is more than a turn; expected radians. Are these degrees? Then {part} = "
                        f"np.radians({part}). Do they count turns? Then wrap them: {part} = models.wrap({part})"
                    )
                if wrong.any():
                    k = int(np.argmax(wrong))
                    named, index = (self.describe(k), k) if k < len(self) else (repr(self), 0)
                    raise GraphError(f"{named}: its {name} is {numbers[k]:g} {says}", self.keys, self.name, index)

    @abstractmethod
    def measured(self, d: int) -> Manifold:
        """The space of z for points of d = 2 or 3 coordinates."""

    @abstractmethod
    def sense(self, p: Array) -> tuple[Array, Array | None]:
        """g(p) and J_g for targets p (n, d) in the frame of the sensor, m; None for the identity."""

    def point(self, z: Array) -> Array:
        """The target p (n, d) in the frame of the sensor, m, from z (n, size): the inverse of g, where it has one."""
        raise NotImplementedError(f"{self.name}: one measurement does not say where its target is")

    def ranges(self, z: Array) -> Array | None:
        """Distances (n,) of targets, m, from measurements z (n, size) of nothing else; None of other sensors."""
        return None

    def directions(self, z: Array) -> Array | None:
        """Unit vectors (n, d) to targets in the frame of the sensor, from z of nothing else; None of other sensors."""
        return None

    def rays(self, z: Array) -> tuple[Array, Array] | None:
        """Rays (n, 3) of the pixels z of a camera, in its frame, and their derivatives (n, 3, 2); None of others."""
        return None

    def locate(self, group: LieGroup, S: Array, z: Array) -> Array:
        """Targets l = S p (n, d) in the world, m, from measurements z (n, size) and poses S (n, size) of the sensor."""
        return group.act(S, self.point(z))

    def sensor_pose(self, group: LieGroup, X: Array, *O: Array) -> Array:
        """S = X o O (n, size), the poses of the sensor, from the stacks of the pose and of a variable offset."""
        if isinstance(self.offset, np.ndarray):
            return group.compose(X, self.offset)
        return group.compose(X, *O) if O else X

    def sizes(self) -> tuple[int, ...]:
        return self.measured(2).size, self.measured(3).size

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        if self.from_points and manifolds[0] is manifolds[1] and manifolds[0] in (R(2), R(3)):
            group = R(manifolds[0].dim)
            if self.offset is not None:
                raise self._refusal(f"{self.keys[0][[0]]} is a point in {group}, which has no axes for an offset")
        else:
            group = pose_group(
                self, manifolds[0], f", or a point like its target, in {manifolds[1]}" * self.from_points
            )
        points = R(group.point_dim)
        if manifolds[1] is not points and manifolds[1] is not group:
            raise self._refusal(
                f"the target {self.keys[1][[0]]} is in {manifolds[1]}; from a pose of {group} it must be in "
                f"{points} or {group}"
            )
        check_offset(self, self.offset, group, manifolds[-1])
        return self.measured(group.point_dim)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group, target = manifolds[:2]
        assert isinstance(group, LieGroup)
        S = self.sensor_pose(group, X[0], *X[2:])  # X o O
        p, (H_S, H_l) = point_in_frame(group, S, target.position(X[1]))  # S^-1 l
        with named_singularity(self):
            h, J_g = self.sense(p)
        if J_g is not None:
            H_S, H_l = product(J_g, H_S), product(J_g, H_l)
        if target is group and not group.flat:
            H_L = np.zeros((*H_l.shape[:-1], group.dim))
            H_L[..., : group.point_dim] = product(H_l, group.rotation(X[1]))
            H_l = H_L
        return h, self._through_mount(group, H_S, H_l, *X[2:])

    def _through_mount(self, group: LieGroup, H_S: Array, H_l: Array, *O: Array) -> tuple[Array, ...]:
        """Jacobians by the pose, the target and a variable offset, from those by the pose of the sensor and target."""
        if self.offset is None:
            return H_S, H_l
        H_X = product(H_S, group.adjoint_inverse(O[0] if O else np.asarray(self.offset)))
        return H_X, H_l, *([H_S] if O else [])
