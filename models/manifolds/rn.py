"""Vectors: R^n, stored as (..., n)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import OptionError
from models.manifolds.base import LieGroup
from models.manifolds.units import unit
from models.options import is_whole

__all__ = ["R"]

_NAMES = ("x", "y", "z")


class Vectors(LieGroup):
    """R^n as an additive group: Exp and Log are the identity, the product is the sum."""

    flat = True
    units: tuple[str, ...] = ()

    def __init__(self, n: int) -> None:
        self.name, self.dim, self.size = f"R({n})", n, n
        self.components = _NAMES[:n] if n <= 3 else tuple(f"c{k}" for k in range(n))
        self.units = ("",) if n == 1 else tuple(map(unit, self.components))  # one number is no place
        self.point_dim = n if n in (2, 3) else 0  # shifts of the plane and of space, without axes of their own

    def exp(self, delta: npt.ArrayLike) -> Array:
        return np.asarray(delta, dtype=float)

    def log(self, X: npt.ArrayLike) -> Array:
        return np.asarray(X, dtype=float)

    vector = log

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        return np.asarray(np.asarray(X, dtype=float) + np.asarray(Y, dtype=float))

    def inverse(self, X: npt.ArrayLike) -> Array:
        return -np.asarray(X, dtype=float)

    def _unit(self, X: npt.ArrayLike) -> Array:
        return np.broadcast_to(np.eye(self.dim), (*np.shape(X)[:-1], self.dim, self.dim))

    adjoint = jl = jl_inv = vector_jl = vector_jr = _unit

    def identity(self, n: int = 1) -> Array:
        return np.zeros((n, self.dim))

    def position(self, X: Array) -> Array:
        return X[..., : self.point_dim]

    def rotation(self, X: npt.ArrayLike) -> Array:
        return self._unit(X) if self.point_dim else super().rotation(X)

    def __reduce__(self) -> tuple[Any, ...]:
        return R, (self.dim,)


def R(n: int) -> LieGroup:
    """The space of vectors of n numbers; ``R(n) is R(n)``.

    Examples
    --------
    >>> import numpy as np
    >>> R(2).retract(np.array([[1.0, 2.0]]), np.array([[0.5, 0.0]]))
    array([[1.5, 2. ]])
    """
    if not is_whole(n) or not 1 <= n < 10**6:
        raise OptionError("R(n)", n, "a whole number from 1 to 999,999")
    return _KNOWN.get(int(n)) or _KNOWN.setdefault(int(n), Vectors(int(n)))


_KNOWN: dict[int, LieGroup] = {}  # setdefault and not @cache: two threads that ask first at once get the same space
