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
    half, every = (n + 1) // 2, np.arange(n + 1)
    cure = "an attribute of each measurement is not sliced with the batch; make it an array named in per_measurement"
    for batch, index in (
        ("reversed", every[-2::-1]),
        (f"of the first {half}", every[:half]),
        (f"of {n + 1}", every % n),
    ):
        try:
            other = factor[index].bind(*model.manifolds).error(*(Y[index] for Y in X))
        except Exception as error:  # broad: data, space and `predict` are the user's; named and chained
            raised = f"a batch {batch} of its measurements raised {type(error).__name__}: {error}"
            raise GraphError(f"{factor!r:.200}: {raised}; {cure}", factor.keys, factor.name) from error
        wrong = (np.abs(other - b[index]) > SAME * terms[index]).any(axis=1)
        if wrong.any():
            k = int(np.argmax(wrong))
            place = int(index[k])
            here, there = (np.array2string(e, precision=6) for e in (b[place], other[k]))
            finding = f"its residual is {there} in a batch {batch} of the measurements, {here} in its own"
            keys = [keys[[place]] for keys in factor.keys]
            raise GraphError(f"{factor.describe(place)}: {finding}; {cure}", keys, factor.name, place)
