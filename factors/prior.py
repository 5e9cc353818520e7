"""Absolute knowledge of one variable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import check_offset, fixed_offset
from factors.noise import Noise, component_names
from factors.noise_size import numbers_of_z
from models import LieGroup, Manifold
from models.algebra import Array, Index
from models.errors import GraphError

__all__ = ["Prior"]


class Prior(Factor):
    r"""A variable measured directly, in full or in some of its tangent components.

    .. math:: h(x) = x, \quad H = I, \quad e = (z \ominus x)_{components}

    With an offset O, a sensor on the vehicle is what is measured: :math:`h(x) = x \circ O, \; H = \mathrm{Ad}_O^{-1}`.

    Parameters
    ----------
    key : the variable(s), any space.
    z : (n, size) the measured element(s), in the stored form of the space.
    noise : of the measured components, in the *body* frame of the variable (tangent space at the prediction).
    components : names of the measured tangent components, e.g. ``("x", "y")``; all when omitted.
    convention : residual of group elements, `factors.conventions`.
    offset : fixed pose of the sensor on the vehicle, (size,) or (n, size); the noise is then in the sensor's frame.

    Raises
    ------
    GraphError
        A component the space does not have; an offset that is no element of the space.

    Notes
    -----
    Leaves nothing free when all components are measured. F. Dellaert, M. Kaess, Factor Graphs for Robot Perception,
    2017, section 2.1.

    Examples
    --------
    >>> from factors import Diagonal, Prior
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph()
    >>> _ = graph.add(Prior(x[0], [1.0, 2.0, 0.5], Diagonal(x=0.1, y=0.1, yaw=0.01)))
    >>> graph.optimize(Values({x: (SE2, [0.0, 0.0, 0.0])})).values[x[0]].round(6)
    array([1. , 2. , 0.5])
    """

    slots = (None,)
    frame = "world"
    per_measurement = ("offset",)
    shared = ("components",)

    def __init__(
        self,
        key: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        components: Sequence[str] | None = None,
        convention: str = "log",
        offset: npt.ArrayLike | None = None,
    ) -> None:
        self.components = None if components is None else component_names(components)
        super().__init__([key], z, noise, convention)
        self.offset = None if offset is None else fixed_offset(self, offset)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        if self.offset is not None and not isinstance(manifolds[0], LieGroup):
            raise self._refusal(f"{manifolds[0]} is no group, so nothing has an offset in it")
        check_offset(self, self.offset, manifolds[0])
        return manifolds[0]

    def rows(self, space: Manifold) -> Index | slice:
        if self.components is None:
            return slice(None)
        unknown = [c for c in self.components if c not in space.components]
        if unknown or not self.components or len(set(self.components)) < len(self.components):
            raise GraphError(f"components {self.components} of {space}, which has {space.components}")
        return np.array([space.components.index(c) for c in self.components])

    def noise_sizes(self) -> tuple[int, ...]:
        return numbers_of_z(self) if self.components is None else (len(self.components),)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        group = manifolds[0]
        if self.offset is None or not isinstance(group, LieGroup):
            return X[0], (None,)
        return group.compose(X[0], self.offset), (group.adjoint_inverse(self.offset),)
