"""What all scripts of the benchmarks share: command line, public data, processes of their own, tables and pages."""

from __future__ import annotations

import argparse
import ctypes
import ctypes.util
import datetime
import inspect
import json
import os
import platform
import resource
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import process_time
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

PROCESSOR_TIME = "- processor time, one thread for every solver; other work on the machine hardly changes it"
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "BLIS", "OMP")}
RESULTS = Path(__file__).parent / "results"
POSE_GRAPHS = {  # public ones, below the folder of the data
    "manhattan": "pose-graphs-2d/manhattan.g2o",
    "intel": "pose-graphs-2d/intel.g2o",
    "CSAIL": "pose-graphs-2d/CSAIL.g2o",
    "kitti_00": "pose-graphs-2d/kitti_00.g2o",
    "city10000": "pose-graphs-2d/city10000.g2o.gz",
    "ring": "pose-graphs-2d/ring.g2o",
    "input_INTEL": "pose-graphs-2d/input_INTEL.g2o",
    "input_M3500": "pose-graphs-2d/input_M3500_g2o.g2o",
    "manhattanOlson3500": "pose-graphs-2d/manhattanOlson3500.g2o",
    "FR079": "pose-graphs-2d/FR079_P_toro.graph",
    "city10000 truth": "pose-graphs-2d/city10000_groundtruth_edges.txt",
    "tinyGrid3D": "pose-graphs-3d/tinyGrid3D.g2o",
    "smallGrid3D": "pose-graphs-3d/smallGrid3D.g2o",
    "Klaus3": "pose-graphs-3d/Klaus3.g2o",
    "parking-garage": "pose-graphs-3d/parking-garage.g2o.gz",
    "sphere2500": "pose-graphs-3d/sphere2500.g2o.gz",
    "torus3D": "pose-graphs-3d/torus3D.g2o.gz",
    "sphere400": "pose-graphs-3d/sphere400.txt",
    "sphere2500 truth": "pose-graphs-3d/sphere2500_groundtruth_edges.txt",
}
GTSAM = {"metavar": "PYTHON", "help": "an interpreter that has GTSAM's wheel"}
T = TypeVar("T")


# --- command line and public data -------------------------------------------------------------------------------------


def make_page(
    title: str,
    page: Callable[..., Iterable[str]],
    measure: Callable[..., Any] | Mapping[str, Callable[..., Any]] | None = None,
    file: str | None = None,
    **options: str | tuple[float, str] | dict[str, Any],
) -> None:
    """Read the command line and write a page: its head, which states the load before the work, and the lines of `page`.

    Parameters
    ----------
    title : of the page; ``{last}`` stands for the last seed.
    page : gets every option by its name; as ``data`` the folder of the public data, and as ``out`` that of the page.
        The first line of its script's text describes the command line. Its lines are laid out by `spaced`.
    measure : what a process of its own makes of the words behind ``--child``, printed as JSON; of several functions the
        first word names one.
    file : name of the page; that of the script when omitted.
    options : of the command line: what a switch does; the default of a whole number from 1, or of a number above 0,
        and what it is; or arguments for argparse.
    """
    if measure is not None and sys.argv[1:2] == ["--child"]:
        first, *words = sys.argv[2:]
        print(json.dumps(measure[first](*words) if isinstance(measure, Mapping) else measure(first, *words)))
        return
    script = page.__globals__
    file = file or f"{Path(script['__file__']).stem}.md"
    parser = arguments(script["__doc__"], file)
    for name, how in options.items():
        parser.add_argument(f"--{name.replace('_', '-')}", **option(how))
    given = vars(parser.parse_args())
    out = given.pop("out")
    wanted = inspect.signature(page).parameters
    if "data" in wanted:
        given["data"] = public_data(parser)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"--out: {error}")
    if "out" in wanted:
        given["out"] = out
    head = [f"# {title.format(last=given.get('seeds', 1) - 1)}", *machine()]  # before the work: with the load by others
    lines = list(spaced(figure_first([*head, *page(**given)])))
    print("\n" + "\n".join(lines))
    (out / file).write_text("\n".join(lines).rstrip() + "\n")


def option(how: str | tuple[float, str] | dict[str, Any]) -> dict[str, Any]:
    """Arguments for argparse of an option of `make_page`."""
    if isinstance(how, str):
        return {"action": "store_true", "help": how}
    if isinstance(how, dict):
        return how
    default, text = how
    if isinstance(default, float):
        return {"type": positive, "default": default, "help": text}
    return {"type": at_least_one, "default": default, "metavar": "N", "help": f"{text} (default {default:,})"}


def arguments(doc: str | None, files: str) -> argparse.ArgumentParser:
    """Command line of a script: the first line of its text, and the folder of the files it writes."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="DIR", help=f"folder for {files}")
    return parser


def at_least_one(text: str) -> int:
    """A number of seeds or of processes."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text!r}")
    return int(text)


def positive(text: str) -> float:
    """A finite number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    return value


def public_data(parser: argparse.ArgumentParser) -> Path:
    """Folder of the public data; without one the script ends here."""
    if not (folder := os.environ.get("LEADLINE_DATA")):
        parser.exit(message="the public data sets are not shipped: set LEADLINE_DATA to the folder that holds them\n")
    return Path(folder)


# --- processes --------------------------------------------------------------------------------------------------------


def fresh(*command: object, timeout: float | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, with one thread."""
    settings = os.environ | ONE_THREAD | environment
    return subprocess.run([*map(str, command)], env=settings, capture_output=True, text=True, timeout=timeout)


