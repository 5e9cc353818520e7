"""What the tests of factors ask again and again: b, A and b, and whether something is refused by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from factors import Factor
from nls import Values

Array = npt.NDArray[np.float64]
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
