"""Size of a Cholesky factor before it is computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

if TYPE_CHECKING:
    from nls.assemble import Pattern

__all__ = ["Fill", "fill_in"]


@dataclass(frozen=True)
class Fill:
    """Numbers in R, and multiplications and additions to compute it."""

    nnz: int
    flops: float


def fill_in(pattern: Pattern, held: npt.NDArray[np.bool_]) -> Fill:
    """Fill of R with A'A = R'R, from a factorization of the graph of variables.

    One node per variable is factorized (a hundredth of the work), with a matrix that is diagonally dominant, so nothing
    cancels; its columns are then counted with the sizes of the variables.
    """
    from nls.linear import best_factorization
    from nls.linear.lu import SYMMETRIC, dominant

    free = np.flatnonzero(~held)
    number = np.full(len(held), -1, dtype=np.intp)
    number[free] = np.arange(len(free))
    pairs = [
        (number[a], number[b]) for f in pattern.batches for k, a in enumerate(f.variables) for b in f.variables[k + 1 :]
    ]
    none = np.zeros(0, dtype=np.intp)
    u, v = (np.concatenate([none, *(p[s] for p in pairs)]) for s in (0, 1))
    both = (u >= 0) & (v >= 0)
    u, v = u[both], v[both]
    dims = pattern.dims[free]
    if not len(free):
        return Fill(0, 0.0)
    order = best_factorization().order(u, v, len(free))
    position = np.empty(len(free), dtype=np.intp)
    position[order] = np.arange(len(free))
    from scipy.sparse.linalg import splu

    matrix = dominant(position[u], position[v], len(free))
    L = sp.csc_array(splu(matrix, permc_spec="NATURAL", **SYMMETRIC).L)
    widths = dims[order].astype(float)
    below = np.add.reduceat(widths[L.indices], L.indptr[:-1]) - widths
    nnz = widths * (widths + 1) / 2 + widths * below
    rows = below[:, None] + np.arange(1, int(widths.max()) + 1)
    flops = np.where(np.arange(1, int(widths.max()) + 1) <= widths[:, None], rows**2, 0.0).sum()
    return Fill(int(nnz.sum()), float(flops))
