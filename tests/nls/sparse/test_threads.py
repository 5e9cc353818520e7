"""Threads of one program may solve at once: the same bits as one after the other, and every setting put back."""

from __future__ import annotations

import ctypes
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from threadpoolctl import ThreadpoolController

from models import SE2, SE3
from nls import Marginals, Values, backends
from nls.linear import SOLVERS
from nls.sparse import threads
from nls.sparse.threads import single_thread
from tests.nls.graphs import SAMPLES, Sample, pose_graph, x
from tests.nls.solving import make

WORKERS = 4


def bits(values: Values) -> bytes:
    return b"".join(stack.X.tobytes("C") for stack in values.stacks.values())


def together(jobs: list[Callable[[], bytes]]) -> list[bytes]:
    """All jobs at once, started together."""
    gate = threading.Barrier(WORKERS, timeout=60)

    def run(job: Callable[[], bytes]) -> bytes:
        gate.wait()
        return job()

    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(run, jobs))


def solved(sample: Sample, solver: str) -> bytes:
    result = sample.graph.optimize(sample.values, linear_solver=SOLVERS[solver]())
    return bits(result.values) + repr([it.chi2 for it in result.history]).encode()


@pytest.mark.parametrize("solver", SOLVERS)
def test_different_graphs_and_one_graph_by_many_at_once(solver: str) -> None:
    make(solver)
    names = ("SO2", "SE2 odd ids", "SE3", "mixed")
    alone = [solved(SAMPLES[name](), solver) for name in names]
    samples = [SAMPLES[name]() for name in names]
    assert together([lambda s=s: solved(s, solver) for s in samples]) == alone  # type: ignore[misc]
    one, shared = (pose_graph(SE2, n=12) for _ in range(2))  # nothing of the shared one has been bound yet
    assert together([lambda: solved(shared, solver)] * 2 * WORKERS) == [solved(one, solver)] * 2 * WORKERS


def test_a_thread_beside_the_main_one_is_kept_to_one_thread_too() -> None:
    """The main thread has set numbers of threads before, as threadpoolctl's owner of them."""
    backends()  # loads SuiteSparse where it is installed
    controller = ThreadpoolController()
    gomp = [ctypes.CDLL(library.filepath) for library in controller.lib_controllers if library.prefix == "libgomp"]
    blas = controller.select(user_api="blas")

    def seen() -> tuple[list[int], list[int]]:
        levels = [library.omp_get_max_active_levels() for library in gomp]
        return [library.num_threads for library in blas.lib_controllers], levels

    def inside() -> tuple[list[int], list[int]]:
        with single_thread():
            return seen()

    before = seen()
    with blas.limit(limits=2), ThreadPoolExecutor(1) as pool:
        assert pool.submit(inside).result() == ([1] * len(blas), [0] * len(gomp))
    assert seen() == before
    assert threads.openmp() is bool(gomp)


def test_marginals_at_once() -> None:
    """Filters of warnings are shared by all threads: who changed them for a moment could leave them changed."""
    sample = pose_graph(SE3, n=20)
    before, show = list(warnings.filters), warnings.showwarning

    def job() -> bytes:
        result = sample.graph.optimize(sample.truth, linear_solver=SOLVERS["lu"]())
        return bits(result.values) + Marginals(sample.graph, sample.truth).all(x, frame="body").tobytes()

    assert together([job] * WORKERS) == [job()] * WORKERS
    assert (list(warnings.filters), warnings.showwarning) == (before, show)


class Runtime:
    """An OpenMP runtime: its levels belong to the process (up to GCC 10) or to every thread (since)."""

    def __init__(self, of_process: bool, levels: int) -> None:
        self._store: Any = type("Process", (), {})() if of_process else threading.local()
        self._default = levels

    def omp_get_max_active_levels(self) -> int:
        return getattr(self._store, "levels", self._default)

    def omp_set_max_active_levels(self, levels: int) -> None:
        self._store.levels = levels


class Blas:
    """A BLAS library with a number of threads for the process, which only one Python thread may set at a time."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._owner: threading.Thread | None = None

    def get_num_threads(self) -> int:
        return self.number

    def set_num_threads(self, number: int) -> None:
        self._owner = self._owner or threading.current_thread()
        if self._owner is threading.current_thread():
            self.number = number

    def clear_controlling_thread(self, force: bool) -> None:
        assert force
        self._owner = None


def settings(runtime: Runtime, blas: Blas) -> list[threads._Setting]:
    levels = threads._Setting(runtime.omp_get_max_active_levels, runtime.omp_set_max_active_levels, 0)
    return [levels, threads._threads(blas)]


def pretend(monkeypatch: pytest.MonkeyPatch, found: list[threads._Setting]) -> None:
    """Put libraries of ours in the place of the real ones."""
    monkeypatch.setattr(threads, "_settings", lambda loaded: found)


@pytest.mark.parametrize("of_process", [True, False])
@pytest.mark.parametrize("first_out", [0, 1])
def test_settings_come_back_in_whatever_order_threads_leave(
    of_process: bool, first_out: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads inside at once: whoever is still inside keeps one thread, and in the end all is as it was."""
    runtime, blas = Runtime(of_process, 3), Blas(8)
    pretend(monkeypatch, settings(runtime, blas))
    numbers: dict[tuple[str, int], tuple[int, int]] = {}
    both, gone = threading.Barrier(2, timeout=60), threading.Event()

    def work(number: int) -> None:
        def look(where: str) -> None:
            numbers[where, number] = runtime.omp_get_max_active_levels(), blas.number

        with single_thread():
            both.wait()
            if number != first_out:
                assert gone.wait(60)
                look("still inside")
        if number == first_out:
            look("first out")
            gone.set()
        both.wait()
        look("after")

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, range(2)))
    assert numbers["still inside", 1 - first_out] == (0, 1)
    assert numbers["after", 0] == numbers["after", 1] == (3, 8)
    assert of_process or numbers["first out", first_out] == (3, 1)  # its own OpenMP is its own again, BLAS still shared


def test_settings_come_back_after_an_error_and_when_nested(monkeypatch: pytest.MonkeyPatch) -> None:
    runtime, blas = Runtime(True, 3), Blas(8)
    pretend(monkeypatch, settings(runtime, blas))

    def inside() -> None:
        with single_thread(), single_thread():
            assert (runtime.omp_get_max_active_levels(), blas.number) == (0, 1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        inside()
    assert (runtime.omp_get_max_active_levels(), blas.number) == (3, 8)


def test_libraries_that_another_thread_loads_are_kept_to_one_thread_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread imports CHOLMOD, with its own BLAS and OpenMP, while another one is inside."""
    numpy_only, suitesparse = Blas(4), Blas(6)
    runtime = Runtime(True, 2)
    loaded = (False,)
    first, later = threads._threads(numpy_only), settings(runtime, suitesparse)
    monkeypatch.setattr(threads, "_loaded", lambda: loaded)
    monkeypatch.setattr(threads, "_settings", lambda which: [first, *later] if which[0] else [first])

    def other() -> None:
        with single_thread():
            assert (numpy_only.number, suitesparse.number) == (1, 1)
            assert runtime.omp_get_max_active_levels() == 0

    with single_thread(), ThreadPoolExecutor(1) as pool:
        loaded = (True,)
        pool.submit(other).result()
        assert (numpy_only.number, suitesparse.number) == (1, 6)
    assert (numpy_only.number, suitesparse.number) == (4, 6)
    assert runtime.omp_get_max_active_levels() == 2
