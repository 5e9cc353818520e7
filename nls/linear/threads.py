"""One thread for the factorizations, whatever the libraries would take.

SuiteSparse 5 opens OpenMP regions of a fixed four threads in its supernodal code, which two cores spend waiting for
each other (80 ms a factorization of sphere2500 instead of 24); OMP_NUM_THREADS does not change it. They are kept from
opening here, and OpenBLAS is kept on one thread, which also makes results independent of the machine's load.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

__all__ = ["openmp", "single_thread"]


def _suitesparse() -> tuple[bool, bool]:
    """Which bindings are loaded: they bring BLAS and OpenMP libraries into the process that were not there before."""
    return "sksparse.cholmod" in sys.modules, "sparseqr" in sys.modules


def openmp() -> ctypes.CDLL | None:
    """GNU's OpenMP runtime, if it is in this process."""
    return _openmp(_suitesparse())


@cache
def _openmp(loaded: tuple[bool, bool]) -> ctypes.CDLL | None:
    try:
        with open("/proc/self/maps") as maps:
            paths = {line.split()[-1] for line in maps if "libgomp" in line}
    except OSError:
        return None
    return ctypes.CDLL(sorted(paths)[0]) if paths else None


@cache
def _blas(loaded: tuple[bool, bool]) -> Any:
    """Controller of the BLAS libraries in this process."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


@contextmanager
def single_thread() -> Iterator[None]:
    """No OpenMP regions and one BLAS thread inside; both are restored."""
    runtime = openmp()
    levels = runtime.omp_get_max_active_levels() if runtime else 0
    if runtime:
        runtime.omp_set_max_active_levels(0)
    try:
        with _blas(_suitesparse()).limit(limits=1):
            yield
    finally:
        if runtime:
            runtime.omp_set_max_active_levels(levels)
