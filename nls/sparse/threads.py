"""One thread for the factorizations, whatever the libraries would take.

SuiteSparse 5 opens OpenMP regions of a fixed four threads in its supernodal code. Two cores spend them waiting for each
other: a factorization of sphere2500 takes 80 ms instead of 24. OMP_NUM_THREADS does not change it. They are kept from
opening here, and the BLAS libraries are kept on one thread, which also makes results independent of the machine's load.

threadpoolctl finds the libraries, again whenever a binding has brought new ones. This costs 1 ms, after 3 ms for its
import. From then on `single_thread` costs 14 us where three BLAS libraries have more than one thread, 4 where they
have one, and 1 inside another one.
"""

import ctypes
import sys
from collections.abc import Callable
from functools import cache, wraps
from threading import RLock, local
from typing import Any, ParamSpec, TypeVar

BRING = ("sksparse.cholmod", "sparseqr._sparseqr", "scipy.linalg.lapack")  # modules that bring libraries with them
P = ParamSpec("P")
T = TypeVar("T")


class _Setting:
    """One number of one library that is taken down while any thread of the program is inside `single_thread`.

    OpenBLAS with its own threads keeps it for the whole process, and so did OpenMP's runtime up to GCC 10; since then,
    and in an OpenBLAS built on OpenMP, every thread has its own. A second thread that comes in tells which: it finds
    what the first one has set, or not. What belongs to the process is put back by the last one out, in whatever order
    they leave.
    """

    def __init__(self, get: Callable[[], int], put: Callable[[int], object], inside: int) -> None:
        self.get, self.put, self.inside = get, put, inside  # `inside`: its value within `single_thread`
        self._users, self._first, self._shared = 0, 0, False

    def enter(self) -> int:
        """Take it down; returns what this thread found."""
        number = self.get()
        if not self._users:
            self._first, self._shared = number, False
        elif number == self.inside:
            self._shared = True
        if number != self.inside:
            self.put(self.inside)
        self._users += 1
        return number

    def leave(self, number: int) -> None:
        """Put it back, unless somebody inside needs it as it is."""
        self._users -= 1
        back = number if not self._shared else self.inside if self._users else self._first
        if back != self.inside:
            self.put(back)


_LOCK = RLock()
_KNOWN: dict[str, _Setting] = {}  # by the file of the library
_HERE = local()


def _loaded() -> tuple[bool, ...]:
    """Which bindings are loaded: they bring BLAS and OpenMP libraries into the process that were not there before."""
    return tuple([name in sys.modules for name in BRING])


@cache
def _settings(loaded: tuple[bool, ...]) -> list[_Setting]:
    """Settings of all libraries loaded by now, looked for once per set of bindings."""
    from threadpoolctl import ThreadpoolController

    for library in ThreadpoolController().lib_controllers:
        if library.user_api == "blas":
            setting = _threads(library)
        elif library.prefix == "libgomp":
            gomp = ctypes.CDLL(library.filepath)
            setting = _Setting(gomp.omp_get_max_active_levels, gomp.omp_set_max_active_levels, 0)
        else:
            continue
        _KNOWN.setdefault(library.filepath, setting)
    return list(_KNOWN.values())


def _threads(blas: Any) -> _Setting:
    """The number of threads of a BLAS library."""
    # Since 3.7 threadpoolctl lets one Python thread alone set what belongs to the process, and ignores all others
    # without a word. Here they agree on it: nobody owns it.
    nobody = getattr(blas, "clear_controlling_thread", lambda force: None)

    def put(number: int) -> None:
        nobody(force=True)
        blas.set_num_threads(number)
        nobody(force=True)

    return _Setting(blas.get_num_threads, put, 1)


def openmp() -> bool:
    """Whether GNU's OpenMP runtime is in this process."""
    return any(setting.inside == 0 for setting in _settings(_loaded()))


class single_thread:
    """No OpenMP regions and one BLAS thread inside; both are restored. Several threads of a program may be inside.

    A context, ``with single_thread():``, or a decorator, ``@single_thread()``.
    """

    __slots__ = ("_before", "_entered")

    def __enter__(self) -> None:
        self._before: tuple[frozenset[_Setting], tuple[bool, ...]] = getattr(_HERE, "inside", (frozenset(), ()))
        (held, known), loaded, self._entered = self._before, _loaded(), list[tuple[_Setting, int]]()
        if loaded != known:  # inside another one only what was loaded since
            with _LOCK:
                self._entered = [(setting, setting.enter()) for setting in _settings(loaded) if setting not in held]
            _HERE.inside = held.union(setting for setting, _ in self._entered), loaded

    def __exit__(self, *_: object) -> None:
        _HERE.inside = self._before
        if self._entered:
            with _LOCK:
                for setting, number in self._entered:
                    setting.leave(number)

    def __call__(self, function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def inside(*args: P.args, **kwargs: P.kwargs) -> T:
            with single_thread():
                return function(*args, **kwargs)

        return inside