def last_words(failed: subprocess.CompletedProcess[str]) -> str:
    """Why a process failed."""
    return (failed.stderr.strip() or "killed").splitlines()[-1]


def child(*command: object, **environment: str) -> Any:
    """JSON that a process of its own prints last; where it fails the benchmark ends."""
    done = fresh(*command, **environment)
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        raise SystemExit(f"{' '.join(map(str, command[1:]))}: {last_words(done)}")
    return json.loads(done.stdout.splitlines()[-1])


def pooled(processes: int, function: Callable[..., T], *arguments: Iterable[Any]) -> Iterator[T]:
    """What a function makes of the arguments, column by column, in the order of these, by several processes."""
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(function, *arguments)


def over(function: Callable[[int], dict[str, Any]], seeds: int) -> dict[str, npt.NDArray[Any]]:
    """The numbers a function finds for every seed from 0 on, by name, on all cores."""
    from sim.monte_carlo import runs

    records = runs(function, range(seeds), progress=True)
    return {name: np.array([record[name] for record in records]) for name in records[0]}


def timed(function: Callable[..., T], *arguments: Any, **options: Any) -> tuple[T, float]:
    """What a call gives, and its processor time, s."""
    began = process_time()
    found = function(*arguments, **options)
    return found, process_time() - began


def peak_memory(reset: bool = False) -> float:
    """Largest resident memory of this process so far, bytes; on Linux, with `reset`, from now on."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * (1 if sys.platform == "darwin" else 1024)
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    # not getrusage: on Linux that begins with the peak of the parent process
    return 1024.0 * next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))


# --- pages ------------------------------------------------------------------------------------------------------------


def machine() -> list[str]:
    """What the figures depend on."""
    import scipy

    processor, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        named = [line.split(":")[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        processor = (named or [processor])[0]
    suitesparse = "not installed"
    if (library := ctypes.util.find_library("suitesparseconfig")) is not None:
        numbers = (ctypes.c_int * 3)()
        ctypes.CDLL(library).SuiteSparse_version(numbers)
        suitesparse = ".".join(map(str, numbers))
    versions = f"NumPy {np.__version__}, SciPy {scipy.__version__}, SuiteSparse {suitesparse}"
    return [
        f"- {datetime.date.today():%Y-%m-%d}, {processor}, {os.cpu_count()} cores",
        f"- other work on the machine at the start: load {os.getloadavg()[0]:.1f}",
        f"- Python {platform.python_version()}, {versions}",
    ]


class Table(list[str]):
    """A table in Markdown. Rows that are added are printed.

    Parameters
    ----------
    titles : of the columns.
    names : the first so many columns are names, the others numbers; or ``l``, ``r`` or ``-`` for every column.
    """

    def __init__(self, titles: Sequence[str], names: int | str = 1) -> None:
        sides = names if isinstance(names, str) else "l" * names + "r" * (len(titles) - names)
        marks = {"l": ":--", "r": "--:", "-": "---"}
        super().__init__([line_of(titles), f"|{'|'.join(marks[side] for side in sides)}|"])

    def add(self, *cells: object) -> None:
        self.append(line_of(cells))
        print(self[-1], flush=True)


def line_of(cells: Iterable[object]) -> str:
    """A line of a table."""
    return f"| {' | '.join(map(str, cells))} |"


def markdown(titles: Sequence[str], rows: Iterable[Iterable[object]], names: int | str = 1) -> list[str]:
    """A whole table in Markdown."""
    return [*Table(titles, names), *map(line_of, rows)]


def spread(numbers: Iterable[float], digits: int = 3) -> str:
    """Mean, and smallest and largest, of all that are numbers."""
    found = np.array([number for number in numbers if np.isfinite(number)])
    return f"{found.mean():.{digits}f} ({found.min():.{digits}f}-{found.max():.{digits}f})"


def figure_first(lines: Sequence[str]) -> list[str]:
    """Lines of a page, with the lists above its first picture or table moved below it."""
    first = next((k for k, line in enumerate(lines) if line[:1] in ("!", "|")), len(lines))
    end = next((k for k in range(first, len(lines)) if lines[k][:1] != lines[first][0]), len(lines))
    return [*sorted(lines[:end], key=lambda line: line[:1] == "-"), *lines[end:]]


def spaced(lines: Iterable[str]) -> Iterator[str]:
    """Lines of a page with a blank one between any two, but not between points of a list, nor between rows of a table.

    Several lines in one text stay together, and blank lines that are there stay.
    """
    before = ""
    for line in lines:
        if before and line and (before[0] != line[0] or line[0] not in "-|"):
            yield ""
        yield line
        before = line.rpartition("\n")[2]


def exponent(n: list[int], y: list[float]) -> float:
    """p of the power law y ~ n^p through the points, by least squares of the logarithms."""
    if len(n) < 2:
        return float("nan")
    return float(np.polyfit(np.log(n), np.log(np.maximum(y, 1e-9)), 1)[0])
