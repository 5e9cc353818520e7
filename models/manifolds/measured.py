"""Spaces of measured numbers with names, some of them angles: ("bearing", "range"), ("yaw",), ("x", "y")."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array, wrap
from models.errors import OptionError
from models.manifolds.base import LieGroup
from models.manifolds.rn import Vectors
from models.manifolds.units import ANGLES, unit

__all__ = ["Measured"]


class MeasuredNumbers(Vectors):
    """Numbers that add up, angles among them wrapped to [-pi, pi): a vector space times circles."""

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__(len(names))
        self.name, self.components = f"({', '.join(names)})", names
        self.units = tuple(map(unit, names))
        self.point_dim = 0  # named numbers are no place
        self._angles = [k for k, name in enumerate(names) if name in ANGLES]

    def exp(self, delta: npt.ArrayLike) -> Array:
        X = np.array(delta, dtype=float)
        for k in self._angles:
            X[..., k] = wrap(X[..., k])
        return X

    def log(self, X: npt.ArrayLike) -> Array:
        return self.exp(X)

    vector = log

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        return self.exp(super().compose(X, Y))

    def inverse(self, X: npt.ArrayLike) -> Array:
        return self.exp(super().inverse(X))

    def __reduce__(self) -> tuple[Any, ...]:
        return Measured, self.components


def Measured(*names: str) -> LieGroup:
    """The space of measurements with these components; ``Measured("range") is Measured("range")``.

    Parameters
    ----------
    *names : in the order of the numbers; they name the sigmas of a noise. azimuth, bearing, elevation, roll, pitch and
        yaw are angles, rad, and wrap; every other name is a plain number.

    Raises
    ------
    OptionError
        No name, or one given twice.

    Examples
    --------
    >>> import numpy as np
    >>> Measured("bearing", "range").local(np.array([[3.0, 5.0]]), np.array([[-3.0, 6.0]])).round(4)
    array([[0.2832, 1.    ]])
    """
    if not names or not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise OptionError("Measured(*names)", names, "different names, at least one")
    return _KNOWN.get(names) or _KNOWN.setdefault(names, MeasuredNumbers(names))


_KNOWN: dict[tuple[str, ...], LieGroup] = {}  # setdefault and not @cache: see `models.manifolds.rn`
