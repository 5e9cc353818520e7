"""How much memory a factorization may take: estimated before it is taken, and refused with the numbers.

The estimate is the numbers of R (`nls.sparse.fill`) times the memory of a number at the peak, in units of 8 bytes. The
peak is the largest resident memory of analysis and solve together, above that of the linearized graph:

    CHOLMOD   1.9 - 2.1   (R of 27 to 218 MB: a factor with zeros in its supernodes, the fronts, H and its blocks)
    SuperLU   8 - 18      (L and U with their indices, in arrays that grow by copying)
    SPQR      9.7 - 10.9  (fronts of Householder vectors, R as triplets and again by columns)

It costs nothing where it cannot matter. A full triangle of n columns has n (n + 1) / 2 numbers. Where these fit (up to
26,000 columns for CHOLMOD in 6 GB) nothing is counted. Beyond, counting adds about a seventh to the analysis, once per
graph. This is 0.05 s to 0.32 s for 100,000 measurements in the plane, 0.05 to 0.51 s in space. For a million in the
plane it is 0.5 to 4.4 s.
"""

import math
import os
import sys
from functools import cache

from models.errors import OptionError, ResourceLimitError
from models.options import is_number
from nls.sparse.fill import counted
from nls.sparse.hessian import Hessian

FRACTION = 0.5  # of the machine's memory: values, A, the operating system and other programs need some too
UNKNOWN = 4e9  # bytes, where the system does not say how much memory there is


@cache
def default_limit() -> float:
    """Bytes a solve may take unless it is told otherwise: half the memory of the machine.

    That is what ``os.sysconf`` says, 4 GB where it says nothing (Windows). A container may be allowed less than the
    machine has: give the limit there.
    """
    try:
        return FRACTION * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return UNKNOWN


def checked_limit(memory_limit: float | None) -> float:
    """The option in bytes, half of the memory where it is None.

    Raises
    ------
    OptionError
        Not a number above 0.
    """
    if memory_limit is None:
        return default_limit()
    if not is_number(memory_limit) or not memory_limit > 0:
        raise OptionError("memory_limit", memory_limit, "bytes, a number above 0; None for half of the memory")
    return float(min(memory_limit, sys.float_info.max))


def always_fits(limit: float, per_number: float, n: int) -> bool:
    """Whether even a full triangle of n columns stays below the limit, so that nothing has to be counted."""
    return per_number * n * (n + 1) / 2 <= limit


def refuse_above(limit: float, per_number: float, hessian: Hessian, solver: str) -> None:
    """Refuse a factorization whose R would not fit.

    Parameters
    ----------
    limit : bytes.
    per_number : bytes at the peak per number of R.
    hessian : the structure with its elimination order.
    solver : name, for the message.

    Raises
    ------
    ResourceLimitError
    """
    if always_fits(limit, per_number, hessian.n):
        return
    elimination = hessian.elimination
    fill = counted(hessian.dims, elimination.u, elimination.v, elimination.variables)
    needed = per_number * fill.nnz
    if needed > limit:
        alternative = "" if solver == "cholesky" else "take linear solver 'cholesky', which needs least, "
        raise ResourceLimitError(
            f"linear solver {solver!r}: R of {hessian.n:,} unknowns has {fill.nnz:,} numbers, its factorization needs "
            f"{gigabytes(needed)}, the limit is {gigabytes(limit)}; {alternative}leave out variables or "
            "the measurements that connect distant parts, fix variables, or allow more with memory_limit",
            needed,
            limit,
            "sparse factorization",
        )


def gigabytes(size: float) -> str:
    """Three digits of a size in GB: 12.3 GB, 0.00123 GB."""
    digits = max(0, 2 - math.floor(math.log10(size / 1e9)))
    return f"{size / 1e9:.{digits}f} GB"
