"""One thread for the factorizations, whatever the libraries would take.

SuiteSparse 5 opens OpenMP regions of a fixed four threads in its supernodal code. Two cores spend them waiting for each
other: a factorization of sphere2500 takes 80 ms instead of 24. OMP_NUM_THREADS does not change it. They are kept from
opening here, and the BLAS libraries are kept on one thread, which also makes results independent of the machine's load.

The libraries are looked for once, by name, among the files that Linux maps into the process: 1.5 ms. threadpoolctl
knows more libraries and other systems, and takes 10 ms. It is asked where there is a BLAS other than an OpenBLAS with
threads of its own. After that `single_thread` costs 5 us, and 2 inside another one.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache, wraps
from threading import RLock, local
from typing import Any, NamedTuple, ParamSpec, TypeVar

BRING = ("sksparse.cholmod", "sparseqr._sparseqr", "scipy.linalg.lapack")  # modules that bring libraries with them
OPENBLAS = ("libopenblas", "libscipy_openblas", "libblas")  # how the names of their files begin
OTHERS = ("libmkl_rt", "libblis", "libflexiblas")
AFFIXES = ("{}", "scipy_{}", "{}64_", "scipy_{}64_", "{}_64", "scipy_{}_64")  # builds of OpenBLAS name their functions
P = ParamSpec("P")
T = TypeVar("T")


class Knob(NamedTuple):
    """A number that a library keeps."""

    name: object  # the same whoever finds it
    get: Callable[[], int]
    put: Callable[[int], object]
    inside: int  # `single_thread`


def _loaded() -> tuple[bool, ...]:
    """Which bindings are loaded: they bring BLAS and OpenMP libraries into the process that were not there before."""
    return tuple([name in sys.modules for name in BRING])


def openmp() -> bool:
    """Whether GNU's OpenMP runtime is in this process."""
    return any(knob.inside == 0 for knob in _knobs(_loaded()))


@cache
def _knobs(loaded: tuple[bool, ...]) -> list[Knob]:
    """Numbers of libraries to turn, looked for once per set of bindings."""
    paths = _mapped()
    gomp = _opened(paths, "libgomp")
    knobs = [_knob(lib.omp_get_max_active_levels, lib.omp_set_max_active_levels, 0) for lib in gomp]
    openblas = [lib for lib in _opened(paths, *OPENBLAS) if _function(lib, "get_parallel")]  # not the reference BLAS
    # an OpenBLAS without threads says 0, one with its own 1; 2 are those of OpenMP
    strange = any(_function(lib, "get_parallel")() not in (0, 1) for lib in openblas)
    if strange or not paths or _opened(paths, *OTHERS):
        return knobs + _blas_knobs()
    knobs += [_knob(_function(lib, "get_num_threads"), _function(lib, "set_num_threads"), 1) for lib in openblas]
    return list({knob.name: knob for knob in knobs}.values())


def _mapped() -> list[str]:
    """Files mapped into this process, none where the system does not say."""
    try:
        with open("/proc/self/maps") as maps:
            return sorted({line[line.find("/") :].rstrip("\n") for line in maps if ".so" in line})
    except OSError:
        return []


def _opened(paths: list[str], *names: str) -> list[Any]:
    """Libraries whose files are named like this; one that was deleted since it was loaded is out of reach."""
    return [ctypes.CDLL(path) for path in paths if os.path.basename(path).startswith(names) and os.path.exists(path)]


def _function(library: Any, name: str) -> Any:
    """A function of an OpenBLAS, None in another library."""
    known = (getattr(library, affix.format(f"openblas_{name}"), None) for affix in AFFIXES)
    return next((function for function in known if function is not None), None)


def _knob(get: Any, put: Any, inside: int) -> Knob:
    return Knob(ctypes.cast(put, ctypes.c_void_p).value, get, put, inside)  # two names of one file: one address


def _blas_knobs() -> list[Knob]:
    """Any BLAS libraries, by threadpoolctl."""
    from threadpoolctl import ThreadpoolController

    return [_numbers(blas) for blas in ThreadpoolController().select(user_api="blas").lib_controllers]


def _numbers(blas: Any) -> Knob:
    # Since 3.7 threadpoolctl lets one Python thread alone set what belongs to the process, and ignores all others
    # without a word. Here they agree on it: nobody owns it.
    nobody = getattr(blas, "clear_controlling_thread", lambda force: None)

    def put(number: int) -> None:
        nobody(force=True)
        blas.set_num_threads(number)
        nobody(force=True)

    return Knob(blas.filepath, blas.get_num_threads, put, 1)


class _Setting:
    """One number of one library that is taken down while any thread of the program is inside `single_thread`.

    OpenBLAS with its own threads keeps it for the whole process, and so did OpenMP's runtime up to GCC 10; since then,
    and in an OpenBLAS built on OpenMP, every thread has its own. A second thread that comes in tells which: it finds
    what the first one has set, or not. What belongs to the process is put back by the last one out, in whatever order
    they leave.
    """

    def __init__(self, knob: Knob) -> None:
        _, self._get, self._put, self._inside = knob
        self._users, self._first, self._shared = 0, 0, False

    def enter(self) -> int:
        """Take it down; returns what this thread found."""
        number = self._get()
        if not self._users:
            self._first, self._shared = number, False
        elif number == self._inside:
            self._shared = True
        if number != self._inside:
            self._put(self._inside)
        self._users += 1
        return number

    def leave(self, number: int) -> None:
        """Put it back, unless somebody inside needs it as it is."""
        self._users -= 1
        back = number if not self._shared else self._inside if self._users else self._first
        if back != self._inside:
            self._put(back)


def _settings() -> list[_Setting]:
    """Settings of all libraries loaded by now."""
    loaded = _loaded()
    if loaded not in _SETTINGS:
        _SETTINGS[loaded] = [_KNOWN.setdefault(knob.name, _Setting(knob)) for knob in _knobs(loaded)]
    return _SETTINGS[loaded]


_LOCK = RLock()
_KNOWN: dict[object, _Setting] = {}
_SETTINGS: dict[tuple[bool, ...], list[_Setting]] = {}
_HERE = local()


class single_thread:
    """No OpenMP regions and one BLAS thread inside; both are restored. Several threads of a program may be inside.

    A context, ``with single_thread():``, or a decorator, ``@single_thread()``.
    """

    __slots__ = ("_before", "_entered")

    def __enter__(self) -> None:
        self._before: frozenset[_Setting] = getattr(_HERE, "held", frozenset())
        with _LOCK:  # inside another one only what was loaded since
            self._entered = [(setting, setting.enter()) for setting in _settings() if setting not in self._before]
        if self._entered:
            _HERE.held = self._before.union(setting for setting, _ in self._entered)

    def __exit__(self, *_: object) -> None:
        if self._entered:
            _HERE.held = self._before
            with _LOCK:
                for setting, number in self._entered:
                    setting.leave(number)

    def __call__(self, function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def inside(*args: P.args, **kwargs: P.kwargs) -> T:
            with single_thread():
                return function(*args, **kwargs)

        return inside
