"""Absolute knowledge of one variable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import ALIASES, Noise
from models import Manifold
from models.algebra import Array
from models.errors import GraphError

__all__ = ["Prior"]


class Prior(Factor):
    r"""A variable measured directly, in full or in some of its tangent components.

    .. math:: h(x) = x, \quad H = I, \quad e = (z \ominus x)_{components}

    Parameters
    ----------
    key : the variable(s), any space.
    z : (n, size) the measured element(s), in the stored form of the space.
    noise : of the measured components, in the *body* frame of the variable (tangent space at the prediction).
    components : names of the measured tangent components, e.g. ``("x", "y")``; all when omitted.
    convention : residual of group elements, `factors.conventions`.

    Raises
    ------
    GraphError
        A component the space does not have.

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

    def __init__(
        self,
        key: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        components: Sequence[str] | None = None,
        convention: str = "log",
    ) -> None:
        super().__init__([key], z, noise, convention)
        self.components = None if components is None else tuple(ALIASES.get(c, c) for c in components)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return manifolds[0]

    def rows(self, space: Manifold) -> npt.NDArray[np.intp] | slice:
        if self.components is None:
            return slice(None)
        unknown = [c for c in self.components if c not in space.components]
        if unknown or not self.components or len(set(self.components)) < len(self.components):
            raise GraphError(f"components {self.components} of {space}, which has {space.components}")
        return np.array([space.components.index(c) for c in self.components])

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return X[0], (None,)
