"""A factor from a function of the user's, behind `Factor.from_function`."""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any, NoReturn

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic, Noise
from models import Manifold, R
from models.algebra import Array
from models.errors import EvaluationError, GraphError, LeadlineError, OptionError
from models.options import is_whole

__all__ = ["FunctionFactor"]


BY_VALUE = {"cloudpickle", "dill"}  # where one is loaded, it may be the one that pickles, and takes any function
SCALARS = (IndexError, TypeError, ValueError)  # of X[2], math.cos(X[0]), `x, y, yaw = X` where X is a stack


class _Alone(pickle.Pickler):
    """Pickles a function without the factors it refers to: the one it is the function of may be among them."""

    def persistent_id(self, thing: object) -> str | None:
        return "factor" if isinstance(thing, Factor) else None


class FunctionFactor(Factor):
    """A residual given as a function: h(X) = residual(X), z = 0."""

    opaque = True

    def __init__(
        self,
        residual: Callable[..., Array],
        keys: Sequence[Keys],
        dim: int,
        noise: Noise | None,
        jacobians: Callable[..., Sequence[Array]] | None,
        relative: bool,
    ) -> None:
        if not is_whole(dim) or not 0 < dim < 10**6:
            raise OptionError("Factor.from_function(dim)", dim, "numbers per residual, a whole number of at least 1")
        if not isinstance(keys, Sequence) or not keys:
            raise GraphError(f"Factor.from_function: expected variables such as x[0] or [x[0], x[1]], got {keys!r:.80}")
        self.dim, self.residual, self.jacobians = int(dim), residual, jacobians
        super().__init__(keys, np.zeros(dim), Isotropic() if noise is None else noise)
        self.slots, self.relative = (None,) * len(keys), relative

    def __getitem__(self, index: object) -> NoReturn:
        raise self._refusal(
            "a factor from a function cannot be sliced: only your function knows its data; make "
            "one of the part you want"
        )

    def __reduce_ex__(self, protocol: Any) -> Any:
        """As any object is pickled, once its functions are known to be.

        Raises
        ------
        GraphError
            A function that another process cannot find: a lambda, a function inside a function.
        """
        if BY_VALUE.isdisjoint(module.rpartition(".")[2] for module in list(sys.modules)):
            for function in (self.residual, self.jacobians):
                try:
                    _Alone(io.BytesIO(), protocol).dump(function)
                except (pickle.PicklingError, AttributeError, TypeError) as error:
                    raise self._refusal(
                        f"its function cannot be pickled: {error}. Define it with `def` at the "
                        "top of a module, its data as arguments of functools.partial; cloudpickle takes any function"
                    ) from error
        return super().__reduce_ex__(protocol)

    def __deepcopy__(self, memo: dict[int, Any]) -> FunctionFactor:
        clone = object.__new__(type(self))
        clone.__setstate__(deepcopy(self.__getstate__(), memo))
        return clone

    @property
    def name(self) -> str:
        return getattr(self.residual, "__name__", "residual")

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(self.dim)

    def noise_sizes(self) -> tuple[int, ...]:
        return (self.dim,)

    def names(self, space: Manifold) -> tuple[str, ...]:
        return tuple(f"r{k}" for k in range(self.dim))

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        (h,) = self._call(lambda *X: [self.residual(*X)], *X)
        if h.shape != (expected := (len(X[0]), self.dim)):
            raise EvaluationError(
                f"{self!r}: your function returned shape {h.shape}, expected {expected}{_stacks(X)}",
                self.name,
                self.keys,
            )
        return h, None if self.jacobians is None else self._call(self.jacobians, *X)

    def _call(self, function: Callable[..., Sequence[Array]], *X: Array) -> tuple[Array, ...]:
        try:
            arrays = function(*(np.array(stack, order="C") for stack in X))  # copies: it may change or keep them
            return tuple(np.array(array, dtype=float) for array in arrays)
        except LeadlineError:
            raise  # it says its own name: a singular geometry, for example, is a place to avoid
        except Exception as error:  # broad: the function is the user's and may raise anything; it is named and chained
            hint = _stacks(X) if isinstance(error, SCALARS) else ""
            raise EvaluationError(
                f"{self!r}: your function raised {type(error).__name__}: {error}{hint}", self.name, self.keys
            ) from error


def _stacks(X: tuple[Array, ...]) -> str:
    """The facts that a function for one measurement has to know."""
    shapes = ", ".join(str(stack.shape) for stack in X)
    return f". Your function gets stacks (n, size), one row per measurement, here {shapes}: take X[:, 0], not X[0]"
