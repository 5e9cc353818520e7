"""Public logs of vehicles, from the file to a chart: edits of the draft, messages, exit status, and what came out.

    python benchmarks/evidence/public_logs.py --logs DIR [--out DIR]

The logs are not shipped. ``public_logs/logs.toml`` names the repository, the commit and the path of each. Without
``--logs`` the commands that get them are printed. Its numbers of minutes and refusals are of the one who wrote the
mappings beside it, by the file, the documentation and the messages alone. All others are measured here.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
from script import make_page, markdown

from models.algebra import Array
from models.geodesy import LocalPlane

FOLDER = Path(__file__).with_suffix("")
SECONDS = 600  # for a command


@dataclass(frozen=True)
class Log:
    """A log, where it comes from, and what its reader has noted."""

    name: str
    vehicle: str
    repository: str
    commit: str
    license: str
    files: dict[str, str]
    first_edits: int
    minutes: float
    refused: int
    found: str

    @property
    def mapping(self) -> Path:
        """The mapping that was kept."""
        return FOLDER / f"{self.name}.toml"

    def commands(self) -> list[str]:
        """Lines of a shell that get its files."""
        clone = self.repository.replace("/", "+")
        show = [f'git -C {clone} show "{self.commit}:{path}" > {name}' for name, path in self.files.items()]
        return [f"git clone https://github.com/{self.repository} {clone}", *show]


@dataclass(frozen=True)
class Run:
    """A command: exit status, lines of its two outputs, processor time in s."""

    status: int
    lines: list[str]
    seconds: float

    def said(self, *kinds: str) -> list[str]:
        """Texts of the lines of some kinds."""
        return [text for kind, text in map(kind_of, self.lines) if kind in kinds]

    @property
    def notes(self) -> list[str]:
        """Notes and warnings."""
        return self.said("note", "warning")

    @property
    def refusal(self) -> str:
        """The line that ended it; empty where it ran through."""
        return next(iter(self.said("error")), "")

    @property
    def result(self) -> str:
        """The verdict on convergence, and its doubt."""
        text = next(iter(self.said("result")), "")
        verdict, but, doubt = text.partition("; but ")
        return f"{verdict.partition(':')[0]}{but}{doubt}"


def kind_of(line: str) -> tuple[str, str]:
    """The kind of a line of output, such as ``note``, and its text."""
    if line.startswith("nls: warning: "):
        return "warning", line.removeprefix("nls: warning: ")
    if line.startswith("nls: "):
        return "error", line.removeprefix("nls: ")
    kind, _, text = line.partition(" ")
    return kind, text.strip()


def nls(*words: str | Path) -> Run:
    """Runs a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "nls", *map(str, words)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=SECONDS)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Run(done.returncode, [*done.stdout.splitlines(), *done.stderr.splitlines()], seconds)


# --- The mapping against the draft ------------------------------------------------------------------------------------


