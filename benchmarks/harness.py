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
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

PROCESSOR_TIME = "- one thread for every solver, and its processor time, which other work on the machine hardly changes"
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "BLIS", "OMP")}
RESULTS = Path(__file__).parent / "results"


# --- command line and public data -------------------------------------------------------------------------------------


def make_page(
    doc: str | None,
    file: str,
    title: str,
    page: Callable[..., Iterable[str]],
    measure: Callable[..., Any] | None = None,
    **options: tuple[int, str] | dict[str, Any],
) -> None:
    """Read the command line and write a page: its head, which states the load before the work, and the lines of `page`.

    Parameters
    ----------
    doc : text of the script; its first line describes it.
    file : name of the page.
    title : of the page; ``{last}`` stands for the last seed.
    page : gets every option by its name; as ``data`` the folder of the public data, and as ``out`` that of the page.
    measure : what a process of its own makes of the words behind ``--child``, printed as JSON.
    options : of the command line: the default of a whole number from 1 and what it is, or arguments for argparse.
    """
    if measure is not None and sys.argv[1:2] == ["--child"]:
        print(json.dumps(measure(*sys.argv[2:])))
        return
    parser = arguments(doc, file)
    for name, how in options.items():
        if isinstance(how, tuple):
            default, text = how
            how = {"type": at_least_one, "default": default, "metavar": "N", "help": f"{text} (default {default:,})"}
        parser.add_argument(f"--{name.replace('_', '-')}", **how)
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
    head = page_head(title.format(last=given.get("seeds", 1) - 1))
    first, *lines = page(**given)
    write_page([*head, *([] if first.startswith("- ") else [""]), first, *lines], out / file)


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


def fresh(*command: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, with one thread."""
    settings = os.environ | ONE_THREAD | environment
    return subprocess.run([*map(str, command)], env=settings, capture_output=True, text=True)


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


def page_head(title: str) -> list[str]:
    """First lines of a page. Made before the work, as they state the load of the machine at the start."""
    return [f"# {title}", "", *machine()]


class Table(list[str]):
    """A table in Markdown; the first columns are names, the others numbers. Rows that are added are printed."""

    def __init__(self, titles: Sequence[str], names: int = 1) -> None:
        super().__init__([line_of(titles), "|:--" * names + "|--:" * (len(titles) - names) + "|"])

    def add(self, *cells: object) -> None:
        self.append(line_of(cells))
        print(self[-1], flush=True)


def line_of(cells: Iterable[object]) -> str:
    """A line of a table."""
    return f"| {' | '.join(map(str, cells))} |"


def markdown(titles: Sequence[str], rows: Iterable[Iterable[object]], names: int = 1) -> list[str]:
    """A whole table in Markdown."""
    return [*Table(titles, names), *map(line_of, rows)]


def spread(numbers: Iterable[float], digits: int = 3) -> str:
    """Mean, and smallest and largest, of all that are numbers."""
    found = np.array([number for number in numbers if np.isfinite(number)])
    return f"{found.mean():.{digits}f} ({found.min():.{digits}f}-{found.max():.{digits}f})"


def write_page(lines: list[str], path: Path) -> None:
    """Print a page and write it."""
    print("\n" + "\n".join(lines))
    path.write_text("\n".join(lines).rstrip() + "\n")


def exponent(n: list[int], y: list[float]) -> float:
    """p of the power law y ~ n^p through the points, by least squares of the logarithms."""
    if len(n) < 2:
        return float("nan")
    return float(np.polyfit(np.log(n), np.log(np.maximum(y, 1e-9)), 1)[0])
