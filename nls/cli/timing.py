"""Where each millisecond of ``nls solve`` went: rows that add up to the whole process."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import nls

PARTS = ("linearize", "assemble", "factorize", "solve", "retract")  # of an iteration
BEFORE = ("startup", "imports", "read", "init", "check", "build", "analyze", *PARTS)
AFTER = ("other", "write", "certify", "report", "process")
SUMS = ("solved", "total", "process")
MEANINGS = {
    "startup": "interpreter, up to the command line; processor time",
    "imports": "NumPy, SciPy, the library, the linear solver",
    "read": "file, numbers, graph",
    "init": "start values, and chi2 of each",
    "check": "whether the output can hold the graph",
    "build": "gauge and pattern",
    "analyze": "elimination order, symbolic factorization",
    "other": "stop rules, degrees of freedom; of scans the matching; solutions that --improve left",
    "write": "files asked for",
    "certify": "optimum and eigenvalues in the SE-Sync cost, chi2 from there",
    "report": "explanation, covariances and pictures of the page",
}


class Clock:
    """Seconds by stage, one after the other.

    Parameters
    ----------
    began : `perf_counter` of the beginning.
    startup : seconds before that.
    """

    def __init__(self, began: float, startup: float) -> None:
        self.seconds = {"startup": startup}
        self._began = self._last = began

    def lap(self, name: str) -> None:
        """End of a stage, or of a part of it."""
        now = perf_counter()
        self.seconds[name], self._last = self.seconds.get(name, 0.0) + now - self._last, now

    def timings(self, optimize: dict[str, float], stages: dict[str, float]) -> dict[str, float]:
        """All stages for the report: the parts of the optimization in the place of its lap, and what they left over.

        ``solved`` is from the file to the optimum, ``total`` adds the outputs, ``process`` the start-up.
        """
        seconds = dict(self.seconds)
        whole = seconds.pop("optimize")
        out = {"read": seconds["read"], "init": seconds["init"], **optimize}
        out["other"] = whole - sum(optimize.values())
        out["solved"] = seconds["read"] + seconds["init"] + whole
        optional = ("check", "write", "certify", "report", "startup", "imports")
        out |= {name: seconds[name] for name in optional if name in seconds}
        out["total"] = out["solved"] + sum(out.get(name, 0.0) for name in ("check", "write", "certify", "report"))
        out["process"] = out["total"] + out["startup"] + out["imports"]
        return out | stages


def rows(timings: dict[str, float]) -> list[str]:
    """Names of the stages, one after the other, and of the whole."""
    more = [name for name in timings if name not in (*BEFORE, *AFTER, *SUMS) and " " not in name]  # of other solvers
    return [row for row in (*BEFORE, *more, *AFTER) if row in timings]


def table(timings: dict[str, float]) -> list[str]:
    """Lines: milliseconds and share of every stage, with what it consists of, and their sum."""
    whole = timings["process"]
    lines = ["time               ms       %"]
    for row in rows(timings):
        lines.append(f"{row:11s} {_shares(timings[row], whole)}   {MEANINGS.get(row, '')}".rstrip())
        inside = [(name, s) for name, s in timings.items() if name.startswith(f"{row} ")]
        lines += [f"  {name.removeprefix(row):9s} {_shares(s, whole)}" for name, s in inside]
    return lines


def iterations(history: Sequence[nls.Iteration]) -> list[str]:
    """Lines: milliseconds of the parts of every iteration; the start is only linearized."""
    parts = dict.fromkeys((*PARTS, *(stage for iteration in history for stage in iteration.seconds)))
    lines = ["iteration " + "".join(f"{stage:>11s}" for stage in parts) + "          ms"]
    for iteration in history:
        seconds = [iteration.seconds.get(stage, 0.0) for stage in parts]
        lines.append(
            f"{iteration.number:9d} " + "".join(f"{1e3 * s:11.2f}" for s in seconds) + f"{1e3 * sum(seconds):12.2f}"
        )
    return lines


def _shares(seconds: float, whole: float) -> str:
    return f"{1e3 * seconds:9.1f} {100 * seconds / whole:7.1f}"


def peak_rss_mb() -> float:
    """The most memory this process has held, MB; 0 where the system does not count it."""
    try:  # Linux hands the peak of the parent process down to ru_maxrss, but not to VmHWM
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    except (OSError, IndexError):
        pass
    try:
        import resource
    except ImportError:  # no such count on Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
