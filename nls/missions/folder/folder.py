"""Which files of a mission a folder has, each read as the table it must be; what is missing or not read is said."""

from __future__ import annotations

import os
import shlex
from difflib import get_close_matches
from pathlib import Path

from models.advice import Advice
from models.errors import GraphFileError
from models.listing import some
from nls.io.files import unreadable
from nls.io.formats import suffixes
from nls.io.report import LoadReport
from nls.io.unused_lines import note_comments
from nls.missions.folder.columns import ALONE, BESIDE, COLUMNS, LOG, TRACK, needed, optional
from nls.missions.folder.report import MissionReport
from nls.missions.folder.table import Table

NOT_MISSED = ("README.txt", "mapping.toml", "templates", "graph.npz", "truth.npz")  # for people; the graph in one file
EXPECTED = (
    "a mission is odometry.csv and zpr.csv, or dvl.csv, ahrs.csv, depth.csv (or pressure.csv) and noise.csv, or "
    "path.csv, or motion.csv (and ahrs.csv, depth.csv, and then noise.csv), with contacts.csv and sonar.csv, both or "
    "none of these two; a scan mission is "
    "keyframes.csv and scans.csv"
)


def read_tables(folder: str | Path) -> tuple[dict[str, Table], MissionReport]:
    """The tables of a mission folder by name, and a report that counts their rows and names what was not read.

    Raises
    ------
    GraphFileError
        No mission, or not all of one; a file that is not the table its name says.
    """
    path, names = Path(folder), names_in(folder)
    files: dict[str, Path] = {}
    other_files = []
    for name in names:
        table = name.removesuffix(".gz").removesuffix(".csv")
        if name not in (f"{table}.csv", f"{table}.csv.gz") or table not in COLUMNS:
            other_files.append(name)
        elif table in files:
            raise GraphFileError(f"there is {files[table].name} beside it; leave one of them", str(path / name))
        else:
            files[table] = _regular(path / name)
    _refuse_parts(str(folder), set(files), other_files)

    tables = {name: Table(file, COLUMNS[name], optional(name, files)) for name, file in files.items()}
    report = report_of(folder, tables)
    note_comments(report, sum(table.comments for table in tables.values()))
    note_others(report, "mission", [name for name in other_files if name not in NOT_MISSED], list(COLUMNS))
    return tables, report


def note_others(report: LoadReport, noun: str, others: list[str], expected: list[str]) -> None:
    """Name the files that were not read: CSV files in a warning, other files of data in a note."""
    if tabular := [name for name in others if ".csv" in name.lower()]:
        report.warn(f"no file of a {noun}, not read: {_listed(tabular)}; expected names: {_listed(expected)}")
    if unread := [name for name in others if name not in tabular]:
        report.notes.append(f"not read: {_listed(unread)}")


def names_in(folder: str | Path) -> list[str]:
    """The names of the files in a folder, sorted.

    Raises
    ------
    GraphFileError
        It cannot be read.
    """
    try:
        return sorted(os.listdir(folder))
    except OSError as error:
        raise unreadable(folder, error) from error


def report_of(folder: str | Path, tables: dict[str, Table]) -> MissionReport:
    """A report that counts the rows of tables."""
    report = MissionReport(str(folder), "mission", "3-D", "log", vertices_given=False, reason="a folder")
    report.tags = {f"{name}.csv": len(table) for name, table in tables.items()}
    return report


def _regular(file: Path) -> Path:
    """Refuse a pipe or a device, which would be waited for; what a folder or a lost link is, reading says."""
    if file.exists() and not (file.is_file() or file.is_dir()):
        raise GraphFileError("is a pipe or a device; expected a file", str(file))
    return file


def _refuse_parts(folder: str, files: set[str], other_files: list[str]) -> None:
    """Refuse a folder that is no mission, half of one or two in one."""
    if not files & {*TRACK, *LOG, "pressure", *ALONE}:
        contents = f"it has {_listed(sorted(files) + other_files)}" if files or other_files else "it is empty"
        endings = {name: Path(name.removesuffix(".gz")).suffix for name in other_files}
        graphs = [name for name, suffix in endings.items() if suffix in suffixes() and suffix != ".csv"]
        advice = [Advice("read file", (os.path.join(folder, name),)) for name in graphs[:1]]
        logs = [name for name, suffix in endings.items() if suffix in (".csv", ".txt", ".bag", ".mcap")]
        if logs and not advice:
            advice = [Advice("import", (shlex.quote(os.path.join(folder, logs[0])),)), Advice("template")]
        raise GraphFileError(f"is a folder, but no mission: {EXPECTED}; {contents}", folder, advice=advice)
    if (track := files & set(TRACK)) and (log := files & {*LOG, *BESIDE}):
        compass = "; the headings of a compass go into zpr.csv, columns yaw_rad and sigma_yaw_rad" * ("ahrs" in log)
        cure = f"leave either the integrated odometry or the raw log{compass}"
        raise GraphFileError(f"has {sorted(track)[0]}.csv and {sorted(log)[0]}.csv, the same way twice; {cure}", folder)
    if {"depth", "pressure"} <= files:
        raise GraphFileError("has depth.csv and pressure.csv, the depth twice; leave one of them", folder)
    for name, beside in ALONE.items():
        if name in files and (other := files & ({*TRACK, *LOG, *BESIDE, *ALONE, "poses"} - {name, *beside})):
            cure = "leave one of them"
            raise GraphFileError(f"has {name}.csv and {sorted(other)[0]}.csv, the same way twice; {cure}", folder)
    if (missing := [name for name in needed(files) if name not in files]) and "motion" not in files:
        message = f"has no {missing[0]}.csv; {EXPECTED}{_near_miss(missing[0], other_files)}"
        raise GraphFileError(message, folder, advice=[Advice("template")])
    for present, name, says in (
        ("contacts", "sonar", "what sonar saw them, and from where"),
        ("sonar", "contacts", "what the sonar saw; leave sonar.csv out where it saw nothing"),
    ):
        if present in files and name not in files:
            rest = f"which says {says}{_near_miss(name, other_files)}"
            raise GraphFileError(f"has {present}.csv and no {name}.csv, {rest}", folder)


def _near_miss(name: str, other_files: list[str]) -> str:
    """Names a file that is not read and may be meant for the one that is missing."""
    near = {file.lower().removesuffix(".gz").removesuffix(".csv").strip(): file for file in other_files}
    close = get_close_matches(name, near, n=1, cutoff=0.8)
    return f"; is it {_listed([near[close[0]]])}? names are written as here" if close else ""


def _listed(names: list[str]) -> str:
    return some([repr(name)[1:-1] for name in names], 12)
