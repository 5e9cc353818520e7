"""The size of a noise, as far as it is known when a factor is made: how many measurements, how many numbers of each.

What is not known there is checked where the factor meets the spaces of its variables.
"""

from __future__ import annotations

from typing import Any

from factors.noise import Covariance, Diagonal, Information, Isotropic, Noise, SqrtInformation
from factors.robust import Robust
from factors.slices import one_each
from models.errors import NoiseModelError

__all__ = ["numbers_of_z", "refuse_other_size"]

TANGENT = {4: (3, 4), 7: (6, 7)}  # numbers of a noise by those of z, where these may be a quaternion; else as many


def refuse_other_size(factor: Any, noise: Noise) -> None:
    """Refuse a noise that is for other measurements or numbers than a factor has.

    Raises
    ------
    NoiseModelError
    """
    (count, size), n = _extent(noise), len(factor)
    if not n or (count in (1, n) and (size is None or size in (factor.noise_sizes() or (size,)))):
        return
    for_n = f"given for {count} measurements, there are {n}; give one, or {n}"
    expected = " or ".join(map(str, factor.noise_sizes()))
    text = for_n if count not in (1, n) else f"for {size} numbers, expected {expected}: z has shape {factor.z.shape}"
    raise NoiseModelError(f"{factor!r}: {noise!r}: {text}", keys=factor.keys)


def _extent(noise: Noise) -> tuple[int, int | None]:
    """How many measurements, 1 for all, and how many numbers of each a noise is for; None for any."""
    if isinstance(noise, Robust):
        return _extent(noise.noise)
    if isinstance(noise, Isotropic):
        return len(noise.sigma), None
    if isinstance(noise, Diagonal) and noise.named:
        return max(map(len, noise.named.values())), len(noise.named)
    if isinstance(noise, Diagonal | Covariance | Information | SqrtInformation):
        array: Any = noise.sigmas if isinstance(noise, Diagonal) else noise.matrix
        return len(array), array.shape[-1]
    return 1, None


def numbers_of_z(factor: Any) -> tuple[int, ...]:
    """How many numbers a noise may have, by those of z; () where it cannot be told."""
    z, sizes = factor.z, factor.sizes()
    per_row = not z.ndim or (z.ndim == 1 and one_each(z, len(factor), sizes))
    if z.ndim > 2 or per_row is None:
        return ()
    size = 1 if per_row else z.shape[-1]
    if sizes:
        return (size,) if size in sizes else ()
    return TANGENT.get(size, (size,))