def entries(mapping: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Keys of a mapping, of all its sections, with their values; ``file`` is left out."""
    for key, value in mapping.items():
        if not isinstance(value, dict) or key in ("where", "time_s"):
            yield key, value
            continue
        yield from ((f"{key}.{column}", cell) for column, cell in value.items() if column != "file")


def edits(draft: str, kept: str) -> int:
    """Lines that were added, changed, or left out; a section that was left out whole is one."""
    old, new = (dict(entries(tomllib.loads(text))) for text in (draft, kept))
    changed = sum(key not in old or old[key] != value for key, value in new.items())
    sections = {key.partition(".")[0] for key in new}
    gone = [key for key in old if key not in new]
    whole = {key.partition(".")[0] for key in gone} - sections
    return changed + len(whole) + sum(key.partition(".")[0] in sections for key in gone)


# --- The solution against the fixes -----------------------------------------------------------------------------------


def table(file: Path) -> npt.NDArray[Any]:
    """A table of a mission with its names."""
    return np.atleast_1d(np.genfromtxt(file, delimiter=",", names=True))


def positions(mission: Path, rows: npt.NDArray[Any]) -> Array:
    """North and east of the rows of a table, (n, 2), m."""
    if "x_m" in (rows.dtype.names or ()):
        return np.stack([rows["x_m"], rows["y_m"]], axis=1)
    plane = LocalPlane(*np.loadtxt(mission / "origin.csv", delimiter=",", skiprows=1, ndmin=1)[:2])
    return np.asarray(plane.local(rows["lat_deg"], rows["lon_deg"]))


def against(mission: Path, solved: Path) -> tuple[float, float]:
    """Diagonal of the solution from above, and median distance from the truth of the log or else its fixes, m."""
    track = table(solved / "trajectory.csv")
    own = next(file for name in ("truth.csv", "fixes.csv") if (file := mission / name).exists())
    rows, way = table(own), positions(mission, track)
    inside = (rows["time_s"] >= track["time_s"][0]) & (rows["time_s"] <= track["time_s"][-1])
    at = [np.interp(rows["time_s"][inside], track["time_s"], way[:, k]) for k in range(2)]
    off = np.linalg.norm(positions(mission, rows)[inside] - np.stack(at, axis=1), axis=1)
    return float(np.linalg.norm(np.ptp(way, axis=0))), float(np.median(off))


# --- The page ---------------------------------------------------------------------------------------------------------


def count(file: Path) -> int:
    """Lines of a text."""
    return sum(1 for _ in file.open("rb"))


def imported(log: Log, logs: Path, folder: Path) -> tuple[list[Any], list[str]]:
    """The row of a log, and what was said of it: the refusal, or the result and the warnings."""
    paths, mission = [logs / name for name in log.files], folder / log.name
    draft = nls("import", *paths)
    text = "\n".join(line for line in draft.lines if not line.startswith("nls: ")) if draft.status == 0 else ""
    taken = nls("import", *paths, "--map", log.mapping, "-o", mission)
    done = nls("solve", mission, "-o", mission / "solved") if taken.status == 0 else taken
    solved = (mission / "solved" / "trajectory.csv").exists()
    span, off = (f"{number:.3g}" for number in against(mission, mission / "solved")) if solved else ("", "")
    now = f"{'' if text else 'no draft, '}{edits(text, log.mapping.read_text(encoding='utf-8'))}"
    row = [log.name, sum(map(count, paths)), log.first_edits, log.refused, f"{log.minutes:g}", now]
    row += [f"{len(taken.notes)}, {len(done.notes)}", f"{taken.status}, {done.status}"]
    row += [f"{draft.seconds + taken.seconds + done.seconds:.1f}", span, off]
    doubts = [line for line in done.notes if "implausible" in line]
    said = [done.refusal] if done.status == 2 else [done.result, *doubts]
    return row, [line.replace(f"{folder}/", "").replace(f"{logs}/", "").replace(f"{FOLDER}/", "") for line in said]


ORIGINS = ["log", "vehicle", "repository on github.com", "commit", "path", "license"]
NUMBERS = ["log", "lines", "edits", "refused", "min", "edits now", "notes", "exit", "s", "span [m]", "off [m]"]
LEGEND = """\
A person who knew the page on imports, but not the log, noted *edits*, *refused* and *min* at the first import.
*Edits*: lines of the mapping that differed from the draft. *Refused*: commands that ended in an error. *Min*: minutes
from the first look at the file to a plausible chart. This program measures the other columns. *Edits now* count
from its draft. *Notes* and *exit* are of `nls import` and of `nls solve`, with their warnings. *s*: processor time of
draft, import and solution. *Span* is the diagonal of the track. *Off* is the median distance from the log's own
truth, or else from its own fixes. All logs are right as these mappings read them: an exit status of 1 is a false alarm.
"""


def page(logs: Path | None) -> list[str]:
    """Origins, numbers, and what the charts showed."""
    text = (FOLDER / "logs.toml").read_text(encoding="utf-8")
    all_logs = [Log(**entry) for entry in tomllib.loads(text)["log"]]
    if not logs:
        print("the logs are not shipped; in a folder, which --logs then names:")
        print(*(line for log in all_logs for line in log.commands()), sep="\n")
        raise SystemExit
    rows, words = [], []
    for log in all_logs:
        with TemporaryDirectory() as folder:
            row, said = imported(log, logs, Path(folder))
        rows.append(row)
        words += [f"- **{log.name}**: {log.found}.", *(f"  `{line}`" for line in said)]
    origins = [
        [log.name, log.vehicle, log.repository, f"`{log.commit[:10]}`", ", ".join(log.files.values()), log.license]
        for log in all_logs
    ]
    lines = [*markdown(NUMBERS, rows), LEGEND, "What the charts showed, and the result:", "\n".join(words)]
    return [*lines, "The logs:", *markdown(ORIGINS, origins, 6)]


if __name__ == "__main__":
    where = {"type": Path, "metavar": "DIR", "help": "folder of the logs"}
    make_page("Public logs, from the file to the chart", page, logs=where)
