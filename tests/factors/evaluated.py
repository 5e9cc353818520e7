"""What the tests of factors ask again and again: b, A and b, and whether something is refused by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from factors import Factor
from models.algebra import Array
from nls import Values

same = np.testing.assert_allclose


def error(factor: Factor, values: Values) -> Array:
    """b (n, m)."""
    model, X = values.gather(factor)
    return model.error(*X)


def linearized(factor: Factor, values: Values) -> tuple[tuple[Array, ...], Array]:
    """A_k (n, m, dim_k), one per slot, and b (n, m)."""
    model, X = values.gather(factor)
    return model.linearize(*X)


def refused(make: Callable[[], object], kind: type[Exception], named: str) -> Exception:
    """The error of this kind that `make` raises; `named` is a pattern of names and numbers in its sentence."""
    with pytest.raises(kind, match=named) as caught:
        make()
    return caught.value


def same_rows(part: Factor, whole: Factor, rows: list[int], values: Values) -> None:
    """A part of a batch is some of its rows."""
    assert type(part) is type(whole)
    assert part.keys == tuple(keys[rows] for keys in whole.keys)
    (A, b), (A_all, b_all) = linearized(part, values), linearized(whole, values)
    for mine, every in zip((*A, b), (*A_all, b_all), strict=True):
        same(mine, every[rows], rtol=1e-12, atol=1e-13)
