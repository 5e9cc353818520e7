"""One thread for the factorizations, whatever the libraries would take.

SuiteSparse 5 opens OpenMP regions of a fixed four threads in its supernodal code, which two cores spend waiting for
each other (80 ms a factorization of sphere2500 instead of 24); OMP_NUM_THREADS does not change it. They are kept from
opening here, and OpenBLAS is kept on one thread, which also makes results independent of the machine's load.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import RLock, local
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
def _blas(loaded: tuple[bool, bool]) -> list[Any]:
    """Controllers of the BLAS libraries in this process."""
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


class _Setting:
    """One number of one library that is taken down while any thread of the program is inside `single_thread`.

    OpenBLAS with its own threads keeps it for the whole process, and so did OpenMP's runtime up to GCC 10; since then,
    and in an OpenBLAS built on OpenMP, every thread has its own. A second thread that comes in tells which: it finds
    what the first one has set, or not. What belongs to the process is put back by the last one out, in whatever order
    they leave.
    """

    def __init__(self, get: Callable[[], int], put: Callable[[int], object], inside: int) -> None:
        self._get, self._put, self._inside = get, put, inside
        self._users, self._first, self._shared = 0, 0, False

    def enter(self) -> int:
        """Take it down; returns what this thread found."""
        found = self._get()
        if not self._users:
            self._first, self._shared = found, False
        elif found == self._inside:
            self._shared = True
        self._put(self._inside)
        self._users += 1
        return found

    def leave(self, found: int) -> None:
        """Put it back, unless somebody inside needs it as it is."""
        self._users -= 1
        if not self._shared:
            self._put(found)
        elif not self._users:
            self._put(self._first)


def _number_of_threads(blas: Any) -> _Setting:
    # Since 3.7 threadpoolctl lets one Python thread alone set what belongs to the process, and ignores all others
    # without a word. Here they agree on it: nobody owns it.
    nobody = getattr(blas, "clear_controlling_thread", lambda force: None)

    def put(number: int) -> None:
        nobody(force=True)
        blas.set_num_threads(number)
        nobody(force=True)

    return _Setting(blas.get_num_threads, put, 1)


def _settings() -> list[_Setting]:
    """Settings of all libraries loaded by now."""
    runtime, loaded = openmp(), _suitesparse()
    if runtime is not None and "openmp" not in _KNOWN:
        _KNOWN["openmp"] = _Setting(runtime.omp_get_max_active_levels, runtime.omp_set_max_active_levels, 0)
    for blas in _blas(loaded):
        if blas.filepath not in _KNOWN:
            _KNOWN[blas.filepath] = _number_of_threads(blas)
    return list(_KNOWN.values())


_LOCK = RLock()
_KNOWN: dict[str, _Setting] = {}
_HERE = local()


@contextmanager
def single_thread() -> Iterator[None]:
    """No OpenMP regions and one BLAS thread inside; both are restored. Several threads of a program may be inside."""
    depth = getattr(_HERE, "depth", 0)
    with _LOCK:
        found = [] if depth else [(setting, setting.enter()) for setting in _settings()]
    _HERE.depth = depth + 1
    try:
        yield
    finally:
        _HERE.depth = depth
        with _LOCK:
            for setting, number in found:
                setting.leave(number)
