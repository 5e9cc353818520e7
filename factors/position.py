"""The position of a vehicle in the world: satellite fix at the surface, long-baseline fix, depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import check_offset, fixed_offset, pose_group
from factors.noise import Noise, component_names
from models import LieGroup, Manifold, Measured, R
from models.algebra import Array
from models.sensors import point_on_body

__all__ = ["Position"]


class Position(Factor):
    r"""World coordinates of a pose, or of a point on the vehicle, all or some of them.

    .. math:: h(X) = t + R\,a, \quad H = [R, -R [a]_\times]

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    z : (n, size) measured coordinates, m, in *world* axes; (n,) for one component.
    noise : of x, y(, z) along the *world* axes, m. (A `Prior` has its noise in the body frame.)
    components : which coordinates are measured, in the order of z, e.g. ``("z",)`` for depth; all when omitted.
    offset : lever arm a of the antenna or pressure cell in the body frame, (2 or 3,) or one for each measurement, m.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit: fewer numbers than coordinates without `components`; a component the world
        does not have.

    Notes
    -----
    The attitude is not measured; with a lever arm, rotations about the arm are not. P. Groves, Principles of GNSS,
    Inertial, and Multisensor Integrated Navigation Systems, 2013, section 14.3 (lever arm).

    Examples
    --------
    >>> from factors import Diagonal, Isotropic, Position, Prior
    >>> from models import SE3
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> start = Prior(x[0], SE3.identity()[0], Isotropic(1.0))
    >>> depth = Position(x[0], 12.5, Diagonal(depth=1e-3), components=("depth",))
    >>> graph = FactorGraph([start, depth])
    >>> graph.optimize(Values({x: (SE3, SE3.identity())})).values[x[0]][:3].round(3)
    array([ 0. ,  0. , 12.5])
    """

    slots = (None,)
    frame = "world"
    per_measurement = ("offset",)
    shared = ("components",)

    def __init__(
        self,
        pose: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        components: Sequence[str] | None = None,
        offset: npt.ArrayLike | None = None,
    ) -> None:
        self.components = None if components is None else component_names(components)
        super().__init__([pose], z, noise)
        self.offset = None if offset is None else fixed_offset(self, offset)

    def sizes(self) -> tuple[int, ...]:
        return (2, 3) if self.components is None else (len(self.components),)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        group = pose_group(self, manifolds[0], "; a point is measured by a Prior")
        world = R(group.point_dim)
        check_offset(self, self.offset, world)
        if self.components is None:
            self._refuse_some_coordinates(group, world)
        names = world.components if self.components is None else self.components
        if not names or not set(names) <= set(world.components) or len(set(names)) < len(names):
            raise self._refusal(f"components {names} of {world.components}")
        return Measured(*names)

    def _refuse_some_coordinates(self, group: LieGroup, world: Manifold) -> None:
        """Fewer numbers than coordinates and no names for them."""
        n, shape = len(self), self.z.shape
        one_number = not shape or (shape == (n,) and n not in (2, world.dim))
        count = 1 if one_number else shape[-1]
        if count < world.dim:
            names = world.components[:2] if count == 2 else world.components[-1:]
            raise self._refusal(
                f"z has shape {shape}; a position in {group} has {world.dim} coordinates, "
                f"{', '.join(world.components)}. Name those that are measured: components={names}"
            )

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group = manifolds[0]
        assert isinstance(group, LieGroup)
        a = np.zeros((1, group.point_dim)) if self.offset is None else self.offset
        h, H = point_on_body(group, X[0], a)
        if self.components is None:
            return h, (H,)
        rows = ["xyz".index(c) for c in self.components]
        return h[:, rows], (H[:, rows],)
