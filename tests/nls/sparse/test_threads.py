"""Threads of one program may solve at once: the same bits as one after the other, and every setting put back."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

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
    from threadpoolctl import ThreadpoolController

    controller = ThreadpoolController().select(user_api="blas")

    def seen() -> list[int]:
        with single_thread():
            return [blas.num_threads for blas in controller.lib_controllers]

    before = [blas.num_threads for blas in controller.lib_controllers]
    with controller.limit(limits=2), ThreadPoolExecutor(1) as pool:
        assert pool.submit(seen).result() == [1] * len(before)
    assert [blas.num_threads for blas in controller.lib_controllers] == before


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

    def __init__(self, number: int, filepath: str = "blas") -> None:
        self.number, self.filepath = number, filepath
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


def levels(runtime: Runtime) -> threads.Knob:
    return threads.Knob(runtime, runtime.omp_get_max_active_levels, runtime.omp_set_max_active_levels, 0)


def pretend(monkeypatch: pytest.MonkeyPatch, knobs: Callable[[Any], list[threads.Knob]]) -> None:
    """Put libraries of ours in the place of the real ones."""
    monkeypatch.setattr(threads, "_knobs", knobs)
    monkeypatch.setattr(threads, "_KNOWN", {})
    monkeypatch.setattr(threads, "_SETTINGS", {})


@pytest.mark.parametrize("of_process", [True, False])
@pytest.mark.parametrize("first_out", [0, 1])
def test_settings_come_back_in_whatever_order_threads_leave(
    of_process: bool, first_out: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads inside at once: whoever is still inside keeps one thread, and in the end all is as it was."""
    runtime, blas = Runtime(of_process, 3), Blas(8)
    pretend(monkeypatch, lambda loaded: [levels(runtime), threads._numbers(blas)])
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
    pretend(monkeypatch, lambda loaded: [levels(runtime), threads._numbers(blas)])

    def inside() -> None:
        with single_thread(), single_thread():
            assert (runtime.omp_get_max_active_levels(), blas.number) == (0, 1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        inside()
    assert (runtime.omp_get_max_active_levels(), blas.number) == (3, 8)


def test_libraries_that_another_thread_loads_are_kept_to_one_thread_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread imports CHOLMOD, with its own BLAS and OpenMP, while another one is inside."""
    numpy_only, suitesparse = Blas(4, "first"), Blas(6, "second")
    runtime = Runtime(True, 2)
    loaded = (False,)
    first, later = threads._numbers(numpy_only), [threads._numbers(suitesparse), levels(runtime)]
    monkeypatch.setattr(threads, "_loaded", lambda: loaded)
    pretend(monkeypatch, lambda which: [first, *later] if which[0] else [first])

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


def test_the_libraries_found_are_those_threadpoolctl_finds() -> None:
    from threadpoolctl import ThreadpoolController

    pytest.importorskip("scipy.linalg.lapack")
    backends()  # loads SuiteSparse where it is installed
    if not threads._mapped():
        pytest.skip("this system does not say which files are mapped")
    controllers = ThreadpoolController().lib_controllers
    blas = [c for c in controllers if c.user_api == "blas"]
    knobs = threads._knobs(threads._loaded())
    assert len([knob for knob in knobs if knob.inside == 1]) == len(blas) > 0
    assert threads.openmp() is any(c.prefix == "libgomp" for c in controllers)
    before = [c.num_threads for c in blas]
    for number in (3, 2):
        for knob in knobs:
            if knob.inside == 1:
                knob.put(number)
                assert knob.get() == number
        assert [c.num_threads for c in blas] == [number] * len(blas)
        with single_thread():
            assert [c.num_threads for c in blas] == [1] * len(blas)
        assert [c.num_threads for c in blas] == [number] * len(blas)
    for c, number in zip(blas, before, strict=True):
        c.set_num_threads(number)
        type(c).clear_controlling_thread(force=True)
    assert [c.num_threads for c in blas] == before


class OpenBLAS:
    """A build of OpenBLAS whose functions end in 64_."""

    def __init__(self, parallel: int) -> None:
        self.openblas_get_parallel64_ = lambda: parallel
        self.openblas_get_num_threads64_ = lambda: 7
        self.openblas_set_num_threads64_ = lambda number: None


@pytest.mark.parametrize(
    ("files", "asked"),
    [
        ({"libopenblas.so": OpenBLAS(1), "libblas.so.3": object()}, False),  # beside the reference BLAS
        ({"libopenblas.so": OpenBLAS(0)}, False),
        ({"libopenblas.so": OpenBLAS(2)}, True),  # its threads are OpenMP's
        ({"libopenblas.so": OpenBLAS(1), "libmkl_rt.so.2": object()}, True),
        ({}, True),  # another system
    ],
)
def test_threadpoolctl_is_asked_about_what_is_no_openblas_of_its_own(
    files: dict[str, Any], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = threads.Knob("theirs", lambda: 4, lambda number: None, 1)
    monkeypatch.setattr(threads, "_mapped", lambda: list(files))
    monkeypatch.setattr(threads.os.path, "exists", lambda path: True)
    monkeypatch.setattr(threads.ctypes, "CDLL", lambda path: files[path])
    monkeypatch.setattr(threads, "_knob", lambda get, put, inside: threads.Knob(put, get, put, inside))
    monkeypatch.setattr(threads, "_blas_knobs", lambda: [theirs])
    knobs = threads._knobs.__wrapped__(())
    assert (theirs in knobs) is asked
    assert [knob.get() for knob in knobs] == ([4] if asked else [7])
