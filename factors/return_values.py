"""Checks of the values returned by methods of a factor. Errors name the factor and the expected value."""

from __future__ import annotations

from functools import reduce
from typing import Any, Protocol

import numpy as np

from factors.keys import Keys
from factors.noise import SQUARABLE
from models import Manifold
from models.algebra import Array, components
from models.errors import EvaluationError, GraphError, NoiseModelError


class Batch(Protocol):
    """A factor, as far as checks of it need one."""

    keys: tuple[Keys, ...]

    @property
    def name(self) -> str: ...

    def describe(self, index: int) -> str: ...

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Any]: ...


def checked_space(factor: Batch, space: object) -> Manifold:
    """The result of `Factor.space`, if it is a space.

    Raises
    ------
    GraphError
    """
    if not isinstance(space, Manifold):
        raise GraphError(
            f"{factor.name}: its `space` returned {space!r:.60}; expected the space of one measurement, such as R(1), "
            "SE2 or Measured('range', 'azimuth')",
            factor.keys,
            factor.name,
        )
    return space


def checked_prediction(factor: Batch, prediction: object, shape: tuple[int, ...]) -> tuple[Array, object]:
    """The result of `Factor.predict`, if it is an array of this shape and Jacobians or None.

    Raises
    ------
    EvaluationError
    """
    if not (isinstance(prediction, tuple) and len(prediction) == 2 and isinstance(prediction[0], np.ndarray)):
        description = (
            f"an array of shape {prediction.shape}" if isinstance(prediction, np.ndarray) else f"{prediction!r:.60}"
        )
        raise _wrong(
            factor,
            f"its `predict` returned {description}; expected two things, the prediction h, an array of shape {shape}, "
            "and a tuple of Jacobians, one per slot, or None for central differences: return h, None",
        )
    h, H = prediction
    if h.shape != shape:
        raise _wrong(factor, f"the prediction has shape {h.shape}, expected {shape}")
    return h, H


def checked_jacobians(
    factor: Batch, H: object, n: int, m: int, manifolds: tuple[Manifold, ...]
) -> tuple[Array | None, ...]:
    """The Jacobians `Factor.predict` returned, if there is one of (n, m, dim_k) for every slot.

    Raises
    ------
    EvaluationError
    """
    if not isinstance(H, tuple | list):
        raise _wrong(factor, f"its Jacobians are a {type(H).__name__}, expected a tuple of arrays, one per slot: (H,)")
    if len(H) != len(manifolds):
        raise _wrong(factor, f"{len(H)} Jacobians, expected {len(manifolds)}: one per slot")
    for slot, (H_k, manifold) in enumerate(zip(H, manifolds, strict=True)):
        shape = (m, manifold.dim)
        if H_k is None and m != manifold.dim:
            raise _wrong(
                factor,
                f"None for slot {slot} means the identity, but its Jacobian is {m} x {manifold.dim}; give it, or "
                "return None instead of all Jacobians for central differences",
            )
        if H_k is not None and np.shape(H_k) not in ((n, *shape), (1, *shape), shape):
            raise _wrong(factor, f"Jacobian of slot {slot} has shape {np.shape(H_k)}, expected {(n, *shape)}")
    return tuple([H_k if H_k is None or H_k.ndim == 3 else H_k[None] for H_k in H])


def squarable(factor: Batch, b: Array) -> Array:
    """Whitened errors (n, m) whose squares are finite.

    Raises
    ------
    EvaluationError
    """
    if len(b) and not np.abs(b).max() <= SQUARABLE:
        index = int(np.argmax(~(np.abs(b).max(axis=1) <= SQUARABLE)))
        raise EvaluationError(
            f"{factor.describe(index)}: its residual is {np.abs(b[index]).max():.3g} sigmas, too large for a chi2; "
            "check its measurement, sigmas and initial values",
            factor.name,
            [k[[index]] for k in factor.keys],
            where="residual",
        )
    return b


def refuse_extreme(factor: Batch, z: Array, W: Array, names: tuple[str, ...]) -> None:
    """Refuse measurements z (n, size) that cannot be weighted by the whitener W, as no square of a number can hold it.

    Raises
    ------
    NoiseModelError
        A weight so small that its square is 0.
    GraphError
        A measurement of so many sigmas that no chi2 of it is finite.
    """
    if not z.size or not W.size:
        return
    sizes = np.abs(W)
    # `sizes.max(axis=2)` takes three times as long for 6,275 matrices
    rows = sizes if W.ndim == 2 else reduce(np.maximum, components(sizes))
    if (faint := (rows > 0) & (rows < 1 / SQUARABLE)).any():
        k, j = (int(i) for i in np.argwhere(faint)[0])
        sigma = float(1 / rows[k, j])
        raise NoiseModelError(
            f"{factor.describe(k)}: sigma {sigma:.3g} of {names[j]} has an information too small for a number; "
            f"expected less than {SQUARABLE:g}, or leave that component out",
            "noise",
            k,
            sigma,
            factor.keys,
        )
    sigmas = np.abs(z).max(axis=1) * rows.max(axis=1)
    if not sigmas.max() <= SQUARABLE:
        k = int(np.argmax(~(sigmas <= SQUARABLE)))
        raise GraphError(
            f"{factor.describe(k)}: its measurement {z[k % len(z)].tolist()} has {sigmas[k]:.3g} sigmas, too many for "
            "a chi2; check its numbers, units and sigmas",
            [keys[[k]] for keys in factor.keys],
            factor.name,
            k,
        )


def _wrong(factor: Batch, message: str) -> EvaluationError:
    return EvaluationError(f"{factor!r}: {message}", factor.name, factor.keys)
