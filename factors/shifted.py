"""Any measurement with a calibration that it depends on at a known rate: a clock offset, a bias, a declination."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.constants import constant
from factors.keys import Keys
from models import LieGroup, Manifold, R
from models.algebra import Array, Index, apply
from models.errors import GraphError

__all__ = ["Shifted"]


class Shifted(Factor):
    r"""The measurements of another factor, shifted by a calibration c times known rates G.

    .. math:: h(X, c) = h_0(X) \circ \mathrm{Exp}(G\,c), \quad
              H = \mathrm{Ad}_{\mathrm{Exp}(G c)}^{-1} H_0, \quad H_c = J_r(G\,c)\,G

    For measured numbers that is h = h_0 + G c, with H_0 and G as Jacobians.

    Parameters
    ----------
    factor : the measurements without the shift; their noise and robust kernel stay.
    G : (m, k) or (n, m, k) rates, derivatives of the measurement by the calibration, in units of the one over the
        other. With the rate by time, c is how late the times of the sensor are; 1 for a bias or a declination.
    key : the calibration(s) c, in R(k), one for all measurements or one for each.

    Raises
    ------
    GraphError
        Rates of another shape; a calibration not in R(k); a factor that is made of a function, is a limit or has
        eliminated its target. Of the last three, add the shift to the function, or leave the factor as it is.

    Notes
    -----
    A clock: a value that was measured c before the time of its row is :math:`y(t - c) \approx y(t) - \dot y c`. So G is
    *minus* the rate of the measurement by time. This is exact while the rate is constant over the time c. The
    calibration is determined only where its rates differ from measurement to measurement. Otherwise other measurements
    must say the same without it, such as a `Prior`. J. Kelly, G. Sukhatme, "A general framework for temporal
    calibration of multiple proprioceptive and exteroceptive sensors", ISER 2010.

    Examples
    --------
    A compass with a declination of 0.1 rad; the pose at x = 0 is known to look along yaw 0.5:

    >>> from factors import Heading, Isotropic, Position, Prior, Shifted
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, c = kinds("x", "c")
    >>> known = Prior(x[0], [0.0, 0.0, 0.5], Isotropic(0.001))
    >>> place = Position(x[1], [1.0, 0.0], Isotropic(0.001))
    >>> compass = Shifted(Heading(x[[0, 1]], [0.6, 1.2], Isotropic(0.01)), [[1.0]], c[0])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]]), c: (R(1), [0.0])})
    >>> result = FactorGraph([known, place, compass]).optimize(values)
    >>> result.values[c[0]].round(4), result.values[x[1]].round(4)
    (array([0.1]), array([1. , 0. , 1.1]))
    """

    per_measurement = ("G", "key")

    def __init__(self, factor: Factor, G: npt.ArrayLike, key: Keys) -> None:
        if not isinstance(factor, Factor) or factor.opaque or factor.limit_only or factor.eliminated:
            raise GraphError(f"Shifted: expected a factor that measures, such as a Heading, got {factor!r:.80}")
        self.factor = factor
        super().__init__([*factor.keys, key], factor.z, factor.noise, factor.convention)
        rates = constant(self, "G", G)
        self.G = rates[None] if rates.ndim == 2 else rates
        if self.G.ndim != 3 or len(self.G) not in (1, len(self)) or not np.isfinite(self.G).all():
            raise self._refusal(
                f"its rates G have shape {np.shape(G)}, expected finite numbers, (m, k) or "
                f"({len(self)}, m, k) for m measured numbers and a calibration of k"
            )
        self.key = self.keys[-1]
        self.slots = (*factor.slots, None)
        self.relative, self.damped = factor.relative, factor.damped
        self.unmoved = (*factor.unmoved, len(factor.keys))

    def knows_axes(self, manifolds: tuple[Manifold | None, ...]) -> bool:
        return self.factor.knows_axes(manifolds[:-1])

    def sizes(self) -> tuple[int, ...]:
        return self.factor.sizes()

    def noise_sizes(self) -> tuple[int, ...]:
        return self.factor.noise_sizes()

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        space, k = self.factor.space(manifolds[:-1]), self.G.shape[2]
        if not isinstance(space, LieGroup) or self.G.shape[1] != space.dim:
            raise self._refusal(f"its rates G have {self.G.shape[1]} rows and it measures {space}")
        if manifolds[-1] is not R(k):
            raise GraphError(
                f"{self!r}: {self.key[[0]]} is in {manifolds[-1]}, expected R({k}) as G has {k} columns",
                [self.key],
                self.name,
            )
        return space

    def rows(self, space: Manifold) -> Index | slice:
        return self.factor.rows(space)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        space = self.space(manifolds)
        assert isinstance(space, LieGroup)
        h, H = self.factor.predict(manifolds[:-1], *X[:-1])
        shift = apply(self.G, X[-1])
        step = space.exp(shift)
        if H is None:
            return space.compose(h, step), None
        Ad = space.adjoint_inverse(step)
        moved = (Ad if H_k is None else Ad @ H_k for H_k in H)
        return space.compose(h, step), (*moved, space.jr(shift) @ self.G)

    def states(self, trait: str) -> bool:
        return trait in ("level_steps", "tilts") and self.factor.states(trait)

    def level_steps(self, model: Any) -> Array | None:
        return self.factor.level_steps(model)

    def tilts(self, model: Any) -> Array | None:
        return self.factor.tilts(model)
