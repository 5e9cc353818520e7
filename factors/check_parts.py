"""Whether parts of a batch, the batch in another order and a longer one say the same of every measurement."""

from __future__ import annotations

import numpy as np

from factors.base import Model
from factors.declared import refuse_undeclared
from models.algebra import Array
from models.errors import GraphError

__all__ = ["check_parts"]

SAME = 1e-6  # difference of residuals of one measurement in two batches, of the largest term: rounding is less


def check_parts(model: Model, X: tuple[Array, ...], b: Array, terms: Array) -> None:
    """Compare the residuals of a batch with those of its first half, of its reverse, and of one measurement more.

    Parameters
    ----------
    model, X : the factor, bound, and the stacks of its variables. A factor that cannot be cut is not compared.
    b, terms : (n, m) whitened residuals, and the size of what they are the difference of.

    Raises
    ------
    GraphError
        An array that its class does not declare, see `factors.declared`; a measurement whose residual differs, or
        cannot be evaluated, in another batch.
    """
    factor, n = model.factor, len(b)
    if factor.opaque or not n:
        return
    refuse_undeclared(factor)
    half = (n + 1) // 2
    batches = {
        "reversed": np.arange(n)[::-1],
        f"of the first {half}": np.arange(half),
        f"of {n + 1}": np.arange(n + 1) % n,
    }
    for batch, index in batches.items():
        cure = (
            "something that it has for each measurement does not follow; hold it in an array of the factor, and name "
            "that in per_measurement"
        )
        try:
            other = factor[index].bind(*model.manifolds).error(*(Y[index] for Y in X))
        except Exception as error:  # broad: `predict` is the user's and may raise anything; it is named and chained
            raise GraphError(
                f"{factor!r:.200}: a batch {batch} of its measurements raised {type(error).__name__}: {error}; {cure}",
                factor.keys,
                factor.name,
            ) from error
        wrong = (np.abs(other - b[index]) > SAME * terms[index]).any(axis=1)
        if wrong.any():
            k = int(np.argmax(wrong))
            place = int(index[k])
            raise GraphError(
                f"{factor.describe(place)}: its residual is {np.array2string(other[k], precision=6)} in a batch "
                f"{batch} of the measurements, {np.array2string(b[place], precision=6)} in its own; {cure}",
                [keys[[place]] for keys in factor.keys],
                factor.name,
                place,
            )
