"""A factor from a function of the user's, behind `Factor.from_function`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic, Noise
from models import Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, LeadlineError

__all__ = ["FunctionFactor"]


class FunctionFactor(Factor):
    """A residual given as a function: h(X) = residual(X), z = 0."""

    def __init__(
        self,
        residual: Callable[..., Array],
        keys: Sequence[Keys],
        dim: int,
        noise: Noise | None,
        jacobians: Callable[..., Sequence[Array]] | None,
        relative: bool,
    ) -> None:
        self.dim, self.residual, self.jacobians = dim, residual, jacobians
        super().__init__(keys, np.zeros(dim), noise or Isotropic())
        self.slots, self.relative = (None,) * len(keys), relative  # type: ignore[misc]

    def __getitem__(self, index: object) -> Factor:
        raise GraphError(
            f"{self!r}: a factor from a function has no parts, only your function knows which measurement is which; make "
            "one of the part",
            self.keys,
            self.name,
        )

    @property
    def name(self) -> str:
        return getattr(self.residual, "__name__", "residual")

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(self.dim)

    def names(self, space: Manifold) -> tuple[str, ...]:
        return tuple(f"r{k}" for k in range(self.dim))

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        (h,) = self._call(lambda *X: [self.residual(*X)], *X)
        return h, None if self.jacobians is None else self._call(self.jacobians, *X)

    def _call(self, function: Callable[..., Sequence[Array]], *X: Array) -> tuple[Array, ...]:
        try:
            found = function(*(np.array(stack, order="C") for stack in X))  # copies: it may change or keep them
            return tuple(np.array(array, dtype=float) for array in found)
        except LeadlineError:
            raise  # it says its own name: a singular geometry, for example, is a place to avoid
        except Exception as error:  # the user's code may raise anything; it comes through, named and chained
            raise EvaluationError(
                f"{self!r}: your function raised {type(error).__name__}: {error}", "from_function", self.keys
            ) from error
