"""A factor from a function of the user's, behind `Factor.from_function`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic, Noise
from models import Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, LeadlineError, OptionError

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
        if isinstance(dim, bool) or not isinstance(dim, int | np.integer) or not 0 < dim < 10**6:
            raise OptionError("Factor.from_function(dim)", dim, "numbers per residual, a whole number of at least 1")
        if not isinstance(keys, Sequence) or not keys:
            raise GraphError(f"Factor.from_function: expected variables such as x[0] or [x[0], x[1]], got {keys!r:.80}")
        self.dim, self.residual, self.jacobians = int(dim), residual, jacobians
        super().__init__(keys, np.zeros(dim), Isotropic() if noise is None else noise)
        self.slots, self.relative = (None,) * len(keys), relative  # type: ignore[misc]

    def __getitem__(self, index: object) -> Factor:
        raise GraphError(
            f"{self!r}: a factor from a function cannot be sliced: only your function knows its data; make "
            "one of the part you want",
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
