"""A distance by a clock and a speed of sound that is not known exactly: its scale is a variable."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic, Noise
from factors.range import Range
from models import Manifold, Measured, R
from models.algebra import Array
from models.errors import GraphError

__all__ = ["ScaledRange"]

UNIT = Isotropic(1.0)  # of a prediction, which has no noise


class ScaledRange(Factor):
    r"""Distance from the sensor to a target, times 1 + s, where the scale error s is a variable.

    .. math:: h(X, l, s) = (1 + s)\,|p|, \quad p = (X \circ O)^{-1} l, \quad H_s = |p|, \quad
              H_{X, l} = (1 + s)\,H_{X, l}^{Range}

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    target : the point(s), R(2) for SE2, R(3) for SE3; or poses of the same group, of which the position is meant.
    scale : the scale error(s) s, R(1); 0.01 where the speed of sound was taken 1 % too high.
    z : (n,) measured ranges, m.
    noise : of ``range``, m.
    offset : fixed pose of the antenna on the vehicle, (size,) or (n, size); None: no offset.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit; a range below 0.
    SingularGeometryError
        At evaluation: zero range, where there is no line of sight.

    Notes
    -----
    Ranges and scale alone leave the size of everything free: another sensor has to measure lengths, or two places have
    to be known. P. Milne, Underwater Acoustic Positioning Systems, 1983, chapter 2 (errors of the speed of sound).

    Examples
    --------
    >>> from factors import Isotropic, Range, ScaledRange
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l, c = kinds("x", "l", "c")
    >>> graph = FactorGraph([ScaledRange(x[[0, 1, 2, 3]], l[0], c[0], [5.1, 4.08, 3.06, 5.1], Isotropic(0.1))])
    >>> poses = [[0, 0, 0], [3, 0, 0], [0, 4, 0], [6, 0, 0]]
    >>> values = Values({x: (SE2, poses), l: (R(2), [2.0, 3.0]), c: (R(1), [0.0])})
    >>> graph.fix(x[[0, 1, 2, 3]])
    >>> result = graph.optimize(values)
    >>> result.values[l[0]].round(6), result.values[c[0]].round(6)
    (array([3., 4.]), array([0.02]))
    """

    relative = True
    slots = (None, None, R(1))
    unmoved = (2,)
    per_measurement = ("offset",)

    def __init__(
        self,
        pose: Keys,
        target: Keys,
        scale: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        offset: npt.ArrayLike | None = None,
    ) -> None:
        if isinstance(offset, Keys):
            raise GraphError(f"ScaledRange: the offset {offset!r} is a variable; here it must be known", [offset])
        super().__init__([pose, target, scale], z, noise)
        self.offset = Range(pose, target, z, noise, offset).offset  # which refuses what is no range or offset

    def unscaled(self, noise: Noise | None = None) -> Range:
        """Plain ranges of these measurements, with the scale taken to be 0, and another noise where one is given."""
        assert not isinstance(self.offset, Keys)
        return Range(self.keys[0], self.keys[1], self.z, noise or self.noise, self.offset)

    def sizes(self) -> tuple[int, ...]:
        return (1,)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        self.unscaled(UNIT).space(manifolds[:2])
        return Measured("range")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        r, H = self.unscaled(UNIT).predict(manifolds[:2], *X[:2])
        assert H is not None
        scale = 1 + X[2]
        H_X, H_l = (scale[:, :, None] * np.asarray(block) for block in H)
        return scale * r, (H_X, H_l, r[:, :, None])
